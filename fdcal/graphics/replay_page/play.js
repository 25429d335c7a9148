// A user can do two things without Python: drag a microphone over its map, where it rolls downhill when released, and take
// steps of descent (fdcal/solvers/descent.py) from there.
const ROLL = 1200, NEAR = 16;  // ms in which a microphone rolls; pixels within which a press takes a microphone
// The user's positions and what belongs to them, or null while the recorded run is shown: places (N, 3), metres; turn, the
// number of steps of descent so far; tries, the number of microphones released; reached, how many of them reached the true
// position; words beside the microphone; path downhill; waiting, the microphone that rolls as soon as its map is computed.
let own = null;
let rolling = null;  // the microphone n that rolls: its map `over`, its path, and the time at which it began, ms
const descentLattice = maps?.descent && new Landscapes(maps, arrays, N, D, Math.max(...maps.shape));

// Begins with the user's own positions, from those of the state that is shown.
function leaveRun() {
  if (!own) own = {places: [...Array(N).keys()].map(n => recorded(at, n)), turn: 0, tries: 0, reached: 0, words: "", waiting: -1};
  playing = false;
}
function returnToRun() { own = rolling = null; }

// The point at the height z that a pixel of the canvas shows, metres.
function placeAt(e, z) {
  const box = view.getBoundingClientRect(), [project] = projector(view.clientWidth, view.clientHeight);
  const o = project([0, 0, z]), a = project([1, 0, z]).map((v, i) => v - o[i]), b = project([0, 1, z]).map((v, i) => v - o[i]);
  const [u, v] = [e.clientX - box.left - o[0], e.clientY - box.top - o[1]], area = a[0] * b[1] - a[1] * b[0];
  return [(u * b[1] - v * b[0]) / area, (a[0] * v - a[1] * u) / area];
}
// The nearest point of the search domain.
const insideDomain = ([x, y]) => [x, y].map((v, i) => Math.min(Math.max(v, landscapes.corner[i]), landscapes.corner[i] + landscapes.edge[i]));

// The free microphone nearest to the pointer, if the map is shown and the microphone is near enough, otherwise -1.
function grabbed(e) {
  if (!maps || !$("map").checked || !drawnAt) return -1;
  const box = view.getBoundingClientRect(), far = n => Math.hypot(drawnAt[n][0] - e.clientX + box.left, drawnAt[n][1] - e.clientY + box.top);
  const best = free.length ? free.reduce((b, n) => far(n) < far(b) ? n : b) : -1;
  return best >= 0 && far(best) < NEAR ? best : -1;
}
function dragTo(n, e) {
  leaveRun();
  const [x, y] = insideDomain(placeAt(e, own.places[n][2] + reliefHeight(own.places[n])));
  Object.assign(own, {words: "", path: null, waiting: -1});
  rolling = null; selected = n; own.places[n] = [x, y, own.places[n][2]];
  if (map?.n == n && map.key == wanted.key) { own.path = downhill(map, [x, y]); own.words = `${level(map, [x, y]).toFixed(1)} dB`; }
  show();
}
function release(n) {
  own.waiting = map?.n == n && map.key == wanted.key ? -1 : n;
  if (own.waiting >= 0) return;  // it rolls as soon as its map is computed
  rolling = {n, over: map, path: downhill(map, own.places[n]), begun: performance.now()};
  requestAnimationFrame(roll);
}
function roll(time) {
  if (!rolling || !own) return;
  const {n, over, path, begun} = rolling, fraction = Math.min(Math.max((time - begun) / ROLL, 0), 1);
  const at = (path.length - 1) * fraction * fraction * (3 - 2 * fraction), i = Math.min(Math.floor(at), path.length - 1), j = Math.min(i + 1, path.length - 1);
  own.places[n] = [0, 1].map(axis => path[i][axis] + (at - i) * (path[j][axis] - path[i][axis])).concat(own.places[n][2]);
  own.path = path.slice(i); own.words = "";
  if (fraction < 1) { drawScene(); requestAnimationFrame(roll); return; }
  own.path = null; rolling = null;
  landed(n, over);
}
// Says in words where microphone n has come to rest on the map `over`, and counts the try. The microphone has reached the
// true position if the path downhill from the true position ends in the same minimum.
function landed(n, over) {
  const [x, y] = own.places[n], truthKnown = truth && data.reference == "true", apart = p => Math.hypot(p[0] - x, p[1] - y);
  const inMinimum = [...over.minima.lowest, ...over.minima.others].some(p => apart(p) < 2 * over.lattice.step);
  const reachedTruth = truthKnown && inMinimum && apart(downhill(over, truthOf(n)).at(-1)) < 2 * over.lattice.step;
  const away = truthKnown ? Math.hypot(...own.places[n].map((v, axis) => v - truthOf(n)[axis])) : NaN;
  if (truthKnown) { own.tries++; own.reached += reachedTruth; }
  const off = away < 0.0995 ? `${(1e3 * away).toFixed(0)} mm` : `${(100 * away).toFixed(0)} cm`;
  const where = !inMinimum ? "At the edge of the map" : truthKnown ? "Trapped" : "At rest";
  own.words = reachedTruth ? `Reached the true position within ${Math.ceil(1e3 * away)} mm` : `${where}, ${truthKnown ? `${off} off` : `${level(over, [x, y]).toFixed(1)} dB`}`;
  show();
}

