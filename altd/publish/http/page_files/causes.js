// The unit's state, its causes, and their remedies.

import { html } from "./vendor/htm-preact.js";
import { REMEDIES } from "./link.js";
import { ORIGINS, SIGNALS, counted, duration, utc, words } from "./words.js";

const isOrigin = cause => ORIGINS.includes(cause.code);
const named = cause => html`${cause.brief}${cause.of ? html` <em>(${cause.of})</em>` : ""}`;

// Active causes, the worst first; those of simulated frames last, which the verdict names already.
const activeIn = status => (status?.state?.causes ?? []).filter(cause => cause.active && cause.code !== "rehearsal")
  .sort((one, other) => isOrigin(one) - isOrigin(other));

// To its explanation, on the unit itself.
const explained = ({ code }) => `reasons#${code}`;

// The worst cause and its remedy in one line. No duration is in it, so that a screen reader repeats it only if it changes.
export function Worst({ words: lost, measurement, status, last }) {
  const remedy = REMEDIES[lost], [worst] = activeIn(remedy ? last?.status : status);
  if (remedy && last) return html`<span>${remedy} Last known state, ${utc(new Date(last.at).toISOString()).slice(0, 16)} UTC: ${
    words(last.status.state?.signal ?? "not known")}${worst && html`, ${named(worst)}`}</span>`;
  if (worst && !remedy) return html`<a href=${explained(worst)}><span><strong>${named(worst)}</strong>: ${worst.remedy}</span></a>`;
  return html`<span>${remedy ?? (measurement && !measurement.valid ? measurement.status.map(words).join(", ") : status?.state ? "no fault" : "state not known")}</span>`;
}

// The worst signal; without that of simulated frames, which the verdict names already.
export function Badge({ status }) {
  const causes = (status?.state?.causes ?? []).filter(cause => cause.active), others = causes.filter(cause => !isOrigin(cause));
  const hasOrigin = others.length < causes.length;
  if (hasOrigin && others.length === 0) return null;
  const signal = hasOrigin ? Object.keys(SIGNALS).findLast(each => others.some(cause => cause.signal === each)) : status?.state?.signal;
  const known = SIGNALS[signal];
  if (!known) return null;
  return html`<span class=${`badge ${signal}`}><span aria-hidden="true">${known.mark}</span> ${known.words}</span>`;
}

// isFar: read from two metres, where one active cause has room: the worst, which is the first.
export function Causes({ status, isFar }) {
  const known = (status?.state?.causes ?? []).filter(cause => cause.code !== "rehearsal")
    .sort((one, other) => other.active - one.active || isOrigin(one) - isOrigin(other));
  const all = isFar ? activeIn(status) : known;
  const causes = isFar ? all.slice(0, 1) : all;
  const badge = Badge({ status }), more = all.length - causes.length;
  return html`<section class="causes" aria-labelledby="causes-title" tabindex="0">
    <h2 id="causes-title">State</h2>
    ${!status?.state && html`<p>not known</p>`}
    ${status?.state && (badge || more > 0) && html`<p class="state">${badge} ${badge && !known.some(isOrigin) && `for ${duration(status.state.for_s)}`}
      ${more > 0 && html` <a href="#">${counted(more, "more cause")}</a>`}</p>`}
    <ul>
      ${causes.map(cause => html`<li key=${`${cause.code} ${cause.of}`} class=${cause.active ? cause.signal : "ended"} data-code=${cause.code}><a href=${explained(cause)}>
        <strong><span aria-hidden="true">${SIGNALS[cause.signal]?.mark}</span> ${named(cause)}</strong>
        <span class="remedy">${cause.remedy}</span>
        <small>${cause.detail ? `${cause.detail}; ` : ""}<code>${cause.code}</code>, ${cause.active ? "for" : "ended; began"} ${duration(cause.for_s)}${cause.active ? "" : " ago"}${
          cause.times > 1 ? `, ${cause.times} times` : ""}</small>
      </a></li>`)}
    </ul>
    ${status?.state && causes.length === 0 && html`<p>no fault</p>`}
    ${!isFar && html`<p><a href="reasons">All reasons</a></p>`}
  </section>`;
}

// A shorter observed span is stated with its length.
const WHOLE_S = { last_hour: 3540, last_day: 86340, last_31_days: 2674800 };

export function Availability({ status }) {
  const availability = status?.availability;
  if (!availability) return null;
  const share = span => span?.share == null ? "–" : `${(100 * span.share).toFixed(2)} %`;
  const known = (span, name) => span?.observed_s < WHOLE_S[name] && html` <small>of ${duration(span.observed_s)}</small>`;
  return html`<section aria-labelledby="availability-title"><h2 id="availability-title">Share of time with valid values</h2>
    <dl class="facts">${["last_hour", "last_day", "last_31_days", "since_start"].map(span => html`<div key=${span}><dt>${words(span)}</dt>
      <dd>${share(availability[span])}${known(availability[span], span)}</dd></div>`)}</dl></section>`;
}
