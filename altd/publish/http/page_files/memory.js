// Measurements of the last minutes, for their trends: those that this page received, and the unit's history between them.

export const LENGTH_S = 600, MIN_STEP_S = 0.24;

// Four a second at most; a gap of both stays a gap.
export class Memory {
  constructor() { this.clear(); }

  clear() { this.live = []; this.past = []; }

  // `serial`: of the unit that answers, where it is known; another one may not have measured anything yet
  add(measurement, serial) {
    if (serial && serial !== this.serial) {
      if (this.serial) this.clear();
      this.serial = serial;
    }
    if (!measurement?.time) return;
    const t = Date.parse(measurement.time) / 1000, last = this.live.at(-1);
    // a clock that was set, a recording that begins again, or another unit at this address
    if (last && (t < last.t || measurement.unit !== last.measurement.unit)) this.clear();
    else if (last && t - last.t < MIN_STEP_S && last.valid === measurement.valid) return;
    this.live.push({ t, valid: measurement.valid, measurement });
    while (this.live.length && this.live[0].t < t - LENGTH_S) this.live.shift();
  }

  // `trend` of the unit's history; points without measurements are gaps.
  fill(trend) {
    const of = (part, number) => Object.fromEntries(Object.entries(trend.quantities).map(([key, columns]) => [key, columns[part][number]]));
    this.past = trend.t_s.flatMap((t, number) => trend.n[number] === 0 ? [] : [{ t: t + trend.span_s / 2,
      valid: trend.n_valid[number] === trend.n[number], measurement: { ...of("mean", number), sigma: of("sigma", number) } }]);
  }

  get rows() {
    const end = this.live.at(-1)?.t ?? this.past.at(-1)?.t ?? 0, seen = new Set(this.live.map(row => Math.floor(row.t)));
    const past = this.past.filter(row => row.t < end && row.t > end - LENGTH_S && !seen.has(Math.floor(row.t)));
    return [...past, ...this.live].sort((one, other) => one.t - other.t);
  }

  columns(key) {
    const t = [], value = [], low = [], high = [];
    let before = null;
    for (const row of this.rows) {
      if (before !== null && row.t - before > 2) { t.push(before + 0.001); value.push(null); low.push(null); high.push(null); }
      const v = row.measurement[key] ?? null, s = row.measurement.sigma?.[key] ?? null;
      t.push(row.t); value.push(v);
      low.push(v === null || s === null ? null : v - 2 * s);
      high.push(v === null || s === null ? null : v + 2 * s);
      before = row.t;
    }
    return [t, value, low, high];
  }
}
