// A lesson: the text, question and explanation of each step beside the scene, and the settings of its parts. A part has
// only settings that differ from those of earlier parts; `range`: the states that it shows, which play if there are several.
const lesson = data.lesson, SECONDS = 6;  // about as long as a run plays
let stepAt = 0, answer = -1;  // numbers of the step and of the chosen answer, from 0; -1 before an answer is chosen
let veiled = false;  // whether the explanation waits for the end of the run
let part = {}, ellipsed = false;  // the present part; whether error ellipses are drawn
function unveil() { if (veiled && at >= range[1]) caption(); }

function enterStep(number, choice = -1) {
  const {steps} = lesson, parts = steps.slice(0, number).flatMap(one => one.parts).concat(steps[number].parts.slice(0, choice < 0 ? 1 : 2));
  const own = parts.at(-1), set = Object.assign({}, ...parts.filter(one => one.run == own.run)), count = own.range[1] - own.range[0];
  if (own.run != run) { visit(number, choice); return; }
  stepAt = number; answer = choice; part = own; ellipsed = set.ellipses ?? false;
  giveBack();
  [at, range] = [own.range[0], own.range];
  selected = set.microphone >= 0 ? set.microphone : oneMoves ? -1 : free[0] ?? 0; chosen = set.modes ?? null; objective = set.objective ?? false; marked = set.minima ?? true;
  $("map").checked = set.map ?? true; $("trails").checked = set.trails ?? false;
  caption();
  if ("view" in own || choice < 0) look((set.view ?? "top") == "top");
  $("speed").value = [...$("speed").options].map(option => option.value).find(rate => rate >= count / SECONDS) ?? 100;
  play(count > 0);
}
// Shows the run of another scene, for which the page is loaded again.
function visit(number, choice) {
  const hash = new URLSearchParams({part: choice < 0 ? number + 1 : `${number + 1},${choice + 1}`}), now = new URLSearchParams(addressNow().slice(1));
  for (const key of ["embed", "theme"]) if (now.has(key)) hash.set(key, now.get(key));
  clearTimeout(writing);
  try { history.replaceState(null, "", `#${hash}`); } catch { location.replace(`#${hash}`); }
  location.reload();
}
// At the end of a run: the microphones that the text names, with their errors, and the ellipses.
const namedNow = () => lesson && at >= range[1] && !own ? part.marks ?? [] : null;
function drawNamed(pen, on, now, r, w) {
  if (ellipsed && at == T - 1) data.ellipses?.axes.forEach(([a, b], n) => {
    const centre = placeOf(at, n), rim = Array.from({length: 37}, (_, i) => i * Math.PI / 18).map(turn => on(centre.map((v, axis) => v + Math.cos(turn) * a[axis] + Math.sin(turn) * b[axis])));
    stroke(pen, rim, marks.ellipse.colour, 1.8);
  });
  pen.font = "600 13px system-ui, sans-serif";
  for (const n of namedNow()) {
    ring(pen, now[n], marks.pointed.reach * r, marks.pointed.colour, Math.max(1.8, r * marks.pointed.width));
    const text = `microphone ${data.names[n]}${truth ? `: ${mm(distance(at, n))} off` : ""}`, left = now[n][0] > w - 240;
    pen.textAlign = left ? "right" : "left"; pen.lineWidth = 4; pen.strokeStyle = css("--back"); pen.fillStyle = css("--ink");
    for (const write of ["strokeText", "fillText"]) pen[write](text, now[n][0] + (left ? -1 : 1) * 3.2 * r, now[n][1] - 2 * r);
  }
  pen.textAlign = "left";
}
function caption() {
  veiled = false;
  const step = lesson.steps[stepAt], last = stepAt == lesson.steps.length - 1, box = document.createElement("div");
  const add = (tag, text, kind = "") => { const one = document.createElement(tag); one.textContent = text; one.className = kind; box.append(one); return one; };
  const button = (parent, text, act, kind) => { const one = document.createElement("button"); one.textContent = text; one.className = kind ?? ""; one.onclick = act; parent.append(one); };
  const panel = () => { if (part.panel) add("div", "").innerHTML = part.panel; };
  add("div", `Step ${stepAt + 1} of ${lesson.steps.length}`, "dim");
  if (answer < 0) for (const text of step.text) add("p", text);
  if (step.question) add("b", step.question);
  if (step.question && answer < 0) {
    const choices = add("div", "", "choices");
    step.choices.forEach((text, i) => button(choices, text, () => enterStep(stepAt, i)));
    panel();
  } else if (veiled = step.question && at < range[1]) {
    add("div", `Your answer: ${step.choices[answer]}`);
    add("p", "The explanation follows when the run has ended.", "dim");
  } else if (step.question) {
    step.choices.forEach((text, i) => { if (i == answer || i == step.answer) add("div", `${i == step.answer ? "✓" : "✗"} ${text}`); });
    add("b", answer == step.answer ? "Right." : "Not quite.");
    for (const text of step.reveal) add("p", text);
    panel();
    add("p", `Try it: drag a microphone and let it go${descentLattice && free.length > 1 ? ", or take steps of descent" : ""}.`, "dim");
  }
  const moves = add("div", "", "moves");
  if (stepAt) button(moves, "Back", () => enterStep(stepAt - 1));
  if (answer >= 0 || !step.question) {
    if (!last) button(moves, "Next step", () => enterStep(stepAt + 1), "first");
    else if (lesson.following) button(moves, "Next lesson", () => { location.href = lesson.following; }, "first");
  } else if (!last) button(moves, "Skip", () => enterStep(stepAt + 1));
  if (answer >= 0) button(moves, "Again", () => enterStep(stepAt));
  $("caption").replaceChildren(box);
  $("caption").scrollTop = 0;
}
