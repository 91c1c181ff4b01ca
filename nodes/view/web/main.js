// Connects the page's parts: one connection feeds dial, scene, force, plots, law, map and log.
import { Beside } from "./beside.js";
import { Delay } from "./delay.js";
import { Dial } from "./dial.js";
import { Drop } from "./drop.js";
import { follow } from "./follow.js";
import { Lag } from "./lag.js";
import { Laws } from "./laws.js";
import { Link } from "./link.js";
import { linkOf, readState } from "./link_state.js";
import { Log } from "./log.js";
import { StabilityMap } from "./map.js";
import { Over } from "./over.js";
import { StaticPage } from "./static_page.js";
import { Plots } from "./plots.js";
import { Replay } from "./replay.js";
import { Scene } from "./scene.js";
import { Section } from "./section.js";
import { Sing } from "./sing.js";
import { SlowMotion } from "./slow_motion.js";
import { Sound } from "./sound.js";
import { Space } from "./space.js";
import { Status } from "./status.js";
import { Still } from "./still.js";
import { Store } from "./store.js";
import { Strip } from "./strip.js";
import { onTheme, startTheme } from "./theme.js";
import { Tour } from "./tour.js";
import { Whole } from "./whole.js";

const $ = (id) => document.getElementById(id);
startTheme($("theme"));

let store = null;
let hello = null;
let stoppedAt = null;
let charted = null;
const log = new Log($("log"));
const status = new Status({ words: $("words"), told: $("told"), dot: $("dot"), figures: $("figures"), nodes: $("nodes"), notice: $("notice"), over: $("over"), overTold: $("over-told"), again: $("start-again") });
const lag = new Lag();
const still = new Still();

let edges = null; // edge and H(1) of each law, as far as known
function moved(target) {
  sing.leave(target !== null);
  $("hint").textContent = "";
  lag.leave(target);
  link.hand(target);
}

const scene = new Scene($("scene"), $("lens"), $("reading"), moved);
const space = new Space($("space"), moved, document.querySelectorAll("#drag button"));
const section = new Section($("section"), $("plane"), (letters) => { strip.look(letters); overview.look(letters[0]); beside.look("xyz".indexOf(letters[0])); plots.start(store, letters, hello.hand || hello.has_hand); });
const strip = new Strip($("strip"));
const slow = new SlowMotion();
const plots = new Plots($("plots"), $("legend"), $("values"), (live) => {
  $("live").hidden = live;
  $("pause").setAttribute("aria-pressed", !live);
  $("pause").textContent = live ? "Pause" : "Paused";
}, (t) => { if (hello?.replay) replay.go(t); });
const map = new StabilityMap($("map"), $("margin"), $("far"), (wanted, beyond) => {
  for (const [name, value] of Object.entries(wanted)) laws.change(name, Number(value.toPrecision(3)), beyond);
});
const laws = new Laws({ picker: $("laws"), sliders: $("sliders"), ramp: $("ramp"), undo: $("undo"), refusal: $("refusal") }, ask);
const dial = new Dial({ dial: $("dial"), hardness: $("hardness"), edge: $("edge"), beyond: $("beyond"), allowed: $("beyond-switch") },
  (stiffness, beyond) => laws.change(stiffnessField(), stiffness, beyond));
const delay = new Delay({ row: $("delay-row"), slider: $("delay"), told: $("delay-told"), beyond: $("beyond") },
  (ticks, beyond) => laws.change("delay", ticks, beyond));

const beside = scene.beside = space.beside = new Beside({ other: $("other"), told: $("b-told") }, ask);
let overlaid = null;
let rings = false; // whether the present force rings
let asked = false; // whether this page requested a recording
plots.over = () => overlaid ?? (beside.on ? beside : null);
const sound = new Sound($("sound"));
const overview = new Whole($("whole"));
overview.marks = plots.marks;

// A law without a nominal stiffness is scaled as a whole: H(1) is the dial.
function stiffnessField(law = laws.state.active) { return laws.state.laws[law]?.stiffness === undefined ? "hardness" : "stiffness"; }

function refused(text) { log.refused(text, scene.now?.t ?? 0); }

async function ask(request) {
  const answer = await link.ask(request);
  if (!answer.ok) refused(answer.error);
  return answer;
}

