// The newest picture of each target, while it is current.

export const OLD_MS = 1300, RETRY_MS = 1000;
const MAX_PATH = 200, FORGET_MS = 250;

function parsed(buffer) {
  const length = new DataView(buffer).getUint32(0);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let offset = 4 + length;
  const pictures = header.pictures.map(picture => {
    const jpeg = new Blob([new Uint8Array(buffer, offset, picture.bytes)], { type: "image/jpeg" });
    offset += picture.bytes;
    return { ...picture, jpeg };
  });
  return { heldMs: 1000 * header.held_s, pictures };
}

// Opens and closes the socket with the page's visibility; `take` gets what is shown now, by target.
export class Watcher {
  constructor(take, world = globalThis) {
    this.take = take;
    this.world = world;
    this.shown = {};
    this.views = [];
    this.onVisible = () => this.world.document.hidden ? this.close() : this.connect();
  }

  start() {
    this.world.document.addEventListener("visibilitychange", this.onVisible);
    this.timer = this.world.setInterval(() => this.forget(), FORGET_MS);
    this.onVisible();
  }

  stop() {
    this.world.document.removeEventListener("visibilitychange", this.onVisible);
    this.world.clearInterval(this.timer);
    this.close();
  }

  connect() {
    if (this.socket) return;
    const { location, URL, WebSocket } = this.world;
    const address = new URL("api/v1/pictures", location.href);
    address.protocol = address.protocol.replace("http", "ws");
    const socket = new WebSocket(address.href);
    let asked = 0;
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onmessage = async message => {
      if (typeof message.data === "string") this.views = JSON.parse(message.data).views;
      else await this.draw(parsed(message.data), asked);
      if (socket.readyState !== 1) return;
      asked = this.world.Date.now();
      socket.send("next");
    };
    socket.onclose = event => {
      if (this.socket !== socket) return;
      this.socket = null;
      this.words = event.reason || "no pictures from the unit";
      this.world.clearTimeout(this.retry);
      this.retry = this.world.setTimeout(() => { if (!this.world.document.hidden) this.connect(); }, RETRY_MS);
    };
  }

  close() {
    const socket = this.socket;
    this.socket = null;
    this.world.clearTimeout(this.retry);
    socket?.close();
    this.shown = {};
    this.tell();
  }

  // The time since the request, less the time that the unit held it, was spent in transmission: a computer that slept
  // receives pictures that waited for it.
  async draw({ heldMs, pictures }, asked) {
    const old = [], now = this.world.Date.now(), onWay = Math.max(now - asked - heldMs, 0);
    for (const picture of pictures) {
      const at = now - onWay - 1000 * picture.age_s;
      if (now - at > OLD_MS) continue;
      const image = await this.world.createImageBitmap(picture.jpeg).catch(() => null);
      if (!image) continue;
      const before = this.shown[picture.target];
      if (before) old.push(before.image);
      const path = [...(before?.path ?? []), picture.spot && [picture.spot.u_px, picture.spot.v_px]].slice(-MAX_PATH);
      this.shown = { ...this.shown, [picture.target]: { ...picture, image, path, at } };
    }
    this.words = "";
    this.tell();
    old.forEach(image => image.close());  // not earlier: the page can draw them until it has newer ones
  }

  // removes pictures that are too old; all of them when the clock was set
  forget() {
    const now = this.world.Date.now();
    const kept = Object.entries(this.shown).filter(([, picture]) => Math.abs(now - picture.at) < OLD_MS);
    if (kept.length < Object.keys(this.shown).length) this.shown = Object.fromEntries(kept);
    this.tell();
  }

  tell() { this.take({ views: this.views, shown: this.shown, words: this.words }); }
}
