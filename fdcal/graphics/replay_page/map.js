// Draws the map on the floor: the cost of moving one microphone, at the state that is shown, summed over the chosen modes.
const free = [...Array(N).keys()].filter(n => !known.has(n));
let objective = false, marked = true;  // whether the map shows the cost that descent minimises, and whether its minima are marked
// map: the finished map; wanted: the request for the map of the present state; modeMaps: the maps of single modes for `key`.
let map = null, wanted = null, working = false, modeMaps = {key: "", found: new Map()};

const oneMoves = moved.some(n => n >= 0);  // whether a step of this solver moves one microphone
if (maps && selected < 0 && !oneMoves) selected = free[0] ?? 0;
// The microphone whose map is shown: the selected one, or the one that the step moved.
const subject = () => selected >= 0 ? selected : moved[at] >= 0 || !maps ? moved[at] : free[0] ?? 0;
const mapShown = () => maps && $("map").checked && map && map.n == wanted.n;

// Indices of the modes of the map in maps.modes: the chosen ones, or the ones that the solver uses.
function modeIndices() {
  const [low, high] = chosen ?? [first[at], last[at]];
  return [...maps.modes.keys()].filter(i => low <= maps.modes[i] && maps.modes[i] <= high);
}

function requestMap() {
  if (!maps || !$("map").checked) return;
  const n = subject(), indices = modeIndices();
  const moved = own ? own.places.map((p, i) => i == n ? "" : p).join() : "";  // where the user has moved the others
  wanted = {t: at, n, indices, moved, objective, key: [at, n, indices[0], indices.length, moved, objective].join()};
  if (n >= 0 && indices.length && !working) { working = true; computeMaps(); } else if (!indices.length) map = null;
}

// Computes maps until the wanted one is finished. A map of the same microphone is finished even if another one is wanted,
// if this takes at most 250 ms or the run plays, so that maps also appear while a slider is dragged.
async function computeMaps() {
  while (wanted.indices.length && map?.key != wanted.key) {
    const job = wanted, begun = performance.now(), positions = [];
    for (let n = 0; n < N; n++) positions.push(...(n == job.n ? recorded : placeOf)(job.t, n));  // a microphone's own position does not change its map, and must not restart it
    const lattice = job.indices.length <= maps.few && !playing ? fineLandscapes : landscapes, terms = job.objective ? descentTerms(Array.from({length: N}, (_, n) => positions.slice(3 * n, 3 * n + 3)), maps.modes[job.indices.at(-1)]) : {};
    const key = [job.t, job.n, lattice.step, job.moved, JSON.stringify([terms.centre, terms.shift])].join();
    if (modeMaps.key != key) modeMaps = {key, found: new Map()};
    let paused = begun, found = modeMaps.found, dropped = false;
    for (const index of job.indices) {
      if (!found.has(index)) found.set(index, lattice.map(index, job.n, positions, job.t, terms));
      if (performance.now() - paused < 14) continue;
      await new Promise(resolve => setTimeout(resolve));
      paused = performance.now();
      dropped = job.n != wanted.n || !playing && job.key != wanted.key && paused - begun > 250;
      if (dropped) break;
    }
    if (dropped) continue;
    map = finished(job, found, lattice); drawScene(); showModes();
    if (own?.waiting >= 0) release(own.waiting);
  }
  working = false;
}

function percentile(sorted, percent) {
  const at = percent / 100 * (sorted.length - 1), i = Math.floor(at), next = sorted[Math.min(i + 1, sorted.length - 1)];
  return sorted[i] + (at - i) * (next - sorted[i]);
}
// The colours of costs (ny, nx) on a logarithmic scale from low to high, as a canvas with a pixel for each cost.
function imageOf(cost, nx, ny, low, high) {
  const image = document.createElement("canvas"), range = Math.log10(high / low) || 1;
  image.width = nx; image.height = ny;
  const pen = image.getContext("2d"), pixels = pen.createImageData(nx, ny);
  for (let j = 0; j < ny; j++) for (let i = 0; i < nx; i++) {  // row 0 of the map is at low y
    const level = Math.log10(Math.max(cost[j * nx + i], low) / low) / range, colour = 3 * Math.round(255 * Math.min(Math.max(level, 0), 1));
    pixels.data.set([maps.colours[colour], maps.colours[colour + 1], maps.colours[colour + 2], 255], 4 * ((ny - 1 - j) * nx + i));
  }
  pen.putImageData(pixels, 0, 0);
  return image;
}
// A map from the maps of its modes: the sum of their costs relative to their power, its image and its minima.
function finished(job, found, lattice) {
  const [nx, ny] = lattice.shape, cost = new Float64Array(nx * ny);
  let power = 0;
  for (const index of job.indices) {
    const one = found.get(index);
    power += one.power;
    for (let i = 0; i < cost.length; i++) cost[i] += one.cost[i];
  }
  for (let i = 0; i < cost.length; i++) cost[i] /= power;
  const sorted = Float64Array.from(cost).sort(), [low, top] = maps.percentiles.map(percent => percentile(sorted, percent));
  const floor = Math.max(low, top * 10 ** -maps.decades), high = Math.max(top, floor * 10 ** (maps.least / 10));
  const image = imageOf(cost, nx, ny, floor, high);
  const marked = minimaOf(cost, nx, ny, maps), place = i => [lattice.places[0][i % nx], lattice.places[1][Math.floor(i / nx)]];
  const minima = {lowest: marked.lowest.map(place), others: marked.others.map(place), count: marked.count};
  const max = sorted[sorted.length - 1], min = Math.max(sorted[0], max * 10 ** -maps.decades);  // heights cover all costs
  const [lowEnd, highEnd, bottom, peak] = [floor, high, min, Math.max(max, min * 10 ** (maps.least / 10))].map(v => 10 * Math.log10(v));
  return {...job, lattice, cost, image, minima, low: lowEnd, high: highEnd, bottom, peak};  // ends of the colours and of the heights, dB
}

