// The page: what the unit says now, put together; which view is shown stands behind # in the address.

import { html, render, useEffect, useState } from "./vendor/htm-preact.js";
import { CheckNow, Session, asked } from "./acting.js";
import { Availability, Badge, Causes } from "./causes.js";
import { Eyes } from "./eye.js";
import { Link } from "./link.js";
import { Parts, SelfCheck, Unit } from "./more.js";
import { Numbers } from "./numbers.js";
import { Pictures } from "./pictures.js";
import { Events, PastTrends, Recordings, SPANS, useAnswer } from "./past.js";
import { LiveTrends, Memory } from "./trend.js";
import { QUANTITIES, verdictOf } from "./words.js";

const CHECK_MS = 5000, RELOAD_MS = 2000, LIVE = "10 minutes";
const VIEWS = { "": "Overview", drive: "Drive", trends: "Trends", events: "Events", unit: "Unit" };
const memory = new Memory();
const hasEyes = ["x_mm", "y_mm", "yaw_mm_per_m", "pitch_mm_per_m"].every(key => QUANTITIES.some(quantity => quantity.key === key));

function useView() {
  const read = () => location.hash.slice(1) in VIEWS ? location.hash.slice(1) : "";
  const [view, setView] = useState(read);
  useEffect(() => {
    const change = () => setView(read());
    addEventListener("hashchange", change);
    return () => removeEventListener("hashchange", change);
  }, []);
  return view;
}

function Trends() {
  const [span, setSpan] = useState(LIVE);
  return html`<section aria-labelledby="trend-title" class="trends"><h2 id="trend-title">Last ${span}</h2>
    <div role="group" aria-label="span of time" class="spans">${[LIVE, ...Object.keys(SPANS)].map(each => html`<button key=${each} type="button"
      aria-pressed=${span === each} onClick=${() => setSpan(each)}>${each}</button>`)}</div>
    ${span === LIVE ? html`<${LiveTrends} memory=${memory} />` : html`<${PastTrends} key=${span} span=${span} />`}</section>`;
}

// Who is logged in, asked for anew after a change and while the unit answers.
function useSession(isAnswering) {
  const [session, setSession] = useState(null);
  const look = async () => { const found = await asked("/api/v1/session"); setSession(found.error ? null : found); };
  useEffect(() => { if (isAnswering) look(); else setSession(null); }, [isAnswering]);
  return [session, look];
}

function EventsView({ session }) {
  return html`<${Events} /><${Recordings} mayAct=${session?.may_act} />`;
}

function UnitView({ status, session, onSession }) {
  const check = useAnswer("/api/v1/self-check", CHECK_MS);
  return html`<${Unit} status=${status} />
    <${SelfCheck} check=${status === null || check?.error ? null : check}><${CheckNow} mayAct=${session?.may_act} /><//>
    <${Session} session=${session} onChange=${onSession} /><${Parts} status=${status} />`;
}

function Page() {
  const [known, setKnown] = useState({ words: "connecting…", measurement: null, status: null });
  const view = useView(), [session, onSession] = useSession(known.status !== null);
  useEffect(() => {
    const link = new Link(now => { memory.add(now.measurement); setKnown(now); });
    link.start();
  }, []);
  const { measurement, status } = known, verdict = verdictOf(known);
  useEffect(() => { document.title = `Active Laser Target ${status?.serial ?? ""}`; }, [status?.serial]);
  return html`
    <header>
      <h1>Active Laser Target <span id="serial">${status?.serial ?? ""}</span></h1>
      <div id="verdict" class=${verdict.kind} role="status">${verdict.text}</div>
      <${Badge} status=${status} />
      <nav aria-label="views">${Object.entries(VIEWS).map(([name, title]) => html`<a key=${name} href=${`#${name}`}
        aria-current=${view === name ? "page" : undefined}>${title}</a>`)}</nav>
    </header>
    <main class=${view || "overview"}>
      ${view === "" && html`<${Numbers} measurement=${measurement} /><${Causes} status=${status} />
        ${hasEyes && html`<${Eyes} measurement=${measurement} />`}<${Pictures} />`}
      ${view === "drive" && html`${hasEyes && html`<${Eyes} measurement=${measurement} />`}<${Numbers} measurement=${measurement} />
        <${Causes} status=${status} />`}
      ${view === "trends" && html`<${Trends} /><${Availability} status=${status} />`}
      ${view === "events" && html`<${EventsView} session=${session} />`}
      ${view === "unit" && html`<${UnitView} status=${status} session=${session} onSession=${onSession} />`}
    </main>`;
}

const root = document.getElementById("page");

// What failed would stand still and show what was; nothing is shown instead, and the page begins anew.
addEventListener("error", event => {
  if (!event.error) return;
  const said = Object.assign(document.createElement("p"), { className: "waiting", textContent: "the page failed and is loaded anew…" });
  root.replaceChildren(said);
  setTimeout(() => location.reload(), RELOAD_MS);
});
root.replaceChildren();
render(html`<${Page} />`, root);
