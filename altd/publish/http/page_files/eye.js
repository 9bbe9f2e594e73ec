// Bull's eyes that are read from two metres: where the beam enters, and in which direction it runs.

import { html, useRef } from "./vendor/htm-preact.js";
import { fixed } from "./words.js";

const SCALES = [2, 5, 10, 20, 50, 100, 200, 400];
const RADIUS = 90;

// The smallest scale that holds the point; it shrinks only when the point is well inside the smaller one.
export function scaleFor(distance, before) {
  const needed = SCALES.find(scale => distance <= scale) ?? SCALES.at(-1);
  if (before === null || needed >= before) return needed;
  return distance <= 0.8 * needed ? needed : SCALES[SCALES.indexOf(needed) + 1] ?? before;
}

function Eye({ title, x, y, unit, sigma, ends }) {
  const last = useRef(null);
  const known = x !== null && y !== null;
  if (known) last.current = scaleFor(Math.hypot(x, y), last.current);
  const scale = last.current ?? 10;
  const at = value => (value / scale) * RADIUS;
  const words = known ? `${title}: ${fixed(x, 1)} and ${fixed(y, 1)} ${unit}` : `${title}: not known`;
  return html`<figure class="eye">
    <svg viewBox="-110 -110 220 220" role="img" aria-label=${words}>
      ${[1, 0.6, 0.2].map(share => html`<circle r=${RADIUS * share} class="ring" />`)}
      <path d="M-100 0H100M0-100V100" class="cross" />
      <text x="4" y=${-RADIUS * 0.62 - 3} class="scale">${fixed(0.6 * scale, scale < 10 ? 1 : 0)} ${unit}</text>
      <text x="106" y="-4" class="end" text-anchor="end">${ends[0]}</text>
      <text x="4" y="-98" class="end">${ends[1]}</text>
      ${known ? html`<circle class="sigma" cx=${at(x)} cy=${-at(y)} r=${Math.min(Math.max(at(3 * (sigma ?? 0)), 0), 200)} />
        <path class="point" d=${`M${at(x) - 9} ${-at(y)}h18M${at(x)} ${-at(y) - 9}v18`} /><circle class="point" cx=${at(x)} cy=${-at(y)} r="6" />`
        : html`<text y="6" class="unknown" text-anchor="middle">not known</text>`}
    </svg>
    <figcaption>${title}</figcaption>
  </figure>`;
}

export function Eyes({ measurement }) {
  const of = key => measurement?.[key] ?? null;
  const slope = key => {  // of an angle's sigma, near enough for a circle on a screen
    const sigma = measurement?.sigma_now?.[key] ?? measurement?.sigma?.[key] ?? null;
    return sigma === null ? null : 1000 * Math.tan(sigma * Math.PI / 180);
  };
  const place = measurement?.sigma_now?.x_mm ?? measurement?.sigma?.x_mm ?? null;
  return html`<section class="eyes" aria-label="bull's eyes">
    <${Eye} title="displacement" x=${of("x_mm")} y=${of("y_mm")} unit="mm" sigma=${place} ends=${["right", "up"]} />
    <${Eye} title="direction" x=${of("yaw_mm_per_m")} y=${of("pitch_mm_per_m")} unit="mm/m" sigma=${slope("yaw_deg")}
      ends=${["yaw", "pitch"]} />
  </section>`;
}
