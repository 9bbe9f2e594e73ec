// Numbers and states as text.

export const UNKNOWN = "–";

export const QUANTITIES = typeof document === "undefined" ? []
  : JSON.parse(document.getElementById("quantities").textContent);

export function fixed(value, decimals) {
  if (value === null || value === undefined) return UNKNOWN;
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

// From the unit of the quantity that has the uncertainty to the unit of this one: a slope is the tangent of an angle.
function scaleOf(measurement, { key, unit, is_also }) {
  if (!is_also) return 1;
  return unit === "mm/m" ? (1000 + measurement[key] ** 2 / 1000) * Math.PI / 180 : null;
}

const MOVING_SIGMAS = 3;

// Both uncertainties of one measurement: of the mean, and of the beam at the moment of sending. Empty without a value.
export function sigmaOf(measurement, quantity) {
  const key = quantity.is_also || quantity.key;
  const mean = measurement?.sigma?.[key] ?? null, now = measurement?.sigma_now?.[key] ?? null;
  const scale = mean === null || measurement[key] == null ? null : scaleOf(measurement, quantity);
  if (scale === null) return "";
  const rate = measurement.rates?.[`${key}_per_s`] ?? null, rateSigma = measurement.rates?.sigma?.[`${key}_per_s`] ?? null;
  const isMoving = rate !== null && rateSigma !== null && Math.abs(rate) > MOVING_SIGMAS * rateSigma;
  if (!quantity.has_motion) return `±\u00a0${fixed(mean * scale, quantity.decimals)}`;
  const digits = now === null ? 0 : 1 - Math.floor(Math.log10(now * scale));  // two significant ones
  return `±\u00a0${fixed(mean * scale, quantity.decimals)} (mean), ${now === null ? "now not known"
    : `±\u00a0${fixed(now * scale, Math.max(0, Math.min(digits, quantity.decimals)))} now`}${isMoving ? ", moving" : ""}`;
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

// Good and the signals of NAMUR NE 107, the worst last; each has a shape for colour-blind readers.
export const SIGNALS = {
  good: { words: "good", mark: "✓" },
  maintenance_required: { words: "maintenance required", mark: "◆" },
  out_of_specification: { words: "out of specification", mark: "▲" },
  check_function: { words: "check function", mark: "▼" },
  failure: { words: "failure", mark: "✕" },
};

// A time of the unit to the second; its zone is written next to it.
export const utc = time => time?.slice(0, 19).replace("T", " ") ?? "not known";

// The same in a time zone, by its IANA name; null without a zone, and for one that this browser does not know.
export function local(time, zone) {
  if (!zone || !time) return null;
  try {
    return new Intl.DateTimeFormat("sv", { timeZone: zone, dateStyle: "short", timeStyle: "medium" }).format(new Date(time));
  } catch {
    return null;
  }
}

export const words = code => code.replaceAll("_", " ");

// Causes of frames that are not from cameras; the verdict names them.
export const ORIGINS = ["simulated", "playback", "rehearsal"];

// What the measurement is worth in one line, with its kind: good, warned, bad or unknown.
export function verdictOf({ words: lost, measurement }) {
  if (lost || !measurement) return { kind: "unknown", text: lost || "connecting…" };
  if (!measurement.valid) return { kind: "bad", text: "not valid" };
  const origin = ORIGINS.find(code => measurement.status.includes(code));
  if (origin) return { kind: "warned", text: origin.toUpperCase() };
  return measurement.status.length ? { kind: "warned", text: "valid, with warnings" } : { kind: "good", text: "valid" };
}
