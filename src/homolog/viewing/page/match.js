// The page of a match: both shapes side by side, and what a click marks on them.

const SIDES = ["source", "target"];
const MARK = [226, 0, 122], MARK_PIXELS = 15;
const REACH_PIXELS = 7;           // how far from a click a drawn point may be
const EDGE = 1e-6;                // barycentric weights may be so far below zero: a ray through an edge meets a triangle

// ---- the scene, as it was packed
//
// Of large shapes some points are here: `index` says which of the file's. For each of them a map has what a click tells: its
// counterpart in the other file (-1 for none), where that is, unless all points of the other are here, and which point that one
// was matched back to. Of several maps one is shown: what it has of the shapes and colours stands in the scene.

function readScene(scene, array) {
  for (const body of scene.bodies) for (const name of ["points", "faces", "index", "rank"]) body[name] = array(body[name]);
  for (const map of scene.maps) {
    for (const side of map.sides) for (const name of ["counterpart", "place", "back", "confidence"]) side[name] = array(side[name]);
    for (const layer of map.layers) {
      layer.colours = layer.colours.map(array);
      layer.values = layer.values && layer.values.map(array);
    }
  }
  takeMap(scene, 0);
  return scene;
}

function takeMap(scene, number) {
  const { sides, layers, method } = scene.maps[number];
  scene.bodies.forEach((body, side) => Object.assign(body, sides[side]));
  Object.assign(scene, { layers, method });
}

// ---- picking

// A ray from the camera through a place of the canvas, in pixels, in the coordinates of the shape in that part. `slope` is
// how far from it, per unit of distance, a point may lie.
function rayAt(x, y) {
  const side = x < parts()[1].left ? 0 : 1, part = parts()[side], [across, up] = extents(part);
  const seen = unit([(2 * (x - part.left) / part.width - 1) * across, (1 - 2 * y / part.height) * up, -1]);
  const r = turned(), back = (v) => [0, 3, 6].map((k) => dot([r[k], r[k + 1], r[k + 2]], v));
  const origin = back([-camera.right, -camera.up, distance()]);
  return { side, origin, direction: back(seen), slope: REACH_PIXELS * scale() * 2 * up / part.height };
}

// The corner nearest, by weight, to where a ray first meets a surface, from either side: T. Moeller and B. Trumbore, "Fast,
// Minimum Storage Ray/Triangle Intersection" (1997).
function hitSurface({ points, faces }, ray) {
  let nearest = null;
  for (let f = 0; f < faces.length; f += 3) {
    const a = row(points, faces[f]), along = minus(row(points, faces[f + 1]), a), over = minus(row(points, faces[f + 2]), a);
    const normal = cross(ray.direction, over), determinant = dot(along, normal), start = minus(ray.origin, a);
    const u = dot(start, normal) / determinant;
    if (!(u >= -EDGE && u <= 1 + EDGE)) continue;
    const lever = cross(start, along), v = dot(lever, ray.direction) / determinant;
    if (!(v >= -EDGE && u + v <= 1 + EDGE)) continue;
    const depth = dot(over, lever) / determinant;
    if (!(depth > 0) || (nearest && depth >= nearest.depth)) continue;
    const weights = [1 - u - v, u, v];
    nearest = { point: faces[f + weights.indexOf(Math.max(...weights))], depth };
  }
  return nearest;
}

// The shown point nearest to a ray, among the first ones that it passes: nearer than the spacing, or than a click reaches. What
// lies so much deeper than the first still counts; what lies behind `before` does not.
function hitPoints(body, shown, ray, before) {
  const passed = [];
  let first = null;
  for (let i = 0; i < shown.length; i++) {
    if (!shown[i]) continue;
    const relative = minus(row(body.points, i), ray.origin), depth = dot(relative, ray.direction);
    if (depth <= 0) continue;
    const gap = Math.hypot(...relative.map((x, k) => x - depth * ray.direction[k]));
    const reach = Math.max(body.spacing, ray.slope * depth);
    if (gap > reach || depth > before + reach) continue;
    passed.push({ point: i, depth, gap, reach });
    if (!first || depth < first.depth) first = passed[passed.length - 1];
  }
  const front = passed.filter(({ depth }) => depth <= first.depth + 2 * first.reach);
  return front.reduce((best, hit) => (best && best.gap <= hit.gap ? best : hit), null);
}

