// How the quantities went in the last minutes, with their uncertainty and when nothing was valid.

import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { LENGTH_S, MIN_STEP_S } from "./memory.js";
import { QUANTITIES, fixed } from "./words.js";

const REDRAW_MS = 500;

export function colours(element) {
  const style = getComputedStyle(element);
  return name => style.getPropertyValue(name).trim();
}

// Of a plot: UTC along, and as many letters as the span needs.
export function axesOf(colour, quantity, spanS) {
  const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
  const [from, to] = spanS > 3 * 86400 ? [0, 10] : spanS > 7200 ? [5, 16] : [11, 19];
  const clock = (_, ticks) => ticks.map(tick => new Date(1000 * tick).toISOString().slice(from, to).replace("T", " "));
  return [{ ...axis, values: clock, space: 100 },
    { ...axis, size: 64, values: (_, ticks) => ticks.map(tick => fixed(tick, Math.max(quantity.decimals - 1, 0))) }];
}

function Plot({ quantity, memory }) {
  const place = useRef(null);
  useEffect(() => {
    const colour = colours(place.current);
    const plot = new uPlot({
      width: place.current.clientWidth, height: 150, legend: { show: false }, cursor: { y: false },
      scales: { y: { range: (_, low, high) => { const least = 10 ** (2 - quantity.decimals), add = Math.max((least - (high - low)) / 2, 0.05 * (high - low)); return [low - add, high + add]; } } },
      axes: axesOf(colour, quantity, LENGTH_S),
      series: [{}, { stroke: colour("--accent"), width: 1.5, points: { show: false } },
        { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } }],
      bands: [{ series: [3, 2], fill: colour("--band") }],
    }, memory.columns(quantity.key), place.current);
    const timer = setInterval(() => { if (!document.hidden) plot.setData(memory.columns(quantity.key)); }, REDRAW_MS);
    const sized = new ResizeObserver(() => plot.setSize({ width: place.current.clientWidth, height: 150 }));
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
  const rows = memory.rows, end = rows.at(-1)?.t ?? 0, begin = rows[0]?.t ?? 0, span = Math.max(end - begin, 1);
  const spans = [];
  for (const [number, row] of rows.entries()) {
    const until = rows[number + 1]?.t ?? row.t + MIN_STEP_S;
    if (until - row.t > 2) continue;
    const last = spans.at(-1);
    if (last && last.valid === row.valid && row.t - last.until < 0.01) last.until = until;
    else spans.push({ valid: row.valid, since: row.t, until });
  }
  return html`<svg class="lane" viewBox="0 0 1000 10" preserveAspectRatio="none" role="img" aria-label="when it was valid">
    ${spans.map(part => html`<rect key=${part.since} x=${1000 * (part.since - begin) / span} width=${1000 * (part.until - part.since) / span}
      height="10" class=${part.valid ? "valid" : "invalid"} />`)}</svg>`;
}

export function LiveTrends({ memory }) {
  return html`<p class="hint">Line: the value; band: two standard deviations; the lane below is green where it was valid. Times are UTC.</p>
    <div class="plots">${QUANTITIES.filter(quantity => quantity.is_shown).map(quantity =>
      html`<${Plot} key=${quantity.key} quantity=${quantity} memory=${memory} />`)}</div>
    <${Lane} memory=${memory} />`;
}
