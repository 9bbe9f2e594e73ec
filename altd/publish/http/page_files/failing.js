// A page that fails shows nothing: what was drawn before would stand there as if it were of now.

const AGAIN_MS = 2000;

// After an error that is not caught, `root` is emptied and the page is loaded again.
export function guard(root, world = globalThis) {
  let hasFailed = false;
  const fail = () => {
    if (hasFailed) return;
    hasFailed = true;
    root.remove();
    const said = world.document.createElement("p");
    said.className = "waiting";
    said.setAttribute("role", "alert");
    said.textContent = "this page has failed and shows nothing; it is loaded again";
    world.document.body.append(said);
    world.setTimeout(() => world.location.reload(), AGAIN_MS);
  };
  // without an error it is a browser's notice, as of an observer that is called again
  world.addEventListener("error", event => { if (event.error) fail(); });
  world.addEventListener("unhandledrejection", fail);
}
