// The unit itself: what it is, its parts, and what can be taken along of them.

import { html } from "./vendor/htm-preact.js";
import { duration } from "./words.js";

export function Parts({ status }) {
  const parts = Object.entries(status?.components ?? {});
  return html`<section aria-labelledby="parts-title"><h2 id="parts-title">Parts</h2>
    <div class="scrolls" tabindex="0" role="region" aria-label="parts of the unit"><table class="parts">
      <thead><tr><th scope="col">part</th><th scope="col">state</th><th scope="col">for</th><th scope="col">says</th></tr></thead>
      <tbody>${parts.map(([name, part]) => html`<tr key=${name} class=${part.state}>
        <th scope="row">${name}</th><td>${part.state}</td><td>${duration(part.for_s)}</td><td>${part.message}</td></tr>`)}</tbody>
    </table></div></section>`;
}

export function Unit({ status, mayLook }) {
  const facts = [["serial", status?.serial], ["version", status?.version], ["calibration", status?.calibration]];
  return html`<section aria-labelledby="unit-title"><h2 id="unit-title">Unit</h2>
    <dl class="facts">${facts.map(([name, value]) => html`<div key=${name}><dt>${name}</dt><dd>${value ?? "–"}</dd></div>`)}</dl>
    <p class="links"><a href="/api/v1/">API</a> <a href="/api/v1/measurement">measurement</a> <a href="/api/v1/status">status</a>
      <a href="/metrics">metrics</a></p>
    <p>${mayLook && html`<a href="/api/v1/diagnostics" download>diagnostics</a>`}${mayLook === false && "Diagnostics: log in first."}
      <span class="hint"> Status, events, trend, settings and versions in one archive, to mail.</span></p></section>`;
}
