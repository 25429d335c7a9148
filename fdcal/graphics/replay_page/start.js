// Connects the controls, and draws the first picture.
$("title").textContent = data.title;
if (data.reference != "true") $("errorbox").firstElementChild.firstChild.data = "Deviation from nominal (mm): ";
$("costbox").hidden = !cost;
$("errorbox").hidden = !mean;
$("caption").hidden = !lesson;
$("restarted").hidden = !restarts(0, T - 1).length;
document.documentElement.classList.toggle("lesson", Boolean(lesson));
for (const rate of [2, 5, 10, 20, 50, 100]) $("speed").add(new Option(`${rate} states/s`, rate, rate == 20, rate == 20));
const shown = {[data.reference]: "true", "this microphone": "ball", estimate: "estimate", known: "known", ...(maps && {"minimum of the map (large: lowest)": "lowest"}),
  ...(data.ellipses && {[data.ellipses.text]: "ellipse"}), ...(lesson?.steps.some(one => one.parts.some(({marks}) => marks)) && {"named in the text": "pointed"})};
$("legend").innerHTML = Object.entries(shown).map(([name, mark]) => `<span class="key"><svg width="18" height="18">${data.marks[mark].symbol}</svg> ${name}</span>`).join("") +
  (T < data.taken ? `<span class="key dim">showing ${T} of ${data.taken} states</span>` : "");
$("play").onclick = () => play(!playing);
$("time").oninput = e => { playing = false; go(Number(e.target.value)); };
$("top").onclick = () => setView(true);
$("turn").onclick = () => setView(false);
$("reset").onclick = () => setView(flat);
$("trails").onchange = show;
$("descend").onclick = () => takeSteps(1);
$("sweepall").onclick = () => takeSteps(free.length);
$("back").onclick = () => { returnToRun(); show(); };
if (maps) mapControls(); else $("mapbar").hidden = true;
$("theme").onclick = () => { themed = true; setTheme(document.documentElement.dataset.theme != "dark"); };
document.addEventListener("keydown", e => {
  if (e.ctrlKey || e.altKey || e.metaKey || e.target.tagName == "SELECT") return;
  const onSlider = e.target.type == "range", keys = {" ": () => play(!playing), t: () => setView(true), "3": () => setView(false),
    Home: () => go(range[0]), End: () => go(range[1]), ArrowLeft: () => go(at - 1), ArrowRight: () => go(at + 1)};
  if (e.key == " " && (e.target.tagName == "BUTTON" || e.target.type == "checkbox") || onSlider && /^(Arrow|Home|End)/.test(e.key) || !keys[e.key]) return;
  e.preventDefault(); if (e.key != " ") playing = false; keys[e.key]();
});
readAddress(location.hash);
setTheme(document.documentElement.dataset.theme ? document.documentElement.dataset.theme == "dark" : window.matchMedia("(prefers-color-scheme: dark)").matches);
new ResizeObserver(show).observe($("scene"));
if (maps && new URLSearchParams(location.hash.slice(1)).get("opening") == "on") playOpening();
