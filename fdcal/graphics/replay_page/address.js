// The part of the address after # says what is shown, for example #step=12&microphone=9&modes=1-20&view=top, so that a link
// leads to a state. Keys and values are those of fdcal/model/address.py, whose table is data.address; `part` is the step
// of a lesson.
let writeTimer = 0, themed = false;  // whether the address or the user has chosen the theme

function readAddress(hash) {
  const asked = new URLSearchParams(hash.slice(1) || data.opens_at), refused = [];
  const possible = (key, text) => key in data.address && new RegExp(`^(?:${data.address[key]})$`).test(text);
  const read = (key, use) => {
    const text = asked.get(key);
    asked.delete(key);
    if (text != null && (!possible(key, text) || use(text) === false)) refused.push(`${key}=${text.slice(0, 40)}`);
  };
  if (runOf(hash) != run) { location.reload(); return; }
  let entered = false;
  read("part", text => {
    const [one, choice = 0] = text.split(",").map(Number), found = lesson?.steps[one - 1];
    if (!found || choice && !found.choices[choice - 1]) return false;
    enterStep(one - 1, choice - 1); entered = true;
  });
  if (lesson && !entered) enterStep(0);
  for (const [key, values, first] of [["step", step, 0], ["sweep", sweep, 0], ["stage", stage, 1]]) read(key, text => {
    playing = false;
    at = nearestState(values, Number(text) - first);
  });
  read("microphone", text => {
    if (Number(text) >= N) return false;
    selected = text == "none" ? -1 : Number(text);
  });
  read("modes", text => {
    const [, low, high] = /^(\d+)(?:-(\d+))?$/.exec(text) ?? [], ends = [Number(low), Number(high ?? low)];
    if (text == "solver") { chosen = null; return; }
    if (!maps || !low || ends[0] > ends[1] || !maps.modes.some(mode => ends[0] <= mode && mode <= ends[1])) return false;
    chosen = ends;
  });
  read("view", text => {
    const angles = text.split(",").map(v => Number(v) * Math.PI / 180);
    if (angles.length == 1) setView(text == "top");
    else if (angles.length == 2 && angles[1] > 0 && angles[1] <= Math.PI / 2) setView(false, ...angles);
    else return false;
  });
  read("zoom", text => {
    const [zoom, x, y] = text.split(",").map(Number);
    if (zoom < 0.1 || zoom > 40) return false;
    Object.assign(eye, {zoom, x, y});
  });
  read("map", text => {
    if (!["flat", "relief", "none"].includes(text)) return false;
    $("map").checked = text != "none";  // flat from the top, in relief from the side
  });
  read("trails", text => { $("trails").checked = text == "on"; });
  read("embed", () => document.documentElement.classList.add("embedded"));
  read("theme", text => { themed = true; document.documentElement.dataset.theme = text; });
  read("opening", () => true);
  for (const [key, text] of asked) refused.push(`${key}=${text.slice(0, 40)}`);
  $("note").textContent = refused.length ? `Not in this replay: ${refused.join(", ")}` : "";
}

// The first of the states in `range` whose value is nearest to the wanted one.
function nearestState(values, wanted) {
  return values.reduce((best, value, t) => t <= range[1] && t > range[0] && Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? t : best, range[0]);
}

function addressNow() {
  const degrees = angle => Math.round(angle * 180 / Math.PI), turned = eye.azimuth == TURNED && eye.elevation == RAISED;
  const parts = {part: lesson && (answer < 0 ? stepAt + 1 : `${stepAt + 1},${answer + 1}`), step: step[at], microphone: selected >= 0 && selected, modes: chosen && [...new Set(chosen)].join("-")};
  parts.view = flat ? "top" : turned ? "3d" : `${degrees(eye.azimuth)},${Math.max(degrees(eye.elevation), 1)}`;
  if (eye.zoom != 1 || eye.x || eye.y) parts.zoom = [eye.zoom, eye.x, eye.y].map(v => Number(v.toPrecision(4))).join();
  if (maps && !$("map").checked) parts.map = "none";
  if ($("trails").checked) parts.trails = "on";
  if (document.documentElement.classList.contains("embedded")) parts.embed = "on";
  if (themed) parts.theme = document.documentElement.dataset.theme;
  return "#" + Object.entries(parts).filter(([, value]) => value || value === 0).map(pair => pair.join("=")).join("&");
}

// Writes the address when nothing has changed for 0.25 s, because browsers limit how often it may change.
function writeAddress() {
  clearTimeout(writeTimer);
  if (playing || location.protocol == "about:") return;  // a page inside a notebook has no address of its own
  writeTimer = setTimeout(() => {
    if (addressNow() == location.hash) return;
    try { history.replaceState(null, "", addressNow()); } catch { location.replace(addressNow()); }
  }, 250);
}
// The event contains the new address; `writeAddress` may already have replaced `location.hash` by the previous one.
window.addEventListener("hashchange", event => { clearTimeout(writeTimer); playing = false; readAddress(new URL(event.newURL).hash); setTheme(document.documentElement.dataset.theme == "dark"); });
