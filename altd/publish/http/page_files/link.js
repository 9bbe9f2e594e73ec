// What the unit has said within the last seconds, and nothing older.
//
// A stream brings measurements; twice a second, and when a reason comes or goes, the status is asked for, and
// when the stream is silent the measurement too. What that does not confirm goes within two seconds.

export const LOOK_MS = 500, FORGET_MS = 200, QUIET_MS = 400, ANSWER_MS = 1200, OLD_MS = 1400;
const MEASUREMENT = "/api/v1/measurement", STATUS = "/api/v1/status", STREAM = "/api/v1/stream";

// `show` is called with {words, measurement, status}; words are empty while the unit answers.
export class Link {
  constructor(show, world = globalThis) {
    this.show = show;
    this.world = world;
    this.known = { words: "connecting…", measurement: null, status: null };
    this.open = false;
    this.heard = 0;
    this.looking = false;
  }

  start() {
    this.connect();
    this.look();
    this.world.setInterval(() => this.forget(), FORGET_MS);
    this.world.setInterval(() => this.look(), LOOK_MS);
    // a page that nobody saw may have slept
    this.world.document.addEventListener("visibilitychange", () => this.look());
  }

  tell(change) {
    this.known = { ...this.known, ...change };
    this.show(this.known);
  }

  connect() {
    const stream = new this.world.EventSource(STREAM);
    this.stream = stream;
    stream.onopen = () => { this.open = true; };
    stream.onmessage = message => {
      this.heard = this.world.Date.now();
      const reasons = this.reasons, measurement = JSON.parse(message.data);
      this.tell({ words: "", measurement });
      if (this.reasons !== reasons) this.look();
    };
    stream.onerror = () => {
      if (this.open) this.tell({ words: "no measurements from the unit", measurement: null });
      this.open = false;
      this.look();
    };
  }

  get reasons() { return this.known.measurement?.status.join(); }

  // a clock that was set back is no news either
  silentMs() { return Math.abs(this.world.Date.now() - this.heard); }

  forget() {
    if (this.heard && this.silentMs() > OLD_MS) {
      this.tell({ words: "no news from the unit", measurement: null, status: null });
    }
  }

  async look() {
    this.forget();
    if (this.looking) return;
    this.looking = true;
    try {
      this.tell({ status: await this.answered(STATUS) });
      if (this.silentMs() > QUIET_MS) await this.ask();
      if (this.stream.readyState === 2) this.connect();  // closed for ever: there are too many, or it was refused
    } catch {
      this.tell({ words: "no connection to the unit", measurement: null, status: null });
      this.stream.close();
      this.open = false;
      this.heard = 0;
    }
    this.looking = false;
  }

  async ask() {
    const before = this.heard, measurement = await this.answered(MEASUREMENT);
    if (this.heard !== before) return;  // what the stream brought meanwhile is newer
    this.heard = this.world.Date.now();
    if (measurement.error) this.tell({ words: "nothing measured yet", measurement: null });
    else this.tell({ words: "", measurement });
  }

  async answered(path) {
    const signal = this.world.AbortSignal.timeout(ANSWER_MS);
    return await (await this.world.fetch(path, { cache: "no-store", signal })).json();
  }
}
