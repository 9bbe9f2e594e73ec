// The page's script in a document of its own, driven from outside: a line of JSON on standard input is an
// order, a line on standard output what the page then shows. Time and network are the driver's.
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import vm from "node:vm";

const script = readFileSync(process.argv[2], "utf-8").match(/<script>([\s\S]*)<\/script>/)[1];
const elements = {};
const element = () => ({
  className: "", textContent: "", children: [],
  append(child) { this.children.push(child); },
  replaceChildren(...children) { this.children = children; },
});
const document = {
  title: "",
  getElementById: id => (elements[id] ??= element()),
  createElement: element,
  addEventListener() {},
};

let now = 1_000_000, tick, answers = {}, asked = [], waiting = [];
class Stream {
  static CLOSED = 2;
  constructor() { Stream.last = this; this.readyState = 0; Stream.opened = (Stream.opened ?? 0) + 1; }
  close() { this.readyState = 2; }
}
const fetch = async path => {
  asked.push(path);
  const answer = answers[path];
  if (answer === "silent") return new Promise((_, reject) => waiting.push(reject));
  if (answer === undefined) throw new TypeError("refused");
  return { json: async () => answer };
};
const settle = () => new Promise(done => setImmediate(done));
vm.runInNewContext(script, {
  document, fetch, EventSource: Stream, AbortSignal: { timeout: () => null },
  Date: { now: () => now }, setInterval: work => { tick = work; },
});

const text = part => [part.textContent, ...part.children.map(text)].filter(Boolean).join("; ");
for await (const line of createInterface({ input: process.stdin })) {
  const order = JSON.parse(line);
  asked = [];
  if (order.answers) answers = order.answers;
  now += order.pass_ms ?? 0;
  if (order.opened) { Stream.last.readyState = 1; Stream.last.onopen(); }
  if (order.message) Stream.last.onmessage({ data: JSON.stringify(order.message) });
  if (order.broken) { Stream.last.readyState = order.broken; Stream.last.onerror(); }
  if (order.tick) tick();
  await settle();
  if (order.give_up) { waiting.splice(0).forEach(reject => reject(new Error("timeout"))); await settle(); }
  console.log(JSON.stringify({
    verdict: text(elements.verdict), kind: elements.verdict.className,
    x_mm: elements.x_mm.textContent, sigma_x_mm: elements.sigma_x_mm.textContent,
    when: elements.when.textContent.trim(), components: text(elements.components),
    asked, streams: Stream.opened, title: document.title,
  }));
}