const link = new Link({
  open() { status.connected(true); },
  close() { status.connected(false); scene.letGo(); space.letGo(); },
  hello(found) {
    // The view restarted: it sends the log again.
    log.clear();
    plots.marks.length = 0;
    hello = found;
    told = false;
    offer(laws.state !== null);
    status.begun();
    // The old ring gets no more data; the state is sent again.
    if (!slow.run?.begun) { stoppedAt = null; slow.end(); }
    store = new Store(found.series, found.bin_s, found.kept_s + 30);
    document.title = found.scenario;
    $("scenario").textContent = found.scenario;
    $("scenario").title = `${found.summary} (${found.run})`;
    scene.start(found);
    strip.start(store, found);
    space.start(found);
    section.start(space.solids, found.axes);
    lookAt(space.shape ? "3-D" : found.axes[0]);
    plots.replayed = strip.replayed = status.replay = found.replay;
    showRun(found);
    laws.start(found.fields, found.replay);
    dial.start(found);
    delay.start(found);
    map.delays = found.delays;
    edges = null;
    map.beyond = () => found.beyond && $("beyond").checked;
    beside.start(found);
    sound.start(store, found.axes);
    if (!found.hand) $("hint").textContent = "";
    $("record").hidden = found.replay || found.records === false;
    $("stop").hidden = found.replay || found.ends === false;
    status.measures = found.measures !== false;
    page.start(found);
    sing.start(found);
    // What cannot act on a recording is not there.
    $("tour-begin").hidden = document.querySelector(".question").hidden = $("ramp").closest(".row").hidden = found.replay;
    $("replay").hidden = !found.replay;
    replay.start(found);
    if (found.replay && wanted) goToLink();
    if (found.notice) status.tell(found.notice);
    if (document.hidden) seen();
    document.body.dataset.ready = found.run;
  },
  reset() { log.clear(); plots.marks.length = 0; plots.dirty = true; },
  frame(frame) {
    if (!store) return;
    store.add(frame);
    if (!still.is(frame, hello.axes.length)) changedAt = performance.now();
    lag.arrive(frame, scene.axis, store.index(`target.${"xyz"[scene.axis]}`));
    sound.hear(hello.replay ? frame.now.t : Infinity);
    if (!slow.on) { scene.show(frame.now); space.show(frame.now); }
    replay.at(frame.now.t);
    plots.at = hello.replay ? frame.now.t : null;
    document.body.dataset.bins = store.head;
  },
  status(found) {
    status.show(found);
    rings = Boolean(found.rings);
    sing.status(found, laws.state?.active, dial.stiffness, beside.law);
    if (lag.median !== null) status.row("hand → picture", `${Math.round(lag.median)} ms`);
    if (lag.force !== null && status.measures) status.row("hand → force", `${Math.round(lag.force)} ms`);
    const stopped = found.safety === "stopped";
    map.stop(stopped);
    if (stopped && found.stop && stoppedAt !== found.stop.t && !hello?.replay) watchSlowly(found.stop);
    else if (!stopped && stoppedAt !== null) goOn();
    $("once-more").hidden = !slow.on;
    $("again").hidden = !stopped || !hello?.again;
    if (found.ended && !hello?.replay) { offer(false); scene.draggable = space.ready = false; scene.letGo(); space.letGo(); $("hint").textContent = ""; $("record").hidden = $("stop").hidden = $("again").hidden = true; }
  },
  laws(found) {
    // What changes the loop can act from the first laws on.
    if (laws.state === null) offer(true);
    laws.show(found);
    beside.laws(Object.keys(found.laws).filter((name) => found.laws[name].kind !== "excitation"));
    chart();
    if (!hello?.replay) open();
  },
  ended(found) { status.end(found); },
  // Bodies move while the hand rests, too.
  poses({ poses }) { if (space.pose(poses)) changedAt = performance.now(); },
  // The surface was replaced while the run goes on.
  shape({ shape }) {
    space.reshape(shape);
    section.solids = space.solids;
    changedAt = performance.now();
  },
  beside(found) { beside.show(found); if (found.law) changedAt = performance.now(); },
  over(found) {
    overlaid = overview.over = new Over(found);
    plots.name();
    plots.dirty = true;
    overview.draw();
  },
  whole(frame) {
    plots.whole = new Store(store.names, 1, frame.count);
    plots.whole.add({ ...frame, void: 0 });
    plots.dirty = true;
    overview.start(plots.whole, replay.begin, replay.end);
  },
  map(found) { charted = found; chart(); },
  edges(found) { edges = found; for (const hear of waiting) hear(found); chart(); },
  log(entry) {
    log.add(entry);
    if (entry.kind === "receipt") plots.mark(entry.t, entry.switched ? entry.law : "");
  },
  record(found) {
    // Also for pages opened later: the button shows the state.
    const knew = asked || $("record").getAttribute("aria-pressed") === "true";
    asked = false;
    $("record").setAttribute("aria-pressed", found.recording);
    $("record").textContent = found.recording ? "Recording" : found.error ? "Not recorded" : "Record";
    $("record").title = found.error;
    if (found.error && knew) { laws.refuse(found); refused(found.error); }
    else if (found.path) log.add({ kind: "event", t: store?.end ?? 0, node: "view", event: "recording", text: `${found.recording ? "recording to" : "recorded"} ${found.path}` });
  },
  answer(found) {
    if (found.ok) return;
    // After one refusal, stop asking for the hand.
    if (found.op === "hand") { scene.letGo(); space.letGo(); $("hint").textContent = "Another page holds the hand."; }
    refused(found.error);
  },
});
// Edges at a delay of the device: known, or with the next document that is of it.
const waiting = new Set();
const EDGES_WAIT = 20e3; // [ms]: a machine that computes them beside much else takes so long
function edgesAt(delay) {
  if (edges?.device_delay === delay) return Promise.resolve(edges.edges);
  return new Promise((done, fail) => {
    const hear = (found) => {
      if (found.device_delay !== delay) return;
      clearTimeout(late);
      waiting.delete(hear);
      done(found.edges);
    };
    const late = setTimeout(() => {
      waiting.delete(hear);
      fail(new Error(`The edges at this delay did not come within ${EDGES_WAIT / 1e3} s.`));
    }, EDGES_WAIT);
    waiting.add(hear);
  });
}

