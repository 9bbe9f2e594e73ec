// Bull's eyes that are read from two metres: where the beam enters, and in which direction it runs.
//
// The scale is the reader's choice and never changes automatically: a beam outside it is drawn at the rim.

import { html, useRef } from "./vendor/htm-preact.js";
import { useKept } from "./keeping.js";
import { fixed } from "./words.js";

const EYES = [
  { name: "displacement", unit: "mm", x: "x_mm", y: "y_mm", sigma: "x_mm", scale: 50 },
  { name: "direction", unit: "mm/m", x: "yaw_mm_per_m", y: "pitch_mm_per_m", sigma: "yaw_deg", scale: 100 },
];
const SCALES = [5, 10, 20, 50, 100, 200, 500], RINGS = [0.2, 0.6, 1], ENDS = [["right", 100, 4], ["left", -100, 4], ["up", 0, -101], ["down", 0, 112]];
const TOLERANCES = [null, 1, 2, 3, 5, 10, 15, 20, 25, 30, 40, 50, 75, 100, 150, 200];
const RADIUS = 90, MARK = 9, HOLE = 5, SHADED_SIGMAS = 3, MAX_SHADED = 200;
const isScale = value => SCALES.includes(value);
const isTolerance = value => TOLERANCES.includes(value);

// Where a point is drawn; `isInside`: that is its place, and not the rim in its direction.
export function placeOf(x, y, scale) {
  const share = Math.hypot(x, y) / scale, unit = RADIUS / scale / Math.max(share, 1);
  return { u: x * unit, v: -y * unit, isInside: share <= 1 };
}

// The quadrant of the ring labels, which is never that of the point.
export function labelsAt([right, down], place) {
  return place && place.u * right > 0 && place.v * down > 0 ? [-right, -down] : [right, down];
}

// Open, so that nothing is hidden by it.
function Mark({ u, v, radius }) {
  const arm = MARK - HOLE;
  return html`${radius !== null && html`<circle class="sigma" cx=${u} cy=${v} r=${Math.min(radius, MAX_SHADED)} />`}
    <path class="point" d=${`M${u - MARK} ${v}h${arm}M${u + HOLE} ${v}h${arm}M${u} ${v - MARK}v${arm}M${u} ${v + HOLE}v${arm}`} />
    <circle class="point" cx=${u} cy=${v} r=${HOLE} />`;
}

function Choice({ label, choices, value, onChoice }) {
  return html`<label>${label} <select value=${choices.indexOf(value)} onChange=${event => onChoice(choices[Number(event.target.value)])}>
    ${choices.map((each, number) => html`<option key=${number} value=${number}>${each ?? "none"}</option>`)}</select></label>`;
}

function Eye({ eye, measurement, isFar }) {
  const { name, unit } = eye, x = measurement?.[eye.x] ?? null, y = measurement?.[eye.y] ?? null, isKnown = x !== null && y !== null;
  const [scale, setScale] = useKept(`scale of ${name}`, eye.scale, isScale);
  const [tolerance, setTolerance] = useKept(`tolerance of ${name}`, null, isTolerance);
  const quadrant = useRef([1, 1]), place = isKnown ? placeOf(x, y, scale) : null;
  const [right, down] = quadrant.current = labelsAt(quadrant.current, place);
  const sigma = measurement?.sigma_now?.[eye.sigma] ?? null;  // of an angle's sigma, near enough for a circle on a screen
  const radius = sigma === null ? null : SHADED_SIGMAS * (unit === "mm" ? sigma : 1000 * Math.tan(sigma * Math.PI / 180)) / scale * RADIUS;
  const words = isKnown ? `${name}: ${fixed(x, 1)} and ${fixed(y, 1)} ${unit}` : `${name}: not known`;
  return html`<figure class="eye" data-scale=${scale}>
    <svg viewBox="-138 -116 276 234" role="img" aria-label=${words}>
      ${RINGS.map(share => html`<circle r=${RADIUS * share} class="ring" />`)}
      <path d="M-96 0H96M0-96V96" class="cross" />
      ${tolerance !== null && tolerance <= scale && html`<circle r=${tolerance / scale * RADIUS} class="tolerance" />`}
      ${ENDS.map(([end, u, v]) => html`<text x=${u} y=${v} class="end" text-anchor=${u > 0 ? "start" : u < 0 ? "end" : "middle"}>${end}</text>`)}
      ${isKnown ? html`<${Mark} ...${place} radius=${radius} />` : html`<text y="6" class="unknown" text-anchor="middle">not known</text>`}
      ${RINGS.map(share => html`<text x=${right * (RADIUS * share * Math.SQRT1_2 + 2)} y=${down * (RADIUS * share * Math.SQRT1_2 + 5) + 4}
        class="scale" text-anchor=${right > 0 ? "start" : "end"}>${Number((share * scale).toPrecision(3))}</text>`)}
    </svg>
    <figcaption><span>${name}, ${unit}</span>${isFar ? html`<${Choice} label="scale" choices=${SCALES} value=${scale} onChoice=${setScale} />
      <${Choice} label="tolerance" choices=${TOLERANCES} value=${tolerance} onChoice=${setTolerance} />` : ""}
      ${place && !place.isInside && html` <strong class="warned">outside the scale</strong>`}
      ${tolerance !== null && tolerance > scale && html` <strong class="warned">tolerance outside the scale</strong>`}</figcaption>
  </figure>`;
}

export function Eyes({ measurement, isFar }) {
  return html`<section class="eyes" aria-label="bull's eyes, seen along the beam">
    ${EYES.map(eye => html`<${Eye} key=${eye.name} eye=${eye} measurement=${measurement} isFar=${isFar} />`)}</section>`;
}
