// What every page draws with: each of the scene's shapes has a part of the canvas, and all are seen by one camera, so that
// they turn where they stand, side by side. The page's own program follows this one: it has `draw`, and `react` for what a
// click and a key mean there.

const $ = (id) => document.getElementById(id);
const KINDS = { float32: Float32Array, uint32: Uint32Array, int32: Int32Array, uint8: Uint8Array };
const OPENING = Math.PI / 6;      // of the camera, along the shorter side of a part
const HIDDEN = [222, 222, 220];   // what is not shown of a surface
const CLICK_PIXELS = 5;           // a pointer that moves farther drags
const MARGIN = 1.14;              // around the shapes, for captions
const FRONT = { turn: -0.35, tilt: 0.08, zoom: 1, right: 0, up: 0 };

// ---- vectors

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const unit = (a) => { const length = Math.hypot(...a); return a.map((x) => x / length); };
const row = (array, i) => [array[3 * i], array[3 * i + 1], array[3 * i + 2]];

// ---- the scene, as it was packed

async function unpacked() {
  const text = atob($("arrays").textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

const arrayIn = (block) => (place) => place && new KINDS[place.kind](block, place.begin, place.length);

function normalsOf({ points, faces }) {
  const normals = new Float32Array(points.length);
  for (let f = 0; f < faces.length; f += 3) {
    const corners = [faces[f], faces[f + 1], faces[f + 2]];
    const [a, b, c] = corners.map((corner) => row(points, corner));
    const normal = cross(minus(b, a), minus(c, a));
    for (const corner of corners) for (let k = 0; k < 3; k++) normals[3 * corner + k] += normal[k];
  }
  return normals;
}

// ---- the camera: turned about each shape's middle

const camera = { ...FRONT };

function turned() {
  const [c, s] = [Math.cos(camera.turn), Math.sin(camera.turn)], [d, t] = [Math.cos(camera.tilt), Math.sin(camera.tilt)];
  return [c, t * s, -d * s, 0, d, t, s, -t * c, d * c];  // columns of a rotation
}

function parts() {
  const { height } = canvas, width = Math.floor(canvas.width / scene.bodies.length);
  return scene.bodies.map((_, side) => ({ left: side * width, width, height }));
}

// Half the extent of what is seen at distance one, across and up.
function extents({ width, height }) {
  const least = Math.tan(OPENING / 2);
  return [least * Math.max(1, width / height), least * Math.max(1, height / width)];
}

// From where all shapes are seen whole, however they are turned about the vertical.
function distance() {
  const [across, up] = extents(parts()[0]), { width, height } = reach;
  return (MARGIN * Math.max(width / across, height / up) + width) / camera.zoom;
}

function reachOf(bodies) {
  const reach = { width: 0, height: 0 };
  for (const { points } of bodies)
    for (let i = 0; i < points.length; i += 3) {
      reach.width = Math.max(reach.width, Math.hypot(points[i], points[i + 2]));
      reach.height = Math.max(reach.height, Math.abs(points[i + 1]));
    }
  return reach;
}

function viewMatrix() {
  const r = turned();
  return [r[0], r[1], r[2], 0, r[3], r[4], r[5], 0, r[6], r[7], r[8], 0, camera.right, camera.up, -distance(), 1];
}

function clipMatrix(part) {
  const [across, up] = extents(part), far = distance() + 2.5, near = Math.max(far - 5, far / 500);
  const depth = near - far;
  return [1 / across, 0, 0, 0, 0, 1 / up, 0, 0, 0, 0, (far + near) / depth, -1, 0, 0, (2 * far * near) / depth, 0];
}

// ---- drawing

const SURFACE_VERTEX = `#version 300 es
uniform mat4 view, clip;
in vec3 position, normal;
in vec4 colour;
out vec3 seen, across;
out vec3 paint;
void main() {
  vec4 place = view * vec4(position, 1.0);
  seen = place.xyz;
  across = mat3(view) * normal;
  paint = colour.rgb;
  gl_Position = clip * place;
}`;

// Both sides of a surface are lit alike: meshes may be open, or turned inside out.
const SURFACE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 seen, across;
in vec3 paint;
out vec4 result;
void main() {
  vec3 n = normalize(across);
  n = dot(n, seen) > 0.0 ? -n : n;
  float light = 0.48 + 0.40 * max(0.0, dot(n, normalize(vec3(-0.4, 0.6, 0.8)))) + 0.22 * max(0.0, n.z);
  result = vec4(min(paint * light, vec3(1.0)), 1.0);
}`;

const DOTS_VERTEX = `#version 300 es
uniform mat4 view, clip;
uniform float size, least, most, lift;
in vec3 position;
in vec4 colour;
out vec3 paint;
void main() {
  vec4 place = view * vec4(position, 1.0);
  place.xyz -= lift * normalize(place.xyz);
  gl_Position = colour.a > 0.5 ? clip * place : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = clamp(size / -place.z, least, most);
  paint = colour.rgb;
}`;

const DOTS_FRAGMENT = `#version 300 es
precision highp float;
in vec3 paint;
out vec4 result;
void main() {
  float r = length(2.0 * gl_PointCoord - 1.0);
  if (r > 1.0) discard;
  result = vec4(paint * (1.0 - 0.28 * r * r), 1.0);
}`;

function programOf(vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  ["position", "normal", "colour"].forEach((name, place) => gl.bindAttribLocation(program, place, name));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

function filled(target, data) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(target, buffer);
  gl.bufferData(target, data, gl.STATIC_DRAW);
  return buffer;
}

function arraysOf(body) {
  return {
    position: filled(gl.ARRAY_BUFFER, body.points),
    normal: body.faces && filled(gl.ARRAY_BUFFER, normalsOf(body)),
    faces: body.faces && filled(gl.ELEMENT_ARRAY_BUFFER, body.faces),
    colour: gl.createBuffer(),
  };
}

function refill(buffer, data) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
}

function feed(place, buffer, size, kind) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, size, kind, kind === gl.UNSIGNED_BYTE, 0, 0);
}

function begin(program, part, numbers = {}) {
  gl.useProgram(program);
  gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false, viewMatrix());
  gl.uniformMatrix4fv(gl.getUniformLocation(program, "clip"), false, clipMatrix(part));
  for (const [name, value] of Object.entries(numbers)) gl.uniform1f(gl.getUniformLocation(program, name), value);
}

function drawSurface(side, part, painted) {
  begin(programs.surface, part);
  const buffer = buffers[side];
  feed(0, buffer.position, 3, gl.FLOAT);
  feed(1, buffer.normal, 3, gl.FLOAT);
  if (painted) feed(2, buffer.colour, 4, gl.UNSIGNED_BYTE);
  else {
    gl.disableVertexAttribArray(2);
    gl.vertexAttrib4f(2, ...HIDDEN.map((x) => x / 255), 1);
  }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer.faces);
  gl.drawElements(gl.TRIANGLES, scene.bodies[side].faces.length, gl.UNSIGNED_INT, 0);
}

// Of a shape's points those whose colour is not hidden, as discs of a width in the scene's unit.
function drawDots(side, part, width) {
  const pixels = part.height / (2 * extents(part)[1]);
  // The surface beneath would cut discs in half.
  begin(programs.dots, part, { size: width * pixels, least: 2 * scale(), most: 14 * scale(), lift: width });
  feed(0, buffers[side].position, 3, gl.FLOAT);
  gl.disableVertexAttribArray(1);
  feed(2, buffers[side].colour, 4, gl.UNSIGNED_BYTE);
  gl.drawArrays(gl.POINTS, 0, scene.bodies[side].points.length / 3);
}

function drawParts(drawOne) {
  fit();
  gl.disable(gl.SCISSOR_TEST);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.SCISSOR_TEST);
  parts().forEach((part, side) => {
    gl.viewport(part.left, 0, part.width, part.height);
    gl.scissor(part.left, 0, part.width, part.height);
    drawOne(side, part);
  });
}

let waiting = false;

function redraw() {
  if (!waiting) requestAnimationFrame(() => { waiting = false; draw(); });
  waiting = true;
}

const scale = () => canvas.width / canvas.clientWidth;

function fit() {
  const dense = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.max(2, Math.round(x * dense)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
}

// ---- pointers and keys

const pointers = new Map();
let moved = 0;

function orbit(across, up) {
  camera.turn += across * 0.009;
  camera.tilt = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, camera.tilt + up * 0.009));
}

function shift(across, up) {
  const part = parts()[0], unitPerPixel = 2 * extents(part)[1] * distance() * scale() / part.height;
  camera.right += across * unitPerPixel;
  camera.up -= up * unitPerPixel;
}

const zoom = (factor) => { camera.zoom = Math.max(0.3, Math.min(30, camera.zoom * factor)); };
const spread = () => { const [a, b] = [...pointers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };

function pressed(event) {
  canvas.setPointerCapture(event.pointerId);
  if (pointers.size === 0) moved = 0;
  pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
}

function dragged(event) {
  const last = pointers.get(event.pointerId);
  if (!last) return;
  const across = event.clientX - last.x, up = event.clientY - last.y, apart = pointers.size === 2 && spread();
  moved += Math.hypot(across, up);
  Object.assign(last, { x: event.clientX, y: event.clientY });
  if (pointers.size === 2) {
    zoom(spread() / apart);
    shift(across / 2, up / 2);
  } else if (event.shiftKey || event.buttons & 6) shift(across, up);
  else orbit(across, up);
  if (moved > CLICK_PIXELS) redraw();
}

function released(event) {
  const alone = pointers.size === 1;
  pointers.delete(event.pointerId);
  if (!alone || moved > CLICK_PIXELS || event.button !== 0 || event.type === "pointercancel") return;
  const { left, top } = canvas.getBoundingClientRect();
  react.click((event.clientX - left) * scale(), (event.clientY - top) * scale());
}

const KEYS = {
  ArrowLeft: () => orbit(-12, 0), ArrowRight: () => orbit(12, 0), ArrowUp: () => orbit(0, -12), ArrowDown: () => orbit(0, 12),
  "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15), r: () => Object.assign(camera, FRONT),
};

function typed(event) {
  if (event.key === "Escape") react.escape();
  if (!KEYS[event.key] || event.ctrlKey || event.metaKey) return;
  KEYS[event.key]();
  event.preventDefault();
  redraw();
}

function listen() {
  canvas.addEventListener("pointerdown", pressed);
  canvas.addEventListener("pointermove", dragged);
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, released);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.0012)); redraw(); }, { passive: false });
  canvas.addEventListener("dblclick", () => { Object.assign(camera, FRONT); redraw(); });
  canvas.addEventListener("keydown", typed);
  new ResizeObserver(redraw).observe(canvas);
}

// ---- the page

const canvas = $("canvas");
const gl = canvas.getContext("webgl2", { antialias: true });
let scene, reach, buffers, programs;

function fault(text) {
  $("fault").textContent = text;
  $("fault").hidden = false;
  return false;
}

// What there is to draw; told to the reader, and false, where this browser cannot draw it.
async function opened(readScene) {
  if (!gl) return fault("This page draws with WebGL 2, which this browser does not offer; use another, or allow it.");
  if (!window.DecompressionStream) return fault("This page needs a browser of 2023 or newer.");
  scene = await readScene(JSON.parse($("scene").textContent), arrayIn(await unpacked()));
  reach = scene.room || reachOf(scene.bodies);
  programs = { surface: programOf(SURFACE_VERTEX, SURFACE_FRAGMENT), dots: programOf(DOTS_VERTEX, DOTS_FRAGMENT) };
  buffers = scene.bodies.map(arraysOf);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(0.965, 0.965, 0.953, 1);
  return true;
}
