// Runs before viser's own script. It adds to the page what viser lacks:
//
//   labels      draws the texts of the scene, outlined, without those that would cover others (scene3d.py)
//   overlay     draws regions on the canvas, whose HTML the server sends in hidden controls (html.py)
//   commands    sends what a user presses or sets there as text: "play", "modes=12"
//   address     keeps the view in the address after #. It is read when the page opens or the address changes, and written
//               when nothing changes. A reloaded page does not open an address that it wrote itself for the same start of
//               the server, because other browsers may have continued meanwhile
//   theme       sends the browser's preference when the page opens and when the preference changes
//   connection  reloads the page when the server answers again. viser itself tries to reconnect every second; after some
//               failures Chromium delays each attempt by up to 5 s, and the next attempt cancels it
//   keys        makes arrow keys on a slider move only the slider, not the camera; Escape closes the large text
//   camera      keeps the camera above the floor
(() => {
"use strict";
const root = document.documentElement, CHANNEL = "fdcal command", REGION = /^<!--fdcal:(\w+)-->/;
const MAX_COMMAND = 190;  // characters
const WRITE_DELAY = 300, POLL = 700, RETRY = 6000, NOTE_TIME = 9000, SEND_INTERVAL = 60, SETTLED = 1000;  // ms
const PART = 65536, AHEAD = 16 * PART;  // bytes of a part of a file, and of the parts that may be sent ahead of the answer
const LEVEL = 1.54;  // rad from the zenith, largest angle of the camera, which is then just above the floor
// regionOf: region of a hidden control, by the control's identifier; shown: HTML of each region; waiting: newest command of
// each slider that waits to be sent.
const regionOf = new Map(), shown = new Map(), waiting = new Map();
// worker: that of viser, which holds the connection; control: identifier of the control that takes commands; introduced:
// whether layout and theme were sent; lost: whether the connection has ended.
let worker = null, control = null, connected = false, greeted = false, introduced = false, lost = false;
// sentCount: number of commands; uploaded: bytes that have arrived; resume: continues an upload that waits.
let lastRetry = -RETRY, sentCount = 0, uploaded = 0, resume = () => {};
// common: the part of the address that is common to all browsers; camera: last message about the camera; moved: whether the
// user has moved it; touched, placed: times of the last gesture and of the last command to the camera, ms; server: name of
// this start of the server, and the scene with which it was started, as "start=NAME&scene=NAME".
let common = "", camera = null, moved = false, writeTimer = 0, touched = -RETRY, placed = 0, server = "";
const written = history.state?.fdcal ?? {};  // the address that this page wrote before a reload, and the start of the server at that time
let asked = location.hash.slice(1) || written.address || "";
const returned = sessionStorage.getItem("fdcal back");  // whether the page was reloaded because the connection was lost
const setAddress = (state, hash) => history.replaceState(state, "", location.pathname + location.search + hash);

// viser derives the server's address from the page's, and would include the part after #.
if (asked) setAddress(history.state, "");

const Native = window.Worker;
window.Worker = class extends Native {
  constructor(...options) {
    super(...options);
    this.addEventListener("message", event => receive(this, event.data));
  }
  postMessage(data, ...others) {
    if (data?.type == "retry" && !mayRetry()) return;
    if (data?.message?.type == "ViewerCameraMessage") { setCanvasSize(data.message); followCamera(data.message); }
    super.postMessage(data, ...others);
  }
};

// Replaces the size of the canvas in a message by its size in pixels of the page. viser reports the pixels that it draws,
// whose number depends on screen and drawing speed.
function setCanvasSize(message) {
  const canvas = document.querySelector("canvas[data-engine]");
  if (canvas?.clientWidth) [message.image_width, message.image_height] = [canvas.clientWidth, canvas.clientHeight];
}

function receive(from, data) {
  if (data?.type == "connected") {
    [worker, connected, control, greeted, introduced] = [from, true, null, false, false];
    regionOf.clear();
  } else if (data?.type == "closed" && connected) reloadWhenAnswered();
  else if (data?.type == "message_batch") data.messages.forEach(readMessage);
}

function readMessage(message) {
  if (message.type == "GuiHtmlMessage" && REGION.test(message.props.content)) {
    regionOf.set(message.uuid, REGION.exec(message.props.content)[1]);
    show(message.uuid, message.props.content);
  } else if (message.type == "GuiTextMessage" && message.props.label == CHANNEL) {
    control = message.uuid;
    introduce();
  } else if (message.type == "GuiUpdateMessage" && regionOf.has(message.uuid) && "content" in message.updates) {
    show(message.uuid, message.updates.content);
  } else if (message.type == "SetCameraPositionMessage") [moved, placed] = [false, performance.now()];
}

// --- commands

function send(command) {
  if (!control || !connected || command.length > MAX_COMMAND) return false;
  const value = `${Date.now().toString(36)}.${sentCount++} ${command}`;  // viser drops a value that is the same as before
  worker.postMessage({type: "send", message: {type: "GuiUpdateMessage", uuid: control, updates: {value}}});
  return true;
}

// A slider that is dragged sends its newest value at most once per SEND_INTERVAL.
function sendLatest(name, command) {
  const busy = waiting.has(name);
  waiting.set(name, command);
  if (busy) return;
  const next = () => {
    if (waiting.get(name) == null) { waiting.delete(name); return; }
    send(waiting.get(name));
    waiting.set(name, null);
    setTimeout(next, SEND_INTERVAL);
  };
  next();
}

// Sends the theme and the layout, and opens the address, as soon as the server accepts commands.
function introduce() {
  if (introduced || !greeted || !control) return;  // the greeting and the control arrive in either order
  introduced = true;
  send(`dark=${matchMedia("(prefers-color-scheme: dark)").matches ? "on" : "off"}`);
  send(`layout=${root.dataset.layout}`);
  const part = (text, name) => new URLSearchParams(text).get(name), named = part(server, "scene");
  // A page that comes back after a restart does not replace the scene with which the server was started.
  if (returned && written.server != server && named && ![null, named].includes(part(asked, "scene"))) asked = "";
  // A reloaded page that shows the same scene restores only its layout and its camera.
  if (written.server != server || written.address != asked) openAddress(asked);
  else if (["scene", "lesson"].every(name => part(asked, name) == part(common, name)))
    openAddress(asked.split("&").filter(pair => /^(layout|view)=/.test(pair)).join("&"));
}

function openAddress(text) {
  const parts = text.split("&");  // not decoded here: the server decodes them
  for (const pair of parts) if (pair.startsWith("layout=")) showLayout(pair.slice("layout=".length));
  text = parts.filter(pair => !pair.startsWith("layout=")).join("&");
  if (text && !send(`open=${text}`) && text.length > 150) note(`The address is too long: ${text.slice(0, 60)}...`);
}

// --- the overlay

const overlay = document.createElement("div"), noteLine = document.createElement("div");
overlay.id = "fdcal";
noteLine.id = "fdcal-note";
noteLine.setAttribute("role", "status");
for (const name of ["words", "invitation", "caption", "legend", "sheet", "bar"]) {
  const region = overlay.appendChild(document.createElement("div"));
  region.dataset.region = name;
  if (name == "bar") region.innerHTML = "<span class='scene'><span><b>fdcal</b><small>Starting ...</small></span></span>";
}

// The hidden controls that are not drawn, and their effects.
const EFFECTS = {
  greeting(html) { [greeted, server] = [true, html]; introduce(); },
  address(html) { common = html.replaceAll("&amp;", "&"); root.toggleAttribute("data-shown", Boolean(common)); writeAddress(); },
  labels(html) { awaited = html; followScene(); },
  upload(html) { uploaded = Number(html); resume(); },
  lecture(html) {
    root.toggleAttribute("data-lecture", Boolean(html));
    for (const label of labels) label.size = null;  // measured again, because the size of the type changes
    drawnFrom = "";
  },
};

function show(uuid, content) {
  const name = regionOf.get(uuid), html = content.replace(REGION, "");
  if (shown.get(name) == html && name != "greeting") return;
  shown.set(name, html);
  if (EFFECTS[name]) EFFECTS[name](html); else drawRegion(name, html);
}

function drawRegion(name, html) {
  const region = overlay.querySelector(`[data-region="${name}"]`), template = document.createElement("template");
  if (name == "invitation" && !html) root.removeAttribute("data-invited");  // a user who has begun needs no further invitation
  if (!region || name == "bar" && !html) return;  // the bar is empty while the server is loading
  template.innerHTML = html;
  const text = () => region.querySelector(".text")?.textContent, before = text();
  morph(region, template.content);
  if (text() != before) for (const part of [region, ...region.querySelectorAll(".text")]) part.scrollTop = 0;
}

// Changes only what differs, so that a slider that is dragged and a button that is pressed are not replaced. An element is
// found by its id or its command, if it has one, even if another element is inserted or removed before it.
const keyOf = node => node.id || node.dataset?.do || node.dataset?.local || "";
function morph(old, wanted) {
  const rest = [...old.childNodes];
  for (const node of [...wanted.childNodes]) {
    const key = keyOf(node), at = key && rest.findIndex(other => keyOf(other) == key);
    if (at > 0) rest.splice(0, at).forEach(other => other.remove());
    const one = rest[0];
    if (!one || keyOf(one) != key || one.nodeName != node.nodeName) { old.insertBefore(node, one ?? null); continue; }
    rest.shift();
    if (node.nodeType != Node.ELEMENT_NODE) { if (one.data != node.data) one.data = node.data; continue; }
    for (const {name} of [...one.attributes]) if (!node.hasAttribute(name)) one.removeAttribute(name);
    for (const {name, value} of node.attributes) if (one.getAttribute(name) != value) one.setAttribute(name, value);
    if (one.matches("input[data-do]") && !one.matches(":active") && !waiting.has(one.dataset.do)) one.value = node.getAttribute("value");
    morph(one, node);
  }
  rest.forEach(other => other.remove());
}

// --- labels

const layer = document.createElement("div");
layer.id = "fdcal-labels";
// awaited: HTML of texts whose scene is not drawn yet; drawnFrom: camera and canvas for which the texts were placed;
// upright: whether the z axis is long enough for its numbers.
let labels = [], awaited = null, drawnFrom = "", canvasSize = [0, 0], upright = true;
const SIDES = {left: 0, center: 0.5, right: 1, top: 0, bottom: 1}, GAP = 3, AXIS = 60;  // pixels: gap between texts; least length of an axis whose numbers are shown

// viser draws a change of the scene some time after its arrival; a text waits for the scene to which it belongs.
function takeLabels() {
  const count = Number(/data-count='(\d+)'/.exec(awaited)?.[1]), at = window.__viserMutable.nodeRefFromName["/labelled"]?.position.x;
  if (awaited == null || at < count) return;
  layer.innerHTML = awaited;
  awaited = null;
  labels = [...layer.querySelectorAll("span")].map(element => {
    const {at, anchor, axis} = element.dataset, [vertical, horizontal] = anchor.split("-");
    return {element, axis, at: at.split(",").map(Number), anchor: [SIDES[horizontal], SIDES[vertical]], size: null};
  });
  drawnFrom = "";
}

// three.js calls `onAfterRender` with each picture, so that texts and scene move together.
function followScene() {
  const {scene, camera} = window.__viserMutable ?? {};
  if (!scene || !camera) { setTimeout(followScene, 50); return; }
  scene.onAfterRender = (renderer, from, by) => { if (by == window.__viserMutable.camera) placeLabels(by); };
  scene.onBeforeRender = () => { takeLabels(); hideHandles(); showNewest(); showTicks(); };
  takeLabels();
  placeLabels(camera);
}

// A handle is an invisible disc. It must not write depth, because it would then hide translucent objects behind it.
function hideHandles() {
  for (const [name, node] of Object.entries(window.__viserMutable.nodeRefFromName))
    if (/^\/picking\//.test(name))
      node?.traverse(part => { for (const material of [part.material ?? []].flat()) material.depthWrite = false; });
}

// In the view from the top the ticks of the z axis coincide and are hidden.
function showTicks() {
  const ticks = window.__viserMutable.nodeRefFromName["/frame_ticks"];
  if (ticks) ticks.visible = upright;
}

// A surface stays until the next one is drawn, for which a slow browser needs seconds. Only the newest of the surfaces that
// are drawn is visible.
function showNewest() {
  const newest = {}, drawn = [];
  for (const [name, node] of Object.entries(window.__viserMutable.nodeRefFromName)) {
    const [, kind, number] = /^\/(relief|isosurfaces)\/(\d+)$/.exec(name) ?? [];
    let found = false;
    if (kind) node?.traverse(part => { found ||= Boolean(part.isMesh); });
    if (!found) continue;
    drawn.push([kind, Number(number), node]);
    newest[kind] = Math.max(newest[kind] ?? 0, Number(number));
  }
  for (const [kind, number, node] of drawn) node.visible = number == newest[kind];
}

// Projects the labels, and shows those that are inside the canvas and do not overlap an earlier one.
function placeLabels(camera) {
  const root = window.__viserMutable.nodeRefFromName[""]?.matrixWorld;
  if (!root || !labels.length || !canvasSize[0]) return;
  const e = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).multiply(root).elements;
  const key = [...e, ...canvasSize].join();
  if (key == drawnFrom) return;
  drawnFrom = key;
  const span = {}, taken = [], scale = Math.hypot(e[1], e[5], e[9]), up = [1, 5, 9].map(i => e[i] / scale);
  for (const label of labels) {
    label.size ??= [label.element.offsetWidth, label.element.offsetHeight];
    const [x, y, z] = [0, 1, 2].map(i => label.at[i] + label.at[3] * up[i]), [u, v, w] = [0, 1, 3].map(i => e[i] * x + e[i + 4] * y + e[i + 8] * z + e[i + 12]);
    label.place = [(1 + u / w) / 2, (1 - v / w) / 2].map((fraction, i) => fraction * canvasSize[i]);
    label.seen = w > 0;
    label.box = label.place.map((at, i) => Math.round(at - label.anchor[i] * label.size[i]));
    const [low, high] = span[label.axis] ?? [label.place, label.place];
    if (label.axis) span[label.axis] = [low.map((a, i) => Math.min(a, label.place[i])), high.map((a, i) => Math.max(a, label.place[i]))];
  }
  const long = axis => axis in span && Math.hypot(...span[axis][1].map((a, i) => a - span[axis][0][i])) > AXIS;
  upright = long("z");
  for (const {element, axis, seen, box: [x, y], size: [width, height]} of labels) {
    const inside = x >= 0 && y >= 0 && x + width <= canvasSize[0] && y + height <= canvasSize[1];
    const free = taken.every(([a, b, c, d]) => x > c + GAP || x + width + GAP < a || y > d || y + height < b);
    const shown = seen && inside && free && (axis == "r" ? !upright : !axis || long(axis));
    if (shown) taken.push([x, y, x + width, y + height]);
    element.style.visibility = shown ? "" : "hidden";
    element.style.transform = `translate(${x}px, ${y}px)`;
  }
}

function showLayout(name) {
  const wanted = name == "expert" ? "expert" : "explore";
  if (root.dataset.layout != wanted) delete root.dataset.sheet;  // a sheet stays open if the layout does not change
  root.dataset.layout = wanted;
  if (introduced) send(`layout=${wanted}`);
  setTimeout(endTransitions, 50);
  writeAddress();
}

// If viser unfolds a section on a phone while the panels are hidden, the transition of the section never ends; this ends it.
function endTransitions() {
  for (const section of document.querySelectorAll("#root [style*='will-change: height']"))
    section.dispatchEvent(new TransitionEvent("transitionend", {propertyName: "height", bubbles: true}));
}

// Uploads files of the user in parts. The server reports how many bytes have arrived; it reports "refused", here NaN, if it
// takes no more.
let uploading = false;
async function upload(form) {
  const {recording, positions, kind, celsius} = form.elements, button = form.querySelector("button");
  const files = [recording, positions].flatMap(input => [...input.files].map(file => [input.name, file]));
  const total = files.reduce((sum, [, file]) => sum + file.size, 0), post = message => worker.postMessage({type: "send", message});
  const ids = {source_component_uuid: "", transfer_uuid: Date.now().toString(36)};  // the server takes files of one identifier together
  if (uploading) return;
  if (!recording.files.length) { recording.click(); return; }
  if (total > form.dataset.limit) { note(`These files are too large: ${Math.ceil(total / 1e6)} MB. Use fdcal view FILE.`); return; }
  let sent = uploaded = 0;
  uploading = true;
  try {
    for (const [name, file] of files) {
      post({type: "FileTransferStartUpload", ...ids, source_component_uuid: name, filename: file.name.slice(-150), mime_type: "",
        part_count: Math.ceil(file.size / PART), size_bytes: file.size});
      for (let at = 0; at < file.size && !lost && !isNaN(uploaded); at += PART) {
        const content = new Uint8Array(await file.slice(at, at + PART).arrayBuffer());
        post({type: "FileTransferPart", ...ids, part_index: at / PART, content});
        sent += content.length;
        button.textContent = `Sending, ${Math.round(100 * uploaded / total)} %`;
        while (sent - uploaded > AHEAD && !lost) await new Promise(next => { resume = next; setTimeout(next, POLL); });
      }
    }
    if (!isNaN(uploaded)) send(`own=${kind.value} ${celsius.value}`);
  } catch { note("A file cannot be read. Choose it again."); }
  button.textContent = "Open";
  uploading = false;
}

overlay.insertAdjacentHTML("beforeend", '<div id="fdcal-back"><button data-local="sheet:lessons">Lessons</button> '
  + '<button data-local="layout:explore">Explore</button></div>');
overlay.addEventListener("click", event => {
  const {do: act, local} = event.target.closest("[data-do], [data-local]")?.dataset ?? {};
  const input = event.target.closest("input, select");
  if (act && !input) send(act);
  const [what, value] = (local ?? "").split(":");
  if (what == "layout") showLayout(value);
  if (what == "upload") { upload(event.target.closest("form")); return; }
  if (what == "sheet" && root.dataset.sheet != value) root.dataset.sheet = value;
  else if (event.target.closest("button")) delete root.dataset.sheet;
});
overlay.addEventListener("input", event => {
  const name = event.target.dataset.do;
  if (name) sendLatest(name, `${name}=${event.target.value}`);
});
document.addEventListener("pointerdown", event => {
  if (!event.target.closest?.("#fdcal")) delete root.dataset.sheet;
}, true);
for (const gesture of ["pointermove", "wheel"]) document.addEventListener(gesture, event => {
  if (event.target.matches?.("canvas") && (event.buttons || gesture == "wheel")) touched = performance.now();
}, {capture: true, passive: true});

// --- fingers

// A finger selects the nearest microphone within REACH. Since the disc of a microphone has only a few pixels, the gesture is
// moved onto the disc.
const REACH = 24;  // pixels
let gesture = null;  // {id, shift}: identifier of the pointer, and the shift, pixels, or undefined
// The shift from a pointer onto the nearest disc, pixels; undefined if no disc is near enough.
function shiftOnto(event) {
  const mutable = window.__viserMutable, canvas = event.target, box = canvas.getBoundingClientRect(), at = mutable.camera.position.clone();
  let best = null;
  for (const [name, node] of Object.entries(mutable.nodeRefFromName)) if (/^\/picking\/\d+$/.test(name)) node?.traverse(discs => {
    for (let i = 0; discs.isInstancedMesh2 && i < discs.instancesCount; i++) {
      const scale = discs.getMatrixAt(i).elements[0], further = scale < 0.95 ? REACH / 2 : 0;  // pixels: a fixed microphone counts as farther away
      if (scale < 0.5) continue;  // a speck in a corner of the search domain
      const {x, y, z} = at.copy(discs.getPositionAt(i)).applyMatrix4(discs.matrixWorld).project(mutable.camera);
      const shift = [box.left + (1 + x) / 2 * box.width - event.clientX, box.top + (1 - y) / 2 * box.height - event.clientY], far = Math.hypot(...shift) + further;
      if (z < 1 && far < (best?.far ?? REACH)) best = {shift, far};
    }
  });
  return best?.shift;
}
for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel", "click"]) addEventListener(kind, event => {
  if (!event.isTrusted || event.pointerType != "touch" || !event.target.matches?.("canvas[data-engine]")) return;
  if (kind == "pointerdown" && event.isPrimary) gesture = window.__viserMutable?.camera ? {id: event.pointerId, shift: shiftOnto(event)} : null;
  if (!gesture?.shift || event.pointerId != gesture.id) return;
  event.stopImmediatePropagation();
  const [dx, dy] = gesture.shift, {type, bubbles, cancelable, pointerId, pointerType, isPrimary, button, buttons, pressure, width, height, clientX, clientY, screenX, screenY} = event;
  event.target.dispatchEvent(new PointerEvent(type, {bubbles, cancelable, composed: true, pointerId, pointerType, isPrimary, button, buttons, pressure, width, height,
    clientX: clientX + dx, clientY: clientY + dy, screenX, screenY, view: window}));
}, true);