const sing = new Sing({ button: $("sing"), told: $("sung"), beyond: $("beyond") }, {
  ask,
  state: () => laws.state,
  stopped: () => stoppedAt !== null,
  soft,
  compared: () => beside.on,
  surface: () => scene.surface,
  hand: (target) => link.hand(target === null ? null : [0, 1, 2].map((k) => (k === scene.axis ? target : 0))),
  edgesAt,
});
const page = new StaticPage({ banner: $("banner"), python: $("python"), restart: $("restart"), scenarios: $("scenarios"), title: $("scenario") }, ask);
const drop = new Drop({ input: $("file"), button: $("open") }, link, (text) => status.tell(text));
const replay = new Replay({ play: $("play"), seek: $("seek"), clock: $("clock"), speed: $("speed") }, ask);

// What a recording has in place of a loop.
function showRun(found) {
  document.body.classList.toggle("replay", found.replay);
  $("live").textContent = found.replay ? "Back to its time" : "Back to live";
  overlaid = overview.over = null;
  plots.whole = overview.store = null;
  plots.run = found.replay ? [found.begin_s, found.end_s] : null;
  const all = $("span").querySelector("[value=whole]");
  all.hidden = !found.replay;
  // All of a recording at first; a launch has no end yet.
  if (found.replay !== (plots.span === Infinity)) $("span").value = found.replay ? "whole" : "10";
  plots.span = spanOf($("span").value);
  drop.start(found);
}

function spanOf(text) { return text === "whole" ? Infinity : Number(text); }

// One axis or 3D, at the same moment.
function lookAt(view) {
  const whole = view === "3-D";
  $("axis").value = view;
  $("space").hidden = !whole;
  $("scene").hidden = whole;
  if (whole) scene.letGo(); else space.letGo();
  if (hello.hand) $("hint").textContent = whole ? "Drag the handle (V, G, S: along view, ground or surface); anywhere else turns the view; the wheel goes nearer, or pushes what is held." : "Pull the handle, or drag anywhere here.";
  $("lens").hidden = whole || !scene.surface;
  $("section").hidden = !whole || !section.plane;
  $("plane").parentElement.hidden = $("section").hidden;
  space.section = $("section").hidden ? null : section;
  scene.look(whole ? hello.axes[0] : view, hello.hand && (whole || view === hello.axes[0]));
  // With three axes, plots show the two of the section; with one, that one.
  const letters = space.section ? [...section.plane] : [whole ? hello.axes[0] : view];
  strip.look(letters);
  overview.look(letters[0]);
  beside.look("xyz".indexOf(letters[0]));
  plots.start(store, whole && !space.section ? hello.axes : letters, hello.hand || hello.has_hand);
}

$("axis").addEventListener("change", () => lookAt($("axis").value));

// A limit is valid for its law only; until the law's own map arrives there is none.
function chart() {
  const fits = charted !== null && charted.law === laws.state?.active;
  if (!fits) map.forget();
  else if (map.map !== charted) map.show(charted);
  laws.edge = (edges ? edges.edges[laws.state?.active] : fits ? charted.k_max_n_per_m : null) ?? null;
  laws.fill();
  turn();
}

