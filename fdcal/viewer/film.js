// The opening: modes are added to a map with many minima until one is left, and a microphone rolls into it. Each browser
// plays it independently, from data in the page (`fdcal.viewer.opening`) and without messages of the server. A touch or a
// key ends it. Its last picture stays until the map of the session, if there is one, is drawn.
//
// Three canvases: shadow and ground below, the relief in WebGL, marks and texts above. Lengths are metres, y is up in the
// map; colours follow the browser's preference.
(() => {
"use strict";
const root = document.getElementById("fdcal-film"), data = JSON.parse(root.querySelector("script").textContent);
const {n, origin, size, height, starts, minima, path, known} = data, K = minima.length, END = starts[K] + data.roll;
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const levels = bytes(data.levels), colours = bytes(data.colours);
const dark = matchMedia("(prefers-color-scheme: dark)"), still = matchMedia("(prefers-reduced-motion: reduce)").matches;
const [below, relief, above] = root.querySelectorAll("canvas"), [words, detail, button] = ["h1", "p", "button"].map(name => root.querySelector(name));
const gl = relief.getContext("webgl2", {antialias: true, alpha: true, premultipliedAlpha: true});
if (!gl || document.documentElement.hasAttribute("data-linked")) { root.remove(); return; }

// --- vectors, and the camera for which the box fills the space within the margins, as in fdcal.graphics.camera

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b, s = 1) => a.map((v, i) => v + s * b[i]), unit = a => a.map(v => v / Math.hypot(...a));
const TOWARDS = unit(data.direction), RIGHT = unit(cross(TOWARDS.map(v => -v), [0, 0, 1])), UP = cross(TOWARDS, RIGHT);
const half = Math.tan(data.fov / 2);
function project({eye, wide, tall}, p) {
  const d = plus(p, eye, -1), depth = -dot(d, TOWARDS), pixels = tall / (2 * depth * half);
  return [wide / 2 + dot(d, RIGHT) * pixels, tall / 2 - dot(d, UP) * pixels, pixels];
}
function marginsAfter(wide, tall) {
  const [width, ratio, phone] = data.broad, [broad, usual, [left, right, top, panel]] = data.after;
  return wide >= Math.max(width, ratio * tall) ? broad : wide > phone || tall < 1.6 * wide ? usual : [left, panel * tall, right, top];
}
function cameraFor(wide, tall, [left, bottom, right, top]) {
  const free = [Math.max(wide - left - right, 0.2 * wide), Math.max(tall - bottom - top, 0.2 * tall)];
  const middle = [(left + wide - right) / 2, (top + tall - bottom) / 2], ends = [0, 1, 2].map(i => data.corners.map(c => c[i]));
  let centre = ends.map(e => (Math.min(...e) + Math.max(...e)) / 2), seen = Math.max(...ends.map(e => Math.max(...e) - Math.min(...e))), camera;
  const place = () => { camera = {eye: plus(centre, TOWARDS, seen / 2 / half), wide, tall}; };
  place();
  for (let turn = 0; turn < 6; turn++) {
    const at = data.corners.map(c => project(camera, c)), span = [0, 1].map(i => at.map(p => p[i])).map(e => [Math.min(...e), Math.max(...e)]);
    const off = span.map(([low, high], i) => ((low + high) / 2 - middle[i]) * seen / tall);
    centre = plus(plus(centre, RIGHT, off[0]), UP, -off[1]);
    seen *= data.margin * Math.max(...span.map(([low, high], i) => (high - low) / free[i]));
    place();
  }
  return camera;
}

// --- what is shown at a time, s

function moment(time) {
  let index = 0;
  while (index < K - 1 && time >= starts[index + 1]) index++;
  const change = Math.min((starts[index + 1] - starts[index]) / 2, data.change), linear = index ? Math.min((time - starts[index]) / change, 1) : 1;
  const rolled = Math.min(Math.max((time - starts[K]) / data.roll, 0), 1), ease = s => s * s * (3 - 2 * s);
  return {index, share: ease(linear), rolled: ease(rolled), words: rolled < 1 ? data.words[linear < 1 ? index - 1 : index] : data.found, over: rolled >= 1};
}
const lengths = path.map((p, i) => i ? Math.hypot(p[0] - path[i - 1][0], p[1] - path[i - 1][1]) : 0).map((sum => v => sum += v)(0));
function along(share) {
  const at = share * lengths.at(-1), i = Math.max(lengths.findIndex(v => v >= at), 1), part = (at - lengths[i - 1]) / (lengths[i] - lengths[i - 1] || 1);
  return [0, 1].map(axis => path[i - 1][axis] + part * (path[i][axis] - path[i - 1][axis]));
}

const mixed = new Float32Array(n * n);
let ends = [0, 1];  // levels between which colours vary, as in fdcal.graphics.heatmap
function mix({index, share, from = Math.max(index - 1, 0)}) {
  const one = levels.subarray(index * n * n, (index + 1) * n * n), before = levels.subarray(from * n * n);
  for (let i = 0; i < n * n; i++) mixed[i] = (share * one[i] + (1 - share) * before[i]) / 255;
  ends = [0, 1].map(end => share * data.shown[index][end] + (1 - share) * data.shown[from][end]);
}
function level(x, y) {
  const [u, v] = [x - origin[0], y - origin[1]].map((d, i) => Math.min(Math.max(d / size[i] * (n - 1), 0), n - 1.001)), i = Math.floor(u), j = Math.floor(v), at = j * n + i;
  return (1 - v + j) * ((1 - u + i) * mixed[at] + (u - i) * mixed[at + 1]) + (v - j) * ((1 - u + i) * mixed[at + n] + (u - i) * mixed[at + n + 1]);
}
// A mark rests on the highest point within its radius; over a valley that is too narrow, a ball rests on the rim.
function on([x, y], radius) {
  const around = [-radius, 0, radius];
  return [x, y, height * Math.max(...around.flatMap(a => around.map(b => level(x + a, y + b))))];
}

// --- the relief: its surface and the two sides that are seen, in one strip of triangles each

const VERTEX = `#version 300 es
in vec3 place; in vec2 look;
uniform vec3 eye, right, up, towards; uniform vec4 lens;
out vec2 shown;
void main() {
  vec3 d = place - eye; float depth = -dot(d, towards);
  shown = look;
  gl_Position = vec4(dot(d, right) * lens.x, dot(d, up) * lens.y, depth * lens.z + lens.w, depth);
}`, FRAGMENT = `#version 300 es
precision mediump float;
in vec2 shown; uniform sampler2D scale; uniform vec3 flank; out vec4 colour;
void main() {
  if (shown.x < 0.0) { colour = vec4(flank, 1.0); return; }
  vec3 c = texture(scale, vec2(shown.x * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb;
  float dark = mix(${data.darkest.toFixed(3)}, 1.0, clamp(shown.y, 0.0, 1.0)), white = ${data.brightest.toFixed(3)} * clamp(shown.y - 1.0, 0.0, 1.0);
  colour = vec4(mix(c * dark, vec3(1.0), white), 1.0);
}`;
const program = gl.createProgram();
for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  gl.attachShader(program, shader);
}
gl.linkProgram(program);
gl.useProgram(program);
const uniform = name => gl.getUniformLocation(program, name);
const faces = [];
for (let j = 0; j < n - 1; j++) for (let i = 0; i < n - 1; i++) {
  const at = j * n + i;
  faces.push(at, at + 1, at + n + 1, at, at + n + 1, at + n);
}
const side = count => Array.from({length: n - 1}, (_, i) => [0, 1, n + 1, 0, n + 1, n].map(k => count + i + k)).flat();
const surface = faces.length;
faces.push(...side(n * n), ...side(n * n + 2 * n));
const vertices = new Float32Array(5 * (n * n + 4 * n));
gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(faces), gl.STATIC_DRAW);
gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
["place", "look"].forEach((name, i) => {
  const at = gl.getAttribLocation(program, name);
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, i ? 2 : 3, gl.FLOAT, false, 20, i ? 12 : 0);
});
gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
for (const kind of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, kind, gl.LINEAR);
for (const kind of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, kind, gl.CLAMP_TO_EDGE);
gl.enable(gl.DEPTH_TEST);

