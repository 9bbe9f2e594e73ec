-- Identity of this database: ingests of one broker compare it. A copy of the database has the same.
CREATE TABLE altd.identity (id text NOT NULL);
INSERT INTO altd.identity VALUES (gen_random_uuid());