// The path downhill on a map, from a point to a marked local minimum or to the edge of the map: points (x, y), metres.
function downhill({cost, lattice, minima}, start) {
  const [nx, ny] = lattice.shape, {step} = lattice, height = ([i, j]) => {
    const a = Math.min(Math.max(Math.floor(i), 0), nx - 2), b = Math.min(Math.max(Math.floor(j), 0), ny - 2), u = i - a, v = j - b, at = b * nx + a;
    return (1 - v) * ((1 - u) * cost[at] + u * cost[at + 1]) + v * ((1 - u) * cost[at + nx] + u * cost[at + nx + 1]);
  };
  const clip = ([i, j]) => [Math.min(Math.max(i, 0), nx - 1), Math.min(Math.max(j, 0), ny - 1)];
  const marked = [...minima.lowest, ...minima.others].map(p => p.map((v, axis) => Math.round((v - lattice.places[axis][0]) / step)));
  let here = clip(start.slice(0, 2).map((v, axis) => (v - lattice.places[axis][0]) / step));
  const path = [here];
  for (let count = 0; count < 4000; count++) {
    const slope = [0, 1].map(axis => {
      const [up, down] = [1, -1].map(sign => clip(here.map((v, i) => i == axis ? v + sign * 0.5 : v)));
      return height(up) - height(down);
    });
    const length = Math.hypot(...slope);
    let next = null;
    for (let stride = 0.7; length > 0 && stride > 0.05 && !next; stride /= 2) {
      const there = clip(here.map((v, axis) => v - stride * slope[axis] / length));
      if (height(there) < height(here)) next = there;
    }
    if (!next) {  // the slope leads nowhere: go to the nearest lower point, unless this is a minimum or the edge
      const [i, j] = here.map(Math.round), at = [i, j], edge = i == 0 || j == 0 || i == nx - 1 || j == ny - 1;
      const done = marked.find(([a, b]) => Math.hypot(a - i, b - j) < 1.5);
      if (done || edge) { if (done) path.push(done); break; }
      next = nearestLower(cost, nx, ny, at, height(here));
      if (!next) break;
    }
    path.push(here = next);
  }
  return path.map(p => p.map((v, axis) => lattice.places[axis][0] + v * step));
}
// The lattice point nearest to (i, j) whose cost is below a level, or null.
function nearestLower(cost, nx, ny, [i, j], level) {
  for (let reach = 1; reach < Math.max(nx, ny); reach++) {
    let best = null;
    for (let b = Math.max(j - reach, 0); b <= Math.min(j + reach, ny - 1); b++) for (let a = Math.max(i - reach, 0); a <= Math.min(i + reach, nx - 1); a++) {
      if (cost[b * nx + a] < level && (!best || Math.hypot(a - i, b - j) < Math.hypot(best[0] - i, best[1] - j))) best = [a, b];
    }
    if (best) return best;
  }
  return null;
}
// The cost of a map at a point, dB.
function level({cost, lattice}, place) {
  const [nx, ny] = lattice.shape, [i, j] = [0, 1].map(axis => Math.min(Math.max((place[axis] - lattice.places[axis][0]) / lattice.step, 0), lattice.shape[axis] - 1));
  const a = Math.min(Math.floor(i), nx - 2), b = Math.min(Math.floor(j), ny - 2), u = i - a, v = j - b, at = b * nx + a;
  return 10 * Math.log10((1 - v) * ((1 - u) * cost[at] + u * cost[at + 1]) + v * ((1 - u) * cost[at + nx] + u * cost[at + nx + 1]));
}

