// Landmarks: numbered pairs of points that correspond, set by clicks, drawn in equal colours, saved as files that
// `--landmarks` reads. A page around this one may match again by them: see `listenToServer`.

const MOST_LANDMARKS = 50;
const CELLS = 8, CELL_PIXELS = 64;  // of the picture that holds all numbers, along each side
const FLAG_PIXELS = 22;
const GOLDEN_DEGREES = 137.508;     // between the hues of one landmark and the next

let landmarks = [];                 // each with a name, empty for its number, and an end on each shape: index and place
let begun = [null, null];           // the ends of the next one, as far as they are set
let setting = false;                // whether clicks set landmarks
let server = null;                  // the page that matches again: a window and its origin

// ---- setting them

function setEnd(side, index, place) {
  if (landmarks.length >= MOST_LANDMARKS) return say(`There are ${MOST_LANDMARKS} landmarks, as many as guide a match.`);
  begun[side] = { index, place };
  if (begun[0] && begun[1]) {
    landmarks.push({ name: "", ends: begun });
    begun = [null, null];
  }
  showLandmarks();
}

function setAt({ side, point }) {
  const { index, points } = scene.bodies[side];
  setEnd(side, index[point], [...row(points, point)]);
}

function switchSetting(on) {
  setting = on;
  begun = [null, null];
  $("set").setAttribute("aria-pressed", on);
  $("by-number").hidden = !on;
  $("click-says").textContent = `Click a point to ${on ? "set a landmark" : "mark its counterpart"}.`;
  showLandmarks();
}

// By the numbers of points, so that it can be done without a pointer.
function setByNumber() {
  const places = SIDES.map((name, side) => {
    const body = scene.bodies[side], index = Number($(`number-${side}`).value || NaN), point = body.index.indexOf(index);
    if (!(Number.isInteger(index) && index >= 0 && index < body.total)) return say(`The ${name} has points 0 to ${body.total - 1}.`);
    return point < 0 ? say(`Point ${index} of the ${name} is not among those that are shown.`) : { side, point };
  });
  if (!places[0] || !places[1]) return;
  begun = [null, null];
  places.forEach(setAt);
  SIDES.forEach((_, side) => { $(`number-${side}`).value = ""; });
  $("number-0").focus();
}

function removeLandmark(number) {
  landmarks.splice(number, 1);
  showLandmarks();
  const left = $("landmarks").querySelectorAll("button");
  (left[Math.min(number, left.length - 1)] || $("set")).focus();
}

// ---- drawing them: the numbers stand in one picture, of which each point shows a part

const hue = (number) => `hsl(${(GOLDEN_DEGREES * number + 205) % 360}, 78%, 38%)`;

