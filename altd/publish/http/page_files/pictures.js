// Live pictures of the targets: the next is asked for when the last was drawn, nothing while nobody looks.

import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { words } from "./words.js";

const OLD_MS = 1300, RETRY_MS = 1000, MAX_PATH = 200;

function parsed(buffer) {
  const length = new DataView(buffer).getUint32(0);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let offset = 4 + length;
  return header.pictures.map(picture => {
    const jpeg = new Blob([new Uint8Array(buffer, offset, picture.bytes)], { type: "image/jpeg" });
    offset += picture.bytes;
    return { ...picture, jpeg };
  });
}

// Opens and closes the socket with the page's visibility; `take` gets what is shown now, by target.
class Watcher {
  constructor(take) {
    this.take = take;
    this.shown = {};
    this.views = [];
    this.onVisible = () => document.hidden ? this.close() : this.connect();
  }

  start() {
    document.addEventListener("visibilitychange", this.onVisible);
    this.timer = setInterval(() => this.forget(), 250);
    this.onVisible();
  }

  stop() {
    document.removeEventListener("visibilitychange", this.onVisible);
    clearInterval(this.timer);
    this.close();
  }

  connect() {
    if (this.socket) return;
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/pictures`);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onmessage = async message => {
      if (typeof message.data === "string") this.views = JSON.parse(message.data).views;
      else await this.draw(parsed(message.data));
      if (socket.readyState === WebSocket.OPEN) socket.send("next");
    };
    socket.onclose = event => {
      if (this.socket !== socket) return;
      this.socket = null;
      this.words = event.reason || "no pictures from the unit";
      clearTimeout(this.retry);
      this.retry = setTimeout(() => { if (!document.hidden) this.connect(); }, RETRY_MS);
    };
  }

  close() {
    const socket = this.socket;
    this.socket = null;
    clearTimeout(this.retry);
    socket?.close();
    this.shown = {};
    this.tell();
  }

  async draw(pictures) {
    for (const picture of pictures) {
      const image = await createImageBitmap(picture.jpeg);
      const before = this.shown[picture.target];
      before?.image.close();
      const path = [...(before?.path ?? []), picture.spot && [picture.spot.u_px, picture.spot.v_px]].slice(-MAX_PATH);
      this.shown = { ...this.shown, [picture.target]: { ...picture, image, path, at: performance.now() - 1000 * picture.age_s } };
    }
    this.words = "";
    this.tell();
  }

  // what is not seen any more is not shown
  forget() {
    const now = performance.now();
    const kept = Object.entries(this.shown).filter(([, picture]) => now - picture.at < OLD_MS);
    if (kept.length < Object.keys(this.shown).length) this.shown = Object.fromEntries(kept);
    this.tell();
  }

  tell() { this.take({ views: this.views, shown: this.shown, words: this.words }); }
}

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
  if (picture?.image.width === 0) return;  // closed, for a newer one is here and painted next
  const context = canvas.getContext("2d");
  canvas.width = picture?.width ?? Math.min(view.width, 800);
  canvas.height = picture?.height ?? Math.round(view.height * canvas.width / view.width);
  context.fillStyle = "#181818";
  context.fillRect(0, 0, canvas.width, canvas.height);
  if (picture) context.drawImage(picture.image, 0, 0);
  const scale = canvas.width / view.width;
  context.setTransform(scale, 0, 0, scale, 0.5 * (scale - 1), 0.5 * (scale - 1));
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

// Where the place at which another target has its spot lies in this target's picture, near enough to aim by.
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
  useEffect(() => { paint(canvas.current, view, picture, aim); }, [view, picture, aim?.[0], aim?.[1]]);
  const said = saidOf(view, picture, seen?.target, lost);
  const age = picture ? (performance.now() - picture.at) / 1000 : null;
  return html`<figure class="target" data-target=${view.target} data-sequence=${picture?.sequence ?? ""}>
    <canvas ref=${canvas} role="img" aria-label=${`${view.target} target: ${said}`}></canvas>
    <figcaption><strong>${view.target}</strong> <span class="said">${said}</span>
      <span class="age">${age === null ? "" : `${age.toFixed(1)} s old`}</span></figcaption>
  </figure>`;
}

export function Pictures() {
  const [now, setNow] = useState({ views: [], shown: {}, words: "" });
  useEffect(() => {
    const watcher = new Watcher(setNow);
    watcher.start();
    return () => watcher.stop();
  }, []);
  return html`<section class="pictures" aria-label="pictures of the targets">
    ${now.views.map(view => html`<${Target} key=${view.target} view=${view} views=${now.views} shown=${now.shown} lost=${now.words} />`)}
    ${now.views.length === 0 && html`<p>${now.words || "no pictures yet"}</p>`}
  </section>`;
}
