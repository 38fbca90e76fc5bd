"use strict";
(() => {

const $ = (id) => document.getElementById(id);
const FACTS = JSON.parse($("facts").textContent);
const SIDES = ["source", "target"];
const LOST_MILLISECONDS = 8000;  // without a word from the server until it is given up
const zones = Object.fromEntries(SIDES.map((side) => [side, document.querySelector(`[data-side=${side}]`)]));
const files = { source: null, target: null };
const faults = { source: null, target: null };
let run = null;                  // the match that is being made, if any
let kept = [];                   // the archives that were fetched, one for each map: address and name

// ---- the files

const suffixOf = (name) => (name.match(/\.[^.]*$/) || [""])[0].toLowerCase();
const sizeText = (bytes) => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 2 ** 20).toFixed(1)} MB`);

// What the server would say as well, before anything is sent.
function fault(file) {
  const suffix = suffixOf(file.name);
  if (!FACTS.suffixes.includes(suffix))
    return `${file.name} has ${suffix ? `the suffix '${suffix}'` : "no suffix"}, but must have one of ${FACTS.suffixes.join(", ")}`;
  if (file.size > FACTS.bytes) return `${file.name} is larger than ${FACTS.mb} MB, the limit here; reduce it`;
  return file.size === 0 ? `${file.name} is empty; export it again` : null;
}

function take(side, file) {
  faults[side] = fault(file);
  files[side] = faults[side] ? null : file;
  describe(side, file);
  complain(faults.source || faults.target);
}

function describe(side, file) {
  const zone = zones[side], wrong = faults[side];
  zone.classList.toggle("filled", !wrong);
  zone.classList.toggle("wrong", Boolean(wrong));
  zone.querySelector(".name").textContent = file.name;
  zone.querySelector(".note").textContent = wrong ? "drop another file" : sizeText(file.size);
  $("match").disabled = !(files.source && files.target);
}

function dropped(side, list) {
  if (run || !list.length) return;
  if (list.length > 2) return complain("Drop one file here, or the source and the target together.");
  if (list.length === 2) SIDES.forEach((name, i) => take(name, list[i]));
  else take(side, list[0]);
  match();
}

function complain(text) {
  for (const id of ["complaint", "complaint-of-result"]) {
    $(id).textContent = text || "";
    $(id).hidden = !text;
  }
}

// ---- a match

async function answerOf(response) {
  if (response.ok) return response;
  const answer = await response.json().catch(() => ({}));
  throw complaintOf(answer, response.status);
}

// fetch does not tell how much is sent.
function send(one, side) {
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest();
    one.requests.push(request);
    request.open("PUT", `${one.address}/${side}?name=${encodeURIComponent(files[side].name)}`);
    request.upload.onprogress = (event) => { one.sent[side] = event.loaded; showUpload(one); };
    request.onload = () => (request.status < 300 ? done() : failed(complaintIn(request)));
    request.onerror = () => failed(new Error("the connection to the server is lost; try again"));
    request.send(files[side]);
  });
}

function complaintIn(request) {
  let answer = {};
  try { answer = JSON.parse(request.responseText); } catch { /* something on the way answers */ }
  return complaintOf(answer, request.status);
}

// With the shape whose file is to blame, if one is.
function complaintOf({ error, side }, status) {
  return Object.assign(new Error(error || `the server answers ${status}; try again`), { side });
}

// With landmarks, which are set on the page of a match: that is shown again where this does not come to its end.
async function match(landmarks) {
  if (run || !files.source || !files.target) return;
  const one = run = { requests: [], sent: { source: 0, target: 0 }, steps: 0, began: 0, again: Boolean(landmarks) };
  result(false);
  complain(null);
  SIDES.forEach((side) => zones[side].classList.remove("wrong"));
  busy(true);
  showUpload(one);
  try {
    const words = ["source_up", "target_up", "partial", "alternatives"].map((name) => [name, $(name).value]);
    const request = { ...Object.fromEntries(words), ...(landmarks && { landmarks }) };
    const response = await answerOf(await fetch("/jobs", { method: "POST", body: JSON.stringify(request) }));
    one.address = `/jobs/${(await response.json()).id}`;
    if (one !== run) return void forget(one);
    await listen(one);
    await Promise.all(SIDES.map((side) => send(one, side)));
  } catch (error) {
    fail(one, error.message, error.side);
  }
}

// The server keeps a match for as long as its page listens.
function listen(one) {
  return new Promise((opened) => {
    const stream = one.stream = new EventSource(`${one.address}/events`);
    const on = (kind, act) => stream.addEventListener(kind, (event) => one === run && act(JSON.parse(event.data)));
    stream.onopen = () => { clearTimeout(one.lost); one.lost = null; opened(); };
    stream.onerror = () => lose(one);
    on("waiting", ({ ahead }) => say(ahead ? `Waiting: ${ahead} before you` : "Waiting for its turn"));
    on("step", (step) => showStep(one, step));
    on("failed", ({ error, side }) => fail(one, error, side));
    on("done", (data) => show(one, data).catch((error) => fail(one, error.message)));
  });
}

// The browser tries again and again, and says so each time.
function lose(one) {
  const give = () => fail(one, "the connection to the server is lost; match again");
  if (one.stream.readyState === EventSource.CLOSED) give();
  else one.lost ||= setTimeout(give, LOST_MILLISECONDS);
}

function fail(one, text, side) {
  if (one !== run) return;
  stop(one);
  complain(text);
  if (side) zones[side].classList.add("wrong");
}

// Back to the files, or to the match that there was.
function stop(one) {
  forget(one);
  run = null;
  busy(false);
  result(one.again);
}

// Without a word more, so that it works while the page is closed.
function forget(one) {
  clearTimeout(one.lost);
  clearInterval(one.clock);
  for (const request of one.requests) request.abort();
  if (one.stream) one.stream.close();
  if (one.address) fetch(one.address, { method: "DELETE", keepalive: true }).catch(() => {});
}

// ---- what is shown of it

function busy(working) {
  document.body.classList.toggle("busy", working);
  $("request").disabled = working;
  for (const input of document.querySelectorAll(".zone input")) input.disabled = working;
  $("match").hidden = working;
  $("cancel").hidden = !working;
  $("work").hidden = !working;
  $("about").hidden = working;
  $("steps").replaceChildren();
  $("progress").value = 0;
}

const say = (text) => { $("doing").textContent = text; };

function showUpload(one) {
  if (one !== run || one.steps) return;
  const share = (one.sent.source + one.sent.target) / (files.source.size + files.target.size);
  $("progress").value = Math.min(1, share);
  say(share < 1 ? "Uploading" : "Starting");
}

function showStep(one, { step, done, total }) {
  one.steps += 1;
  clearInterval(one.clock);
  const line = document.createElement("li"), seconds = document.createElement("span"), began = performance.now();
  line.textContent = step;
  seconds.className = "seconds";
  line.append(seconds);
  const tick = () => { seconds.textContent = `${((performance.now() - began) / 1000).toFixed(1)} s`; };
  tick();
  one.clock = setInterval(tick, 100);
  $("steps").append(line);
  $("progress").value = Math.min(1, done / total);
  say(`Step ${Math.min(done + 1, total)} of ${total}`);
}

async function show(one, { archive, maps, warnings }) {
  say("Fetching the result");
  $("progress").value = 1;
  const fetched = [];
  for (let number = 1; number <= maps; number++) {
    const response = await answerOf(await fetch(`${one.address}/result${number > 1 ? `-${number}` : ""}.zip`));
    const name = number > 1 ? archive.replace(/\.zip$/, ` (alternative ${number}).zip`) : archive;
    fetched.push({ href: URL.createObjectURL(await response.blob()), download: name });
  }
  if (one !== run) return;
  letGo();
  kept = fetched;
  const shown = new Promise((loaded) => { $("map").onload = loaded; });
  $("map").src = `${one.address}/view.html`;
  await shown;
  if (one !== run) return;
  one.again = true;
  offer(0);
  // It has an origin of its own, which no address names.
  $("map").contentWindow.postMessage({ homolog: "matches again" }, "*");
  $("pair").textContent = `${files.source.name} \u2192 ${files.target.name}`;
  document.title = `${$("pair").textContent} \u00b7 Homolog`;
  $("warnings").replaceChildren(...warnings.map(listed));
  $("warnings").hidden = !warnings.length;
  stop(one);
}

// What is downloaded: the whole result, or another of its maps while that is shown.
function offer(number) {
  if (!kept[number]) return;
  Object.assign($("download"), kept[number]);
  $("download").textContent = number ? `Download alternative ${number + 1}` : "Download the result";
}

function letGo() {
  for (const { href } of kept) URL.revokeObjectURL(href);
  kept = [];
}

function listed(text) {
  const line = document.createElement("li");
  line.textContent = text;
  return line;
}

function result(seen) {
  document.body.classList.toggle("result", seen);
  for (const name of ["bar-of-result", "map"]) $(name).hidden = !seen;
  for (const name of ["upload", "panel"]) $(name).hidden = seen;
}

function again() {
  letGo();
  complain(null);
  $("map").onload = null;
  $("map").src = "about:blank";
  document.title = "Homolog";
  result(false);
}

// ---- the page

function listenToZone(side) {
  const zone = zones[side], input = zone.querySelector("input");
  input.accept = FACTS.suffixes.join(",");
  input.addEventListener("change", () => {
    dropped(side, [...input.files]);
    input.value = "";  // so that the same file can be chosen again, once it was mended
  });
  zone.addEventListener("dragover", () => zone.classList.add("over"));
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    zone.classList.remove("over");
    dropped(side, [...event.dataTransfer.files]);
  });
}

SIDES.forEach(listenToZone);
// A file that is dropped beside the zones would take the place of the page.
for (const kind of ["dragover", "drop"]) window.addEventListener(kind, (event) => event.preventDefault());
// What the page of the match tells, and no other.
window.addEventListener("message", ({ source, data }) => {
  if (source !== $("map").contentWindow || !data || !document.body.classList.contains("result")) return;
  if (data.homolog === "match again") match(data.landmarks);
  if (data.homolog === "map") offer(data.number);
});
window.addEventListener("pagehide", () => { if (run) forget(run); });
$("match").addEventListener("click", () => match());
$("cancel").addEventListener("click", () => { if (run) stop(run); });
$("again").addEventListener("click", again);
$("allowed").textContent = `${FACTS.suffixes.map((suffix) => suffix.slice(1).toUpperCase()).join(", ")}; up to ${FACTS.mb} MB each.`;
$("made-with").textContent = FACTS.madeWith && `Method: ${FACTS.madeWith}.`;

})();
