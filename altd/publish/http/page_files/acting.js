// Asking the unit, and who may ask it to do something.

import { html, useState } from "./vendor/htm-preact.js";

const ANSWER_MS = 30000;

// The unit's answer; {error} in words where there is none or it refuses.
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

export function Session({ session, onChange }) {
  const [name, setName] = useState(""), [password, setPassword] = useState(""), [said, setSaid] = useState("");
  if (!session?.login) return null;
  const logIn = async event => {
    event.preventDefault();
    setSaid("…");
    const done = await asked("/api/v1/login", "POST", { name, password });
    setPassword("");
    setSaid(done.error ?? "");
    onChange();
  };
  const logOut = async () => { await asked("/api/v1/logout", "POST"); onChange(); };
  return html`<section aria-labelledby="session-title"><h2 id="session-title">Who may act</h2>
    ${session.name ? html`<p>${session.name} <button type="button" onClick=${logOut}>log out</button></p>`
      : html`<form onSubmit=${logIn}>
        <label>name <input autocomplete="username" required maxlength="32" value=${name} onInput=${event => setName(event.target.value)} /></label>
        <label>password <input type="password" autocomplete="current-password" required value=${password} onInput=${event => setPassword(event.target.value)} /></label>
        <button>log in</button> <span role="status">${said}</span></form>`}</section>`;
}

export function CheckNow({ mayAct, onSession }) {
  const [said, setSaid] = useState("");
  if (!mayAct) return null;
  const check = async () => {
    setSaid("the unit checks itself…");
    const done = await asked("/api/v1/self-check", "POST");
    setSaid(done.error ?? `the verdict: ${done.verdict}`);
    if (done.error) onSession();
  };
  return html`<p><button type="button" onClick=${check}>check now</button> <span role="status">${said}</span></p>`;
}
