-- Tables of the fleet. All times are UTC. Each migration runs once, in one transaction.

CREATE TABLE altd.units (
    id integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    serial text NOT NULL UNIQUE,
    last_time timestamptz,      -- of the newest summary of the unit
    heard timestamptz,          -- when that was written
    worst smallint,             -- its severity, 0 good to 4 failure, and the cause
    cause text
);

-- A file is a history of a unit: sequences count within it.
CREATE TABLE altd.files (
    id integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    unit integer NOT NULL,
    file text NOT NULL,
    dropped bigint NOT NULL DEFAULT 0,  -- by the unit, before they were acknowledged
    UNIQUE (unit, file)
);

-- A stream is one opening of a file: the sequences that were received in it, or that the unit has no more.
CREATE TABLE altd.streams (
    unit integer NOT NULL,
    stream text NOT NULL,
    received int8multirange NOT NULL,
    seen bigint NOT NULL,       -- the highest sequence of a batch
    newest bigint NOT NULL,     -- the highest that the unit had then
    updated timestamptz NOT NULL DEFAULT now(),
    PRIMARY KEY (unit, stream)
);

-- The highest sequence below which none is missing.
CREATE FUNCTION altd.contiguous(received int8multirange) RETURNS bigint LANGUAGE sql IMMUTABLE AS $$
    SELECT coalesce((SELECT upper(part) - 1 FROM unnest(received) AS part WHERE part @> 1::bigint), 0)
$$;

CREATE TABLE altd.seconds (
    unit integer NOT NULL,
    time timestamptz NOT NULL,  -- the second of UTC, by the unit's clock
    file integer NOT NULL,
    sequence bigint NOT NULL,
    boot integer NOT NULL,      -- counts the starts of the daemon and the settings of its clock
    n integer NOT NULL,
    n_valid integer NOT NULL,
    worst smallint NOT NULL,
    cause text NOT NULL,
    lost_to text NOT NULL,
    quantities jsonb NOT NULL,  -- {"x_mm": [mean, sigma, lowest, highest], ...}
    received timestamptz NOT NULL DEFAULT now(),
    PRIMARY KEY (unit, time, file, sequence)
) PARTITION BY RANGE (time);
CREATE TABLE altd.seconds_other PARTITION OF altd.seconds DEFAULT;  -- of clocks that were wrong

CREATE TABLE altd.minutes (
    unit integer NOT NULL,
    time timestamptz NOT NULL,
    seconds integer NOT NULL,
    n bigint NOT NULL,
    n_valid bigint NOT NULL,
    worst smallint NOT NULL,
    quantities jsonb NOT NULL,
    PRIMARY KEY (unit, time)
);
CREATE INDEX ON altd.minutes USING brin (time);
CREATE TABLE altd.hours (LIKE altd.minutes INCLUDING ALL);

-- Hours of a unit whose roll-ups lack seconds.
CREATE TABLE altd.stale (
    unit integer NOT NULL,
    hour timestamptz NOT NULL,
    marked timestamptz NOT NULL DEFAULT now(),
    PRIMARY KEY (unit, hour)
);

-- Messages that were refused, by unit ('' of units that are not known) and reason.
CREATE TABLE altd.refused (
    unit text NOT NULL,
    reason text NOT NULL,
    count bigint NOT NULL,
    last timestamptz NOT NULL DEFAULT now(),
    PRIMARY KEY (unit, reason)
);

-- The partition of a day; rows of that day that a wrong clock wrote before are moved into it.
CREATE FUNCTION altd.make_day(day timestamptz) RETURNS void LANGUAGE plpgsql AS $$
DECLARE
    name text := 'seconds_' || to_char(day AT TIME ZONE 'UTC', 'YYYYMMDD');
    ends timestamptz := day + interval '24 hours';
BEGIN
    PERFORM pg_advisory_xact_lock(hashtext('altd.make_day'));
    IF to_regclass('altd.' || name) IS NOT NULL THEN
        RETURN;
    END IF;
    LOCK TABLE altd.seconds_other IN ACCESS EXCLUSIVE MODE;
    EXECUTE format('CREATE TABLE altd.%I (LIKE altd.seconds INCLUDING ALL)', name);
    EXECUTE format('WITH moved AS (DELETE FROM altd.seconds_other WHERE time >= $1 AND time < $2 RETURNING *) '
        'INSERT INTO altd.%I SELECT * FROM moved', name) USING day, ends;
    EXECUTE format('ALTER TABLE altd.seconds ATTACH PARTITION altd.%I FOR VALUES FROM (%L) TO (%L)', name, day, ends);
END $$;

-- Sums of a unit's seconds by minute or hour. Means are weighted by the valid measurements; of a second without
-- any, a sensor's value by all.
CREATE FUNCTION altd.sums(of_unit integer, begins timestamptz, ends timestamptz, span text)
RETURNS SETOF altd.minutes LANGUAGE sql STABLE AS $$
    WITH spans AS MATERIALIZED (
        SELECT date_trunc(span, s.time, 'UTC') AS at, s.n, s.n_valid, s.worst, s.quantities
        FROM altd.seconds AS s WHERE s.unit = of_unit AND s.time >= begins AND s.time < ends
    ), known AS (
        SELECT at, key, coalesce(nullif(n_valid, 0), n)::float8 AS weight, (value->>0)::float8 AS mean,
            (value->>1)::float8 AS sigma, (value->>2)::float8 AS low, (value->>3)::float8 AS high
        FROM spans, jsonb_each(quantities)
    ), merged AS (
        SELECT at, key, jsonb_build_array(
            round((sum(mean * weight) / sum(weight))::numeric, 9),
            round(sqrt(sum(sigma * sigma * weight) / sum(weight) FILTER (WHERE sigma IS NOT NULL))::numeric, 9),
            min(low), max(high)) AS value
        FROM known WHERE weight > 0 GROUP BY at, key
    ), documents AS (
        SELECT at, jsonb_object_agg(key, value) AS document FROM merged GROUP BY at
    )
    SELECT of_unit, at, count(*)::integer, sum(n), sum(n_valid), max(worst),
        coalesce((SELECT document FROM documents WHERE documents.at = spans.at), '{}')
    FROM spans GROUP BY at
