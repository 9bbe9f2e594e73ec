// The page: the unit's current data; the view is behind # in the address.

import { html, render, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { CheckNow, Session, asked, useAnswer } from "./acting.js";
import { Availability, Badge, Causes, Worst } from "./causes.js";
import { Calibration } from "./calibration.js";
import { PastChecks, SelfCheck } from "./checks.js";
import { Eyes } from "./eye.js";
import { guard } from "./failing.js";
import { useKept } from "./keeping.js";
import { Link, NOTHING } from "./link.js";
import { LENGTH_S, Memory } from "./memory.js";
import { CrossCheck, Parts, Unit } from "./more.js";
import { Numbers } from "./numbers.js";
import { Pictures } from "./pictures.js";
import { Events, Jump, PastTrends, Recordings, SPANS, secondsOf } from "./past.js";
import { LiveTrends } from "./trend.js";
import { QUANTITIES, verdictOf } from "./words.js";

const CHECK_MS = 5000, LIVE = "10 minutes";
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

function Trends({ unit, at, setAt, zone }) {
  const [span, setSpan] = useKept("span of the trends", LIVE, value => value === LIVE || Object.hasOwn(SPANS, value));
  const t = secondsOf(at), isLive = span === LIVE && t === null;
  return html`<section aria-labelledby="trend-title" class="trends"><h2 id="trend-title">${t === null ? `Last ${span}` : `${span} around ${at.replace("T", " ")} UTC`}</h2>
    <${Jump} at=${at} setAt=${setAt} zone=${zone} />
    <div role="group" aria-label="span of time" class="spans">${[LIVE, ...Object.keys(SPANS)].map(each => html`<button key=${each} type="button"
      aria-pressed=${span === each} onClick=${() => setSpan(each)}>${each}</button>`)}</div>
    ${isLive ? html`<${LiveTrends} key=${unit} memory=${memory} />` : html`<${PastTrends} key=${`${unit} ${span} ${at}`} seconds=${SPANS[span] ?? LENGTH_S} t=${t} />`}</section>`;
}

// The user who is logged in; requested again after a change and while the unit answers.
function useSession(isAnswering) {
  const [session, setSession] = useState(null);
  const look = async () => { const found = await asked("api/v1/session"); setSession(found.error ? null : found); };
  useEffect(() => { if (isAnswering) look(); else setSession(null); }, [isAnswering]);
  return [session, look];
}

function EventsView({ session, mayLook, zone, onSession, ...jump }) {
  const kept = useAnswer("api/v1/recordings", CHECK_MS);
  return html`<${Events} kept=${kept} mayLook=${mayLook} zone=${zone} ...${jump} /><${Recordings} kept=${kept} session=${session} mayLook=${mayLook} zone=${zone} onSession=${onSession} />`;
}

function UnitView({ status, measurement, session, mayLook, onSession }) {
  const check = useAnswer("api/v1/self-check", CHECK_MS);
  return html`<${Unit} status=${status} mayLook=${mayLook} />
    <${SelfCheck} check=${status === null || check?.error ? null : check}><${CheckNow} session=${session} unavailable=${check?.unavailable} onSession=${onSession} /><//>
    <${Session} session=${session} onChange=${onSession} />
    <${CrossCheck} check=${measurement?.cross_check} />
    ${status !== null && html`<${Calibration} mayLook=${mayLook} /><${PastChecks} />`}<${Parts} status=${status} />`;
}

function Page() {
  const [known, setKnown] = useState(NOTHING);
  const [at, setAt] = useState("");
  const view = useView(), [session, onSession] = useSession(known.status !== null);
  useEffect(() => {
    const link = new Link(now => { memory.add(now.measurement, now.status?.serial); setKnown(now); });
    link.start();
  }, []);
  const { measurement, status } = known, verdict = verdictOf(known), unit = useRef("");
  const latest = status ?? known.last?.status, zone = latest?.time_zone;
  const product = latest?.kind === "desk" ? "Active Laser Target on a desk" : "Active Laser Target";
  unit.current = latest?.serial ?? unit.current;  // data of one unit is not kept for another at its address
  const mayLook = session && (!session.login || session.name !== null);  // null: not known
  useEffect(() => { document.title = `${product} ${status?.serial ?? ""}`; }, [product, status?.serial]);
  return html`
    <header>
      <h1>${product} <span id="serial">${unit.current}</span></h1>
      <div class="now"><div id="verdict" class=${verdict.kind}>${verdict.text}</div><${Badge} status=${status} />
        <p id="cause" role="status"><${Worst} ...${known} /></p></div>
      <nav aria-label="views">${Object.entries(VIEWS).map(([name, title]) => html`<a key=${name} href=${`#${name}`}
        aria-current=${view === name ? "page" : undefined}>${title}</a>`)}</nav>
    </header>
    <main class=${view || "overview"}>
      ${view === "" && html`<${Causes} status=${status} /><${Numbers} measurement=${measurement} zone=${zone} />
        ${hasEyes && html`<${Eyes} measurement=${measurement} />`}<${Pictures} mayLook=${mayLook} onSession=${onSession} />`}
      ${view === "drive" && html`<${Causes} status=${status} isFar /><${Numbers} measurement=${measurement} isFar />
        ${hasEyes && html`<${Eyes} measurement=${measurement} isFar />`}`}
      ${view === "trends" && html`<${Trends} unit=${unit.current} at=${at} setAt=${setAt} zone=${zone} /><${Availability} status=${status} />`}
      ${view === "events" && html`<${EventsView} key=${unit.current} at=${at} setAt=${setAt} zone=${zone} session=${session} mayLook=${mayLook} onSession=${onSession} />`}
      ${view === "unit" && html`<${UnitView} status=${status} measurement=${measurement} session=${session} mayLook=${mayLook} onSession=${onSession} />`}
    </main>`;
}

const root = document.getElementById("page");
root.replaceChildren();
guard(root);
render(html`<${Page} />`, root);