// Height of the map at a point relative to its highest point, at most 0, metres. The view 3-D shows the map of a plane
// scene as a relief, whose highest point is on the floor.
const RELIEF = 0.22;  // ratio of the greatest height to the longer edge of the map
const reliefShown = () => D == 2 && !flat && mapShown();
function reliefHeight([x, y]) {
  if (!reliefShown()) return 0;
  const value = 10 ** (level(map, [x, y]) / 10), below = 10 * Math.log10(Math.max(value, 10 ** (map.bottom / 10))) - map.peak;
  return RELIEF * Math.max(...landscapes.edge) * below / Math.max(map.peak - map.bottom, 1e-9);
}
// Whether a relief hides a point on its surface, because nearer to the viewer it is above the line of sight.
const RAY = 40;  // points that are tested on the line of sight
function hidden([x, y]) {
  if (!reliefShown()) return false;
  const away = Math.cos(eye.elevation), way = [-Math.sin(eye.azimuth) * away, -Math.cos(eye.azimuth) * away, Math.sin(eye.elevation)];
  const z = reliefHeight([x, y]), long = Math.max(...landscapes.edge), reach = Math.min(-z / way[2], 2 * long), [left, low] = landscapes.corner, [wide, deep] = landscapes.edge;
  for (let i = 1; i <= RAY; i++) {
    const [u, v, w] = way.map((d, axis) => [x, y, z][axis] + reach * i / RAY * d);
    if (u < left || v < low || u > left + wide || v > low + deep) return false;
    if (reliefHeight([u, v]) > w + 0.03 * RELIEF * long) return true;
  }
  return false;
}
function drawRelief(pen, project) {
  const {cost, lattice} = map, [nx, ny] = lattice.shape, every = Math.ceil(Math.max(nx, ny) / 96);
  const axes = [nx, ny].map(count => Array.from({length: Math.floor((count - 1) / every) + 1}, (_, i) => i * every));
  const tall = RELIEF * Math.max(...landscapes.edge), range = map.peak - map.bottom || 1, fraction = at => Math.min(Math.max((10 * Math.log10(Math.max(cost[at], 1e-30)) - map.bottom) / range, 0), 1);
  const points = axes[1].map(j => axes[0].map(i => {
    const s = fraction(j * nx + i);
    return {s, p: project([lattice.places[0][i], lattice.places[1][j], z0 - tall * (1 - s)])};
  }));
  const [columns, rows] = axes.map(axis => [...axis.keys()].slice(0, -1)), ordered = (list, forward) => forward ? list : [...list].reverse();
  // Cells are drawn from the back to the front; farther cells are higher on the screen.
  for (const j of ordered(rows, Math.cos(eye.azimuth) < 0)) for (const i of ordered(columns, Math.sin(eye.azimuth) < 0)) {
    const corners = [points[j][i], points[j][i + 1], points[j + 1][i + 1], points[j + 1][i]], mean = corners.reduce((sum, c) => sum + c.s, 0) / 4;
    const light = 1 + 1.6 * (corners[0].s + corners[3].s - corners[1].s - corners[2].s), shade = Math.min(Math.max(light, 0.72), 1.18);
    const colour = 3 * Math.round(255 * mean);
    pen.fillStyle = pen.strokeStyle = `rgb(${[0, 1, 2].map(c => Math.min(Math.round(shade * maps.colours[colour + c]), 255)).join()})`;
    pen.beginPath();
    corners.forEach(({p}, c) => c ? pen.lineTo(...p) : pen.moveTo(...p));
    pen.closePath(); pen.lineWidth = 0.6; pen.fill(); pen.stroke();
  }
}

