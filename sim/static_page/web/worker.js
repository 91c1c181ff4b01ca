// Stands where the view's server stands: the same messages to the same page, over the player.
// Requests and documents are those of nodes/view/; DATA is written by the build.
const session = new Session(DATA);
const AXES = Array.from(DATA.image.axes), PERIOD = DATA.device.period;
const SERIES = DATA.hello.series, PER_BIN = Math.round(DATA.hello.bin_s / PERIOD);
const post = (message, transfer) => postMessage(message, transfer);
const say = (type, content) => post(JSON.stringify({ type, ...content }));

// -- bins and frames: smallest and largest value of some ticks, as nodes/view/feed.py ----------------

let bins = [], open = null, isVoid = 1;
const valuesNow = () => {
  const { driver: s, environment: e, force } = session.player, values = [];
  for (const field of [s.position, e.met, s.target, force, s.force]) {
    for (const axis of AXES) values.push(field[axis]);
  }
  return [...values, s.energy, NaN];
};
const bin = (tick) => {
  const values = valuesNow();
  if (open === null) open = { t: tick * PERIOD, low: values, high: values.slice() };
  else values.forEach((value, i) => {
    if (value < open.low[i]) open.low[i] = value;
    if (value > open.high[i]) open.high[i] = value;
  });
  if ((tick + 1) % PER_BIN === 0) {
    bins.push(open);
    open = null;
  }
};

const frame = () => {
  const { driver: s, environment: e, force, contact } = session.player, n = bins.length, m = SERIES.length;
  const buffer = new ArrayBuffer(16 + 22 * 8 + 8 * n + 8 * m * n), head = new DataView(buffer);
  [1, n, m, isVoid].forEach((value, i) => head.setUint32(4 * i, value, true));
  isVoid = 0;
  const vectors = [s.position, e.met.subarray(0, 3), e.met.subarray(3, 6), force, s.force, s.target];
  new Float64Array(buffer, 16, 22).set([
    s.asked * PERIOD, ...vectors.flatMap((vector) => Array.from(vector)), e.met[6], contact ? 1 : 0, session.delay,
  ]);
  new Float64Array(buffer, 192, n).set(bins.map(({ t }) => t));
  const values = new Float32Array(buffer, 192 + 8 * n, 2 * m * n);
  bins.forEach(({ low, high }, k) => {
    for (let i = 0; i < m; i++) [values[i * n + k], values[(m + i) * n + k]] = [low[i], high[i]];
  });
  bins = [];
  post(buffer, [buffer]);
};

// Shapes that move, where they are.
const MOVES = (DATA.hello.shape.parts ?? []).some(({ pose }) => pose >= 0);
const poses = () => {
  if (!MOVES) return;
  const { table } = session.player, found = [];
  for (let n = 0; n < table[SHAPES_COUNT_]; n++) {
    const row = ROWS_ + ROW_ * n, at = row + SHIFT_;
    if (table[row + SPEED_] > 0) found.push([...table.slice(at, at + 3), 1, 0, 0, 0, 1, 0, 0, 0, 1]);
  }
  say("poses", { poses: found });
};

// -- documents ------------------------------------------------------------------------------------

let why = "", stop = null, revision = 0;
const ringings = AXES.map((axis) => new Ringing(axis));
let besideAt = null; // stiffness of B where it is not its own [N/m]
const besideRinging = new Ringing(AXES[0]);
const rings = () => ringings.map((one) => one.ring()).reduce((most, ring) =>
  ring && (!most || ring.force > most.force) ? ring : most, null);