function pick(x, y) {
  const ray = rayAt(x, y), body = scene.bodies[ray.side], surface = body.faces && hitSurface(body, ray);
  const hit = isSurface(body) ? surface : hitPoints(body, shown[ray.side], ray, surface ? surface.depth : Infinity);
  return hit && { side: ray.side, point: hit.point };
}

// ---- what is shown

const isSurface = (body) => body.faces !== null && $("surface").value === "surface";
const shown = [null, null];

function choose() {
  const least = Number($("confidence").value), share = Number($("share").value) / 100;
  scene.bodies.forEach((body, side) => {
    const n = body.confidence.length, most = isSurface(body) ? Infinity : Math.ceil(share * n);
    shown[side] = new Uint8Array(n);
    for (let i = 0; i < n; i++) shown[side][i] = body.confidence[i] >= least - 1e-6 && body.rank[i] < most ? 1 : 0;
  });
}

// Colours with, as a fourth number, whether a point is shown.
function coloured(layer, side) {
  const n = shown[side].length, colours = new Uint8Array(4 * n);
  for (let i = 0; i < n; i++) {
    const from = shown[side][i] ? layer.colours[side].subarray(3 * i, 3 * i + 3) : HIDDEN;
    colours.set(from, 4 * i);
    colours[4 * i + 3] = 255 * shown[side][i];
  }
  return colours;
}

// ---- drawing

const MARK_FRAGMENT = `#version 300 es
precision highp float;
uniform float strength;
in vec3 paint;
out vec4 result;
void main() {
  float r = length(2.0 * gl_PointCoord - 1.0);
  if (r > 1.0) discard;
  result = vec4(r > 0.62 ? vec3(1.0) : paint, strength);
}`;

function recolour() {
  choose();
  scene.bodies.forEach((_, side) => refill(buffers[side].colour, coloured(layer(), side)));
  redraw();
}

// A sign at a place, so many pixels wide. Behind a surface it shines through faintly.
function drawSign(program, part, place, width, numbers) {
  gl.disableVertexAttribArray(0);
  gl.disableVertexAttribArray(1);
  gl.disableVertexAttribArray(2);
  gl.vertexAttrib3f(0, ...place);
  gl.vertexAttrib4f(2, ...MARK.map((x) => x / 255), 1);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  for (const [test, strength] of [[gl.ALWAYS, 0.3], [gl.LEQUAL, 1]]) {
    gl.depthFunc(test);
    const pixels = width * scale();
    begin(program, part, { size: 0, least: pixels, most: pixels, lift: 0.02, strength, ...numbers });
    gl.drawArrays(gl.POINTS, 0, 1);
  }
  gl.depthFunc(gl.LESS);
  gl.disable(gl.BLEND);
}

function draw() {
  const share = Number($("share").value) / 100;
  drawParts((side, part) => {
    const body = scene.bodies[side];
    if (body.faces) drawSurface(side, part, isSurface(body));
    // Fewer points are drawn larger, but not as large as the gaps between them.
    if (!isSurface(body)) drawDots(side, part, 1.5 * body.spacing * Math.min(2, share ** -0.25));
    const place = marked && markedPlace(side);
    if (place) drawSign(programs.mark, part, place, MARK_PIXELS);
    drawLandmarks(side, part);
  });
}

// ---- the mark

let marked = null;                // a side, and the place of a point in its arrays

// The clicked point and its counterpart by the numbers of the files.
const indices = ({ side, point }) => [scene.bodies[side].index[point], scene.bodies[side].counterpart[point]];

function markedPlace(side) {
  const { points, counterpart, place } = scene.bodies[marked.side], other = counterpart[marked.point];
  if (side === marked.side) return row(points, marked.point);
  if (other < 0) return null;
  return place ? row(place, marked.point) : row(scene.bodies[side].points, other);
}

function mark(found) {
  marked = found;
  $("clear").hidden = !marked;
  $("marked").replaceChildren(marked ? markTable() : "Nothing yet.");
  redraw();
}