function note(text) {
  noteLine.textContent = text;
  clearTimeout(note.timer);
  if (text && !lost) note.timer = setTimeout(() => note(""), NOTE_TIME);
}

// Places the overlay over the canvas, between the panels, and tooltips beside the panel to which they belong.
function coverCanvas(canvas) {
  const place = () => {
    const {left, top, width, height} = canvas.getBoundingClientRect();
    const right = innerWidth - left - width, bottom = innerHeight - top - height;
    for (const [name, value] of Object.entries({left, top, right, bottom})) root.style.setProperty(`--${name}`, `${value}px`);
    canvasSize = [width, height];
    root.toggleAttribute("data-broad", width >= Math.max(1000, 1.4 * height));  // as in scene3d.py
  };
  new ResizeObserver(place).observe(canvas);
  addEventListener("resize", place);
  addEventListener("transitionend", place);
  addEventListener("pointerover", event => { root.dataset.side = event.clientX > innerWidth / 2 ? "right" : "left"; });
  place();
}

overlay.insertAdjacentHTML("beforeend", '<div id="fdcal-slow">Slow drawing: this browser uses no graphics card. '
  + '<button aria-label="Hide this line">&#10005;</button></div>');
overlay.querySelector("#fdcal-slow button").addEventListener("click", event => event.target.parentNode.remove());

