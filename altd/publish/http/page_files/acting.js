// Requests to the unit, access to its actions, and the reason for an action that is not possible.

import { html, useEffect, useState } from "./vendor/htm-preact.js";

const ANSWER_MS = 30000;

// The unit's answer; {error} with a sentence if there is none or the unit refuses.
export async function asked(address, method = "GET", body = undefined) {
  const headers = method === "GET" ? {} : { "X-Altd-Request": "page" };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  try {
    const answer = await fetch(address, { method, headers, body: body && JSON.stringify(body), cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS) });
    return await answer.json();
  } catch {
    return { error: "no answer from the unit" };
  }
}

// The answer of an address, requested again at an interval; {error} if there is none.
export function useAnswer(address, everyMs) {
  const [answer, setAnswer] = useState(null);
  useEffect(() => {
    let isWanted = true, isAsking = false;
    const look = async () => {
      if (document.hidden || isAsking) return;  // a slow unit gets no more requests
      isAsking = true;
      const found = await asked(address);
      isAsking = false;
      if (isWanted) setAnswer(found);
    };
    setAnswer(null);
    look();
    const timer = setInterval(look, everyMs);
    document.addEventListener("visibilitychange", look);
    return () => { isWanted = false; clearInterval(timer); document.removeEventListener("visibilitychange", look); };
  }, [address]);
  return answer;
}

// Why the unit would refuse an action of this browser; empty: it would not.
export function whyNot(session) {
  if (session?.may_act) return "";
  if (!session) return "access is not known yet";
  return session.login ? html`<a href="#unit">log in</a> first` : "possible only on the unit's own computer";
}

export function Session({ session, onChange }) {
  const [name, setName] = useState(""), [password, setPassword] = useState(""), [said, setSaid] = useState("");
  if (!session?.login) return null;
  const logIn = async event => {
    event.preventDefault();
    setSaid("…");
    const done = await asked("api/v1/login", "POST", { name, password });
    setPassword("");
    setSaid(done.error ?? "");
    onChange();
  };
  const logOut = async () => { await asked("api/v1/logout", "POST"); onChange(); };
  return html`<section aria-labelledby="session-title"><h2 id="session-title">Access</h2>
    ${session.name ? html`<p>${session.name} <button type="button" onClick=${logOut}>Log out</button></p>`
      : html`<form onSubmit=${logIn}>
        <label>name <input autocomplete="username" required maxlength="32" value=${name} onInput=${event => setName(event.target.value)} /></label>
        <label>password <input type="password" autocomplete="current-password" required value=${password} onInput=${event => setPassword(event.target.value)} /></label>
        <button>Log in</button> <span role="status">${said}</span></form>`}</section>`;
}

export function CheckNow({ session, unavailable, onSession }) {
  const [said, setSaid] = useState("");
  const check = async () => {
    setSaid("self-check running…");
    const done = await asked("api/v1/self-check", "POST");
    setSaid(done.error ?? `result: ${done.verdict}`);
    if (done.error) onSession();
  };
  return html`<p><button type="button" disabled=${!session?.may_act || Boolean(unavailable)} onClick=${check}>Check now</button>
    <span class="reason">${unavailable || whyNot(session)}</span> <span role="status">${said}</span></p>`;
}
