// Draws the scene, the curves and the table of a run: `show` draws all of them from the variables below.
const $ = id => document.getElementById(id);
const file = JSON.parse($("data").textContent), run = runOf(location.hash), data = Object.assign(file, run && file.others[run - 1]);
// A lesson has a run for each of its scenes; the part in the address determines which run is shown.
function runOf(hash) {
  const [number, choice] = (new URLSearchParams(hash.slice(1)).get("part") ?? "1").split(",").map(Number);
  const parts = file.lesson?.steps[number - 1]?.parts ?? [{run: 0}];
  return parts[choice && parts.length > 1 ? 1 : 0].run;
}
if (typeof DecompressionStream == "undefined") $("note").textContent = "This browser is too old for the replay; use a version of 2023 or later.";
const arrays = await unpack(data.packed), {step, sweep, stage, restart, moved, first, last, truth, mean, largest, cost} = arrays;
const N = data.names.length, D = data.dimension, T = data.count, known = new Set(data.known), maps = data.maps;
const places = Float64Array.from(arrays.positions, v => v * data.unit);
const landscapes = maps && new Landscapes(maps, arrays, N, D);
const fineLandscapes = maps && new Landscapes(maps, arrays, N, D, Landscapes.FINE);
const marks = data.marks, RED = marks.estimate.colour;  // the table of fdcal/graphics/marks.py: reach and width in radii of a marker
const BLUE = "#1f78c8", ORANGE = "#e08a1e", VIOLET = "#8c5ab4";  // of curves and of ticks on them
const STRIP = maps ? 56 : 0;  // pixels above the scene, for the colour bar
// Angles of the 3-D view, from which the minima of a relief can be seen.
const TURNED = 35 * Math.PI / 180, RAISED = maps && D == 2 ? 52 * Math.PI / 180 : TURNED;
// at: index of the state that is shown; drawnAt: pixels of the estimates; flat: whether the view is from the top.
let at = 0, playing = false, selected = data.microphone ?? -1, drawnAt = null, flat = true;
let chosen = null;  // modes of the map, [first, last], or null for those of the solver
let range = [0, T - 1];  // first and last state that can be shown; a part of a lesson shows a part of its run
const [x0, y0, x1, y1] = data.focus, [z0, z1] = data.heights;  // the box of the view, metres
const eye = {azimuth: 0, elevation: Math.PI / 2, zoom: 1, x: 0, y: 0};
const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// A point in the room, metres: positions in the file are relative to data.origin.
function point(array, i) {
  const o = data.origin, z = D == 3 ? array[i + 2] + o[2] : z0;
  return [array[i] + o[0], array[i + 1] + o[1], z];
}
// Positions of microphone n, metres: in the run, as the user has moved it, and the true one.
const recorded = (t, n) => point(places, (t * N + n) * D), placeOf = (t, n) => own ? own.places[n] : recorded(t, n), truthOf = n => point(truth, n * D);
const givenOf = i => [data.given[i][0], data.given[i][1], D == 3 ? data.given[i][2] : z0];  // given position of the i-th known microphone

// Fits the pixels of a canvas to its size on the page, clears it, and returns its context and its width and height.
function fit(canvas) {
  const dpr = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width != Math.round(w * dpr) || canvas.height != Math.round(h * dpr)) {
    canvas.width = Math.round(w * dpr); canvas.height = Math.round(h * dpr);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(dpr, 0, 0, dpr, 0, 0);
  pen.clearRect(0, 0, w, h);
  return [pen, w, h];
}

const captionWidth = () => data.lesson && innerWidth > 760 ? $("caption").offsetWidth + 10 : 0;  // width, pixels, of the part of the scene that a lesson's text covers