document.addEventListener("keydown", event => {
  if (event.key != "Escape") return;
  delete root.dataset.sheet;
  if (!overlay.querySelector("[data-region=words]").innerText) return;
  send("dismiss");
  event.stopPropagation();
}, true);

// --- address

// Remembers the camera and limits its angle. After a gesture the camera counts as moved by the user, until the server places
// it.
function followCamera(message) {
  const now = performance.now(), [before, here] = [camera?.position ?? [], message.position];
  if (now - touched < SETTLED && now - placed > SETTLED && here.some((x, i) => Math.abs(x - before[i]) > 1e-4)) moved = true;
  camera = message;
  const controls = window.__viserMutable?.cameraControl;  // if z is up, the camera must stay above the floor
  if (controls) controls.maxPolarAngle = message.up_direction[2] > 0.99 ? LEVEL : Math.PI;
  writeAddress();
}

// The camera for the address; "" for the plan view, in which a page opens anyway.
function cameraText() {
  if (!camera) return "";
  const {position, look_at, up_direction, fov} = camera, level = Math.hypot(position[0] - look_at[0], position[1] - look_at[1]);
  if (!moved && level < 1e-2 * Math.abs(position[2] - look_at[2])) return "";
  return [...position, ...look_at, ...up_direction, fov].map(x => Number(x.toPrecision(6))).join();
}