function pictureOfNumbers() {
  const picture = document.createElement("canvas"), pen = picture.getContext("2d");
  picture.width = picture.height = CELLS * CELL_PIXELS;
  Object.assign(pen, { font: `700 ${CELL_PIXELS * 0.5}px system-ui, sans-serif`, textAlign: "center", textBaseline: "middle" });
  for (let number = 0; number <= MOST_LANDMARKS; number++) {
    const x = (number % CELLS + 0.5) * CELL_PIXELS, y = (Math.floor(number / CELLS) + 0.5) * CELL_PIXELS;
    for (const [radius, colour] of [[0.46, "#fff"], [0.39, hue(number)]]) {
      pen.fillStyle = colour;
      pen.beginPath();
      pen.arc(x, y, radius * CELL_PIXELS, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.fillStyle = "#fff";
    pen.fillText(number + 1, x, y + 2);
  }
  return picture;
}

const FLAG_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D numbers;
uniform float cell, strength;
out vec4 result;
void main() {
  vec4 found = texture(numbers, (vec2(mod(cell, ${CELLS}.0), floor(cell / ${CELLS}.0)) + gl_PointCoord) / ${CELLS}.0);
  if (found.a < 0.05) discard;
  result = vec4(found.rgb, found.a * strength);
}`;

function setUpFlags() {
  programs.flag = programOf(DOTS_VERTEX, FLAG_FRAGMENT);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, pictureOfNumbers());
  gl.generateMipmap(gl.TEXTURE_2D);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
}

function drawLandmarks(side, part) {
  [...landmarks.map(({ ends }) => ends), begun].forEach((ends, cell) => {
    if (ends[side]) drawSign(programs.flag, part, ends[side].place, FLAG_PIXELS, { cell });
  });
}

// ---- telling of them

const say = (text) => { $("guide").textContent = text; };

function nextStep() {
  const from = begun[0] || !begun[1] ? 0 : 1;
  if (!setting) return landmarks.length ? "" : "Points that you know to correspond guide a match.";
  if (!begun[from]) return "Click a point on the source, then its counterpart on the target. Or give their numbers:";
  return `Now click its counterpart on the ${SIDES[1 - from]}.`;
}

function showLandmarks() {
  say(nextStep());
  $("landmarks").replaceChildren(...landmarks.map(listed));
  $("with-landmarks").hidden = !landmarks.length;
  $("again").hidden = !server;
  $("run").hidden = Boolean(server) || !scene.guide.command;
  redraw();
}

function listed({ name, ends }, number) {
  const line = document.createElement("li"), flag = document.createElement("b"), text = document.createElement("span");
  const remove = document.createElement("button");
  flag.textContent = number + 1;
  flag.style.background = hue(number);
  text.textContent = `${name ? `${name}: ` : ""}${ends[0].index} \u2192 ${ends[1].index}`;
  Object.assign(remove, { type: "button", textContent: "\u00d7", title: `Remove landmark ${number + 1}` });
  remove.setAttribute("aria-label", remove.title);
  remove.addEventListener("click", () => removeLandmark(number));
  line.append(flag, text, remove);
  return line;
}

// ---- saving them

// In the coordinates of the shape's file, as 3D Slicer and `--landmarks` read them.
function markups(side) {
  const turn = scene.bodies[side].toFile;
  const inFile = (place) => [0, 1, 2].map((k) => turn[3][k] + place[0] * turn[0][k] + place[1] * turn[1][k] + place[2] * turn[2][k]);
  const controlPoints = landmarks.map(({ name, ends }, number) => ({
    id: String(number + 1), label: name || String(number + 1), position: inFile(ends[side].place), positionStatus: "defined",
  }));
  return JSON.stringify({ markups: [{ type: "Fiducial", coordinateSystem: scene.guide.systems[side], controlPoints }] }, null, 1);
}

function save(side) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([markups(side)], { type: "application/json" }));
  link.download = scene.guide.files[side];
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

// ---- matching again

// A server's page, which has both files, says so to the page of their match within it. What is told there then: which
// landmarks to match by, and which of several maps is shown.
function listenToServer() {
  if (window.parent === window) return;
  window.addEventListener("message", ({ source, origin, data }) => {
    if (source !== window.parent || !data || data.homolog !== "matches again") return;
    server = { window: source, origin };
    if (scene && scene.guide) showLandmarks();
  });
}

const tell = (homolog, more) => server && server.window.postMessage({ homolog, ...more }, server.origin);

function matchAgain() {
  const [source, target] = SIDES.map((_, side) => landmarks.map(({ ends }) => ends[side].index));
  tell("match again", { landmarks: { source, target } });
}

function setUpLandmarks() {
  $("guiding").hidden = !scene.guide;
  if (!scene.guide) return;
  landmarks = scene.guide.known;
  $("set").addEventListener("click", () => switchSetting(!setting));
  $("add").addEventListener("click", setByNumber);
  for (const side of [0, 1]) {
    $(`number-${side}`).addEventListener("keydown", ({ key }) => { if (key === "Enter") setByNumber(); });
    $(`save-${side}`).textContent = scene.guide.files[side];
    $(`save-${side}`).addEventListener("click", () => save(side));
  }
  $("again").addEventListener("click", matchAgain);
  $("command").value = scene.guide.command;
  $("command").addEventListener("focus", () => $("command").select());
  showLandmarks();
}

listenToServer();