// Orthographic projection: rotated about z by the azimuth, then tilted by the elevation; from the top x is right and y
// is up. The search domain fills the canvas except for the margins of the scale and the rulers.
function projector(w, h) {
  const ca = Math.cos(eye.azimuth), sa = Math.sin(eye.azimuth), ce = Math.cos(eye.elevation), se = Math.sin(eye.elevation);
  const turn = ([x, y, z]) => [ca * x - sa * y, se * (sa * x + ca * y) + ce * z];
  const corners = [x0, x1].flatMap(x => [y0, y1].flatMap(y => [z0, z1].map(z => turn([x, y, z]))));
  const ends = [0, 1].map(i => [Math.min(...corners.map(c => c[i])), Math.max(...corners.map(c => c[i]))]);
  const [u, v] = ends.map(([low, high]) => (low + high) / 2), [wide, tall] = ends.map(([low, high]) => high - low);
  const inset = captionWidth(), below = $("words").textContent ? 48 : 0;  // pixels that the words of the opening need
  const scale = eye.zoom * Math.min((w - inset - 90) / wide, (h - 64 - STRIP - below) / tall);
  const project = p => {
    const [a, b] = turn(p);
    return [(w + inset) / 2 + 14 + scale * (a - u + eye.x), (h + STRIP - below) / 2 - 8 - scale * (b - v + eye.y)];
  };
  return [project, scale];
}

function stroke(pen, points, colour, width, close) {
  pen.beginPath();
  points.forEach((p, i) => i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]));
  if (close) pen.closePath();
  pen.strokeStyle = colour; pen.lineWidth = width; pen.stroke();
}
const withHalo = (draw, colour, width, halo) => { draw("#fff", width + halo); draw(colour, width); };
function cross(pen, [x, y], r, colour, width) {
  withHalo((c, w) => { stroke(pen, [[x - r, y - r], [x + r, y + r]], c, w); stroke(pen, [[x - r, y + r], [x + r, y - r]], c, w); },
    colour, width, 2.4);
}
function ring(pen, [x, y], r, colour, width) {
  withHalo((c, w) => { pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.strokeStyle = c; pen.lineWidth = w; pen.stroke(); }, colour, width, 2.4);
}
// The microphone that the user moves: a ball, as on the page of fdcal.
function ball(pen, [x, y], r) {
  const shine = pen.createRadialGradient(x - 0.35 * r, y - 0.4 * r, 0.05 * r, x, y, r);
  [[0, "#fff"], [0.2, "#f2616d"], [0.6, RED], [1, "#8f0d1c"]].forEach(stop => shine.addColorStop(...stop));
  pen.fillStyle = "rgba(0, 0, 0, 0.3)"; pen.beginPath(); pen.arc(x + 0.25 * r, y + 0.3 * r, r, 0, 7); pen.fill();
  pen.fillStyle = shine; pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.fill();
}
function square(pen, [x, y], r) {
  pen.fillStyle = "#fff"; pen.fillRect(x - r - 1.5, y - r - 1.5, 2 * r + 3, 2 * r + 3);
  pen.fillStyle = marks.known.colour; pen.fillRect(x - r, y - r, 2 * r, 2 * r);
}

// Draws a mark, translucent if a hill of the relief hides it.
function drawMark(pen, place, draw) {
  pen.globalAlpha = mapShown() && hidden(place) ? 0.5 : 1;
  draw();
  pen.globalAlpha = 1;
}
// Points on the line from one place to another: many over a relief, so that the line lies on it.
function between(one, other) {
  const count = maps && reliefShown() ? 24 : 1;
  return Array.from({length: count + 1}, (_, i) => one.map((v, axis) => v + i / count * (other[axis] - v)));
}

// The least of 1, 2, 5, 10, ... that divides a span into at most about `count` parts.
const roundStep = (span, count) => {
  const raw = span / count, base = 10 ** Math.floor(Math.log10(raw));
  return base * [1, 2, 5, 10].find(m => m * base >= raw * 0.999);
};
// Round values from low to high, and the number of decimals that they need.
function ticks(low, high, count) {
  const gap = roundStep(high - low, count), values = [];
  for (let i = Math.ceil(low / gap - 1e-9); i * gap <= high + 1e-9 * gap; i++) values.push(i * gap);
  return [values, Math.max(0, -Math.floor(Math.log10(gap) + 1e-9))];
}

// At most about five values for a logarithmic axis.
function decades(low, high) {
  const values = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); e++) for (const m of [1, 2, 5]) values.push(m * 10 ** e);
  const inside = values.filter(v => v >= low * 0.999 && v <= high * 1.001), tens = inside.filter(v => Math.abs(Math.log10(v) % 1) < 1e-9);
  const few = inside.length > 4 && tens.length > 1 ? tens : inside, every = Math.ceil(few.length / 5);
  return few.length > 1 ? few.filter((_, i) => i % every == 0) : ticks(low, high, 3)[0];
}

