// The past: trends and events from the unit's history, and the recordings of frames around faults.

import { html, useEffect, useState } from "./vendor/htm-preact.js";
import { asked, useAnswer, whyNot } from "./acting.js";
import { Lane, Plot, banded } from "./plot.js";
import { QUANTITIES, SIGNALS, local, megabytes, utc, words } from "./words.js";

const MINUTE_S = 60, DAY_S = 86400, POINTS = 600;
export const SPANS = { "1 hour": 3600, "1 day": DAY_S, "1 week": 7 * DAY_S, "1 month": 31 * DAY_S, "1 year": 366 * DAY_S };
const KINDS = { cause_came: "began", cause_went: "ended" };
const SEVERITIES = Object.keys(SIGNALS), NAMES = ["mean", "lowest", "highest"];

// The time of `at`, of a field without a zone: UTC, s; null for none.
export const secondsOf = at => at && Date.parse(`${at}Z`) > 0 ? Date.parse(`${at}Z`) / 1000 : null;

// Goes to a time, and tells what was the case in its minute; `at`: text of the field.
export function Jump({ at, setAt, zone }) {
  const t = secondsOf(at), there = t !== null && local(1000 * t, zone);
  return html`<p class="jump"><label>Time, UTC <input type="datetime-local" value=${at} onInput=${event => setAt(event.target.value)} /></label>
    ${there && html` <small>${there} ${zone}</small>`} ${at && html` <button type="button" onClick=${() => setAt("")}>now</button>`}
    ${t !== null && html` <${Then} t=${t} />`}</p>`;
}

function Then({ t }) {
  const trend = useAnswer(`api/v1/trend?from=${t}&to=${t + MINUTE_S}&points=1`, 10000);
  if (!trend?.n?.length) return html`<strong>${trend === null ? "waiting for the unit…" : trend.error ?? "nothing was measured then"}</strong>`;
  const [n, valid, why] = [trend.n[0], trend.n_valid[0], trend.lost_to[0]], state = SIGNALS[SEVERITIES[trend.worst[0]]].words;
  return html`<strong class=${valid === n ? "good" : "bad"}>${utc(new Date(1000 * t).toISOString()).slice(11, 16)}${" UTC: "}
    ${valid === n ? "all" : valid ? `${Math.floor(100 * valid / n)} % of the` : "no"} measurements valid${why && ` (${words(why)})`}, state ${state}</strong>`;
}

// No line is drawn where nothing was measured for more than two spans.
function gapped(trend, { mean, low, high }) {
  const columns = [[], [], [], []];
  trend.t_s.forEach((t, number) => {
    if (number && t - trend.t_s[number - 1] > 2.5 * trend.span_s) columns.forEach((column, each) => column.push(each ? null : t - trend.span_s));
    [t, mean[number], low[number], high[number]].forEach((value, each) => columns[each].push(value));
  });
  return columns;
}

function Worst({ trend }) {
  const spans = trend.t_s.map((t, number) => ({ state: SEVERITIES[trend.worst[number]], since: t, until: t + trend.span_s }));
  return html`<${Lane} title="the unit's worst state" spans=${spans} begin=${trend.t_s[0]} end=${trend.t_s.at(-1) + trend.span_s}
    names=${Object.fromEntries(SEVERITIES.map(each => [each, SIGNALS[each].words]))} />`;
}

function csvOf(trend) {
  const names = Object.keys(trend.quantities);
  const head = ["time", "n", "n_valid", "worst", ...names.flatMap(name => [`${name}_mean`, `${name}_sigma`, `${name}_low`, `${name}_high`])];
  const rows = trend.t_s.map((t, number) => [new Date(1000 * t).toISOString(), trend.n[number], trend.n_valid[number], trend.worst[number],
    ...names.flatMap(name => ["mean", "sigma", "low", "high"].map(part => trend.quantities[name][part][number] ?? ""))].join(","));
  return `${[head.join(","), ...rows].join("\n")}\n`;
}

// An address that the browser can save from; the previous one is released.
function useFile(text) {
  const [address, setAddress] = useState("");
  useEffect(() => {
    if (text === null) { setAddress(""); return undefined; }
    const made = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    setAddress(made);
    return () => URL.revokeObjectURL(made);
  }, [text]);
  return address;
}

// The last `seconds`, or as many around the time `t`, s.
export function PastTrends({ seconds, t }) {
  const span = t === null ? `from=-${seconds}` : `from=${Math.max(t - seconds / 2, 0)}&to=${t + seconds / 2}`;
  const isOld = t !== null && Date.now() / 1000 - t > 30 * DAY_S, points = isOld ? Math.min(POINTS, seconds / MINUTE_S) : POINTS;  // of minutes
  const trend = useAnswer(`api/v1/trend?${span}&points=${points}`, seconds > 3600 ? 60000 : 10000);
  const isThere = trend && !trend.error && trend.t_s.length > 0;
  const address = useFile(isThere ? csvOf(trend) : null);
  if (!isThere) return html`<p>${trend === null ? "waiting for the unit…" : trend.error ?? "nothing was measured in that time"}</p>`;
  return html`<p class="hint">Line: mean; band: lowest to highest value. Times are UTC.
      ${address && html` <a href=${address} download="trend.csv">Download as CSV</a>`}</p>
    <div class="plots">${QUANTITIES.filter(quantity => quantity.is_shown && trend.quantities[quantity.key]).map(quantity =>
      html`<${Plot} key=${quantity.key} title=${`${quantity.label}, ${quantity.unit}`} names=${NAMES} decimals=${quantity.decimals}
        read=${() => gapped(trend, trend.quantities[quantity.key])} lines=${banded(trend.t_s.length < 3)} bands changes=${[quantity.key, trend]} />`)}
      <${Worst} trend=${trend} /></div>`;
}

