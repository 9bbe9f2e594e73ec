// The quantities in the last minutes, with their uncertainty and when nothing was valid.

import { html, useEffect, useState } from "./vendor/htm-preact.js";
import { useAnswer } from "./acting.js";
import { LENGTH_S, MIN_STEP_S } from "./memory.js";
import { Lane, Plot, banded } from "./plot.js";
import { QUANTITIES } from "./words.js";

const REDRAW_MS = 500, FILL_MS = 10000, MAX_POINTS = 1000;
const NAMES = ["value", "− 2 sigma", "+ 2 sigma"];

function scalesOf(quantity) {
  const range = (_, low, high) => {
    const least = 10 ** (2 - quantity.decimals), add = Math.max((least - (high - low)) / 2, 0.05 * (high - low));
    return [low - add, high + add];
  };
  return { x: { range: (_, __, end) => [end - LENGTH_S, end] }, y: { range } };
}

function Valid({ memory }) {
  const [, redraw] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => redraw(number => number + 1), REDRAW_MS);
    return () => clearInterval(timer);
  }, []);
  const rows = memory.rows, end = rows.at(-1)?.t ?? Date.now() / 1000;
  const spans = [];
  for (const [number, row] of rows.entries()) {
    const until = rows[number + 1]?.t ?? row.t + MIN_STEP_S, state = row.valid ? "valid" : "invalid";
    if (until - row.t > 2) continue;
    const last = spans.at(-1);
    if (last && last.state === state && row.t - last.until < 0.01) last.until = until;
    else spans.push({ state, since: row.t, until });
  }
  return html`<${Lane} title="when the values were valid" spans=${spans} begin=${end - LENGTH_S} end=${end} names=${{ valid: "valid", invalid: "not valid" }} />`;
}

export function LiveTrends({ memory }) {
  const past = useAnswer(`api/v1/trend?from=-${LENGTH_S}&points=${MAX_POINTS}`, FILL_MS);
  useEffect(() => { if (past?.t_s) memory.fill(past); }, [past]);
  return html`<p class="hint">Line: value; band: ± 2 sigma (mean). Times are UTC.
      ${past?.error && html` Before this page was opened: ${past.error}.`}</p>
    <div class="plots">${QUANTITIES.filter(quantity => quantity.is_shown).map(quantity =>
      html`<${Plot} key=${quantity.key} title=${`${quantity.label}, ${quantity.unit}`} names=${NAMES} decimals=${quantity.decimals} read=${() => memory.columns(quantity.key)}
        lines=${banded(false)} bands scales=${scalesOf(quantity)} spanS=${LENGTH_S} changes=${[quantity.key]} redrawMs=${REDRAW_MS} />`)}
      <${Valid} memory=${memory} /></div>`;
}
