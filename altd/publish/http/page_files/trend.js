// The quantities in the last minutes, with their uncertainty and when nothing was valid.

import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { useAnswer } from "./acting.js";
import { LENGTH_S, MIN_STEP_S } from "./memory.js";
import { QUANTITIES, fixed } from "./words.js";

const REDRAW_MS = 500, FILL_MS = 10000, MAX_POINTS = 1000, HOUR_S = 3600, DAY_S = 86400;
export const PLOT_HEIGHT = 190;
// of ticks in time: so that each span has three, whose labels differ
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 180, 300, 600, 900, 1200, 1800, HOUR_S, 2 * HOUR_S, 3 * HOUR_S, 6 * HOUR_S, 12 * HOUR_S,
  DAY_S, 2 * DAY_S, 5 * DAY_S, 7 * DAY_S, 14 * DAY_S, 30 * DAY_S, 60 * DAY_S, 90 * DAY_S, 120 * DAY_S];

// The fewest decimals in which ticks of such a step differ.
export function decimalsOf(step) {
  const decimals = [0, 1, 2, 3, 4, 5, 6, 7, 8].find(each => Math.abs(step * 10 ** each - Math.round(step * 10 ** each)) < 1e-6);
  return decimals ?? 9;
}

export function colours(element) {
  const style = getComputedStyle(element);
  return name => style.getPropertyValue(name).trim();
}

// Of a plot: UTC along, in as many letters as the span needs. Its x scale has `time: false`: ticks are at whole UTC times.
export function axesOf(colour, spanS) {
  const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
  const [from, to] = spanS > 3 * 86400 ? [0, 10] : spanS > 7200 ? [5, 16] : [11, 19];
  const clock = (_, ticks) => ticks.map(tick => new Date(1000 * tick).toISOString().slice(from, to).replace("T", " "));
  return [{ ...axis, values: clock, size: 32, space: 68, incrs: STEPS_S },
    { ...axis, size: 64, space: 18, values: (_, ticks, __, ___, step) => ticks.map(tick => fixed(tick, decimalsOf(step))) }];
}

function Plot({ quantity, memory }) {
  const place = useRef(null);
  useEffect(() => {
    const colour = colours(place.current);
    const plot = new uPlot({
      width: place.current.clientWidth, height: PLOT_HEIGHT, legend: { show: false }, cursor: { y: false },
      scales: { x: { time: false, range: (_, __, end) => [end - LENGTH_S, end] }, y: { range: (_, low, high) => { const least = 10 ** (2 - quantity.decimals), add = Math.max((least - (high - low)) / 2, 0.05 * (high - low)); return [low - add, high + add]; } } },
      axes: axesOf(colour, LENGTH_S),
      series: [{}, { stroke: colour("--accent"), width: 1.5, points: { show: false } },
        { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } }],
      bands: [{ series: [3, 2], fill: colour("--band") }],
    }, memory.columns(quantity.key), place.current);
    const timer = setInterval(() => { if (!document.hidden) plot.setData(memory.columns(quantity.key)); }, REDRAW_MS);
    const sized = new ResizeObserver(() => plot.setSize({ width: place.current.clientWidth, height: PLOT_HEIGHT }));
    sized.observe(place.current);
    return () => { clearInterval(timer); sized.disconnect(); plot.destroy(); };
  }, [quantity.key]);
  return html`<figure class="plot"><figcaption>${quantity.label}, ${quantity.unit}</figcaption>
    <div ref=${place} role="img" aria-label=${`${quantity.label} in the last minutes`}></div></figure>`;
}

function Lane({ memory }) {
  const [, redraw] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => redraw(number => number + 1), REDRAW_MS);
    return () => clearInterval(timer);
  }, []);
  const rows = memory.rows, begin = (rows.at(-1)?.t ?? 0) - LENGTH_S;
  const spans = [];
  for (const [number, row] of rows.entries()) {
    const until = rows[number + 1]?.t ?? row.t + MIN_STEP_S;
    if (until - row.t > 2) continue;
    const last = spans.at(-1);
    if (last && last.valid === row.valid && row.t - last.until < 0.01) last.until = until;
    else spans.push({ valid: row.valid, since: row.t, until });
  }
  return html`<svg class="lane" viewBox="0 0 1000 10" preserveAspectRatio="none" role="img" aria-label="when it was valid">
    ${spans.map(part => html`<rect key=${part.since} x=${1000 * (part.since - begin) / LENGTH_S} width=${1000 * (part.until - part.since) / LENGTH_S}
      height="10" class=${part.valid ? "valid" : "invalid"} />`)}</svg>`;
}

export function LiveTrends({ memory }) {
  const past = useAnswer(`api/v1/trend?from=-${LENGTH_S}&points=${MAX_POINTS}`, FILL_MS);
  useEffect(() => { if (past?.t_s) memory.fill(past); }, [past]);
  return html`<p class="hint">Line: value; band: ± 2 sigma (mean); bar below: green where all values were valid. Times are UTC.
      ${past?.error && html` Before this page was opened: ${past.error}.`}</p>
    <div class="plots">${QUANTITIES.filter(quantity => quantity.is_shown).map(quantity =>
      html`<${Plot} key=${quantity.key} quantity=${quantity} memory=${memory} />`)}</div>
    <${Lane} memory=${memory} />`;
}
