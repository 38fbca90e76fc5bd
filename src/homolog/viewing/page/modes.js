// The page of a shape model: one shape, and a slider for each of its modes.

const ROUND_MS = 4000;            // of playing a mode forth and back
const STOPS = [[236, 236, 232], [250, 196, 92], [214, 72, 64], [94, 16, 84]];

// ---- the scene, as it was packed

function readScene(scene, array) {
  for (const body of scene.bodies)
    for (const name of ["points", "faces", "colours"]) body[name] = array(body[name]);
  for (const mode of scene.modes) mode.offsets = array(mode.offsets);
  return scene;
}

// ---- the shape

let mean, where, last = 0;

function bend() {
  const body = scene.bodies[0], { points } = body;
  points.set(mean);
  scene.modes.forEach(({ offsets }, k) => {
    if (where[k] !== 0) for (let i = 0; i < points.length; i++) points[i] += where[k] * offsets[i];
  });
  refill(buffers[0].position, points);
  if (body.faces) refill(buffers[0].normal, normalsOf(body));
  refill(buffers[0].colour, $("colours").value === "place" ? shownAll(body.colours) : shownAll(distances()));
  redraw();
}

// Colours with, as a fourth number, that each point is shown.
function shownAll(colours) {
  const four = new Uint8Array(colours.length / 3 * 4).fill(255);
  for (let i = 0; i < colours.length / 3; i++) four.set(colours.subarray(3 * i, 3 * i + 3), 4 * i);
  return four;
}

function distances() {
  const { points } = scene.bodies[0], colours = new Uint8Array(points.length);
  for (let i = 0; i < points.length; i += 3) {
    const away = Math.hypot(points[i] - mean[i], points[i + 1] - mean[i + 1], points[i + 2] - mean[i + 2]);
    const place = Math.min(STOPS.length - 1, away / scene.reach * (STOPS.length - 1)), stop = Math.min(STOPS.length - 2, Math.floor(place));
    for (let c = 0; c < 3; c++) colours[i + c] = STOPS[stop][c] + (place - stop) * (STOPS[stop + 1][c] - STOPS[stop][c]);
  }
  return colours;
}

function draw() {
  const body = scene.bodies[0];
  drawParts((side, part) => (body.faces ? drawSurface(side, part, true) : drawDots(side, part, 1.5 * body.spacing)));
}

// ---- controls

function show() {
  scene.modes.forEach((_, k) => {
    $(`mode-${k}`).value = where[k];
    $(`mode-${k}-says`).textContent = where[k].toFixed(1).replace("-", "\u2212");
  });
  $("ramp").hidden = $("colours").value === "place";
  bend();
}

function goTo(coefficients) {
  where = coefficients.slice();
  show();
}

function addMode({ share }, k) {
  const label = document.createElement("label"), says = document.createElement("output"), slider = document.createElement("input");
  const part = document.createElement("span");
  part.className = "quiet";
  part.textContent = ` ${(100 * share).toPrecision(2)} %`;
  says.id = `mode-${k}-says`;
  Object.assign(slider, { id: `mode-${k}`, type: "range", min: -scene.farthest, max: scene.farthest, step: 0.05, value: 0 });
  slider.addEventListener("input", () => { stop(); last = k; where[k] = Number(slider.value); show(); });
  slider.addEventListener("dblclick", () => { stop(); where[k] = 0; show(); });
  label.append(`Mode ${k + 1}`, part, says, slider);
  $("modes").append(label);
}

function setUpControls() {
  scene.modes.forEach(addMode);
  for (const { name } of scene.subjects) $("subject").add(new Option(name));
  $("subject").addEventListener("input", () => {
    stop();
    const chosen = $("subject").selectedIndex;
    goTo(chosen ? scene.subjects[chosen - 1].coefficients : atMean());
  });
  $("colours").addEventListener("input", show);
  $("mean").addEventListener("click", () => { stop(); $("subject").selectedIndex = 0; goTo(atMean()); });
  $("play").addEventListener("click", () => (playing ? stop() : play()));
  $("bar").style.background = `linear-gradient(to right, ${STOPS.map((stop) => `rgb(${stop})`).join(", ")})`;
  $("high").textContent = String(Number((scene.reach * scene.unit).toPrecision(2)));
  $("caption-0").textContent = scene.bodies[0].title;
  $("summary").textContent = scene.summary;
}

const atMean = () => scene.modes.map(() => 0);

// ---- playing the mode that was moved last

let playing = 0;

function play() {
  const began = performance.now(), phase = Math.asin(Math.max(-1, Math.min(1, where[last] / scene.farthest)));
  const step = (now) => {
    where[last] = scene.farthest * Math.sin(phase + 2 * Math.PI * (now - began) / ROUND_MS);
    show();
    playing = requestAnimationFrame(step);
  };
  playing = requestAnimationFrame(step);
  $("play").textContent = "Stop";
  $("play").setAttribute("aria-pressed", "true");
}

function stop() {
  cancelAnimationFrame(playing);
  playing = 0;
  $("play").textContent = "Play";
  $("play").setAttribute("aria-pressed", "false");
}

// ---- the page

const react = { click: () => {}, escape: () => { stop(); goTo(atMean()); } };

async function start() {
  if (!(await opened(readScene))) return;
  mean = scene.bodies[0].points.slice();
  setUpControls();
  listen();
  goTo(atMean());
}

await start();

// For programs that look at the page: where the sliders are, and the shape's points.
window.homolog = { where: () => [...where], points: () => [...scene.bodies[0].points] };