function drawRelief(camera) {
  const [lx, ly, lz] = data.light, step = [0, 1].map(i => size[i] / (n - 1)), at = (i, j) => mixed[Math.min(Math.max(j, 0), n - 1) * n + Math.min(Math.max(i, 0), n - 1)];
  let k = 0;
  const vertex = (i, j, z, s, light) => { vertices.set([origin[0] + i * step[0], origin[1] + j * step[1], z, s, light], k); k += 5; };
  for (let j = 0; j < n; j++) for (let i = 0; i < n; i++) {
    const x = height * (at(i + 1, j) - at(i - 1, j)) / 2 / step[0], y = height * (at(i, j + 1) - at(i, j - 1)) / 2 / step[1];
    const shade = Math.min(Math.max((at(i, j) - ends[0]) / (ends[1] - ends[0]), 0), 1);
    vertex(i, j, height * at(i, j), shade, (1 - x * lx / lz - y * ly / lz) / Math.hypot(1, x, y));
  }
  for (const [x, y] of [[-1, 0], [0, -1]]) for (const top of [1, 0]) for (let i = 0; i < n; i++)
    vertex(x ? 0 : i, y ? 0 : i, top * height * (x ? at(0, i) : at(i, 0)), -1, 0);
  gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.DYNAMIC_DRAW);
  gl.viewport(0, 0, relief.width, relief.height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const far = 4 * Math.hypot(...plus(camera.eye, [origin[0], origin[1], 0], -1)), near = far / 40;
  for (const [name, value] of [["eye", camera.eye], ["right", RIGHT], ["up", UP], ["towards", TOWARDS]]) gl.uniform3fv(uniform(name), value);
  gl.uniform4f(uniform("lens"), camera.tall / camera.wide / half, 1 / half, (far + near) / (far - near), -2 * far * near / (far - near));
  gl.drawElements(gl.TRIANGLES, surface, gl.UNSIGNED_SHORT, 0);
  theme().sides.forEach((colour, i) => {
    gl.uniform3fv(uniform("flank"), colour.map(v => v / 255));
    gl.drawElements(gl.TRIANGLES, 6 * (n - 1), gl.UNSIGNED_SHORT, 2 * (surface + 6 * (n - 1) * i));
  });
}

