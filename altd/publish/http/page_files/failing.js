// A page that fails is emptied: old values must not look current.

const AGAIN_MS = 2000;

// After an uncaught error `root` is removed and the page reloads.
export function guard(root, world = globalThis) {
  let hasFailed = false;
  const fail = () => {
    if (hasFailed) return;
    hasFailed = true;
    root.remove();
    const said = world.document.createElement("p");
    said.className = "waiting";
    said.setAttribute("role", "alert");
    said.textContent = "this page has failed and shows no values; it reloads now";
    world.document.body.append(said);
    world.setTimeout(() => world.location.reload(), AGAIN_MS);
  };
  // without an error it is a browser's notice, as of an observer that is called again
  world.addEventListener("error", event => { if (event.error) fail(); });
  world.addEventListener("unhandledrejection", fail);
}