function Local({ time, zone }) {
  const there = local(time, zone);
  return there && html`<small>${there}</small>`;
}

// The frames of an event, if they are still kept; `kept`: the unit's list of recordings.
function Frames({ name, kept, mayLook }) {
  if (!name || !kept?.recordings) return null;
  if (!kept.recordings.some(each => each.name === name)) return html`<small>the frames were deleted</small>`;
  return mayLook !== false && html` <a href=${`api/v1/recordings/${name}`} download>Download frames</a>`;
}

const kindOf = event => KINDS[event.kind] ?? words(event.kind);

export function Events({ kept, mayLook, at, setAt, zone }) {
  const [before, setBefore] = useState(null), [kind, setKind] = useState(""), [search, setSearch] = useState(""), t = secondsOf(at);
  const answer = useAnswer(`api/v1/events?limit=50${t === null ? "" : `&to=${t + MINUTE_S}`}${before ? `&before=${before}` : ""}`, 5000);
  const loaded = answer?.events ?? [], kinds = [...new Set([kind, ...loaded.map(kindOf)].filter(Boolean))];
  const events = loaded.filter(event => (!kind || kindOf(event) === kind)
    && [kindOf(event), event.of, event.text, event.detail.code, event.detail.remedy].join(" ").toLowerCase().includes(search.toLowerCase()));
  return html`<section aria-labelledby="events-title" class="wide"><h2 id="events-title">Events</h2>
    <${Jump} at=${at} setAt=${value => { setBefore(null); setAt(value); }} zone=${zone} />
    <p class="jump"><label>Kind <select value=${kind} onChange=${event => setKind(event.target.value)}><option value="">all</option>
      ${kinds.map(each => html`<option key=${each} value=${each}>${each}</option>`)}</select></label>
      <label>Search <input type="search" value=${search} onInput=${event => setSearch(event.target.value)} /></label>
      ${events.length < loaded.length && html` <small>${events.length} of ${loaded.length}</small>`}</p>
    ${answer?.error && html`<p>${answer.error}</p>`}
    <div class="scrolls" tabindex="0" role="region" aria-label="table of events"><table class="events">
      <thead><tr><th scope="col">UTC${zone && html`<small>${zone}</small>`}</th><th scope="col">Event</th><th scope="col">Part</th><th scope="col">Message</th></tr></thead>
      <tbody>${events.map(event => html`<tr key=${event.id} class=${`severity${event.kind === "cause_went" ? 0 : event.severity}`}>
        <td>${utc(event.time)}<${Local} time=${event.time} zone=${zone} /></td><td>${kindOf(event)}</td><td>${event.of ?? ""}</td>
        <td>${event.kind in KINDS ? html`<a href=${`reasons#${event.detail.code}`}>${event.text}</a>` : event.text}${event.detail.remedy ? html`<small>${event.detail.remedy}</small>` : ""}
          <${Frames} name=${event.detail.recording} kept=${kept} mayLook=${mayLook} /></td></tr>`)}</tbody>
    </table></div>
    ${before && html`<button type="button" onClick=${() => setBefore(null)}>newest</button>`}
    ${loaded.length === 50 && html` <button type="button" onClick=${() => setBefore(loaded.at(-1).id)}>older</button>`}</section>`;
}

// mayLook: whether this browser gets pictures, and so recordings of them.
export function Recordings({ kept: answer, session, mayLook, zone, onSession }) {
  const mayAct = Boolean(session?.may_act);
  const [said, setSaid] = useState(""), kept = answer?.recordings ?? [], isImpossible = !mayAct || Boolean(answer?.unavailable);
  const act = async (address, method) => {
    setSaid("…");
    const done = await asked(address, method);
    setSaid(done.error ?? "done");
    if (done.error) onSession();
  };
  return html`<section aria-labelledby="kept-title" class="wide"><h2 id="kept-title">Fault recordings</h2>
    <p class="hint">The frames of the seconds around each fault, for <code>altd replay</code>. ${answer?.error ?? ""}
      ${mayLook === false && html` To download them, <a href="#unit">log in</a> first.`}</p>
    <button type="button" disabled=${isImpossible} onClick=${() => act("api/v1/recordings", "POST")}>Record the last seconds</button>
    <span class="reason"> ${answer?.unavailable || whyNot(session)}</span> <span role="status">${said}</span>
    ${kept.length > 0 && html`<div class="scrolls" tabindex="0" role="region" aria-label="kept frames"><table>
      <thead><tr><th scope="col">UTC</th><th scope="col">Cause</th><th scope="col">s</th><th scope="col">Size</th><th scope="col">Download</th><th scope="col">Protect</th></tr></thead>
      <tbody>${kept.map(each => html`<tr key=${each.name}><td>${utc(each.start)}<${Local} time=${each.start} zone=${zone} /></td><td>${words(each.why)}</td>
        <td>${each.seconds.toFixed(1)}</td><td>${megabytes(each.bytes)}</td>
        <td>${mayLook === false ? each.name : html`<a href=${`api/v1/recordings/${each.name}`} download>${each.name}.tar</a>`}</td>
        <td><button type="button" disabled=${!mayAct} onClick=${() => act(`api/v1/recordings/${each.name}/mark`, each.marked ? "DELETE" : "PUT")}>
            ${each.marked ? "Unprotect" : "Protect"}</button>${each.marked && html` <small>protected from deletion</small>`}</td></tr>`)}</tbody></table></div>`}</section>`;
}
