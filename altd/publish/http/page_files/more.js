// The unit itself: its last self-check, its parts, its calibration, and what can be taken along.

import { html } from "./vendor/htm-preact.js";
import { duration, fixed, words } from "./words.js";

export function Parts({ status }) {
  const parts = Object.entries(status?.components ?? {});
  return html`<section aria-labelledby="parts-title"><h2 id="parts-title">Parts</h2>
    <div class="scrolls" tabindex="0" role="region" aria-label="parts of the unit"><table class="parts">
      <thead><tr><th scope="col">part</th><th scope="col">state</th><th scope="col">for</th><th scope="col">says</th></tr></thead>
      <tbody>${parts.map(([name, part]) => html`<tr key=${name} class=${part.state}>
        <th scope="row">${name}</th><td>${part.state}</td><td>${duration(part.for_s)}</td><td>${part.message}</td></tr>`)}</tbody>
    </table></div></section>`;
}

export function Unit({ status }) {
  const facts = [["serial", status?.serial], ["version", status?.version], ["calibration", status?.calibration]];
  return html`<section aria-labelledby="unit-title"><h2 id="unit-title">Unit</h2>
    <dl class="facts">${facts.map(([name, value]) => html`<div key=${name}><dt>${name}</dt><dd>${value ?? "–"}</dd></div>`)}</dl>
    <p class="links"><a href="/api/v1/">API</a> <a href="/api/v1/measurement">measurement</a> <a href="/api/v1/status">status</a>
      <a href="/metrics">metrics</a></p></section>`;
}

export function SelfCheck({ check, children }) {
  if (!check) return html`<section aria-labelledby="check-title"><h2 id="check-title">Self-check</h2><p>not known</p></section>`;
  const targets = Object.entries(check.targets ?? {});
  return html`<section aria-labelledby="check-title"><h2 id="check-title">Self-check</h2>
    <p><strong>${check.verdict ?? "none yet"}</strong>${check.reasons?.length ? `: ${check.reasons.map(words).join(", ")}` : ""}</p>
    ${targets.length > 0 && html`<table><thead><tr><th scope="col">target</th><th scope="col">LEDs</th><th scope="col">shift, px</th>
      <th scope="col">turn, °</th></tr></thead><tbody>${targets.map(([name, target]) => html`<tr key=${name}><th scope="row">${name}</th>
      <td>${target.leds_found} of ${target.leds_expected}</td>
      <td>${target.shift_px ? target.shift_px.map(value => fixed(value, 2)).join(", ") : "–"}</td>
      <td>${fixed(target.turn_deg, 3)}</td></tr>`)}</tbody></table>`}${children}</section>`;
}