function drawRoom(pen, project) {
  if (!data.outline) return;
  const ink = css("--ink"), faint = css("--faint");
  const foot = data.outline.map(p => project([p[0], p[1], 0])), head = data.outline.map(p => project([p[0], p[1], data.tall]));
  stroke(pen, foot, ink, 2, true);
  if (!flat) { stroke(pen, head, faint, 1.2, true); foot.forEach((p, i) => stroke(pen, [p, head[i]], faint, 1.2)); }
  data.sources.forEach((place, take) => {
    const s = project([...place, 0].slice(0, 3));
    stroke(pen, [[s[0] - 7, s[1]], [s[0] + 7, s[1]]], ink, 2); stroke(pen, [[s[0], s[1] - 7], [s[0], s[1] + 7]], ink, 2);
    pen.fillStyle = ink; pen.fillText(data.sources.length > 1 ? "source, take " + take : "source", s[0] + 9, s[1] - 5);
  });
}
// The outline of the search domain, with its rulers.
function drawFrame(pen, project) {
  const ink = css("--ink"), faint = css("--faint");
  stroke(pen, [[x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0]].map(project), ink, 1.2, true);
  if (z1 > z0 && !flat) stroke(pen, [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]].map(project), faint, 1, true);
  pen.fillStyle = ink;
  for (const [low, high, onEdge, left] of [[x0, x1, v => [v, y0, z0], 0], [y0, y1, v => [x0, v, z0], 1]]) {
    const [values, digits] = ticks(low, high, 5);
    values.forEach((v, i) => {
      const p = project(onEdge(v)), text = fixed(v, digits);
      stroke(pen, left ? [p, [p[0] - 5, p[1]]] : [p, [p[0], p[1] + 5]], ink, 1.2);
      pen.textAlign = left ? "right" : "center";
      pen.fillText(text, p[0] - (left ? 8 : 0), p[1] + (left ? 4 : 18));
    });
    const end = project(onEdge(high));
    pen.textAlign = left ? "center" : "right";
    pen.fillText(left ? "y (m)" : "x (m)", end[0], end[1] + (left ? -7 : 32));
  }
  pen.textAlign = "left";
}

