// Measurements of this page's life, for the trends of the last minutes.

export const LENGTH_S = 600, MIN_STEP_S = 0.24;

// Four a second at most; a gap stays a gap.
export class Memory {
  constructor() { this.rows = []; }

  // `serial`: of the unit that answers, where it is known; another one may not have measured anything yet
  add(measurement, serial) {
    if (serial && serial !== this.serial) {
      if (this.serial) this.rows = [];
      this.serial = serial;
    }
    if (!measurement?.time) return;
    const t = Date.parse(measurement.time) / 1000, last = this.rows.at(-1);
    // a clock that was set, a recording that begins again, or another unit at this address
    if (last && (t < last.t || measurement.unit !== last.measurement.unit)) this.rows = [];
    else if (last && t - last.t < MIN_STEP_S && last.valid === measurement.valid) return;
    this.rows.push({ t, valid: measurement.valid, measurement });
    while (this.rows.length && this.rows[0].t < t - LENGTH_S) this.rows.shift();
  }

  columns(key) {
    const t = [], value = [], low = [], high = [];
    let before = null;
    for (const row of this.rows) {
      if (before !== null && row.t - before > 2) { t.push(before + 0.001); value.push(null); low.push(null); high.push(null); }
      const v = row.measurement[key] ?? null, s = row.measurement.sigma_now?.[key] ?? row.measurement.sigma?.[key] ?? null;
      t.push(row.t); value.push(v);
      low.push(v === null || s === null ? null : v - 2 * s);
      high.push(v === null || s === null ? null : v + 2 * s);
      before = row.t;
    }
    return [t, value, low, high];
  }
}