function drawMap(pen, project) {
  if (reliefShown()) { drawRelief(pen, project); return; }
  const [x, y] = landscapes.corner, [wide, deep] = landscapes.edge;
  const [p, right, up] = [[x, y + deep, z0], [x + wide, y + deep, z0], [x, y, z0]].map(project);
  pen.save();
  pen.transform((right[0] - p[0]) / map.image.width, (right[1] - p[1]) / map.image.width,
    (up[0] - p[0]) / map.image.height, (up[1] - p[1]) / map.image.height, p[0], p[1]);
  pen.drawImage(map.image, 0, 0);
  pen.restore();
}

function drawMinima(pen, project, r) {
  for (const [places, {reach, colour}, wide] of [[map.minima.others, marks.minima, 1.6], [map.minima.lowest, marks.lowest, 2.4]]) for (const [x, y] of places) {
    const [u, v] = project([x, y, z0 + reliefHeight([x, y])]), size = reach * r;
    const corners = [[u + size, v], [u, v + size], [u - size, v], [u, v - size]];
    drawMark(pen, [x, y], () => withHalo((c, width) => stroke(pen, corners, c, width, true), colour, wide, 2.2));
  }
}

const rangeText = indices => indices.length > 1 ? `frequencies no. ${maps.modes[indices[0]]} to ${maps.modes[indices.at(-1)]}` : `frequency ${maps.modes[indices[0]]}`;

// Draws caption and colour bar, in decibels relative to the power of the pressures of these modes.
function drawColourBar(pen, w) {
  const left = 14 + captionWidth(), top = 26, wide = Math.min(300, w - left - 120), ink = css("--ink"), [low, high] = [map.low, map.high];
  const minima = !marked ? "" : [", lowest at the edge", ", 1 minimum"][map.minima.count] ?? `, ${map.minima.count} minima`, layer = D == 3 ? ` at z = ${fixed(placeOf(map.t, map.n)[2], 2)} m` : "";
  pen.fillStyle = css("--back"); pen.fillRect(0, 0, w, STRIP - 4);
  pen.fillStyle = ink; pen.font = "600 13px system-ui, sans-serif"; pen.textAlign = "left";
  pen.fillText(`Cost of microphone ${data.names[map.n]}${layer}: ${rangeText(map.indices)}${minima}`, left, 16, w - 20);
  for (let i = 0; i < wide; i++) {
    const colour = 3 * Math.round(255 * i / (wide - 1));
    pen.fillStyle = `rgb(${maps.colours.slice(colour, colour + 3).join()})`; pen.fillRect(left + i, top, 1.5, 9);
  }
  pen.font = "11px system-ui, sans-serif"; pen.fillStyle = ink; pen.textAlign = "center";
  const [values, digits] = ticks(low, high, 4);
  for (const v of values) {
    const x = left + wide * (v - low) / (high - low);
    stroke(pen, [[x, top + 9], [x, top + 13]], ink, 1);
    pen.fillText(v.toFixed(digits).replace("-", "−"), x, top + 24);
  }
  pen.textAlign = "left"; pen.fillText("dB", left + wide + 8, top + 9);
}

function showModes() {
  if (!maps) return;
  const indices = modeIndices(), none = !indices.length;
  $("follow").checked = !chosen;
  if (!none) { $("firstmode").value = indices[0]; $("lastmode").value = indices.at(-1); }
  $("modes").textContent = none ? "none of these has a map" : rangeText(indices);
  $("microphone").value = selected;
}

function mapControls() {
  for (const id of ["firstmode", "lastmode"]) {
    Object.assign($(id), {min: 0, max: maps.modes.length - 1, step: 1});
    $(id).oninput = () => {
      const ends = ["firstmode", "lastmode"].map(one => Number($(one).value)), moved = Number($(id).value);
      if (ends[0] > ends[1]) ends.fill(moved);
      chosen = ends.map(i => maps.modes[i]); show();
    };
  }
  if (oneMoves) $("microphone").add(new Option("the one that moved", -1));
  data.names.forEach((name, n) => $("microphone").add(new Option(name, n)));
  $("microphone").onchange = e => { selected = Number(e.target.value); show(); };
  $("follow").onchange = e => { chosen = e.target.checked ? null : [first[at], last[at]]; show(); };
  $("map").onchange = show;
}
// For tests, and for use in the console of a browser.
window.replay = {get map() { return mapShown() && map.key == wanted.key ? map : null; }, landscapes, fineLandscapes, finished, placeOf, hidden, data, arrays, descentStep, downhill, level, get own() { return own; }, drawn: n => drawnAt[n]};