// --- below: the shadow; above: marks and texts

// From the table of fdcal/graphics/marks.py: reach and width in radii of a marker. A known microphone is a disc in a ring.
const marks = data.marks, ringEdges = [1, -1].map(side => marks.true.reach + side * marks.true.width / 2);
const knownRings = [[ringEdges[0] + marks.true.halo / 2, "#fff"], [ringEdges[0], marks.true.colour], [ringEdges[1], "#fff"], [marks.known.reach * Math.SQRT2, marks.known.colour]];
const theme = () => data.themes[dark.matches ? 1 : 0], css = colour => `rgb(${colour.join()})`;
function pen(canvas, {wide, tall}) {
  const ratio = canvas.width / wide, drawn = canvas.getContext("2d");
  drawn.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawn.clearRect(0, 0, wide, tall);
  return drawn;
}
function trace(drawn, points, close) {
  drawn.beginPath();
  points.forEach(([x, y], i) => i ? drawn.lineTo(x, y) : drawn.moveTo(x, y));
  if (close) drawn.closePath();
}
function drawShadow(camera) {
  const drawn = pen(below, camera), [x, y] = origin, [w, h] = size, away = [0.3, -0.3].map(v => v * 0.8 * height);
  const corners = [[x, y], [x + w, y], [x + w, y + h], [x, y + h]].map(([a, b]) => project(camera, [a + away[0], b + away[1], 0]));
  drawn.filter = `blur(${Math.max(camera.tall, camera.wide) / 70}px)`;
  drawn.fillStyle = dark.matches ? "rgba(0, 0, 0, 0.75)" : "rgba(0, 0, 0, 0.3)";
  trace(drawn, corners, true);
  drawn.fill();
  drawn.filter = "none";
}
// Whether a point of the surface is visible: nothing between it and the eye is above the line of sight.
function seen(camera, p) {
  const way = plus(camera.eye, p, -1), reach = 0.6 / Math.hypot(...way);
  for (let i = 2; i < 40; i++) {
    const [x, y, z] = plus(p, way, reach * i / 40);
    if (x < origin[0] || y < origin[1] || x > origin[0] + size[0] || y > origin[1] + size[1]) return true;
    if (z > height) return true;
    if (height * level(x, y) > z + 0.004) return false;
  }
  return true;
}
function drawMarks(camera, now) {
  const drawn = pen(above, camera), {foreground, background} = theme(), r = Math.max(data.marker * project(camera, data.middle)[2], 4);
  drawn.lineJoin = "round";
  drawn.strokeStyle = css(foreground);
  drawn.lineWidth = 1.3;
  for (const [a, b] of data.frame) { trace(drawn, [project(camera, a), project(camera, b)]); drawn.stroke(); }
  const halo = (text, x, y) => { drawn.lineWidth = 4; drawn.strokeStyle = css(background); drawn.fillStyle = css(foreground); drawn.strokeText(text, x, y); drawn.fillText(text, x, y); };
  const spots = known.map(p => on(p, data.marker)).filter(p => seen(camera, p)).map(p => project(camera, p));
  for (const [reach, colour] of knownRings) for (const [x, y] of spots) {
    drawn.fillStyle = colour;
    drawn.beginPath();
    drawn.arc(x, y, reach * r, 0, 7);
    drawn.fill();
  }
  if (now.share == 1) for (const [places, {reach, colour: own}] of [[minima[now.index].others, marks.minima], [minima[now.index].lowest, marks.lowest]]) for (const place of places) {
    const s = reach * data.marker, p = on(place, s);
    if (!seen(camera, p)) continue;
    trace(drawn, [[s, 0], [0, s], [-s, 0], [0, -s]].map(([x, y]) => project(camera, [p[0] + x, p[1] + y, p[2]])), true);
    for (const [colour, width] of [["#fff", 5], [own, 2.8]]) { drawn.strokeStyle = colour; drawn.lineWidth = width; drawn.stroke(); }
  }
  drawn.font = "12px system-ui, sans-serif";
  const taken = [];
  for (const {text, at, anchor} of data.labels) {
    const [vertical, horizontal] = anchor.split("-"), [x, y] = project(camera, at), half = drawn.measureText(text).width / 2 + 3;
    const middle = x + half * ({left: 1, right: -1}[horizontal] ?? 0);
    if (taken.some(([a, b, reach]) => Math.abs(a - middle) < reach + half && Math.abs(b - y) < 13)) continue;
    taken.push([middle, y, half]);
    drawn.textAlign = horizontal;
    drawn.textBaseline = {center: "middle"}[vertical] ?? vertical;
    halo(text, x, y);
  }
  if (over) return;  // now the session draws the ball
  const ball = marks.ball.reach * r, ground = on(along(now.rolled), marks.ball.reach * data.marker), [x, y] = project(camera, plus(ground, [0, 0, 1.3 * data.marker]));
  drawn.fillStyle = "rgba(0, 0, 0, 0.35)";
  drawn.beginPath();
  drawn.ellipse(x + 0.35 * ball, y + 0.55 * ball, ball, 0.6 * ball, 0, 0, 7);
  drawn.fill();
  const shine = drawn.createRadialGradient(x - 0.35 * ball, y - 0.4 * ball, 0.05 * ball, x, y, ball);
  [[0, "#ffffff"], [0.18, "#f2616d"], [0.6, marks.ball.colour], [1, "#8f0d1c"]].forEach(stop => shine.addColorStop(...stop));
  drawn.fillStyle = shine;
  drawn.beginPath();
  drawn.arc(x, y, ball, 0, 7);
  drawn.fill();
  drawn.font = "600 14px system-ui, sans-serif";
  drawn.textAlign = "center";
  drawn.textBaseline = "bottom";
  halo(data.name, x, y - 1.3 * ball);
}

