// The unit: its identity, its parts, and its diagnostics.

import { html } from "./vendor/htm-preact.js";
import { counted, duration, fixed, local, utc } from "./words.js";

// What is known of a part: temperature, exposure and lost frames, where it has these.
function readingsOf(name, part, components) {
  const celsius = part.celsius ?? components[`temperature ${name}`]?.celsius ?? null, camera = /^camera (\S+)$/.exec(name)?.[1];
  const lost = (part.lost ?? 0) + (components.measuring?.[`dropped_${camera}`] ?? 0);
  return [celsius !== null && `${fixed(celsius, 1)} °C`, part.exposure_ms != null && `exposure ${fixed(part.exposure_ms, 2)} ms`,
    camera && counted(lost, "lost frame")].filter(Boolean).join(", ");
}

export function Parts({ status }) {
  const parts = Object.entries(status?.components ?? {});
  return html`<section aria-labelledby="parts-title"><h2 id="parts-title">Parts</h2>
    <div class="scrolls" tabindex="0" role="region" aria-label="parts of the unit"><table class="parts">
      <thead><tr><th scope="col">Part</th><th scope="col">State</th><th scope="col">For</th><th scope="col">Readings</th><th scope="col">Message</th></tr></thead>
      <tbody>${parts.map(([name, part]) => html`<tr key=${name} class=${part.state}>
        <th scope="row">${name}</th><td>${part.state}</td><td>${duration(part.for_s)}</td><td>${readingsOf(name, part, status.components)}</td><td>${part.message}</td></tr>`)}</tbody>
    </table></div></section>`;
}

export function Unit({ status, mayLook }) {
  const zero = status?.zero, there = local(zero?.time, status?.time_zone);
  const facts = [["serial", status?.serial], ["version", status?.version], ["calibration", status?.calibration],
    ["calibration valid until", status?.calibration_valid_until],
    ["operating hours", status && (status.operating_hours === null ? "not known" : fixed(status.operating_hours, 1))],
    ["zero", zero ? `${utc(zero.time)} UTC${there ? `, ${there} ${status.time_zone}` : ""}, by ${zero.by}` : status && "not set since the start"]];
  return html`<section aria-labelledby="unit-title"><h2 id="unit-title">Unit</h2>
    <dl class="facts">${facts.map(([name, value]) => html`<div key=${name}><dt>${name}</dt><dd>${value ?? "–"}</dd></div>`)}</dl>
    <p class="links"><a href="api/v1/">API</a> <a href="api/v1/measurement">measurement</a> <a href="api/v1/status">status</a>
      <a href="metrics">metrics</a> <a href="screen">plate on this screen</a></p>
    <p>${mayLook && html`<a href="api/v1/diagnostics" download>Download diagnostics</a>`}${mayLook === false && html`To download diagnostics, <a href="#unit">log in</a> first.`}
      <span class="hint"> Status, events, trend, settings and versions in one archive for remote support.</span></p></section>`;
}

// Figures for diagnosis: the spots in the pictures, and the beam by the second maps. An instrument without them has no section.
export function CrossCheck({ check }) {
  if (!check) return null;
  const PX = 2, MM = 3, DEG = 4;  // decimals
  return html`<section aria-labelledby="cross-title"><h2 id="cross-title">Cross-check</h2>
    <table id="cross-check"><thead><tr><th scope="col">target</th><th scope="col">spot u, v, px</th><th scope="col">x, y by the second map, mm</th></tr></thead>
    <tbody>${Object.entries(check.targets).map(([name, at]) => html`<tr key=${name}><th scope="row">${name}</th>
      <td>${fixed(at.u_px, PX)}, ${fixed(at.v_px, PX)}</td><td>${fixed(at.x_mm, MM)}, ${fixed(at.y_mm, MM)}</td></tr>`)}</tbody></table>
    <p>yaw ${fixed(check.yaw_deg, DEG)}°, pitch ${fixed(check.pitch_deg, DEG)}° by the second maps. <span class="hint">For diagnosis: do not control by these.</span></p></section>`;
}