const status = () => {
  const { driver: s, environment: e, force, contact, name } = session.player, safety = SAFETY_[s.safety];
  const state = { safety, force: s.force, asked: force, age: 0, contact, normal: e.met.subarray(3, 6), distance: e.met[6], law: name };
  const active = safety === "active" || safety === "ramp";
  // What settles is no wall that is too hard: where the map says stable, it does not ring.
  const ring = session.rests ? null : rings();
  const [level, words] = explained(state, active ? "" : why, ringWords(ring));
  say("status", {
    level, words, safety, stop: safety === "stopped" ? stop : null, tick: s.seq, t: s.seq * PERIOD,
    rate_hz: 1 / PERIOD, missed: 0, missed_lately: 0, overruns: 0, delay_ticks: session.delay + DATA.image.next_tick,
    rings: ring,
    // The same of both laws, where they are compared.
    sings: session.beside ? { a: rings(), b: besideRinging.ring() } : null,
    response_us: {}, law: name, revision, ended: failure,
    nodes: Object.fromEntries(Object.values(DATA.nodes).map((node) => [node, { state: "running", silent_s: 0 }])),
  });
};

// Edge of every law at the present delay [N/m], for whoever looks for the one that bears most.
let edges = {}, edged = "";
const edgesNow = () => {
  const key = JSON.stringify([session.delay, Object.values(session.laws).map(({ damping }) => damping)]);
  if (key !== edged) {
    edged = key;
    edges = Object.fromEntries(Object.keys(session.laws).map((name) => [name, session.edge(name)]));
  }
  return edges;
};

const laws = () => say("laws", {
  node: DATA.nodes.coupling, active: session.law, laws: session.laws, named: DATA.named, ramp: session.ramp,
  plant: DATA.plant, device_delay: session.delay,
});
const tellEdges = () => say("edges", {
  device_delay: session.delay, edges: DATA.no_map ? {} : edgesNow(),
  rest: Object.fromEntries(Object.keys(session.laws).map((name) => [name, session.laws[name].stiffness === undefined ? restStiffness(session.numbersOf(name)) : null])),
});

const MOVING_PAUSE = 20; // between two steps of the limits for moving worlds [ms]

const map = () => {
  const { law, delay } = session, parts = DATA.parts[law];
  const found = DATA.no_map ? { why: DATA.no_map } : stabilityMap(session.device(), parts, session.laws[law]);
  if (session.laws[law].stiffness === undefined && !found.why) found.k_max_n_per_m = session.edge(law);
  const tell = (chart) => say("map", { law, device_delay: delay, plant: DATA.plant, ...chart });
  tell(found);
  addMoving(movingSteps(found, session.device(), parts, { ...session.laws[law] }, DATA.world), tell);
};

// The limits for moving worlds follow, a step between two turns of the loop; a newer map ends them.
let moving = null;
const addMoving = (steps, tell) => {
  moving = steps;
  const next = () => {
    if (moving !== steps) return;
    const { value, done } = steps.next();
    if (value) tell(value);
    if (!done) setTimeout(next, MOVING_PAUSE);
  };
  setTimeout(next, MOVING_PAUSE);
};

const receipt = (action, before) => {
  const { law } = session, after = session.laws[law], switched = before.name !== law;
  const changes = Object.keys(after).filter((name) => JSON.stringify(after[name]) !== JSON.stringify(before.law[name]));
  const text = switched ? `${before.name} → ${law}`
    : `${law}: ${changes.map((name) => `${name} ${formatted(before.law[name], ".4g")} → ${formatted(after[name], ".4g")}`).join(", ")}`;
  say("log", {
    kind: "receipt", t: session.seq * PERIOD, action, ramp: switched ? session.player.coupling.fade_ramp : 0, reason: "asked",
    revision: ++revision, law, after: { law, ...after }, switched, text, force_step_n: 0,
  });
};

const events = () => {
  for (const note of session.player.events) {
    const { kind, reason, why: cause, data, changes } = noted(note);
    if (changes) {
      why = cause;
      stop = { t: note[1] * PERIOD, span_s: data.span_s ?? 0 };
    }
    say("log", { kind: "event", t: note[1] * PERIOD, node: DATA.nodes.driver, event: kind, text: reason, data });
  }
  session.player.events.length = 0;
};

const beside = () => {
  const b = session.beside;
  if (!b?.position.length) return;
  say("beside", { law: b.name, at: besideAt, t: b.begun * PERIOD, period: PERIOD, late: 0, position: b.position, force: b.force });
  b.begun += b.position.length;
  b.position = [];
  b.force = [];
};

