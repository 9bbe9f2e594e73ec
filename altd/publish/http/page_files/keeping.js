// Choices of this browser, which survive a reload where the browser stores them.

import { useState } from "./vendor/htm-preact.js";

function read(name, otherwise, isUsable) {
  try {
    const value = JSON.parse(localStorage.getItem(name));
    return isUsable(value) ? value : otherwise;
  } catch {
    return otherwise;
  }
}

export function useKept(name, otherwise, isUsable) {
  const [value, setValue] = useState(() => read(name, otherwise, isUsable));
  const keep = next => {
    setValue(next);
    try { localStorage.setItem(name, JSON.stringify(next)); } catch { /* kept until the page is closed */ }
  };
  return [value, keep];
}