function turn() {
  const law = laws.state?.laws[laws.state.active];
  dial.show(law?.stiffness ?? edges?.rest[laws.state?.active] ?? null, laws.edge, edges !== null || map.map !== null,
    JSON.stringify([laws.state?.active, { ...law, stiffness: 0 }, laws.state?.device_delay]));
  if (delay.offered && laws.state) delay.show(laws.state.device_delay, map.delayEdge());
}

// -- link state and tour --------------------------------------------------------------------------

let wanted = readState();
$("lab").open = wanted.lab;

// A link pasted into a page that is already open.
addEventListener("hashchange", () => {
  const scenario = new URLSearchParams(location.hash.slice(1)).get("scenario");
  if (scenario && page.scenario && scenario !== page.scenario) location.reload();
  wanted = readState();
  if (hello?.replay) goToLink();
  else if (laws.state) open();
});

// The moment of a recording that the link names.
function goToLink() {
  if (wanted.time !== null) replay.stay(wanted.time);
  if (wanted.wrong.length) laws.refuse({ error: wanted.wrong.join(" ") });
  wanted = null;
}

// Follow the link, once the laws are known; one link after the other.
let following = Promise.resolve();
function open() {
  const asked = wanted;
  wanted = null;
  if (!asked) return;
  following = following.then(async () => {
    const { forced, missed } = await follow(asked, {
      hello, scenarios: page.names, state: () => laws.state, ask: (request) => link.ask(request), field: stiffnessField, compare: (law) => beside.choose(law),
      // A page without a server begins anew: its session is the link's from tick 0.
      begin: page.names.length ? () => ask({ op: "restart" }) : null,
    });
    if (forced) {
      $("beyond").checked = true;
      $("beyond").dispatchEvent(new Event("change"));
    }
    if (!missed.length) return;
    laws.refuse(...missed);
    refused(missed.map(({ error }) => error).join(" "));
  });
}

$("share").addEventListener("click", async () => {
  if (!hello) return;
  const link = linkOf({ law: hello.replay ? null : laws.state?.active, stiffness: hello.replay ? null : dial.stiffness, delay: delay.ticks, beside: beside.law, lab: $("lab").open, scenario: page.scenario, time: hello.replay ? scene.now?.t ?? null : null });
  history.replaceState(null, "", link);
  await navigator.clipboard?.writeText(link).catch(() => {});
  $("share").textContent = "Copied";
  setTimeout(() => { $("share").textContent = "Link"; }, 1500);
});

// The law to put beside the active one: the one with the largest edge at this delay, where known.
async function strongest() {
  const names = [...$("other").options].map(({ value }) => value).filter((name) => name && name !== laws.state.active);
  const known = await edgesAt(laws.state.device_delay).catch(() => ({})), edge = (name) => known[name] ?? 0;
  return names.reduce((best, name) => (edge(name) > edge(best) ? name : best), names[0]);
}

const tour = new Tour({ tour: $("tour"), sentence: $("sentence"), act: $("tour-act"), leave: $("tour-leave"), begin: $("tour-begin") }, {
  dial,
  delay,
  touched: () => scene.grip.used && scene.now?.contact === 1,
  stopped: () => stoppedAt !== null,
  rings: () => rings,
  calm: () => {
    // Back below the edge, for good: the switch goes back, too.
    $("beyond").checked = false;
    if (stoppedAt === null) dial.set(dial.edge * 0.25);
    else $("again").click();
  },
  compare: async () => beside.choose(await strongest()),
  // Edges of A and B, as far as known.
  edges: () => [laws.state?.active, beside.law].map((name) => ({ name, edge: edges?.edges[name] ?? null })),
  compared: () => beside.law !== "" && beside.law !== laws.state.active,
});

$("start-again").addEventListener("click", async () => {
  status.starting();
  const answer = await ask({ op: "restart" });
  if (!answer.ok) $("start-again").disabled = false;
});

// -- stop and restart -----------------------------------------------------------------------------

function watchSlowly(stop) {
  stoppedAt = stop.t;
  scene.letGo();
  scene.trace.length = 0;
  slow.start(store, scene.axis, stop, hello.axes.length > 1 ? null : scene.surface);
}

function goOn() {
  stoppedAt = null;
  slow.end();
  dial.turning = -Infinity;
  turn();
}

$("once-more").addEventListener("click", () => { scene.trace.length = 0; slow.again(); });
// A stable stiffness to start again with, or the loop would be unstable at once.
function soft() {
  const present = laws.edge ?? laws.state.laws[laws.state.active].stiffness ?? dial.stiffness;
  return { stiffness: Number((present * 0.25).toPrecision(2)), field: stiffnessField() };
}

$("again").addEventListener("click", async () => {
  $("again").disabled = true;
  await ask({ op: "again", ...soft() });
  $("again").disabled = false;
});

