// Self-checks: the last one, earlier ones, and how far the frame LEDs have moved since the calibration.

import { html } from "./vendor/htm-preact.js";
import { useAnswer } from "./acting.js";
import { Plot } from "./plot.js";
import { UNKNOWN, fixed, utc, words } from "./words.js";

const ASK_MS = 10000, SHOWN = 20, DRAWN = 200, MIN_SPAN_PX = 0.2, DOTS = { show: true, size: 5 };

export function SelfCheck({ check, children }) {
  if (!check) return html`<section aria-labelledby="check-title"><h2 id="check-title">Self-check</h2><p>not known</p></section>`;
  const targets = Object.entries(check.targets ?? {});
  return html`<section aria-labelledby="check-title"><h2 id="check-title">Self-check</h2>
    <p><strong>${check.verdict ?? "none"}</strong>${check.reasons?.length && !check.unavailable ? `: ${check.reasons.map(words).join(", ")}` : ""}</p>
    ${targets.length > 0 && html`<table><thead><tr><th scope="col">target</th><th scope="col">LEDs</th><th scope="col">shift, px</th>
      <th scope="col">turn, °</th></tr></thead><tbody>${targets.map(([name, target]) => html`<tr key=${name}><th scope="row">${name}</th>
      <td>${target.leds_found} of ${target.leds_expected}</td>
      <td>${target.shift_px ? target.shift_px.map(value => fixed(value, 2)).join(", ") : UNKNOWN}</td>
      <td>${fixed(target.turn_deg, 3)}</td></tr>`)}</tbody></table>`}${children}</section>`;
}

const isShift = shift => Array.isArray(shift) && shift.length === 2 && shift.every(Number.isFinite);

const shiftsIn = ({ shift_px: shifts }) => shifts !== null && typeof shifts === "object" ? shifts : {};

// Columns t, u, v of the checks of one target, the oldest first; null where its LEDs were not found.
export function shiftsOf(events, target) {
  const columns = [[], [], []];
  for (const { time, detail } of [...events].reverse()) {
    const shifts = shiftsIn(detail);
    if (!time || !(target in shifts)) continue;
    const [u, v] = isShift(shifts[target]) ? shifts[target] : [null, null], t = Date.parse(time) / 1000;
    if (columns[0].length && t <= columns[0].at(-1)) continue;  // the clock was set
    [t, u, v].forEach((value, number) => columns[number].push(value));
  }
  return columns;
}

// The scatter of checks must not look like a drift.
function rangeOf(_, low, high) {
  const add = Math.max((MIN_SPAN_PX - (high - low)) / 2, 0.05 * (high - low));
  return [low - add, high + add];
}

const linesOf = colour => [{ stroke: colour("--accent"), width: 1.5, points: DOTS },
  { stroke: colour("--warned"), width: 1.5, dash: [6, 4], points: DOTS }];

export function PastChecks() {
  const answer = useAnswer(`api/v1/events?kind=self_check&limit=${DRAWN}`, ASK_MS);
  const events = answer?.events ?? [];
  const targets = [...new Set(events.flatMap(({ detail }) => Object.keys(shiftsIn(detail))))];
  const drawn = targets.map(target => [target, shiftsOf(events, target)]).filter(([, columns]) => columns[0].length > 1);
  return html`<section aria-labelledby="checks-title" class="wide"><h2 id="checks-title">Earlier self-checks</h2>
    ${answer === null ? html`<p>waiting for the unit…</p>` : answer.error ? html`<p>${answer.error}</p>` : !events.length && html`<p>none</p>`}
    ${drawn.length > 0 && html`<p class="hint">How far the frame LEDs have moved in the picture since the calibration. Times are UTC.</p>
      <div class="plots">${drawn.map(([target, columns]) => html`<${Plot} key=${target}
        title=${`${target}: shift, px; u solid, v dashed`} names=${["u", "v"]} decimals=${2} read=${() => columns} lines=${linesOf}
        scales=${{ y: { range: rangeOf } }} changes=${[columns[0].length, columns[0].at(-1)]} />`)}</div>`}
    ${events.length > 0 && html`<div class="scrolls" tabindex="0" role="region" aria-label="table of earlier self-checks"><table class="events">
      <thead><tr><th scope="col">UTC</th><th scope="col">Result</th><th scope="col">Cause</th><th scope="col">Message</th></tr></thead>
      <tbody>${events.slice(0, SHOWN).map(event => html`<tr key=${event.id} class=${`severity${event.severity}`}><td>${utc(event.time)}</td>
        <td>${words(String(event.detail.verdict ?? "not known"))}</td><td>${words(String(event.detail.cause ?? ""))}</td><td>${event.text}</td></tr>`)}</tbody>
    </table></div>`}</section>`;
}
