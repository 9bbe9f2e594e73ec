// Numbers and states as a person reads them.

export const UNKNOWN = "–";

export const QUANTITIES = typeof document === "undefined" ? []
  : JSON.parse(document.getElementById("quantities").textContent);

export function fixed(value, decimals) {
  if (value === null || value === undefined) return UNKNOWN;
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

// What a unit of the quantity that has the uncertainty is in the unit of this one: a slope is the tangent of an angle.
function scaleOf(measurement, { key, unit, is_also }) {
  if (!is_also) return 1;
  return unit === "mm/m" ? (1000 + measurement[key] ** 2 / 1000) * Math.PI / 180 : null;
}

// The uncertainty as a statement about now; at rest where nobody knows how the beam moves.
export function sigmaOf(measurement, quantity) {
  const key = quantity.is_also || quantity.key;
  const then = measurement?.sigma?.[key] ?? null, now = measurement?.sigma_now?.[key] ?? null;
  const scale = then === null ? null : scaleOf(measurement, quantity);
  if (scale === null) return "";
  return `± ${fixed((now ?? then) * scale, quantity.decimals)} (${now === null ? "at rest" : "1σ"})`;
}

export function duration(seconds) {
  const minutes = seconds / 60, hours = seconds / 3600, days = seconds / 86400;
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (minutes < 1) return `${Math.floor(seconds)} s`;
  if (hours < 1) return `${Math.floor(minutes)} min`;
  if (days < 1) return `${Math.floor(hours)} h ${Math.floor(minutes % 60)} min`;
  return `${Math.floor(days)} d ${Math.floor(hours % 24)} h`;
}

// "1 frame", "2 frames".
export const counted = (number, thing) => `${number} ${thing}${number === 1 ? "" : "s"}`;

export function megabytes(bytes) {
  return `${(bytes / 1e6).toFixed(1)} MB`;
}

// The signals of NAMUR NE 107 beside good, each with a shape, for who sees no colours.
export const SIGNALS = {
  good: { words: "good", mark: "✓" },
  maintenance_required: { words: "maintenance required", mark: "◆" },
  out_of_specification: { words: "out of specification", mark: "▲" },
  check_function: { words: "check function", mark: "▼" },
  failure: { words: "failure", mark: "✕" },
};

// A time of the unit to the second; its zone stands beside it.
export const utc = time => time?.slice(0, 19).replace("T", " ") ?? "not known";

export const words = code => code.replaceAll("_", " ");

// What is shown of the measurement in one line, and how it is meant: good, warned, bad or unknown.
export function verdictOf({ words: lost, measurement }) {
  if (lost || !measurement) return { kind: "unknown", text: lost || "connecting…" };
  if (!measurement.valid) return { kind: "bad", text: "not valid" };
  if (measurement.status.some(code => code === "playback" || code === "simulated")) {
    return { kind: "warned", text: "NOT LIVE" };
  }
  return measurement.status.length ? { kind: "warned", text: "valid, with warnings" } : { kind: "good", text: "valid" };
}