// -- requests ---------------------------------------------------------------------------------------

const OPERATIONS = {
  law({ field, value, beyond = false, law = "" }) {
    if (law && law !== session.law) throw new Error(`${session.law} is now active, not ${law}; ${law}.${field} is unchanged.`);
    receipt("set", session.setLaw(field, value, beyond));
  },
  switch({ law, ramp = session.ramp, beyond = false }) { receipt("switch", session.switchTo(law, ramp, beyond)); },
  set({ values }) { session.ramp = values.ramp ?? session.ramp; },
  delay({ ticks, beyond = false }) { session.setDelay(ticks, beyond); },
  undo() { session.undo(); },
  again({ stiffness }) {
    if (SAFETY_[session.player.driver.safety] !== "stopped") throw new Error("The driver has not stopped the loop.");
    const field = session.laws[session.law].stiffness === undefined ? "hardness" : "stiffness";
    session.setLaw(field, stiffness, false);
    session.rearm();
    stop = null;
  },
  // Stiffness and scale of B may differ from A's law of that name.
  compare({ law, stiffness, hardness }) {
    if (law && !Object.hasOwn(session.laws, law)) throw new Error(`no law is named ${law} on this page`);
    const described = { ...session.laws[law] };
    besideAt = hardness ?? stiffness ?? null;
    if (stiffness !== undefined) described.stiffness = stiffness;
    if (hardness !== undefined) described.scale = hardness / DATA.parts[law].rest;
    session.compare(law, described);
    Object.assign(besideRinging, new Ringing(AXES[0]));
    say("beside", { law, at: besideAt });
    return { law };
  },
  restart() {
    session.begin();
    bins = [];
    open = null;
    [isVoid, why, stop, failure, began] = [1, "", null, "", performance.now()];
    ringings.forEach((one) => Object.assign(one, new Ringing(one.axis)));
    say("hello", DATA.hello);
    say("beside", { law: "" });
    session.hand(null);
  },
  python() { return { text: session.python() }; },
};

onmessage = ({ data }) => {
  const request = JSON.parse(data), { op, id } = request;
  if (op === "hand") {
    if (request.target === null || request.target.every(Number.isFinite)) {
      session.hand(request.target);
    }
    return;
  }
  try {
    if (!Object.hasOwn(OPERATIONS, op)) throw new Error(`${op}: this page has no nodes to ask; a launch has.`);
    const result = OPERATIONS[op](request) ?? {};
    say("answer", { id, op, ok: true, result, error: "", remedies: [] });
    if (op !== "python" && op !== "compare") {
      laws();
      tellEdges();
      map();
    }
  } catch (error) {
    say("answer", { id, op, ok: false, result: null, error: error.message, remedies: error.remedies ?? [] });
  }
};

// -- time: the browser's clock decides how many ticks are due ------------------------------------------

const WAKES = 16, LONGEST_PAUSE = 0.25, STATUS_PERIOD = 200; // [ms], [s], [ms]
let began = performance.now(), told = -Infinity, failure = "";

const play = () => {
  const time = performance.now(), due = Math.floor((time - began) / 1e3 / PERIOD);
  // The page slept: its time stood still.
  if ((due - session.seq) * PERIOD > LONGEST_PAUSE) began = time - (session.seq + 1) * PERIOD * 1e3;
  const most = Math.ceil(LONGEST_PAUSE / PERIOD);
  for (let n = 0; session.seq < due && n < most && !failure; n++) {
    const k = session.seq;
    session.tick();
    if (session.beside) besideRinging.take(k * PERIOD, session.beside.player.driver);
    bin(k);
    AXES.forEach((_, i) => ringings[i].take(k * PERIOD, session.player.driver));
  }
  events();
  if (bins.length) {
    frame();
    poses();
    beside();
  }
  if (time - told > STATUS_PERIOD) {
    status();
    told = time;
  }
};

say("hello", DATA.hello);
laws();
tellEdges();
map();
play();
setInterval(() => {
  try { play(); } catch (error) {
    failure ||= error.message;
    status();
  }
}, WAKES);