$$;

-- Roll up the first stale hour that is over, of the first such unit with an id above "after". Each unit has its turn,
-- so that one with many stale hours delays itself alone. Returns its id; null: there is none. The unit's row is locked:
-- no second of the unit is written between the deletion of the mark and the sums.
CREATE FUNCTION altd.roll_up(after integer, settled interval DEFAULT '1 minute') RETURNS integer LANGUAGE plpgsql AS $$
DECLARE
    of_unit integer;
    begins timestamptz;
    ends timestamptz;
BEGIN
    SELECT unit, hour INTO of_unit, begins FROM altd.stale
        WHERE unit > after AND marked <= now() - settled
            AND NOT (hour > now() - settled - interval '1 hour' AND hour <= now())
        ORDER BY unit, hour LIMIT 1;
    IF of_unit IS NULL THEN
        RETURN NULL;
    END IF;
    ends := begins + interval '1 hour';
    PERFORM 1 FROM altd.units WHERE id = of_unit FOR UPDATE;
    DELETE FROM altd.stale WHERE unit = of_unit AND hour = begins;
    BEGIN
        INSERT INTO altd.minutes AS old SELECT * FROM altd.sums(of_unit, begins, ends, 'minute')
            ON CONFLICT (unit, time) DO UPDATE SET seconds = excluded.seconds, n = excluded.n,
                n_valid = excluded.n_valid, worst = excluded.worst, quantities = excluded.quantities
            WHERE excluded.seconds >= old.seconds;
        INSERT INTO altd.hours AS old SELECT * FROM altd.sums(of_unit, begins, ends, 'hour')
            ON CONFLICT (unit, time) DO UPDATE SET seconds = excluded.seconds, n = excluded.n,
                n_valid = excluded.n_valid, worst = excluded.worst, quantities = excluded.quantities
            WHERE excluded.seconds >= old.seconds;
    EXCEPTION WHEN data_exception THEN  -- values that no unit sends, such as 1e308: they must not end the maintenance
        INSERT INTO altd.refused AS old (unit, reason, count) SELECT serial, 'database', 1 FROM altd.units
            WHERE id = of_unit ON CONFLICT (unit, reason) DO UPDATE SET count = old.count + 1, last = now();
    END;
    RETURN of_unit;
END $$;

-- Delete what is old: seconds and minutes by their age; hours stay. Rows of wrong clocks count from their arrival.
CREATE FUNCTION altd.retain(seconds_days integer, minutes_days integer) RETURNS void LANGUAGE plpgsql AS $$
DECLARE
    name text;
BEGIN
    FOR name IN
        SELECT relname FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid
        WHERE inhparent = 'altd.seconds'::regclass AND relname ~ '^seconds_\d{8}$'
            AND to_date(right(relname, 8), 'YYYYMMDD') + 1 < (now() AT TIME ZONE 'UTC')::date - seconds_days
    LOOP
        EXECUTE format('DROP TABLE altd.%I', name);
    END LOOP;
    DELETE FROM altd.seconds_other WHERE received < now() - make_interval(days => seconds_days);
    DELETE FROM altd.minutes WHERE time < now() - make_interval(days => minutes_days);
    DELETE FROM altd.streams AS old WHERE updated < now() - interval '31 days' AND EXISTS (
        SELECT FROM altd.streams AS newer WHERE newer.unit = old.unit AND newer.updated > old.updated);
END $$;

-- All units: age of the newest summary, by the clock that makes it older, for the unit's may be ahead; share of time
-- with a valid measurement in the hour up to that summary, for a new unit since its first one; seconds still kept.
CREATE VIEW altd.fleet AS
    SELECT units.serial AS unit, units.last_time, units.heard, units.worst, units.cause,
        extract(epoch FROM now() - least(units.last_time, units.heard))::float8 AS lag_s, hour.valid_share,
        stream.backlog, coalesce(kept.dropped, 0)::bigint AS dropped, coalesce(wrong.refused, 0)::bigint AS refused
    FROM altd.units
    LEFT JOIN LATERAL (
        SELECT least(1, coalesce(sum(n_valid::float8 / nullif(n, 0)), 0) / CASE
            WHEN EXISTS (SELECT FROM altd.hours WHERE unit = units.id AND time <= units.last_time - interval '2 hours')
            THEN 3600 ELSE extract(epoch FROM units.last_time - min(time))::float8 + 1 END) AS valid_share
        FROM altd.seconds
        WHERE unit = units.id AND time > units.last_time - interval '1 hour' AND time <= units.last_time
        HAVING count(*) > 0
    ) AS hour ON true
    LEFT JOIN LATERAL (
        SELECT newest - altd.contiguous(received) AS backlog FROM altd.streams
        WHERE unit = units.id ORDER BY updated DESC LIMIT 1
    ) AS stream ON true
    LEFT JOIN LATERAL (
        SELECT least(sum(dropped), 2::numeric ^ 63 - 1) AS dropped FROM altd.files WHERE unit = units.id
    ) AS kept ON true
    LEFT JOIN LATERAL (
        SELECT sum(count) AS refused FROM altd.refused WHERE refused.unit = units.serial
    ) AS wrong ON true
    ORDER BY units.serial;
