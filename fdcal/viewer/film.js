// The opening: modes are added to a map with many minima until one is left, and a microphone rolls into it. Each browser
// plays it independently, from data in the page (`fdcal.viewer.opening`) and without messages from the server. A touch or
// a key ends it. The last picture stays until the map of the session is drawn, if there is one.
//
// There are three canvases: the shadow below, the relief in WebGL, and marks and texts above. Lengths are metres; y points
// up in the map. Colours follow the browser's preference.
(() => {
"use strict";
const root = document.getElementById("fdcal-film"), data = JSON.parse(root.querySelector("script").textContent);
// n: points along an edge of a map; K: number of maps; starts: times, s, at which they begin.
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
const slope = Math.tan(data.fov / 2);  // tangent of half the field of view
function project({eye, wide, tall}, p) {
  const d = plus(p, eye, -1), depth = -dot(d, TOWARDS), pixels = tall / (2 * depth * slope);
  return [wide / 2 + dot(d, RIGHT) * pixels, tall / 2 - dot(d, UP) * pixels, pixels];
}
function marginsAfter(wide, tall) {
  const [width, ratio, phone] = data.broad, [broad, usual, [left, right, top, panel]] = data.after;
  return wide >= Math.max(width, ratio * tall) ? broad : wide > phone || tall < 1.6 * wide ? usual : [left, panel * tall, right, top];
}
function cameraFor(wide, tall, [left, bottom, right, top]) {
  const free = [Math.max(wide - left - right, 0.2 * wide), Math.max(tall - bottom - top, 0.2 * tall)];
  const middle = [(left + wide - right) / 2, (top + tall - bottom) / 2], ends = [0, 1, 2].map(i => data.corners.map(c => c[i]));
  let centre = ends.map(e => (Math.min(...e) + Math.max(...e)) / 2), span = Math.max(...ends.map(e => Math.max(...e) - Math.min(...e))), camera;  // span: metres that the image shows at the centre
  const place = () => { camera = {eye: plus(centre, TOWARDS, span / 2 / slope), wide, tall}; };
  place();
  for (let iteration = 0; iteration < 6; iteration++) {
    const at = data.corners.map(c => project(camera, c)), box = [0, 1].map(i => at.map(p => p[i])).map(e => [Math.min(...e), Math.max(...e)]);
    const off = box.map(([low, high], i) => ((low + high) / 2 - middle[i]) * span / tall);
    centre = plus(plus(centre, RIGHT, off[0]), UP, -off[1]);
    span *= data.margin * Math.max(...box.map(([low, high], i) => (high - low) / free[i]));
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
  return {index, fraction: ease(linear), rolled: ease(rolled), words: rolled < 1 ? data.words[linear < 1 ? index - 1 : index] : data.found, over: rolled >= 1};
}
// Lengths along the path of the ball from its start to each point, metres.
const lengths = path.map((p, i) => i ? Math.hypot(p[0] - path[i - 1][0], p[1] - path[i - 1][1]) : 0).map((sum => v => sum += v)(0));
// The point at a fraction of the length of the path.
function along(fraction) {
  const at = fraction * lengths.at(-1), i = Math.max(lengths.findIndex(v => v >= at), 1), part = (at - lengths[i - 1]) / (lengths[i] - lengths[i - 1] || 1);
  return [0, 1].map(axis => path[i - 1][axis] + part * (path[i][axis] - path[i - 1][axis]));
}

// The map on the screen: while a mode is added, a mixture of the last map and the next one.
const mixed = new Float32Array(n * n);
let ends = [0, 1];  // levels between which colours vary, as in fdcal.graphics.heatmap
function mix({index, fraction, from = Math.max(index - 1, 0)}) {
  const one = levels.subarray(index * n * n, (index + 1) * n * n), before = levels.subarray(from * n * n);
  for (let i = 0; i < n * n; i++) mixed[i] = (fraction * one[i] + (1 - fraction) * before[i]) / 255;
  ends = [0, 1].map(end => fraction * data.shown[index][end] + (1 - fraction) * data.shown[from][end]);
}
// The level of the map at a point, 0 to 1, by bilinear interpolation.
function level(x, y) {
  const [u, v] = [x - origin[0], y - origin[1]].map((d, i) => Math.min(Math.max(d / size[i] * (n - 1), 0), n - 1.001)), i = Math.floor(u), j = Math.floor(v), at = j * n + i;
  return (1 - v + j) * ((1 - u + i) * mixed[at] + (u - i) * mixed[at + 1]) + (v - j) * ((1 - u + i) * mixed[at + n] + (u - i) * mixed[at + n + 1]);
}
// A mark rests on the highest of nine points, its centre and eight on the square around it; over a narrow valley, a ball
// therefore rests on the rim.
function restingOn([x, y], radius) {
  const around = [-radius, 0, radius];
  return [x, y, height * Math.max(...around.flatMap(a => around.map(b => level(x + a, y + b))))];
}

// --- the relief: triangles of its surface and of the two sides that are seen

const VERTEX = `#version 300 es
in vec3 place; in vec2 look;  // look: level on the colour scale, or -1 on a side, and brightness
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
// A side is a strip of 2 n vertices, the upper ones first.
const side = first => Array.from({length: n - 1}, (_, i) => [0, 1, n + 1, 0, n + 1, n].map(k => first + i + k)).flat();
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
  gl.uniform4f(uniform("lens"), camera.tall / camera.wide / slope, 1 / slope, (far + near) / (far - near), -2 * far * near / (far - near));
  gl.drawElements(gl.TRIANGLES, surface, gl.UNSIGNED_SHORT, 0);
  theme().sides.forEach((colour, i) => {
    gl.uniform3fv(uniform("flank"), colour.map(v => v / 255));
    gl.drawElements(gl.TRIANGLES, 6 * (n - 1), gl.UNSIGNED_SHORT, 2 * (surface + 6 * (n - 1) * i));
  });
}

// --- below: the shadow; above: marks and texts

// From the table of fdcal/graphics/marks.py, with reach and width in radii of a marker. A known microphone is a disc in a
// ring.
const marks = data.marks, ringEdges = [1, -1].map(side => marks.true.reach + side * marks.true.width / 2);
const knownDiscs = [[ringEdges[0] + marks.true.halo / 2, "#fff"], [ringEdges[0], marks.true.colour], [ringEdges[1], "#fff"], [marks.known.reach * Math.SQRT2, marks.known.colour]];
const theme = () => data.themes[dark.matches ? 1 : 0], css = colour => `rgb(${colour.join()})`;
function pen(canvas, {wide, tall}) {
  const ratio = canvas.width / wide, context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, wide, tall);
  return context;
}
function trace(context, points, close) {
  context.beginPath();
  points.forEach(([x, y], i) => i ? context.lineTo(x, y) : context.moveTo(x, y));
  if (close) context.closePath();
}
function drawShadow(camera) {
  const context = pen(below, camera), [x, y] = origin, [w, h] = size, away = [0.3, -0.3].map(v => v * 0.8 * height);
  const corners = [[x, y], [x + w, y], [x + w, y + h], [x, y + h]].map(([a, b]) => project(camera, [a + away[0], b + away[1], 0]));
  context.filter = `blur(${Math.max(camera.tall, camera.wide) / 70}px)`;
  context.fillStyle = dark.matches ? "rgba(0, 0, 0, 0.75)" : "rgba(0, 0, 0, 0.3)";
  trace(context, corners, true);
  context.fill();
  context.filter = "none";
}
// Whether a point of the surface is visible: the surface between this point and the eye is below the line of sight.
function visible(camera, p) {
  const way = plus(camera.eye, p, -1), reach = 0.6 / Math.hypot(...way);
  for (let i = 2; i < 40; i++) {
    const [x, y, z] = plus(p, way, reach * i / 40);
    if (x < origin[0] || y < origin[1] || x > origin[0] + size[0] || y > origin[1] + size[1]) return true;
    if (z > height) return true;
    if (height * level(x, y) > z + 0.004) return false;
  }
  return true;
}
function drawMarks(context, camera, now, r) {  // r: radius of a marker, pixels
  context.lineJoin = "round";
  context.strokeStyle = css(theme().foreground);
  context.lineWidth = 1.3;
  for (const [a, b] of data.frame) { trace(context, [project(camera, a), project(camera, b)]); context.stroke(); }
  const spots = known.map(p => restingOn(p, data.marker)).filter(p => visible(camera, p)).map(p => project(camera, p));
  for (const [reach, colour] of knownDiscs) for (const [x, y] of spots) {
    context.fillStyle = colour;
    context.beginPath();
    context.arc(x, y, reach * r, 0, 7);
    context.fill();
  }
  if (now.fraction == 1) for (const [places, {reach, colour: own}] of [[minima[now.index].others, marks.minima], [minima[now.index].lowest, marks.lowest]]) for (const place of places) {
    const s = reach * data.marker, p = restingOn(place, s);
    if (!visible(camera, p)) continue;
    trace(context, [[s, 0], [0, s], [-s, 0], [0, -s]].map(([x, y]) => project(camera, [p[0] + x, p[1] + y, p[2]])), true);
    for (const [colour, width] of [["#fff", 5], [own, 2.8]]) { context.strokeStyle = colour; context.lineWidth = width; context.stroke(); }
  }
}
function drawText(context, text, x, y) {
  const {foreground, background} = theme();
  Object.assign(context, {lineWidth: 4, strokeStyle: css(background), fillStyle: css(foreground)});
  context.strokeText(text, x, y);
  context.fillText(text, x, y);
}
// Draws the labels, without those that overlap an earlier one.
function drawLabels(context, camera) {
  context.font = "12px system-ui, sans-serif";
  const taken = [];
  for (const {text, at, anchor} of data.labels) {
    const [vertical, horizontal] = anchor.split("-"), [x, y] = project(camera, at), half = context.measureText(text).width / 2 + 3;
    const middle = x + half * ({left: 1, right: -1}[horizontal] ?? 0);
    if (taken.some(([a, b, reach]) => Math.abs(a - middle) < reach + half && Math.abs(b - y) < 13)) continue;
    taken.push([middle, y, half]);
    context.textAlign = horizontal;
    context.textBaseline = {center: "middle"}[vertical] ?? vertical;
    drawText(context, text, x, y);
  }
}
function drawBall(context, camera, now, r) {
  const ball = marks.ball.reach * r, ground = restingOn(along(now.rolled), marks.ball.reach * data.marker), [x, y] = project(camera, plus(ground, [0, 0, 1.3 * data.marker]));
  context.fillStyle = "rgba(0, 0, 0, 0.35)";
  context.beginPath();
  context.ellipse(x + 0.35 * ball, y + 0.55 * ball, ball, 0.6 * ball, 0, 0, 7);
  context.fill();
  const shine = context.createRadialGradient(x - 0.35 * ball, y - 0.4 * ball, 0.05 * ball, x, y, ball);
  [[0, "#ffffff"], [0.18, "#f2616d"], [0.6, marks.ball.colour], [1, "#8f0d1c"]].forEach(stop => shine.addColorStop(...stop));
  context.fillStyle = shine;
  context.beginPath();
  context.arc(x, y, ball, 0, 7);
  context.fill();
  context.font = "600 14px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "bottom";
  drawText(context, data.name, x, y - 1.3 * ball);
}

// --- the film

const MAX_ADVANCE = 100;  // ms, largest time by which the film advances between two pictures
// elapsed: time in the film, s; last: time of the last picture, ms; endedAt: index of the map at which the film ended.
let elapsed = 0, last = Infinity, held = false, drawnKey = "", over = false, endedAt = 0, lastMoment = null;
// The session shows the first map at another place in the window; after its end the film moves there in this time.
const AFTER = 0.7;  // s
const MAX_WAIT = 3000;  // ms, longest time to wait for a map after the session is shown, because a session may have none
function after(time) {
  const linear = Math.min(time / AFTER, 1), ease = linear * linear * (3 - 2 * linear);
  return {index: 0, from: endedAt, fraction: ease, rolled: 0, moved: ease};
}
function showTexts(now) {
  words.textContent = now.words;
  detail.textContent = data.about;
  detail.style.visibility = now.over ? "hidden" : "";  // hidden text keeps its space, so that the button does not move
  button.textContent = now.over ? "Your turn" : "Skip";
  button.className = now.over ? "first" : "";
}
function draw(time) {
  const now = over ? after(time) : moment(time), wide = root.clientWidth, tall = root.clientHeight, ratio = Math.min(window.devicePixelRatio || 1, 2);
  const key = [now.index, now.fraction, now.rolled, wide, tall, dark.matches, over].join();
  if (!over) showTexts(now);
  if (key == drawnKey || !wide || !tall) return;
  drawnKey = key;
  lastMoment = now;
  for (const canvas of [below, relief, above]) Object.assign(canvas, {width: Math.round(wide * ratio), height: Math.round(tall * ratio)});
  const margins = data.margins.map((v, i) => v + (now.moved ?? 0) * (marginsAfter(wide, tall)[i] - v)), camera = cameraFor(wide, tall, margins);
  mix(now);
  drawShadow(camera);
  drawRelief(camera);
  const context = pen(above, camera), r = Math.max(data.marker * project(camera, data.middle)[2], 4);
  drawMarks(context, camera, now, r);
  drawLabels(context, camera);
  if (!over) drawBall(context, camera, now, r);  // later the session draws the ball
}
// If the browser is busy, for example because it loads the page, the film waits instead of skipping pictures.
function play(time) {
  if (!root.isConnected) return;
  if (!held) {
    elapsed += Math.min(Math.max(time - last, 0), MAX_ADVANCE) / 1e3;
    draw(still ? (over ? AFTER : END) : elapsed);
  }
  last = time;
  requestAnimationFrame(play);
}
function end() {
  if (over) return;
  [over, elapsed, held, endedAt] = [true, 0, false, lastMoment?.index ?? 0];
  root.classList.add("over");
  document.documentElement.removeAttribute("data-film");
  for (const [kind, act] of listeners) removeEventListener(kind, act, true);
  setTimeout(removeWhenDrawn, 1e3 * AFTER);
}
// Removes the film when the session has drawn its map, or has been shown for MAX_WAIT without one.
function removeWhenDrawn() {
  // A node of this name may remain after its map was removed, so only a mesh counts.
  const drawn = () => ["/relief", "/floor"].some(name => {
    let found = false;
    window.__viserMutable?.nodeRefFromName?.[name]?.traverse(part => { found ||= Boolean(part.isMesh); });
    return found;
  });
  let since = 0;  // ms, time at which the session was first shown
  const look = () => {
    if (document.documentElement.hasAttribute("data-shown")) since ||= performance.now();
    if (!drawn() && !(since && performance.now() - since > MAX_WAIT)) { setTimeout(look, 50); return; }
    root.classList.add("gone");
    document.documentElement.setAttribute("data-invited", "");  // invites the user to drag, now that the scene is shown (page.js)
    setTimeout(() => { gl.getExtension("WEBGL_lose_context")?.loseContext(); root.remove(); }, 500);
  };
  look();
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