function addressNow() {
  const parts = [common, root.dataset.layout == "expert" && "layout=expert", cameraText() && `view=${cameraText()}`];
  return "#" + parts.filter(Boolean).join("&");
}

function writeAddress() {
  clearTimeout(writeTimer);
  if (!introduced || lost || !common) return;
  writeTimer = setTimeout(() => {
    if (lost) return;
    if (root.hasAttribute("data-film")) { writeAddress(); return; }  // not during the film, which a reloaded page then shows from its beginning
    asked = addressNow().slice(1);
    setAddress({fdcal: {server, address: asked}}, `#${asked}`);
  }, WRITE_DELAY);
}
// The event contains the new address; `writeAddress` may already have replaced `location.hash` by the previous one. `asked`
// is kept for the reload after the server has stopped.
addEventListener("hashchange", event => {
  clearTimeout(writeTimer);  // a pending write would replace this address by the previous one
  asked = new URL(event.newURL).hash.slice(1);
  openAddress(asked);
});

// --- connection

// Whether viser may try to connect again now. The time of an allowed attempt is remembered.
function mayRetry() {
  if (lost || performance.now() - lastRetry < RETRY) return false;
  lastRetry = performance.now();
  return true;
}

function reloadWhenAnswered() {
  if (lost) return;
  lost = true;
  note("The connection is lost. The page reloads when the server answers.");
  let answers = 0;  // a server that stops may answer once more over a socket that Chromium has opened in advance, so two answers are needed
  const poll = async () => {
    try {
      answers = (await fetch(location.pathname, {method: "GET", cache: "no-store"})).ok ? answers + 1 : 0;
    } catch { answers = 0; }
    if (answers < 2) { setTimeout(poll, POLL); return; }
    sessionStorage.setItem("fdcal back", "1");
    setAddress(history.state, asked && `#${asked}`);
    location.reload();
  };
  setTimeout(poll, POLL);
}

// --- start

showLayout(new URLSearchParams(asked).get("layout"));
root.toggleAttribute("data-linked", Boolean(asked));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", event => send(`dark=${event.matches ? "on" : "off"}`));
addEventListener("DOMContentLoaded", () => {
  document.body.append(layer, overlay, noteLine);
  document.body.addEventListener("keydown", event => {
    const slider = event.target.closest?.("[role=slider], [type=range], [role=radiogroup]");
    if (slider && /^Arrow|^Home$|^End$|^Page/.test(event.key)) event.stopPropagation();
  });
  const found = setInterval(() => {
    const canvas = document.querySelector("[data-dock-root] canvas[data-engine], canvas[data-engine]");
    if (canvas) { clearInterval(found); coverCanvas(canvas); }
  }, 50);
  if (returned) {
    sessionStorage.removeItem("fdcal back");
    note("The connection was lost and is restored.");
  }
});
})();
