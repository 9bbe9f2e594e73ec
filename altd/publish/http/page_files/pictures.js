// Live pictures of the targets: the next is requested when the last was drawn, and none by a hidden page.

import { html, useEffect, useLayoutEffect, useRef, useState } from "./vendor/htm-preact.js";
import { Watcher } from "./watcher.js";
import { words } from "./words.js";

function line(context, points, close) {
  context.beginPath();
  let pen = false;
  for (const point of points) {
    if (!point) { pen = false; continue; }
    if (pen) context.lineTo(...point); else context.moveTo(...point);
    pen = true;
  }
  if (close) context.closePath();
  context.stroke();
}

function cross(context, [u, v], half) {
  line(context, [[u - half, v], [u + half, v], null, [u, v - half], [u, v + half]]);
}

function paint(canvas, view, picture, aim) {
  if (picture && !picture.image.width) return;  // closed: nothing can be drawn of it, and an error would end the page
  const context = canvas.getContext("2d");
  canvas.width = picture?.width ?? Math.min(view.width, 800);
  canvas.height = picture?.height ?? Math.round(view.height * canvas.width / view.width);
  context.fillStyle = "#181818";
  context.fillRect(0, 0, canvas.width, canvas.height);
  if (picture) context.drawImage(picture.image, 0, 0);
  const scale = canvas.width / view.width;
  context.setTransform(scale, 0, 0, scale, 0.5 * scale, 0.5 * scale);  // (0, 0) is the middle of the first pixel
  const thin = 1.5 * view.width / 752;
  context.lineWidth = thin;
  context.strokeStyle = "#6ad";
  line(context, view.outline, true);
  context.strokeStyle = "#6ad8";
  cross(context, view.middle, 12 * thin);
  context.strokeStyle = "#fb4";
  for (const [u, v] of view.leds) { context.beginPath(); context.arc(u, v, 7 * thin, 0, 7); context.stroke(); }
  if (picture) {
    context.strokeStyle = "#6e68";
    line(context, picture.path);
  }
  if (picture?.spot) {
    const { u_px, v_px, semi_major_px, semi_minor_px, turn_deg } = picture.spot;
    context.strokeStyle = "#3f6";
    context.beginPath();
    context.ellipse(u_px, v_px, semi_major_px, semi_minor_px, turn_deg * Math.PI / 180, 0, 7);
    context.stroke();
    cross(context, [u_px, v_px], 5 * thin);
  } else if (aim) {
    context.strokeStyle = "#f6f";
    context.setLineDash([6 * thin, 4 * thin]);
    context.beginPath();
    context.arc(...aim, 20 * thin, 0, 7);
    context.stroke();
    context.setLineDash([]);
  }
  context.setTransform(1, 0, 0, 1, 0, 0);
}

// The class that turns a picture so that it is seen along the beam: x to the right, y up. In the picture of a camera that looks
// against the beam, right and left are exchanged. null: the camera is on its side, and its picture is drawn as it is.
export function turnOf({ x_axis: [right, across], y_axis: [, down] }) {
  if (Math.abs(across) > Math.abs(right)) return null;
  return [right < 0 && "flip-x", down > 0 && "flip-y"].filter(Boolean).join(" ");
}

// The position of another target's spot in this target's picture, accurate enough for aiming.
export function aimIn(view, other, spot) {
  const [u, v] = [spot.u_px - other.middle[0], spot.v_px - other.middle[1]];
  const [[a, c], [b, d]] = [other.x_axis, other.y_axis], det = a * d - b * c;
  const x = (d * u - b * v) / det, y = (a * v - c * u) / det;
  return [view.middle[0] + x * view.x_axis[0] + y * view.y_axis[0], view.middle[1] + x * view.x_axis[1] + y * view.y_axis[1]];
}

function saidOf(view, picture, aimedFrom, lost) {
  if (!picture) return lost || "no picture";
  if (picture.spot) return "spot found";
  const why = picture.leds_on ? "frame LEDs lit" : words(picture.why || "no spot");
  return aimedFrom ? `${why}; dashed: where the beam meets ${aimedFrom}` : why;
}

function Target({ view, shown, views, lost }) {
  const canvas = useRef(null), picture = shown[view.target];
  const seen = picture && !picture.spot && !picture.leds_on
    ? views.find(other => other.target !== view.target && shown[other.target]?.spot) : undefined;
  const aim = seen && aimIn(view, seen, shown[seen.target].spot);
  useLayoutEffect(() => { paint(canvas.current, view, picture, aim); }, [view, picture, aim?.[0], aim?.[1]]);
  const said = saidOf(view, picture, seen?.target, lost);
  const turn = turnOf(view), age = picture ? (Date.now() - picture.at) / 1000 : null;
  return html`<figure class="target" data-target=${view.target} data-sequence=${picture?.sequence ?? ""}>
    <canvas ref=${canvas} class=${turn ?? ""} role="img" aria-label=${`${view.target} target: ${said}`}></canvas>
    <figcaption><strong>${view.target}</strong> <span class="hint">${turn === null ? "seen by the camera" : "seen along the beam"}</span> <span class="said">${said}</span>
      <span class="age">${age === null ? "" : `${age.toFixed(1)} s old`}</span></figcaption>
  </figure>`;
}

// mayLook false: a login is needed. If no pictures arrive, `onSession` checks whether that is the cause.
export function Pictures({ mayLook, onSession }) {
  const [now, setNow] = useState({ views: [], shown: {}, words: "" }), isRefused = mayLook === false, isLost = Boolean(now.words);
  useEffect(() => {
    if (isRefused) return undefined;
    const watcher = new Watcher(setNow);
    watcher.start();
    return () => watcher.stop();
  }, [isRefused]);
  useEffect(() => { if (isLost) onSession(); }, [isLost]);
  if (isRefused) return html`<section class="pictures" aria-label="pictures of the targets"><p>To see the pictures, <a href="#unit">log in</a> first.</p></section>`;
  return html`<section class="pictures" aria-label="pictures of the targets">
    ${now.views.map(view => html`<${Target} key=${view.target} view=${view} views=${now.views} shown=${now.shown} lost=${now.words} />`)}
    ${now.views.length === 0 && html`<p>${now.words || "no pictures yet"}</p>`}
  </section>`;
}
