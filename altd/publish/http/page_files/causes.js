// The unit's state, what it comes from, and what to do.

import { html } from "./vendor/htm-preact.js";
import { SIGNALS, duration, words } from "./words.js";

export function Badge({ status }) {
  const signal = status?.state?.signal, known = SIGNALS[signal];
  if (!known) return html`<span class="badge unknown">state not known</span>`;
  return html`<span class=${`badge ${signal}`}><span aria-hidden="true">${known.mark}</span> ${known.words}</span>`;
}

export function Causes({ status }) {
  const causes = status?.state?.causes ?? [];
  return html`<section class="causes" aria-labelledby="causes-title">
    <h2 id="causes-title">State</h2>
    ${status?.state ? html`<p><${Badge} status=${status} /> for ${duration(status.state.for_s)}</p>` : html`<p>not known</p>`}
    <ul aria-live="polite">
      ${causes.map(cause => html`<li key=${`${cause.code} ${cause.of}`} class=${cause.signal} data-code=${cause.code}>
        <strong><span aria-hidden="true">${SIGNALS[cause.signal]?.mark}</span> ${cause.brief}${cause.of ? html` <em>(${cause.of})</em>` : ""}</strong>
        <span class="remedy">${cause.remedy}</span>
        <small>${cause.detail ? `${cause.detail}; ` : ""}${words(cause.code)}, ${cause.active ? "for" : "over; began"} ${duration(cause.for_s)}${cause.active ? "" : " ago"}${
          cause.times > 1 ? `, ${cause.times} times` : ""}</small>
      </li>`)}
    </ul>
    ${status?.state && causes.length === 0 && html`<p>nothing is wrong</p>`}
  </section>`;
}

// Below so many seconds a span is not as long as its name says.
const WHOLE_S = { last_hour: 3540, last_day: 86340, last_31_days: 2674800 };

export function Availability({ status }) {
  const availability = status?.availability;
  if (!availability) return null;
  const share = span => span?.share == null ? "–" : `${(100 * span.share).toFixed(2)} %`;
  const known = (span, name) => span?.observed_s < WHOLE_S[name] && html` <small>of ${duration(span.observed_s)}</small>`;
  return html`<section aria-labelledby="availability-title"><h2 id="availability-title">Time valid</h2>
    <dl class="facts">${["last_hour", "last_day", "last_31_days", "since_start"].map(span => html`<div key=${span}><dt>${words(span)}</dt>
      <dd>${share(availability[span])}${known(availability[span], span)}</dd></div>`)}</dl></section>`;
}
