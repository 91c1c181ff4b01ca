// Wires the page: one connection, and what it brings to scene, plots, law, map and log.
import { Laws } from "./laws.js";
import { Link } from "./link.js";
import { Log } from "./log.js";
import { StabilityMap } from "./map.js";
import { Plots } from "./plots.js";
import { Replay } from "./replay.js";
import { Scene } from "./scene.js";
import { Status } from "./status.js";
import { Store } from "./store.js";
import { startTheme } from "./theme.js";

const $ = (id) => document.getElementById(id);
startTheme($("theme"));

let store = null;
let hello = null;
const log = new Log($("log"));
const status = new Status({ words: $("words"), dot: $("dot"), figures: $("figures"), nodes: $("nodes"), notice: $("notice") });
const scene = new Scene($("scene"), $("reading"), (target) => link.hand(target));
const plots = new Plots($("plots"), $("legend"), (live) => {
  $("live").hidden = live;
  $("pause").setAttribute("aria-pressed", !live);
  $("pause").textContent = live ? "Pause" : "Paused";
});
const map = new StabilityMap($("map"), $("margin"), $("far"));
const laws = new Laws({ picker: $("laws"), sliders: $("sliders"), ramp: $("ramp"), undo: $("undo"), refusal: $("refusal") }, ask);

function refused(text) { log.refused(text, store?.end ?? 0); }

async function ask(request) {
  const answer = await link.ask(request);
  if (!answer.ok) refused(answer.error);
  return answer;
}

const link = new Link({
  open() { status.connected(true); },
  close() { status.connected(false); scene.letGo(); },
  hello(found) {
    // The same run again, or the view started anew: what was logged comes again too.
    log.clear();
    plots.marks.length = 0;
    hello = found;
    store = new Store(found.series, found.bin_s, found.kept_s + 30);
    document.title = found.scenario;
    $("scenario").textContent = found.scenario;
    $("scenario").title = `${found.summary} (${found.run})`;
    scene.start(found.axes, found.hand);
    plots.start(store, found.axes, found.hand || found.has_hand);
    laws.start(found.fields, found.replay);
    $("hint").textContent = found.hand ? "Drag anywhere here: the hand follows." : "";
    $("record").hidden = $("stop").hidden = found.replay;
    $("replay").hidden = !found.replay;
    replay.start(found);
  },
  reset() { log.clear(); plots.marks.length = 0; },
  frame(frame) {
    if (!store) return;
    store.add(frame);
    scene.show(frame.now);
    replay.at(frame.now.t);
    document.body.dataset.bins = store.head;
  },
  status(found) {
    status.show(found);
    if (found.ended && !hello?.replay) { link.over = true; scene.draggable = false; scene.letGo(); $("hint").textContent = ""; $("record").hidden = $("stop").hidden = true; }
  },
  laws(found) { laws.show(found); },
  map(found) { map.show(found); if (found.k_max_n_per_m) { laws.edge = found.k_max_n_per_m; laws.fill(); } },
  log(entry) {
    log.add(entry);
    if (entry.kind === "receipt") plots.mark(entry.t, entry.switched ? entry.law : "");
  },
  record(found) {
    $("record").setAttribute("aria-pressed", found.recording);
    $("record").textContent = found.recording ? "Recording" : "Record";
    if (found.path) log.add({ kind: "event", t: store?.end ?? 0, node: "view", event: "recording", text: `${found.recording ? "recording to" : "recorded"} ${found.path}` });
  },
  answer(found) { if (!found.ok) refused(found.error); },
});
const replay = new Replay({ play: $("play"), seek: $("seek"), clock: $("clock"), speed: $("speed") }, ask);

// -- buttons and keys ---------------------------------------------------------------------------------------------

$("magnify").addEventListener("change", (event) => { scene.magnify = Number(event.target.value); scene.fit(true); });
$("span").addEventListener("change", (event) => { plots.span = Number(event.target.value); plots.follow(); });
$("pause").addEventListener("click", () => plots.window ? plots.follow() : plots.pause());
$("live").addEventListener("click", () => plots.follow());
$("record").addEventListener("click", () => ask({ op: "record", on: $("record").getAttribute("aria-pressed") !== "true" }));
$("stop").addEventListener("click", () => {
  if (!$("stop").classList.contains("sure")) {
    $("stop").classList.add("sure");
    $("stop").textContent = "End the run?";
    setTimeout(() => { $("stop").classList.remove("sure"); $("stop").textContent = "Stop"; }, 3000);
    return;
  }
  ask({ op: "stop" });
});
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, button, canvas") || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = {
    " ": () => plots.window ? plots.follow() : plots.pause(), "+": () => plots.zoom(0.5), "-": () => plots.zoom(2),
    ArrowLeft: () => plots.shift(-0.25), ArrowRight: () => plots.shift(0.25), Home: () => plots.follow(),
  };
  if (event.key in keys) { event.preventDefault(); keys[event.key](); }
});

// -- drawing ------------------------------------------------------------------------------------------------------

let plotted = 0, read = 0;
function draw(time) {
  scene.draw();
  // Half as often as the scene: nobody reads a plot faster.
  if (time - plotted > 30) { plots.draw(); plotted = time; }
  if (time - read > 120) { scene.read(); read = time; }
  requestAnimationFrame(draw);
}
requestAnimationFrame(draw);
setInterval(() => scene.tell(), 100);
