// What is shown, in the address after #, as in #step=12&microphone=9&modes=1-20&view=top: a link leads to a moment.
//
//   lesson      step of the lesson, from 1, and the answer given, as 2 or 2,1
//   step        the state of this step, or the nearest one that the file holds
//   microphone  name or number of the selected microphone, or "none"
//   modes       of the map, 1-20, or one of them, or "solver"
//   view        top, 3d, or azimuth,elevation in degrees
//   zoom        factor, and by how many metres the picture is moved to the right and up
//   embed       on: without curves and table, for a frame in another page
//   map, trails on or off; theme light or dark; opening on: modes are added one after the other, from `modes` down
let writing = 0, themed = false;

function readAddress(hash) {
  const asked = new URLSearchParams(hash.slice(1) || data.opens_at), refused = [];
  const read = (key, use) => { if (asked.has(key) && use(asked.get(key)) === false) refused.push(`${key}=${asked.get(key).slice(0, 40)}`); };
  const number = text => /^-?\d+(\.\d+)?$/.test(text) ? Number(text) : NaN, onOff = id => text => {
    if (text != "on" && text != "off") return false;
    $(id).checked = text == "on";
  };
  if (lesson) enterStep(0);
  read("lesson", text => {
    const [one, choice = 0] = text.split(",").map(number), found = lesson?.steps[one - 1];
    if (!found || choice && !found.choices[choice - 1]) return false;
    enterStep(one - 1, choice - 1);
  });
  if (asked.has("step")) playing = false;
  read("step", text => {
    const value = number(text);
    if (!Number.isFinite(value)) return false;
    at = nearestState(step, value);
  });
  read("microphone", text => {
    const n = data.names.includes(text) ? data.names.indexOf(text) : text == "none" ? -1 : number(text);
    if (!Number.isInteger(n) || n < -1 || n >= N) return false;
    selected = n;
  });
  read("modes", text => {
    const [, low, high] = /^(\d+)(?:-(\d+))?$/.exec(text) ?? [], ends = [Number(low), Number(high ?? low)];
    if (text == "solver") { chosen = null; return; }
    if (!maps || !low || ends[0] > ends[1] || !maps.modes.some(mode => ends[0] <= mode && mode <= ends[1])) return false;
    chosen = ends;
  });
  read("view", text => {
    const [azimuth, elevation] = text.split(",").map(v => number(v) * Math.PI / 180);
    if (text == "top" || text == "3d") look(text == "top");
    else if (Number.isFinite(azimuth) && elevation > 0 && elevation <= Math.PI / 2) look(false, azimuth, elevation);
    else return false;
  });
  read("zoom", text => {
    const [zoom, x, y] = text.split(",").map(number);
    if (!(zoom >= 0.1 && zoom <= 40 && Number.isFinite(x) && Number.isFinite(y))) return false;
    Object.assign(eye, {zoom, x, y});
  });
  read("map", onOff("map"));
  read("trails", onOff("trails"));
  read("opening", text => text == "on");
  read("embed", text => { if (text != "on") return false; document.documentElement.classList.add("embedded"); });
  read("theme", text => {
    if (text != "dark" && text != "light") return false;
    themed = true; document.documentElement.dataset.theme = text;
  });
  $("note").textContent = refused.length ? `Not in this replay: ${refused.join(", ")}` : "";
}

// The first state of those shown whose value is nearest to the one wanted.
function nearestState(values, wanted) {
  return values.reduce((best, value, t) => t <= range[1] && t > range[0] && Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? t : best, range[0]);
}

function addressNow() {
  const degrees = angle => Math.round(angle * 180 / Math.PI), turned = eye.azimuth == TURNED && eye.elevation == RAISED;
  const parts = {lesson: lesson && (answer < 0 ? stepAt + 1 : `${stepAt + 1},${answer + 1}`), step: step[at], microphone: selected >= 0 && encodeURIComponent(data.names[selected]), modes: chosen && [...new Set(chosen)].join("-")};
  parts.view = flat ? "top" : turned ? "3d" : `${degrees(eye.azimuth)},${Math.max(degrees(eye.elevation), 1)}`;
  if (eye.zoom != 1 || eye.x || eye.y) parts.zoom = [eye.zoom, eye.x, eye.y].map(v => Number(v.toPrecision(4))).join();
  if (maps && !$("map").checked) parts.map = "off";
  if ($("trails").checked) parts.trails = "on";
  if (document.documentElement.classList.contains("embedded")) parts.embed = "on";
  if (themed) parts.theme = document.documentElement.dataset.theme;
  return "#" + Object.entries(parts).filter(([, value]) => value || value === 0).map(pair => pair.join("=")).join("&");
}

// Written once nothing has changed for a moment: browsers bound how often an address may change.
function writeAddress() {
  clearTimeout(writing);
  if (playing || location.protocol == "about:") return;  // inline in a notebook there is no address of its own
  writing = setTimeout(() => {
    if (addressNow() == location.hash) return;
    try { history.replaceState(null, "", addressNow()); } catch { location.replace(addressNow()); }
  }, 250);
}
// `writeAddress` may already have replaced `location.hash` by the previous address.
window.addEventListener("hashchange", event => { clearTimeout(writing); playing = false; readAddress(new URL(event.newURL).hash); theme(document.documentElement.dataset.theme == "dark"); });
