// The screen as a plate of LEDs: discs on the screen's own pixels, and the option that describes them.
// Once loaded it asks the unit for nothing: the daemon is stopped while the cameras are recorded.

const CARD_MM = 85.60;  // ISO/IEC 7810, ID-1
const LIT_MS = 4000, DARK_MS = 4000;  // both in any recording of 10 s, however it begins
const PARTS = 4, MOST_PARTS = 3;  // an arrow moves the discs by a quarter of the pitch, three quarters at most
const BAR_TOP_CSS = 24, BAR_HEIGHT_CSS = 40, FORM_TOP_CSS = 80, LEFT_CSS = 16, MIN_BAR_PX = 50, COARSE_PX = 10;
const LIMITS = { length: [20, 3000], error: [0.01, 20], columns: [4, 100], rows: [4, 100], pitch: [2, 1000], disc: [0.5, 100] };

const field = name => document.getElementById(name);
const canvas = field("plate"), context = canvas.getContext("2d");
let barPx = 0, isBarSet = false, isBarHeld = false, isShowing = false, isLit = false, timer = 0, parts = [0, 0];
let measuredOn = "", isElsewhere = false;

const left = () => Math.round(LEFT_CSS * devicePixelRatio);
const longestBar = () => canvas.width - 2 * left();
// A decimal comma is read too: a field of type number would drop it, and 12,5 be 125.
const number = name => Number(field(name).value.trim().replace(",", ".") || NaN);

// What a pixel's size depends on: the zoom and the screen, however it is turned.
const screenNow = () => [devicePixelRatio, screen.width + screen.height, screen.availLeft, screen.availTop].join();

function unfilled() {
  if ((visualViewport?.scale ?? 1) !== 1) return "the page is zoomed with two fingers: zoom out";
  if (isElsewhere) return "another screen or zoom: measure the bar again";
  const within = ([name, [low, high]]) => number(name) >= low && number(name) <= high;
  const wrong = Object.entries(LIMITS).find(limit => !within(limit));
  return wrong && `${field(wrong[0]).labels[0].firstChild.data.trim()}: a number from ${wrong[1].join(" to ")}`;
}

// The plate on device pixels, or why there is none.
function plateOf({ columns, rows, wishedMm, discMm, barPx, barMm, errorMm, width, height, parts }) {
  const why = unfilled();
  if (why) return { why };
  const mmPerPx = barMm / barPx, pitchPx = Math.round(wishedMm / mmPerPx), radiusPx = Math.round(discMm / mmPerPx / 2);
  const most = [width, height].map(px => Math.floor((px - 2 * radiusPx) / pitchPx) + 1);
  if (columns % 1 || rows % 1) return { why: "columns and rows: whole numbers" };
  if (radiusPx < 3 || 2 * radiusPx > 0.6 * pitchPx) return { why: "discs of 6 pixels at least, and of half of the pitch at most" };
  if (columns > most[0] || rows > most[1]) return { why: `does not fit: ${most[0]} columns, ${most[1]} rows at most, or a smaller pitch` };
  const firstX = Math.round((width - (columns - 1) * pitchPx) / 2), firstY = Math.round((height - (rows - 1) * pitchPx) / 2);
  const [rightPx, upPx] = parts.map(count => Math.round(count * pitchPx / PARTS));
  if (firstX - Math.abs(rightPx) < radiusPx || firstY - Math.abs(upPx) < radiusPx) return { why: "does not fit when moved" };
  const shift = rightPx || upPx ? ` --shift=${[rightPx, upPx].map(px => (px * mmPerPx).toFixed(4)).join(",")}` : "";
  const pitchMm = pitchPx * mmPerPx, sigmaMm = Math.ceil(1e4 * pitchMm * errorMm / Math.sqrt(3) / barMm) / 1e4;
  return { columns, rows, pitchPx, radiusPx, pitchMm, sigmaMm, firstX, firstY, rightPx, upPx, shift,
    option: `--plate ${columns},${rows},${pitchMm.toFixed(4)},${sigmaMm.toFixed(4)}${shift}` };
}

const plate = () => plateOf({ columns: number("columns"), rows: number("rows"), wishedMm: number("pitch"), discMm: number("disc"),
  barPx, barMm: number("length"), errorMm: number("error"), width: canvas.width, height: canvas.height, parts });

