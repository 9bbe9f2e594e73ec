// The page's pictures in a world of its own, driven as `page_in_node.mjs` is: a line of JSON is an order, a line on
// standard output what is then shown.
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const { Watcher } = await import(new URL("watcher.mjs", pathToFileURL(`${process.argv[2]}/`)));

let now = 1_000_000, tick, known;
class Socket {
  constructor(address) { Socket.last = this; this.address = address; this.readyState = 1; this.sent = 0; }
  send() { this.sent += 1; }
  close() { this.readyState = 3; }
}
const message = header => {
  const text = new TextEncoder().encode(JSON.stringify(header)), bytes = new Uint8Array(4 + text.length);
  new DataView(bytes.buffer).setUint32(0, text.length);
  bytes.set(text, 4);
  return bytes.buffer;
};
const settle = () => new Promise(done => setImmediate(done));
new Watcher(shown => { known = shown; }, {
  document: { addEventListener() {}, hidden: false }, location: { href: "http://plant/unit7/#drive" }, URL, WebSocket: Socket,
  Date: { now: () => now }, setInterval: work => { tick = work; }, setTimeout() {}, clearTimeout() {},
  createImageBitmap: async () => ({ close() {} }),
}).start();
await Socket.last.onmessage({ data: JSON.stringify({ views: [] }) });

for await (const line of createInterface({ input: process.stdin })) {
  const order = JSON.parse(line);
  now += order.pass_ms ?? 0;
  if (order.message) await Socket.last.onmessage({ data: message(order.message) });
  if (order.tick) tick();
  await settle();
  const shown = Object.entries(known.shown).map(([target, picture]) => [target, [picture.sequence, (now - picture.at) / 1000]]);
  console.log(JSON.stringify({ shown: Object.fromEntries(shown), asked: Socket.last.sent, address: Socket.last.address }));
}
