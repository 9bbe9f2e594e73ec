// The unit's messages of the last seconds, and nothing older.
//
// A stream brings measurements. The status is requested twice a second and when a reason begins or ends; so is the
// measurement, when the stream is silent. Unconfirmed data is removed within two seconds. A message that was delayed,
// by a computer that slept, a slow line or a proxy, is as old as its `clock_ms`, and is not news. An answer that takes longer
// than ANSWER_MS is late: it shows only that the line is slow, and what the state was.

export const LOOK_MS = 500, FORGET_MS = 200, QUIET_MS = 400, ANSWER_MS = 1200, OLD_MS = 1400, SLOW_MS = 500, GIVE_UP_MS = 8000;
const MEASUREMENT = "api/v1/measurement", STATUS = "api/v1/status", STREAM = "api/v1/stream";

// Of two numbers of messages, which start again after 32 bits.
const isLater = (message, last) => ((message - last) | 0) > 0;

const SLOW = "link too slow", SILENT = "no data from the unit", NONE = "no connection to the unit";
const CHECK = "Check the network, and the unit's power supply.";
export const REMEDIES = { [SLOW]: "Values would be too old. Use a faster connection.", [SILENT]: CHECK, [NONE]: CHECK };
export const NOTHING = { words: "connecting…", measurement: null, status: null, last: null };

// `show` is called with {words, measurement, status, last}; words are empty while the unit answers. `last`: the last status
// that came, {status, at}, with the time of the request.
export class Link {
  constructor(show, world = globalThis) {
    this.show = show;
    this.world = world;
    this.known = NOTHING;
    this.open = false;
    this.heard = 0;  // when what is shown was sent
    this.sent = null;  // the clock of this session: at `at` here it was `clock_ms` there, or later
    this.looking = false;
    this.askedAt = null;  // of the request that is under way
    this.tookMs = 0;  // the last answer
  }

  start() {
    this.connect();
    this.look();
    this.world.setInterval(() => this.forget(), FORGET_MS);
    this.world.setInterval(() => this.look(), LOOK_MS);
    // a hidden page may have slept
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
      const reasons = this.reasons, measurement = JSON.parse(message.data);
      const sentAt = this.sentAt(measurement);
      if (sentAt === null) return;
      this.heard = sentAt;
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

  // When a measurement was sent, or a little before; null for one that is no news: not newer than all before, or too
  // long on its way. Where none is news, the unit is asked as when the stream is silent.
  sentAt({ session, message, clock_ms }) {
    if (session !== this.sent?.session || !isLater(message, this.sent.message)) return null;
    const at = this.timeOf(clock_ms);
    if (this.world.Date.now() - at > OLD_MS) return null;
    this.sent.message = message;
    return at;
  }

  // Of the unit's clock here; nothing came before it was sent, and by that the clocks are kept together.
  timeOf(clock_ms) {
    const now = this.world.Date.now(), at = this.sent.at + ((clock_ms - this.sent.clock_ms) | 0);
    if (at > now) Object.assign(this.sent, { clock_ms, at: now });
    return Math.min(at, now);
  }

  // a clock that was set back is no news either
  silentMs() { return Math.abs(this.world.Date.now() - this.heard); }

  forget() {
    const isLate = this.askedAt !== null && Math.abs(this.world.Date.now() - this.askedAt) > ANSWER_MS;
    if (isLate) this.lose(Object.hasOwn(REMEDIES, this.known.words) ? this.known.words : SILENT);
    else if (this.heard && this.silentMs() > OLD_MS) this.tell({ words: this.isSlow ? SLOW : SILENT, measurement: null, status: null });
  }

  get isSlow() { return this.tookMs > SLOW_MS; }

  lose(words) {
    this.tell({ words, measurement: null, status: null });
    this.stream.close();
    this.open = false;
    this.heard = 0;
  }

  async look() {
    this.forget();
    if (this.looking) return;
    this.looking = true;
    try {
      const status = await this.answered(STATUS);
      this.tell({ status: this.isSlow && this.silentMs() > OLD_MS ? null : status });
      if (this.silentMs() > QUIET_MS) await this.ask();
      if (this.stream.readyState === 2) this.connect();  // closed permanently: there are too many, or it was refused
    } catch (error) {
      this.lose(error === SLOW ? SLOW : NONE);
    }
    this.looking = false;
    this.askedAt = null;
  }

  async ask() {
    const at = this.world.Date.now(), before = this.heard, last = { ...this.sent };
    const measurement = await this.answered(MEASUREMENT);
    if (measurement === null) return;
    const { error, session, message, clock_ms } = measurement;
    if (!error) {
      if (session === last.session && !isLater(message, last.message)) return;  // it is repeated: not the unit answered
      if (session !== this.sent?.session) this.sent = { session, message, clock_ms, at };
      else if (this.timeOf(clock_ms) < at) Object.assign(this.sent, { clock_ms, at });  // it was sent after it was asked for
    }
    if (this.heard !== before) return;  // what the stream brought meanwhile is newer
    if (!error) this.sent.message = message;
    if (this.isSlow) {  // values would be shown for a moment, and be too old before the next ones come
      this.tell({ words: SLOW, measurement: null });
      return;
    }
    this.heard = error ? at : this.timeOf(clock_ms);
    this.tell(error ? { words: "nothing measured yet", measurement: null } : { words: "", measurement });
  }

  // null if it is refused, as after too many requests: that gives no information; before the first measurement there
  // are reasons in `status`.
  async answered(path) {
    const at = this.askedAt = this.world.Date.now(), signal = this.world.AbortSignal.timeout(GIVE_UP_MS);
    const answer = await (await this.world.fetch(path, { cache: "no-store", signal })).json();
    if (path === STATUS && !answer.error) this.known = { ...this.known, last: { status: answer, at } };
    this.tookMs = this.world.Date.now() - at;
    if (this.tookMs > ANSWER_MS) throw SLOW;
    this.askedAt = null;
    return answer.error && !answer.status ? null : answer;
  }
}