// Hide controls that change the loop if there is no loop.
function offer(there) {
  map.movable = there && !hello?.replay;
  for (const id of ["tour-begin", "dial", "sing", "beyond-switch", "delay-row", "laws", "sliders", "ramp", "undo"]) $(id).inert = !there;
  $("other").parentElement.inert = !there;
}
offer(false);

// -- buttons and keys -----------------------------------------------------------------------------

$("lab").addEventListener("toggle", () => { plots.resize(); });
$("span").addEventListener("change", (event) => { plots.span = spanOf(event.target.value); plots.follow(); });
$("pause").addEventListener("click", () => plots.window ? plots.follow() : plots.pause());
$("live").addEventListener("click", () => plots.follow());
$("record").addEventListener("click", () => { asked = true; ask({ op: "record", on: $("record").getAttribute("aria-pressed") !== "true" }); });
$("stop").addEventListener("click", () => {
  if (!$("stop").classList.contains("sure")) {
    $("stop").classList.add("sure");
    $("stop").textContent = "End the run?";
    setTimeout(() => { $("stop").classList.remove("sure"); $("stop").textContent = "Stop"; }, 5000);
    return;
  }
  ask({ op: "stop" });
});
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, button, canvas, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = hello?.replay ? {
    " ": () => replay.set(!replay.playing), "+": () => plots.zoom(0.5), "-": () => plots.zoom(2),
    ArrowLeft: () => replay.by(-1), ArrowRight: () => replay.by(1), Home: () => replay.go(replay.begin), End: () => replay.go(replay.end),
  } : {
    " ": () => plots.window ? plots.follow() : plots.pause(), "+": () => plots.zoom(0.5), "-": () => plots.zoom(2),
    ArrowLeft: () => plots.shift(-0.25), ArrowRight: () => plots.shift(0.25), Home: () => plots.follow(),
  };
  if (event.key in keys) { event.preventDefault(); keys[event.key](); }
});

// -- drawing --------------------------------------------------------------------------------------

// Draw at the screen's rate while something is dragged or in slow motion, else at half of it; pause
// without data.
const LIVELY = 500, HALF = 30;
let drawn = 0, plotted = 0, read = 0, touched = 0, changedAt = 0, told = false;
// What rests is drawn once it has left the strip, and looked at ten times a second.
const RESTING = 4500, GLANCE = 100;
for (const event of ["pointerdown", "pointermove", "wheel", "keydown", "click", "input", "change", "resize"]) {
  addEventListener(event, () => { touched = performance.now(); }, { capture: true, passive: true });
}
onTheme(() => { touched = performance.now(); });

function rests(time) { return time - changedAt > RESTING && time - touched > RESTING && !$("lab").open && !slow.on; }
// At rest without a frame of the screen, which would be composed though nothing is drawn.
function glance() { if (rests(performance.now())) setTimeout(glance, GLANCE); else requestAnimationFrame(draw); }

function draw(time) {
  if (rests(time)) { setTimeout(glance, GLANCE); return; }
  requestAnimationFrame(draw);
  const past = slow.window(), held = scene.held !== null || space.held !== null;
  const lively = held || (past && past.at < past.sight[1]) || time - touched < LIVELY;
  // Also while the hand is kept where it is.
  if (!lively && (time - link.heard > LIVELY || time - drawn < HALF)) return;
  drawn = time;
  if (past) { const then = slow.now(past.at); scene.show(then); space.show(then); }
  if ($("space").hidden) scene.draw();
  else {
    space.draw();
    if (space.section) section.draw(space.now, space.turn);
  }
  // At half the screen's rate, which is enough for plots.
  if (time - plotted >= HALF) {
    strip.draw(past, overlaid ?? beside, scene.now?.t);
    if ($("lab").open) plots.draw();
    plotted = time;
  }
  // In slow motion the figures follow the picture.
  if (!told && store?.head > 0 && document.querySelector("#laws input")) {
    told = true;
    if (hello.hides) link.drawn();
  }
  if (time - read > (past ? HALF : 120)) { if ($("space").hidden) scene.read(); else space.read($("reading")); read = time; }
}
requestAnimationFrame(draw);
setInterval(() => { scene.tell(); space.tell(); }, 100);

// Nothing is sent to a page that nobody sees or hears.
function seen() { if (hello?.hides) link.ask({ op: "seen", on: !document.hidden || sound.on }); }
document.addEventListener("visibilitychange", seen);

// For the console and the tests.
Object.assign(globalThis, { haptic: { lag, scene, space, section, strip, plots, dial, delay, map, laws, slow, beside, sound, sing, tour } });