// What the cost that a step of descent minimises depends on: the centre of the expansion, which is a lattice point, the weights
// of the microphones, and the shift of the orders. `high`: the last mode in use; `places`: (N, 3), metres.
function descentTerms(places, high) {
  const {order_offset, ample_modes, known_weight} = maps.descent, lattice = descentLattice;
  const shift = (high >= ample_modes ? order_offset : 0) - maps.order_offset, mean = [0, 1, 2].map(axis => places.reduce((sum, p) => sum + p[axis], 0) / N);
  const centre = mean.map((v, axis) => axis == 2 ? v : lattice.places[axis][Math.min(Math.max(Math.round((v - lattice.places[axis][0]) / lattice.step), 0), lattice.shape[axis] - 1)]);
  const weights = [...Array(N).keys()].map(i => known.has(i) ? known_weight : 1);
  return {centre, weights, shift};
}
// One step of descent: the point of the search lattice at which this cost is lowest.
function descentStep(n, places, low, high) {
  const lattice = descentLattice, terms = descentTerms(places, high), total = new Float64Array(lattice.shape[0] * lattice.shape[1]);
  maps.modes.forEach((mode, index) => {
    if (mode < low || mode > high) return;
    lattice.map(index, n, places.flat(), at, terms).cost.forEach((v, i) => { total[i] += v; });
  });
  const best = total.reduce((b, v, i) => v < total[b] ? i : b, 0), nx = lattice.shape[0];
  return [lattice.places[0][best % nx], lattice.places[1][Math.floor(best / nx)], places[n][2]];
}
function takeSteps(count) {
  leaveRun();
  rolling = null; own.waiting = -1;
  const ends = chosen ?? [first[at], last[at]];
  for (let i = 0; i < count; i++) {
    selected = free[own.turn++ % free.length];
    own.places[selected] = descentStep(selected, own.places, ...ends);
  }
  Object.assign(own, {path: null, words: ""});
  show();
}

// Plays the opening: lower and lower modes are added to the map until one minimum is left, and the microphone rolls into it.
let opening = false;
async function playOpening() {
  const high = (chosen ?? [0, maps.modes.at(-1)])[1], pause = seconds => new Promise(resolve => setTimeout(resolve, 1e3 * seconds));
  const say = words => {
    const resized = Boolean($("words").textContent) != Boolean(words);  // a text takes space from the scene
    $("words").textContent = words;
    if (resized) show();
  };
  let places = null;  // the local minima of the first map
  opening = true; at = 0; returnToRun();
  for (let low = high, added = 1; opening; low = Math.max(low - added, 1), added = low > high - 4 ? 1 : 2 * added) {
    chosen = [low, high]; show();
    while (opening && (!map || map.key != wanted.key)) await pause(0.05);
    if (!opening) break;
    const count = high - low + 1, left = map.minima.count;
    places ??= map.minima.lowest;
    say(`${count == 1 ? "One frequency" : `${count} frequencies`}: ${left} place${left == 1 ? " fits" : "s fit"}`);
    await pause(left > 1 ? 3 : 0.5);
    if (opening && low == 1) {
      // The microphone rolls from that minimum of the first map whose path to the last minimum is the longest.
      const toLast = path => Math.hypot(...path.at(-1).map((v, i) => v - map.minima.lowest[0][i])) < 2 * map.lattice.step;
      const ways = places.map(place => downhill(map, place)).filter(toLast), start = ways.reduce((a, b) => b.length > a.length ? b : a, [map.minima.lowest[0]])[0];
      leaveRun(); own.places[map.n].splice(0, 2, ...start); release(map.n); await pause(1.5 + ROLL / 1e3);
      say("Your turn: drag the microphone away, and let it go");
      await pause(6);
      break;
    }
  }
  opening = false; say("");
}
for (const touch of ["pointerdown", "keydown", "wheel"]) addEventListener(touch, () => { opening = false; }, {capture: true});

function drawPlay(pen, project, r) {
  if (!own) return;
  const n = selected, z = own.places[n]?.[2] ?? z0;
  if (own.path) withHalo((c, width) => stroke(pen, own.path.map(([x, y]) => project([x, y, z + reliefHeight([x, y])])), c, width), RED, 1.6, 2.4);
  if (!own.words || n < 0) return;
  const [u, v] = project([...own.places[n].slice(0, 2), z + reliefHeight(own.places[n])]);
  pen.font = "700 20px system-ui, sans-serif"; pen.textAlign = "center"; pen.lineWidth = 5;
  pen.strokeStyle = css("--back"); pen.fillStyle = css("--ink");
  pen.strokeText(own.words, u, v - 2.2 * r - 8); pen.fillText(own.words, u, v - 2.2 * r - 8);
  pen.textAlign = "left";
}
function showPlay() {
  $("back").hidden = !own;
  $("steps").hidden = !descentLattice || !free.length;
  $("tries").textContent = own?.tries ? `${own.reached} of ${own.tries} drop${own.tries > 1 ? "s" : ""} reached the true position` : maps && free.length && !own ? "Drag a microphone, and let it go" : "";
}