function drawScene() {
  $("reset").hidden = eye.zoom == 1 && !eye.x && !eye.y && (flat || eye.azimuth == TURNED && eye.elevation == RAISED);
  const [pen, w, h] = fit($("view")), [project, scale] = projector(w, h);
  const r = Math.max(4, Math.min(11, scale * 0.0125 * Math.max(x1 - x0, y1 - y0)));
  pen.font = "12px system-ui, sans-serif"; pen.lineJoin = "round"; pen.lineCap = "round";
  if (mapShown()) drawMap(pen, project);
  drawRoom(pen, project);
  drawFrame(pen, project);
  const on = ([x, y, z]) => project([x, y, z + reliefHeight([x, y])]), now = [...Array(N).keys()].map(n => on(placeOf(at, n)));
  const given = new Map(data.known.map((n, i) => [n, on(givenOf(i))]));
  // Whether the square of a known microphone covers its estimate.
  const covered = n => given.has(n) && Math.hypot(now[n][0] - given.get(n)[0], now[n][1] - given.get(n)[1]) <= r;
  if ($("trails").checked) for (let n = 0; n < N; n++) {
    if (known.has(n)) continue;
    const path = [];
    for (let t = Math.max(range[0], at - 200); t <= at; t++) path.push(on(recorded(t, n)));
    stroke(pen, path, marks.trail.colour, 1.4);
  }
  if (truth) for (let n = 0; n < N; n++) {
    const p = on(truthOf(n));
    if (!covered(n)) withHalo((c, width) => stroke(pen, between(truthOf(n), placeOf(at, n)).map(on), c, width), marks.error.colour, 1.3, 1.6);
    drawMark(pen, truthOf(n), () => ring(pen, p, r * marks.true.reach, marks.true.colour, Math.max(1.6, r * marks.true.width)));
  }
  data.known.forEach((n, i) => drawMark(pen, givenOf(i), () => square(pen, given.get(n), Math.max(3, r * marks.known.reach))));
  for (let n = 0; n < N; n++) if (!covered(n)) drawMark(pen, placeOf(at, n), () => cross(pen, now[n], r * marks.estimate.reach * Math.SQRT1_2, RED, Math.max(1.8, r * marks.estimate.width)));
  if (mapShown() && marked) drawMinima(pen, project, r);
  const n = subject();
  if (n >= 0) {
    if (D == 3 && !flat) stroke(pen, [now[n], project([...placeOf(at, n).slice(0, 2), z0])], RED, 1.6);  // down to the map
    if (truth) drawMark(pen, truthOf(n), () => ring(pen, on(truthOf(n)), marks.selected.reach * r, marks.true.colour, Math.max(2, r * marks.selected.width)));
    drawMark(pen, placeOf(at, n), () => {
      if (covered(n)) square(pen, given.get(n), Math.max(5, 2 * r * marks.known.reach)); else if (known.has(n)) cross(pen, now[n], r * marks.moved.reach * Math.SQRT1_2, RED, Math.max(2.4, r * marks.moved.width)); else ball(pen, now[n], marks.ball.reach * r);
    });
    pen.font = "600 13px system-ui, sans-serif";
    pen.lineWidth = 4; pen.strokeStyle = css("--back"); pen.fillStyle = css("--ink");
    const left = now[n][0] > w - 150, x = left ? Math.min(now[n][0] - 2.4 * r, w - 4) : Math.max(now[n][0] + 2.4 * r, 4);
    pen.textAlign = left ? "right" : "left";
    if (!namedNow()?.includes(n)) for (const write of ["strokeText", "fillText"]) pen[write]("microphone " + data.names[n], x, now[n][1] + 4);
    pen.textAlign = "left";
  }
  if (namedNow()) drawNamed(pen, on, now, r, w);
  drawPlay(pen, project, r);
  if (mapShown()) drawColourBar(pen, w);
  drawnAt = now;
}

// States at which the solver has restarted.
const restarts = (begin, finish) => Array.from({length: finish - begin}, (_, i) => begin + 1 + i).filter(t => restart[t] != restart[t - 1]);

// Draws curves over the steps into a canvas, and returns the first and the last column of pixels of their axis.
function drawCurve(id, series, log) {
  const [pen, w, h] = fit($(id)), left = 52, right = 8, top = 6, bottom = 20, ink = css("--ink"), faint = css("--faint");
  const usable = v => Number.isFinite(v) && (!log || v >= 0), [begin, finish] = range;
  const shown = series.flatMap(([values]) => [...values.slice(begin, finish + 1)].filter(usable)), drawable = shown.filter(v => !log || v > 0);
  const foot = bottom + (drawable.length < shown.length ? 16 : 0);  // 0 is drawn below a logarithmic scale
  let low = Math.min(...drawable), high = Math.max(...drawable);
  if (!(low <= high)) { low = log ? 0.1 : 0; high = 1; }
  const scale = log ? Math.log10 : v => v;
  let a = scale(low), b = scale(high);
  if (b - a < 1e-9) { a -= 0.5; b += 0.5; }
  const end = Math.max(step[finish], step[begin] + 1), X = s => left + (w - left - right) * (s - step[begin]) / (end - step[begin]);
  const Y = v => log && v == 0 ? h - bottom : h - foot - (h - top - foot) * (scale(v) - a) / (b - a);
  pen.font = "11px system-ui, sans-serif"; pen.textAlign = "right"; pen.fillStyle = ink;
  for (const v of [...foot > bottom ? [0] : [], ...log ? decades(low, high) : ticks(a, b, 3)[0]]) {
    stroke(pen, [[left, Y(v)], [w - right, Y(v)]], faint, 1);
    pen.fillText(Number(v.toPrecision(4)).toString(), left - 5, Y(v) + 4);
  }
  const [stops, places] = ticks(step[begin], end, 4);
  pen.textAlign = "center";
  for (const s of stops) pen.fillText(s.toFixed(places), Math.min(X(s), w - 14), h - 6);
  pen.setLineDash([4, 4]);
  const added = Array.from({length: finish - begin}, (_, i) => begin + 1 + i).filter(t => last[t] > last[t - 1]);
  for (const t of added.length > 30 ? [] : added) stroke(pen, [[X(step[t]), top], [X(step[t]), h - bottom]], "#8a8f98", 1);
  pen.setLineDash([]);
  for (const t of restarts(begin, finish)) stroke(pen, [[X(step[t]), top], [X(step[t]), top + 0.25 * (h - top - bottom)]], VIOLET, 2.5);
  for (const [values, colour, width] of series) {
    let line = [];
    for (let t = begin; t <= finish + 1; t++) if (t <= finish && usable(values[t])) line.push([X(step[t]), Y(values[t])]); else { stroke(pen, line, colour, width); line = []; }
  }
  stroke(pen, [[X(step[at]), top], [X(step[at]), h - bottom]], ink, 1.5);
  for (const [values, colour] of series) if (usable(values[at])) {
    pen.beginPath(); pen.arc(X(step[at]), Y(values[at]), 3.5, 0, 7); pen.fillStyle = colour; pen.fill();
  }
  return [left, w - right];
}

