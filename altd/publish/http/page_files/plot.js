// Plots over time, with the values under the pointer and in a table; and bars of what was the case when.

import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { UNKNOWN, duration, fixed, utc } from "./words.js";

const HEIGHT = 190, ROWS = 20, HOUR_S = 3600, DAY_S = 86400;
// of ticks in time: so that each span has three, whose labels differ
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 180, 300, 600, 900, 1200, 1800, HOUR_S, 2 * HOUR_S, 3 * HOUR_S, 6 * HOUR_S, 12 * HOUR_S,
  DAY_S, 2 * DAY_S, 5 * DAY_S, 7 * DAY_S, 14 * DAY_S, 30 * DAY_S, 60 * DAY_S, 90 * DAY_S, 120 * DAY_S];

const timeOf = t => t == null ? UNKNOWN : utc(new Date(1000 * t).toISOString());

// The fewest decimals in which ticks of such a step differ.
function decimalsOf(step) {
  const decimals = [0, 1, 2, 3, 4, 5, 6, 7, 8].find(each => Math.abs(step * 10 ** each - Math.round(step * 10 ** each)) < 1e-6);
  return decimals ?? 9;
}

// UTC along, in as many letters as the span needs. The x scale has `time: false`: ticks are at whole UTC times.
function axesOf(colour, spanS) {
  const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
  const [from, to] = spanS > 3 * DAY_S ? [0, 10] : spanS > 7200 ? [5, 16] : [11, 19];
  const clock = (_, ticks) => ticks.map(tick => new Date(1000 * tick).toISOString().slice(from, to).replace("T", " "));
  return [{ ...axis, values: clock, size: 32, space: 68, incrs: STEPS_S },
    { ...axis, size: 64, space: 18, values: (_, ticks, __, ___, step) => ticks.map(tick => fixed(tick, decimalsOf(step))) }];
}

// Comes with the first plot: on a slow link the values are there before it.
let library = null;
function loaded() {
  library ??= new Promise(done => document.head.append(Object.assign(document.createElement("script"),
    { src: "page/vendor/uPlot.iife.min.js", onload: done, onerror: () => { library = null; } })));
  return library;
}

function Table({ title, names, decimals, columns }) {
  const [t] = columns, step = Math.ceil(t.length / ROWS), rows = [...t.keys()].reverse().filter((_, number) => number % step === 0);
  return html`<table><caption class="unseen">${title}</caption>
    <thead><tr><th scope="col">UTC</th>${names.map(name => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${rows.map(row => html`<tr key=${row}><th scope="row">${timeOf(t[row])}</th>
      ${names.map((_, number) => html`<td>${fixed(columns[number + 1][row], decimals)}</td>`)}</tr>`)}</tbody></table>`;
}

// `read` returns times, s, and a column of values for each of `names`; `lines` draws these with the colours of the page.
// It is drawn again if one of `changes` differs, and read again each `redrawMs`. The table stays as when it was opened.
export function Plot({ title, names, decimals, read, lines, bands, scales, spanS, changes, redrawMs }) {
  const place = useRef(null), [columns, setColumns] = useState(null);
  const draw = () => {
    const style = getComputedStyle(place.current), colour = name => style.getPropertyValue(name).trim(), [t, ...rest] = read();
    const plot = new uPlot({
      width: place.current.clientWidth, height: HEIGHT, cursor: { y: false }, scales: { x: { time: false, ...scales?.x }, y: { ...scales?.y } },
      axes: axesOf(colour, spanS ?? t.at(-1) - t[0]), bands: bands && [{ series: [3, 2], fill: colour("--band") }],
      series: [{ label: "UTC", value: (_, at) => timeOf(at) },
        ...lines(colour).map((line, number) => ({ label: names[number], value: (_, value) => fixed(value, decimals), ...line }))],
    }, [t, ...rest], place.current);
    const timer = redrawMs && setInterval(() => { if (!document.hidden) plot.setData(read()); }, redrawMs);
    const sized = new ResizeObserver(() => plot.setSize({ width: place.current.clientWidth, height: HEIGHT }));
    sized.observe(place.current);
    return () => { clearInterval(timer); sized.disconnect(); plot.destroy(); };
  };
  useEffect(() => {
    let isWanted = true, end = () => {};
    loaded().then(() => { if (isWanted) end = draw(); });
    return () => { isWanted = false; end(); };
  }, changes);
  return html`<figure class="plot"><figcaption>${title}</figcaption>
    <div ref=${place} role="img" aria-label=${`plot of ${title}; the table has its values`}></div>
    <details onToggle=${event => setColumns(event.currentTarget.open ? read() : null)}><summary>Table of ${title}</summary>
      ${columns && html`<${Table} title=${title} names=${names} decimals=${decimals} columns=${columns} />`}</details></figure>`;
}

// The line of a value, between the invisible borders of its band.
export const banded = points => colour => [{ stroke: colour("--accent"), width: 1.5, points: { show: points } },
  ...[1, 2].map(() => ({ stroke: "transparent", points: { show: false } }))];

// Along the time of the plots: each of `spans`, {state, since, until} in s, drawn as its state in `names`, {state: words}.
export function Lane({ title, spans, begin, end, names }) {
  const share = seconds => `${100 * seconds / Math.max(end - begin, 1)}%`;
  const said = Object.entries(names).map(([state, name]) => [state, name, spans.reduce((sum, span) => sum + (span.state === state ? span.until - span.since : 0), 0)])
    .filter(([, , seconds]) => seconds > 0);
  return html`<figure class="plot"><figcaption>${title}</figcaption>
    <div class="lane" role="img" aria-label=${said.map(([, name, seconds]) => `${name} ${duration(seconds)}`).join(", ") || "nothing measured"}>
      ${spans.map(span => html`<i key=${span.since} class=${span.state} style=${{ left: share(span.since - begin), width: share(span.until - span.since) }}></i>`)}</div>
    <div class="ends">${[begin, (begin + end) / 2, end].map(t => html`<span>${timeOf(t).slice(end - begin > DAY_S ? 0 : 11, end - begin > DAY_S ? 10 : 19)}</span>`)}</div>
    <p class="key">${said.map(([state, name, seconds]) => html`<span key=${state}><i class=${state}></i> ${name} ${duration(seconds)}</span>`)}</p></figure>`;
}
