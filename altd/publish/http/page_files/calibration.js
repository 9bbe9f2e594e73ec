// The loaded calibration: its origin, its quality, and its files.

import { html } from "./vendor/htm-preact.js";
import { useAnswer } from "./acting.js";
import { QUANTITIES, UNKNOWN, counted, fixed, utc } from "./words.js";

const ASK_MS = 60000;

const plain = value => value === null || value === undefined ? UNKNOWN : String(value).replace("-", "−");
const listed = (values, decimals) => values.map(value => fixed(value, decimals)).join(", ");
const PX = 3, MM = 4;  // decimals, as altd calibrate and its report print them

function Facts({ calibration }) {
  const sigma = Object.entries(calibration.expected_sigma).map(([key, value]) => {
    const quantity = QUANTITIES.find(each => each.key === key);
    return `${quantity?.label ?? key} ${fixed(value, MM)} ${quantity?.unit ?? ""}`;
  });
  const facts = [["made", utc(calibration.created)], ["made from", calibration.recording.note], ["unit", calibration.unit],
    [`expected sigma of ${counted(calibration.exposures, "exposure")}, rms over the calibrated area`, sigma.join("; ") || "not known"],
    ["file", calibration.file.name], ["SHA-256 of the file", calibration.file.sha256]];
  return html`<dl class="facts">${facts.map(([name, value]) => html`<div key=${name}><dt>${name}</dt><dd>${value || UNKNOWN}</dd></div>`)}</dl>`;
}

const ROWS = [
  ["z, mm", target => plain(target.z_mm)],
  ["valid from x, y, mm", target => listed([target.x_mm[0], target.y_mm[0]], 1)],
  ["valid to x, y, mm", target => listed([target.x_mm[1], target.y_mm[1]], 1)],
  ["map", target => target.map],
  ["leave-one-out residual, px", target => fixed(target.left_out_px, PX)],
  ["residual mean, std, max, mm", ({ residuals }) => listed([residuals.mean_mm, residuals.std_mm, residuals.max_mm], MM)],
  ["repeatability u, v, px", target => listed(target.repeatability_px, PX)],
  ["cross-check", ({ cross_check: check }) => `${check.map}: ${fixed(check.largest_px, PX)} px difference, limit ${fixed(check.bound_px, PX)} px`],
  ["frame LEDs", target => target.leds],
  ["flat", target => ({ recording: "recorded", print: "model of the print" })[target.flat] ?? "none: print assumed plain"],
  ["camera view", ({ fingerprint }) => fingerprint
    ? `${fingerprint.hot_px} hot pixels; texture ${fingerprint.texture ? `from the ${fingerprint.texture}` : "not known"}` : "cannot be verified"],
  ["camera", ({ camera }) => [camera.model, camera.serial, camera.driver].filter(Boolean).join(", ") || "not known"],
  ["picture, px", target => `${target.width} × ${target.height}`],
];

function Targets({ targets }) {
  return html`<div class="scrolls" tabindex="0" role="region" aria-label="calibration of each target"><table>
    <thead><tr><th scope="col">target</th>${targets.map(target => html`<th scope="col" key=${target.name}>${target.name}</th>`)}</tr></thead>
    <tbody>${ROWS.map(([name, read]) => html`<tr key=${name}><th scope="row">${name}</th>
      ${targets.map(target => html`<td key=${target.name}>${read(target)}</td>`)}</tr>`)}</tbody></table></div>`;
}

// mayLook: whether this browser gets pictures, and so the files that contain some.
export function Calibration({ mayLook }) {
  const calibration = useAnswer("api/v1/calibration", ASK_MS);
  const isThere = calibration !== null && !calibration.error;
  return html`<section aria-labelledby="calibration-title" class="wide"><h2 id="calibration-title">Calibration</h2>
    ${!isThere && html`<p>${calibration?.error ?? "waiting for the unit…"}</p>`}
    ${isThere && html`${calibration.simulated && html`<p class="warned">Made from SIMULATED frames: not for a real unit.</p>`}
      <${Facts} calibration=${calibration} />${calibration.targets.length > 0 && html`<${Targets} targets=${calibration.targets} />`}
      <p class="links">${mayLook && html`<a href="api/v1/calibration/file" download>Download the file</a>
        ${calibration.report.available && html` <a href="api/v1/calibration/report" target="_blank" rel="noopener">Report</a>`}`}
        ${mayLook === false && html`<span>To download the file, <a href="#unit">log in</a> first.</span>`}
        ${!calibration.report.available && html` <span class="hint">No report: ${calibration.report.why}</span>`}</p>`}</section>`;
}