function markTable() {
  const { side, point } = marked, [own, other] = indices(marked), rows = [];
  const there = other < 0 ? "no counterpart" : `point ${other}`;
  const points = side === 0 ? [`point ${own}`, there] : [there, `point ${own}`];
  SIDES.forEach((name, i) => rows.push([`${i === side ? "\u25cf" : "\u25cb"} ${name}`, points[i]]));
  if (other >= 0) {
    const back = scene.bodies[side].back[point];
    rows.push(["and back", back < 0 ? "no counterpart" : back === own ? "the same point" : `point ${back}`]);
    for (const { name, values, ramp } of scene.layers)
      if (values) rows.push([name.toLowerCase(), valueText(values[side][point], ramp)]);
  }
  return tableOf(rows);
}

const valueText = (value, ramp) => (Number.isNaN(value) ? "not known" : `${value.toFixed(2)} ${ramp.unit}`.trim());

function tableOf(rows) {
  const table = document.createElement("table");
  for (const cells of rows) {
    const line = table.insertRow();
    for (const text of cells) line.insertCell().textContent = text;
  }
  return table;
}

// ---- controls

const layer = () => scene.layers[$("layer").selectedIndex];

function showLegend() {
  const { ramp, note } = layer();
  $("note").textContent = note;
  $("ramp").hidden = !ramp;
  if (!ramp) return;
  $("bar").style.background = `linear-gradient(to right, ${ramp.stops.map((stop) => `rgb(${stop})`).join(", ")})`;
  $("low").textContent = String(ramp.low);
  $("high").textContent = `${Number(ramp.high.toPrecision(2))} ${ramp.unit}`.trim();
}

function showControls() {
  $("confidence-says").textContent = Number($("confidence").value).toFixed(2);
  $("share-says").textContent = `${$("share").value} %`;
  // A surface cannot do without some of its points.
  const idle = scene.bodies.every(isSurface);
  $("share").disabled = idle;
  $("sharing").classList.toggle("idle", idle);
}

function update() {
  showControls();
  showLegend();
  recolour();
}

function showMap() {
  const number = $("map").selectedIndex;
  takeMap(scene, number);
  $("map-note").textContent = scene.maps[number].note;
  $("summary").textContent = `Method: ${scene.method}. Points count from 0.`;
  mark(marked);
  update();
  tell("map", { number });
}

const countText = (shown, total) =>
  (shown < total ? `showing ${shown.toLocaleString("en")} of ` : "") + total.toLocaleString("en");

function setUpControls() {
  for (const { name } of scene.layers) $("layer").add(new Option(name));
  for (const { name } of scene.maps) $("map").add(new Option(name));
  $("maps").hidden = scene.maps.length < 2;
  $("map").addEventListener("input", showMap);
  $("drawing").hidden = scene.bodies.every((body) => !body.faces);
  for (const name of ["layer", "surface", "confidence", "share"]) $(name).addEventListener("input", update);
  $("clear").addEventListener("click", () => mark(null));
  scene.bodies.forEach((body, side) => {
    const name = document.createElement("b"), what = document.createElement("span");
    name.textContent = body.title;
    what.textContent = ` ${SIDES[side]}, ${countText(body.index.length, body.total)} points`;
    $(`caption-${side}`).replaceChildren(name, what);
  });
}

// ---- the page

const react = {
  click: (x, y) => { const found = pick(x, y); if (found) (setting ? setAt : mark)(found); },
  escape: () => (setting && (begun[0] || begun[1]) ? switchSetting(true) : mark(null)),
};

async function start() {
  if (!(await opened(readScene))) return;
  programs.mark = programOf(DOTS_VERTEX, MARK_FRAGMENT);
  setUpFlags();
  setUpControls();
  setUpLandmarks();
  listen();
  showMap();
}

await start();

// For programs that look at the page: the camera, by columns, for a part of the canvas, which points are here and where, what is
// marked, landmarks by the points of their ends, and picking.
window.homolog = {
  camera: (side) => { fit(); return { view: [...viewMatrix()], clip: [...clipMatrix(parts()[side])], part: parts()[side] }; },
  marked: () => marked && { side: SIDES[marked.side], point: indices(marked)[0], counterpart: indices(marked)[1] },
  shown: (side) => scene.bodies[side].index,
  points: (side) => [...scene.bodies[side].points],
  landmarks: () => landmarks.map(({ ends }) => ends.map(({ index }) => index)),
  hitSurface, hitPoints,
};