// Marks in the middle of the sides, and the shift, as dim in the lit picture as in the dark one: they cancel.
// The marks stay where they are when the discs are moved.
function ticks({ firstX, firstY, columns, rows, pitchPx, shift }) {
  const x = firstX + (columns - 1) * pitchPx / 2, y = firstY + (rows - 1) * pitchPx / 2;
  const long = Math.max(Math.min(firstX, firstY) - pitchPx / 2, 0);
  context.fillStyle = "#444";
  for (const far of [0, canvas.height - long]) context.fillRect(x - 1, far, 2, long);
  for (const far of [0, canvas.width - long]) context.fillRect(far, y - 1, long, 2);
  context.font = `${16 * devicePixelRatio}px monospace`;
  context.fillText(shift, left(), canvas.height - left());
}

function draw() {
  if (measuredOn && measuredOn !== screenNow()) {
    field("length").value = measuredOn = "";
    isElsewhere = true;
  }
  const { width, height } = canvas, found = plate();
  context.fillStyle = "#000";
  context.fillRect(0, 0, width, height);
  if (!isShowing) {
    context.fillStyle = "#fff";
    const [top, tall] = [BAR_TOP_CSS, BAR_HEIGHT_CSS].map(css => Math.round(css * devicePixelRatio));
    context.fillRect(left(), top, barPx, tall);
  } else if (found.why) {
    stop();  // a screen that was turned is too narrow
  } else {
    ticks(found);
    if (isLit) for (let row = 0; row < found.rows; row++) for (let column = 0; column < found.columns; column++) {
      context.beginPath();
      context.fillStyle = "#fff";
      const x = found.firstX + found.rightPx + column * found.pitchPx, y = found.firstY - found.upPx + row * found.pitchPx;
      context.arc(x, y, found.radiusPx, 0, 2 * Math.PI);
      context.fill();
    }
  }
  field("option").textContent = found.why ?? found.option;
  field("row").textContent = found.why ? "–" : `${((found.columns - 1) * found.pitchMm).toFixed(1)} mm`;
  field("show").disabled = Boolean(found.why);
}

function blink() {
  isLit = !isLit;
  draw();
  timer = setTimeout(blink, isLit ? LIT_MS : DARK_MS);
}

function show() {
  parts = [0, 0];
  isShowing = true;
  isLit = false;
  document.body.className = "showing";
  blink();
}

function stop() {
  clearTimeout(timer);
  isShowing = false;
  document.body.className = "";
  draw();
}

function measure() {
  measuredOn = screenNow();
  isBarSet = true;  // the length is that of this bar, also in a larger window
  isElsewhere = false;
  draw();
}

function setBar(px) {
  isBarSet = true;
  barPx = Math.min(Math.max(Math.round(px), MIN_BAR_PX), longestBar());
  draw();
}

// Move the discs one step right and up, unless they would leave the screen.
function move(right, up) {
  const before = parts;
  parts = [right, up].map((step, axis) => Math.min(Math.max(parts[axis] + step, -MOST_PARTS), MOST_PARTS));
  if (plate().why) parts = before;
  draw();
}

// As many pixels as the device has: a scaled canvas would blur the discs and change their pitch.
function fit() {
  const box = canvas.getBoundingClientRect();
  canvas.width = Math.round(box.width * devicePixelRatio);
  canvas.height = Math.round(box.height * devicePixelRatio);
  if (!isBarSet) barPx = longestBar();  // until it is set, as long as possible
  draw();
}

// Another screen may have the same size in the page's own pixels: then there is no resize.
function watchRatio() {
  matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => { fit(); watchRatio(); }, { once: true });
}

addEventListener("resize", fit);
window.visualViewport?.addEventListener("resize", draw);
watchRatio();
fit();
field("length").addEventListener("input", measure);
field("setup").addEventListener("input", draw);
field("setup").addEventListener("submit", event => { event.preventDefault(); show(); });
field("full").addEventListener("click", () => document.documentElement.requestFullscreen?.());
field("card").addEventListener("click", () => { field("length").value = CARD_MM; measure(); });
canvas.addEventListener("pointerdown", event => {
  isBarHeld = !isShowing && event.clientY < FORM_TOP_CSS;  // not by the touch that ends the picture
  if (isShowing) return stop();
  if (!isBarHeld) return;
  canvas.setPointerCapture(event.pointerId);
  setBar(event.clientX * devicePixelRatio - left());
});
canvas.addEventListener("pointermove", event => {
  if (isBarHeld && event.buttons) setBar(event.clientX * devicePixelRatio - left());
});
addEventListener("keydown", event => {
  const moved = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
  if (isShowing) { event.preventDefault(); return moved ? move(...moved) : stop(); }
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (step && event.target.tagName !== "INPUT") setBar(barPx + step * (event.shiftKey ? COARSE_PX : 1));
});
