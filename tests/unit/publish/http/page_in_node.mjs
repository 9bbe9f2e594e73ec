// The page's link to the unit in a world of its own, driven from outside: a line of JSON on standard input is
// an order, a line on standard output what is then known. Time and network are the driver's.
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const folder = pathToFileURL(`${process.argv[2]}/`);
const { Link } = await import(new URL("link.mjs", folder));
const { fixed, sigmaOf, verdictOf } = await import(new URL("words.mjs", folder));
const X = { key: "x_mm", decimals: 3, has_motion: true };
const PLACE = { ...X, has_motion: false };
const SLOPE = { key: "pitch_mm_per_m", is_also: "pitch_deg", unit: "mm/m", decimals: 4, has_motion: true };

let now = 1_000_000, tick, answers = {}, asked = [], waiting = [], slow = [], known;
class Stream {
  constructor() { Stream.last = this; this.readyState = 0; Stream.opened = (Stream.opened ?? 0) + 1; }
  close() { this.readyState = 2; }
}
const fetch = async path => {
  asked.push(path);
  const answer = answers[path];
  if (answer?.after_ms) return new Promise(done => slow.push([now + answer.after_ms, () => done({ json: async () => answer.document })]));
  if (answer === "silent") return new Promise((_, reject) => waiting.push(reject));
  if (answer === undefined) throw new TypeError("refused");
  return { json: async () => answer };
};
const settle = () => new Promise(done => setImmediate(done));
new Link(shown => { known = shown; }, {
  document: { addEventListener() {} }, fetch, EventSource: Stream, AbortSignal: { timeout: () => null },
  Date: { now: () => now }, setInterval: work => { tick = work; },
}).start();

for await (const line of createInterface({ input: process.stdin })) {
  const order = JSON.parse(line);
  asked = [];
  if (order.answers) answers = order.answers;
  now += order.pass_ms ?? 0;
  if (order.opened) { Stream.last.readyState = 1; Stream.last.onopen(); }
  for (const [at, done] of slow) if (at <= now) done();
  await settle();
  if (order.message) Stream.last.onmessage({ data: JSON.stringify(order.message) });
  if (order.broken) { Stream.last.readyState = order.broken; Stream.last.onerror(); }
  if (order.tick) tick();
  await settle();
  if (order.give_up) { waiting.splice(0).forEach(reject => reject(new Error("timeout"))); await settle(); }
  const verdict = verdictOf(known);
  console.log(JSON.stringify({
    verdict: verdict.text, kind: verdict.kind, sequence: known.measurement?.sequence ?? null,
    x_mm: fixed(known.measurement?.x_mm, X.decimals), sigma_x_mm: sigmaOf(known.measurement, X),
    sigma_of_a_place: sigmaOf(known.measurement, PLACE),
    sigma_pitch_mm_per_m: sigmaOf(known.measurement, SLOPE),
    knows_status: known.status !== null, components: Object.keys(known.status?.components ?? {}), asked, streams: Stream.opened, last: known.last,
  }));
}
