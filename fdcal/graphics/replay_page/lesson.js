// Shows a lesson: text, question and explanation of each step beside the scene, and the scene with the settings of a part. A
// step has one part before the answer and perhaps another one after it. A part has only the settings that differ from
// those of earlier parts; `range`: the first and the last state that it shows, between which the run plays.
const lesson = data.lesson, SECONDS = 6;  // about the time for which a run plays
let stepAt = 0, answer = -1;  // indices of the step and of the chosen answer, which is -1 before the answer
let awaitsEnd = false;  // whether the explanation is shown only when the run has ended
let part = {}, showsEllipses = false;  // the present part; whether error ellipses are drawn
function explainAtEnd() { if (awaitsEnd && at >= range[1]) showCaption(); }

function enterStep(number, choice = -1) {
  const {steps} = lesson, parts = steps.slice(0, number).flatMap(one => one.parts).concat(steps[number].parts.slice(0, choice < 0 ? 1 : 2));
  const entered = parts.at(-1), set = Object.assign({}, ...parts.filter(one => one.run == entered.run)), count = entered.range[1] - entered.range[0];
  if (entered.run != run) { loadRun(number, choice); return; }
  stepAt = number; answer = choice; part = entered; showsEllipses = set.ellipses ?? false;
  returnToRun();
  [at, range] = [entered.range[0], entered.range];
  selected = set.microphone >= 0 ? set.microphone : oneMoves ? -1 : free[0] ?? 0; chosen = set.modes ?? null; objective = Boolean(set.objective && maps?.descent); marked = set.minima ?? true;
  $("map").checked = set.map ?? true; $("trails").checked = set.trails ?? false;
  showCaption();
  if ("view" in entered || choice < 0) setView((set.view ?? "top") == "top");
  $("speed").value = [...$("speed").options].map(option => option.value).find(rate => rate >= count / SECONDS) ?? 100;
  play(count > 0);
}
// Shows the run of another scene; for this the page is loaded again.
function loadRun(number, choice) {
  const hash = new URLSearchParams({part: choice < 0 ? number + 1 : `${number + 1},${choice + 1}`}), now = new URLSearchParams(addressNow().slice(1));
  for (const key of ["embed", "theme"]) if (now.has(key)) hash.set(key, now.get(key));
  clearTimeout(writeTimer);
  try { history.replaceState(null, "", `#${hash}`); } catch { location.replace(`#${hash}`); }
  location.reload();
}
// The microphones that the text names, at the end of the run; null otherwise.
const namedNow = () => lesson && at >= range[1] && !own ? part.marks ?? [] : null;
// Draws the microphones of `namedNow` with their errors, and the ellipses.
function drawNamed(pen, on, now, r, w) {
  if (showsEllipses && at == T - 1) data.ellipses?.axes.forEach(([a, b], n) => {
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
function showCaption() {
  awaitsEnd = false;
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
  } else if (step.question && at < range[1]) {
    awaitsEnd = true;
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