// --- the film

const LONGEST = 100;  // ms by which the film advances between two pictures, at most
let elapsed = 0, last = Infinity, held = false, drawnKey = "", over = false, left = 0, lastMoment = null;
// The session opens with the first map, at another position in the window; the film moves there in this time.
const AFTER = 0.7;  // s
const LONGEST_WAIT = 3000;  // ms to wait for the map of a session that is shown, which may have none
function after(time) {
  const share = Math.min(time / AFTER, 1), ease = share * share * (3 - 2 * share);
  return {index: 0, from: left, share: ease, rolled: 0, left: ease};
}
function draw(time) {
  const now = over ? after(time) : moment(time), wide = root.clientWidth, tall = root.clientHeight, ratio = Math.min(window.devicePixelRatio || 1, 2);
  const key = [now.index, now.share, now.rolled, wide, tall, dark.matches, over].join();
  if (!over) {
    words.textContent = now.words;
    detail.textContent = data.about;
    detail.style.visibility = now.over ? "hidden" : "";  // hidden text keeps its space, so that the button does not move
    button.textContent = now.over ? "Your turn" : "Skip";
    button.className = now.over ? "first" : "";
  }
  if (key == drawnKey || !wide || !tall) return;
  drawnKey = key;
  lastMoment = now;
  for (const canvas of [below, relief, above]) Object.assign(canvas, {width: Math.round(wide * ratio), height: Math.round(tall * ratio)});
  const margins = data.margins.map((v, i) => v + (now.left ?? 0) * (marginsAfter(wide, tall)[i] - v)), camera = cameraFor(wide, tall, margins);
  mix(now);
  drawShadow(camera);
  drawRelief(camera);
  drawMarks(camera, now);
}
// While the browser is busy, for example with loading the page, the film waits instead of skipping pictures.
function play(time) {
  if (!root.isConnected) return;
  if (!held) {
    elapsed += Math.min(Math.max(time - last, 0), LONGEST) / 1e3;
    draw(still ? (over ? AFTER : END) : elapsed);
  }
  last = time;
  requestAnimationFrame(play);
}
function end() {
  if (over) return;
  [over, elapsed, held, left] = [true, 0, false, lastMoment?.index ?? 0];
  root.classList.add("over");
  document.documentElement.removeAttribute("data-film");
  for (const [kind, act] of listeners) removeEventListener(kind, act, true);
  // A node of this name may remain after its map was removed, so only a mesh counts.
  const drawn = () => ["/relief", "/floor"].some(name => {
    let found = false;
    window.__viserMutable?.nodeRefFromName?.[name]?.traverse(part => { found ||= Boolean(part.isMesh); });
    return found;
  });
  let since = 0;  // ms, time at which the session was first shown
  const look = () => {
    if (document.documentElement.hasAttribute("data-shown")) since ||= performance.now();
    if (!drawn() && !(since && performance.now() - since > LONGEST_WAIT)) { setTimeout(look, 50); return; }
    root.classList.add("gone");
    document.documentElement.setAttribute("data-invited", "");  // invites the user to drag, now that the scene is shown (page.js)
    setTimeout(() => { gl.getExtension("WEBGL_lose_context")?.loseContext(); root.remove(); }, 500);
  };
  setTimeout(look, 1e3 * AFTER);
}
const MODIFIERS = ["Shift", "Control", "Alt", "AltGraph", "Meta", "Tab"];
const listeners = [["pointerdown", event => { event.stopPropagation(); }], ["click", event => { event.stopPropagation(); event.preventDefault(); end(); }],
  ["pointercancel", end], ["wheel", end], ["hashchange", end], ["keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey || MODIFIERS.includes(event.key)) return;
    event.stopPropagation();
    event.preventDefault();
    end();
  }]];
for (const [kind, act] of listeners) addEventListener(kind, act, {capture: true, passive: kind == "wheel"});
document.documentElement.setAttribute("data-film", "");
window.fdcalFilm = {draw, end, moment, length: END, hold: () => { held = true; }};  // for tests and docs/film.py
draw(still ? END : 0);
requestAnimationFrame(play);
})();