const fixed = (v, digits) => (Number(v.toFixed(digits)) + 0).toFixed(digits);  // no minus before a zero
const mm = v => v < 1e-6 ? "0 mm" : v < 0.1 ? Number((1e3 * v).toPrecision(3)) + " mm" : (1e3 * v).toFixed(0) + " mm";
const frequency = mode => data.frequencies[mode - 1].toFixed(1);
const distance = (t, n) => Math.hypot(...placeOf(t, n).map((v, i) => v - truthOf(n)[i]));
const coordinates = n => placeOf(at, n).slice(0, D).map(v => fixed(v, 3)).join(", ") + " m";

const errorName = data.reference == "true" ? "error" : "deviation from nominal";

function showTexts() {
  const one = first[at] == last[at];
  $("now").textContent = own ? "your positions" : `step ${step[at]}, sweep ${sweep[at]}; ` + (one ?
    `frequency ${first[at]}, ${frequency(first[at])} Hz` : `frequencies no. ${first[at]} to ${last[at]}, ${frequency(first[at])} to ${frequency(last[at])} Hz`);
  const away = own && truth ? data.averaged.map(n => distance(at, n)) : null, average = away ? away.reduce((a, b) => a + b, 0) / away.length : mean?.[at];
  $("errors").textContent = mean ? `${errorName}: mean ${mm(average)}, largest ${mm(away ? Math.max(...away) : largest[at])}${data.aligned && !own ? ", after alignment" : ""}` : "true positions unknown";
  $("cost").textContent = own || !cost ? "" : `cost ${cost[at].toFixed(1)} dB`;
  if (selected >= 0) $("selected").textContent = `microphone ${data.names[selected]}${known.has(selected) ? " (known)" : ""} at ${coordinates(selected)}` +
    (truth ? `, ${errorName} ${mm(distance(at, selected))}` : "");
  else $("selected").textContent = "Click or tap a microphone to follow it.";
  const listed = [...free];
  if (truth) listed.sort((m, n) => distance(at, n) - distance(at, m) || m - n);
  $("tablehead").textContent = truth ? `Microphones, largest ${data.reference == "true" ? "error" : "deviation"} first` : "Microphones";
  $("table").replaceChildren(...listed.slice(0, 12).map(n => {
    const row = document.createElement("tr");
    for (const text of [data.names[n], coordinates(n), truth ? mm(distance(at, n)) : ""]) row.insertCell().textContent = text;
    row.className = n == subject() ? "here" : "";
    return row;
  }));
}

let axis = [0, 1];  // columns of pixels of the curves at the first and the last state
function show() {
  requestMap(); drawScene(); showTexts(); showModes(); showPlay(); writeAddress();
  if (mean) axis = drawCurve("error", [[largest, ORANGE, 1.3], [mean, RED, 2]].map(([values, ...style]) => [values.map(v => v < 1e-9 ? 0 : 1e3 * v), ...style]), true);
  if (cost) axis = drawCurve("costs", [[cost, BLUE, 2]], false);
  Object.assign($("time"), {min: range[0], max: range[1], value: at});
  $("play").textContent = playing ? "Pause" : "Play";
  if (lesson) explainAtEnd();
}
function go(t) { returnToRun(); at = Math.min(Math.max(t, range[0]), range[1]); show(); }

let due = 0, before = 0;  // number of states that are due, and time of the last call, ms
function advance(time) {
  if (!playing) return;
  due += (time - before) / 1e3 * Number($("speed").value); before = time;
  if (due >= 1) { at = Math.min(at + Math.floor(due), range[1]); due %= 1; if (at == range[1]) playing = false; show(); }
  requestAnimationFrame(advance);
}
function play(on) {
  playing = on;
  returnToRun();
  $("note").textContent = "";
  if (on) { if (at == range[1]) at = range[0]; due = 0; before = performance.now(); requestAnimationFrame(advance); }
  show();
}
function setView(top, azimuth = TURNED, elevation = RAISED) {
  flat = top;
  Object.assign(eye, top ? {azimuth: 0, elevation: Math.PI / 2} : {azimuth, elevation}, {zoom: 1, x: 0, y: 0});
  $("top").setAttribute("aria-pressed", top); $("turn").setAttribute("aria-pressed", !top);
  show();
}
function setTheme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  $("theme").textContent = dark ? "Light" : "Dark";
  show();
}

const pointers = new Map();
// dragged: length of the gesture, pixels; pinch: distance of two fingers, pixels; taken: the microphone that is dragged.
let dragged = 0, pinch = 0, taken = -1;
const view = $("view");
view.addEventListener("pointerdown", e => { view.setPointerCapture(e.pointerId); pointers.set(e.pointerId, [e.clientX, e.clientY]); dragged = pinch = 0;
  if (pointers.size > 1 && taken >= 0 && own) release(taken);  // a second finger ends the drag
  taken = pointers.size == 1 ? grabbed(e) : -1;
});
view.addEventListener("pointermove", e => {
  const old = pointers.get(e.pointerId);
  if (!old) return;
  const dx = e.clientX - old[0], dy = e.clientY - old[1];
  dragged += Math.abs(dx) + Math.abs(dy);
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  if (pointers.size == 2) {
    const [p, q] = [...pointers.values()], wide = Math.hypot(p[0] - q[0], p[1] - q[1]);
    if (pinch) zoom(wide / pinch);
    pinch = wide;
  } else if (taken >= 0) {
    if (dragged >= 5) dragTo(taken, e);
  } else if (flat || e.shiftKey || e.buttons & 6) {
    const [, scale] = projector(view.clientWidth, view.clientHeight);
    eye.x += dx / scale; eye.y -= dy / scale; drawScene();
  } else { eye.azimuth += dx * 0.008; eye.elevation = Math.min(Math.max(eye.elevation + dy * 0.008, 0.05), Math.PI / 2); drawScene(); }
  writeAddress();
});
for (const name of ["pointerup", "pointercancel"]) view.addEventListener(name, e => {
  pointers.delete(e.pointerId);
  if (name == "pointerup" && dragged < 5) pick(e);
  else if (taken >= 0 && own) release(taken);
  taken = -1;
});
view.addEventListener("contextmenu", e => e.preventDefault());
view.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(-e.deltaY * 0.0012)); }, {passive: false});
view.addEventListener("dblclick", () => setView(flat));
function zoom(by) {
  eye.zoom = Math.min(Math.max(eye.zoom * by, 0.1), 40);
  drawScene(); writeAddress();
}
function pick(e) {
  const box = view.getBoundingClientRect(), far = p => Math.hypot(p[0] - e.clientX + box.left, p[1] - e.clientY + box.top);
  const best = drawnAt.reduce((b, p, n) => far(p) < far(drawnAt[b]) ? n : b, 0);
  selected = far(drawnAt[best]) < 22 ? best : maps && !oneMoves ? selected : -1;
  show();
}
for (const id of ["error", "costs"]) $(id).addEventListener("click", e => {
  const box = $(id).getBoundingClientRect(), fraction = (e.clientX - box.left - axis[0]) / (axis[1] - axis[0]);
  const [begin, end] = range;
  playing = false; go(nearestState(step, step[begin] + fraction * (step[end] - step[begin])));
});
