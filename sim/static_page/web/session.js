// A visitor's session: the player A, B beside it, changes, and what `haptic.play` needs to repeat it.
const LONGEST_SESSION = 60000; // ticks that a copied session may have

const DELAYS_SEARCHED = 64; // between none and a refused one

// A refused change, with what would be accepted, as nodes word it for a page.
class Refusal extends Error {
  constructor(text, remedies) {
    super(text);
    this.remedies = remedies;
  }
}

class Session {
  constructor(data) {
    Object.assign(this, { data, law: data.active, laws: structuredClone(data.laws), ramp: data.ramp, delay: data.delay });
    this.begin();
  }

  // Start at tick 0, with the present law, parameters and delay.
  begin() {
    const { data } = this;
    top_ = 8;
    HEAP.fill(0);
    PAIRS.clear();
    now = 0.0;
    this.beside = null;
    this.player = new Player({ ...data.image, law: this.law, laws: this.numbers() });
    this.player.driver.lines_room = placed(new Float64Array(3 * ROOM_));
    this.pointer = placed(new Float64Array(6));
    HEAP[this.pointer / 8 + 4] = -Infinity;
    for (const d of this.player.devices) {
      [d.pointer, d.silence, d.farthest] = [data.hand ? this.pointer : 0, data.silence, data.farthest];
    }
    if (this.delay !== data.delay) setDelay(this.player, this.delay);
    this.until = top_; // memory of A; B's follows
    this.first = { law: this.law, laws: structuredClone(this.laws), delay: this.delay };
    this.swaps = [];
    this.spoiled = "";
    this.targets = this.player.devices.map(() => new Float64Array(LONGEST_SESSION));
    this.undos = [];
  }

  numbers() {
    return Object.fromEntries(Object.keys(this.laws).map((name) => [name, this.numbersOf(name)]));
  }

  numbersOf(name, law = this.laws[name]) {
    return compiled(this.data.parts[name], law, this.data.device.period);
  }

  get seq() { return this.player.driver.seq; }

  tick() {
    const { player, targets } = this, k = player.driver.seq;
    now = k * player.driver.period;
    player.tick();
    if (k < LONGEST_SESSION) player.devices.forEach((d, n) => { targets[n][k] = d.pull; });
    this.beside?.tick();
  }

  // The hand's wanted position, or null to let go. A sequence lock, as in nodes/driver/pointer.py.
  hand(target) {
    const at = this.pointer / 8;
    HEAP[at] = HEAP[at + 5] = HEAP[at] + 1;
    if (target) HEAP.set(target, at + 1);
    HEAP[at + 4] = target ? now : -Infinity;
  }

  device(delay = this.delay) { return { ...this.data.device, delay: delay + this.data.image.next_tick }; }

  stable(name, law = this.laws[name], delay = this.delay) {
    const numbers = this.numbersOf(name, law);
    return numbers.own.kind ? true : loopIsStable(this.device(delay), numbers);
  }

  // Whether the map says that the active law rests; not for a law with code of its own.
  get rests() { return !this.numbersOf(this.law).own.kind && this.stable(this.law); }

  // -- changes ------------------------------------------------------------------------------------

  // Render a law, perhaps changed, from the next tick on. Return the receipt's facts.
  use(name, law, ramp) {
    const before = { name: this.law, law: { ...this.laws[this.law] } };
    const numbers = this.numbersOf(name, law);
    this.player.swap(name, numbers, ramp);
    this.record({ tick: this.seq, name, law: { ...law }, ramp });
    this.laws[name] = law;
    this.law = name;
    return before;
  }

  // Store a swap for `python`; a launch file schedules no swap during another one's fade.
  record(swap) {
    const last = this.swaps.at(-1);
    if (last && last.tick === swap.tick && swap.ramp === 0) this.swaps.pop();
    else if (last && swap.tick < last.tick + Math.max(last.ramp, 1)) {
      this.spoiled ||= `the law changed again during a fade at tick ${swap.tick}`;
    }
    this.swaps.push(swap);
  }

  remember(kind, back) {
    const last = this.undos.at(-1), time = performance.now();
    if (last && last.kind === kind && time - last.time < 1000) { last.time = time; return; }
    this.undos.push({ kind, back, time });
    if (this.undos.length > 100) this.undos.shift();
  }

  setLaw(field, value, beyond) {
    const name = this.law, parts = this.data.parts[name], old = this.laws[name];
    if (field === "hardness") return this.scale(value, beyond);
    if (!parts.free.includes(field)) throw new Error(`${name}.${field} is fixed on this page; a launch can change it.`);
    if (!Number.isFinite(value) || value < 0 || (field === "stiffness" && value === 0)) {
      throw new Error(`${name}.${field}: ${value} is no ${field} of this law.`);
    }
    const law = { ...old, [field]: value };
    this.refusePulling(name, law);
    if (!beyond && !this.stable(name, law)) throw this.refusal(name, law);
    this.remember(`${name}.${field}`, () => this.use(name, old, 0));
    return this.use(name, law, 0);
  }

  // Scale a law without a nominal stiffness, so that H(1) is `value`.
  scale(value, beyond) {
    const name = this.law, old = this.laws[name];
    const law = { ...old, scale: value / this.data.parts[name].rest };
    if (!beyond && !this.stable(name, law)) throw this.refusal(name, law);
    this.remember(`${name}.scale`, () => this.use(name, old, 0));
    return this.use(name, law, 0);
  }

  refusal(name, law) {
    const fault = `${name}: the loop would be unstable; nothing was changed`;
    const [least, edge] = this.interval(name, law);
    const field = `${name}.${law.stiffness === undefined ? "hardness" : "stiffness"}`;
    const refused = (kind, word, value) => {
      const text = `the ${word} ${field} that is accepted is ${value}`;
      return new Refusal(`${fault}; ${text}`, [{ kind, text, values: { [field]: value } }]);
    };
    // Some laws are unstable where they are too soft, too. On a hand they need less than without.
    if (least > 0 && law.stiffness <= least) {
      let [out, inside] = [law.stiffness, Math.min(1.001 * least, 0.5 * (least + (edge ?? Infinity)))];
      for (let n = 0; n < 30; n++) {
        const middle = 0.5 * (out + inside);
        if (this.stable(name, { ...law, stiffness: middle })) inside = middle; else out = middle;
      }
      return refused("at_least", "smallest", Number((inside * 1.001).toPrecision(4)));
    }
    if (edge === null) return new Refusal(`${fault}; no stiffness is stable with this damping and delay`, []);
    return refused("at_most", "largest", Number((edge * 0.999).toPrecision(4)));
  }

  // A law with H(1) ≤ 0 is no wall, also past the edge: neither a launch nor `haptic.play` renders it.
  refusePulling(name, law) {
    const rest = restStiffness(this.numbersOf(name, law));
    if (this.numbersOf(name, law).own.kind || rest > 0) return;
    const fault = `${name}: H(1) would be ${rest.toPrecision(3)} N/m: it would pull into the wall; nothing was changed`;
    const unit = 10 ** Math.floor(Math.log10(law.stiffness - rest) - 2), least = Number((unit * Math.ceil((law.stiffness - rest) / unit + 1e-6)).toPrecision(3));
    const text = `the smallest ${name}.stiffness that is accepted is ${least}`;
    throw new Refusal(`${fault}; ${text}`, [{ kind: "at_least", text, values: { [`${name}.stiffness`]: least } }]);
  }

  refusedDelay(ticks) {
    const fault = `The loop would be unstable at a delay of ${ticks} ticks; nothing was changed`;
    const stable = (delay) => this.stable(this.law, this.laws[this.law], delay);
    let out = ticks, inside = null;
    for (let n = DELAYS_SEARCHED - 1; n >= 0 && inside === null; n--) {
      const delay = (n / DELAYS_SEARCHED) * ticks;
      if (stable(delay)) inside = delay; else out = delay;
    }
    if (inside === null) return new Refusal(`${fault}; no delay is stable with this law`, []);
    for (let n = 0; n < 30; n++) {
      const middle = 0.5 * (out + inside);
      if (stable(middle)) inside = middle; else out = middle;
    }
    // In hundredths of a tick, as the slider sets it.
    const most = Math.floor(100 * inside) / 100, text = `the largest delay that is accepted is ${most}`;
    return new Refusal(`${fault}; ${text}`, [{ kind: "at_most", text, values: { delay: most } }]);
  }

  // Smallest and largest stable stiffness of a law [N/m]; null where there is none.
  interval(name, law = this.laws[name], delay = this.delay) {
    const parts = this.data.parts[name], { period } = this.data.device;
    // What is scaled as a whole is searched around the law as it is written, however far it was scaled.
    const numbers = compiled(parts, { ...law, scale: 1 }, period);
    if (numbers.own.kind) return [null, null];
    if (law.stiffness === undefined) return [null, scaledEdge(this.device(delay), numbers)];
    const found = stableStiffness(this.device(delay), withoutSpring(parts, law, period));
    return found ? [found[0], found[1] < Infinity ? found[1] : null] : [null, null];
  }

  // Largest stable stiffness of a law [N/m], or null.
  edge(name, law = this.laws[name], delay = this.delay) { return this.interval(name, law, delay)[1]; }

  switchTo(name, ramp, beyond) {
    if (!Object.hasOwn(this.laws, name)) throw new Error(`no law is named ${name} on this page`);
    if (!beyond && !this.stable(name)) throw this.refusal(name, this.laws[name]);
    const from = this.law;
    this.remember("switch", () => this.use(from, this.laws[from], 0));
    return this.use(name, this.laws[name], ramp);
  }

  setDelay(ticks, beyond) {
    if (!(ticks >= 0 && ticks <= LONGEST_DELAY_)) {
      throw new Error(`A delay of ${ticks} ticks is not played here; this page plays 0 to ${LONGEST_DELAY_} ticks.`);
    }
    if (!beyond && !this.stable(this.law, this.laws[this.law], ticks)) {
      throw this.refusedDelay(ticks);
    }
    const from = this.delay;
    this.remember("delay", () => this.delayBy(from));
    this.delayBy(ticks);
  }

  delayBy(ticks) {
    this.delay = ticks;
    setDelay(this.player, ticks);
    if (this.beside) setDelay(this.beside.player, ticks);
    this.spoiled = `the delay changed at tick ${this.seq}`;
  }

  undo() {
    const last = this.undos.pop();
    if (!last) throw new Error("Nothing to undo.");
    last.back();
  }

  rearm() {
    rearm(this.player.driver, this.seq);
    this.spoiled = `the driver was rearmed at tick ${this.seq}`;
  }

  // B: the same device and hand, from A's present state, with another law. Null for none.
  compare(name, law = this.laws[name]) {
    this.beside = name ? new Beside(this, name, law) : null;
  }

  // -- the same session for haptic.play -----------------------------------------------------------

  // Python that repeats this session to the bit: a launch file that includes the scenario.
  python() {
    const { data, first, seq } = this, { period } = data.device, { driver, coupling } = data.nodes;
    if (this.spoiled) throw new Error(`${this.spoiled}, which haptic.play does not repeat: press Start again first.`);
    if (seq > LONGEST_SESSION) throw new Error(`The session is longer than ${LONGEST_SESSION} ticks: press Start again first.`);
    const laws = Object.fromEntries(data.named.map((name) => [name, this.written(name, first.laws[name])]));
    laws[first.law] = this.written(first.law, first.laws[first.law]);
    const planned = data.image.schedule.map(({ tick, law, ramp }) => ({ at: tick * period, law, ramp }));
    const schedule = this.swaps.map(({ tick, name, law, ramp }, n) => {
      laws[`${name}_${n + 1}`] = this.written(name, law);
      return { at: tick * period, law: `${name}_${n + 1}`, ramp };
    });
    const device = { delay: first.delay, ...(data.hand ? { hand: { path: this.path(0), repeat: null } } : {}) };
    const others = data.hand ? this.player.devices.slice(1) : [];
    if (others.length) {
      device.axes = Object.fromEntries(others.map((d, n) => ["xyz"[d.axis], { hand: { path: this.path(n + 1), repeat: null } }]));
    }
    const parameters = {
      [driver]: { device },
      [coupling]: { law: first.law, laws, schedule: [...planned, ...schedule], stability: "warn" },
    };
    const lines = [
      "import haptic", "", 'with open("session.yaml", "w") as file:', '    file.write("""',
      `summary: ${seq} ticks of ${data.scenario} as they were played in a browser`,
      "include:", `  - launch: ${data.scenario}`, `    arguments: ${yaml(data.arguments)}`, `    parameters: ${yaml(parameters)}`,
      `run: {pace: lockstep, duration: ${yaml(seq * period)}}`, '""")', 'print(haptic.play("session.yaml"))', "",
    ];
    return lines.join("\n");
  }

  // Parameters of a law for a launch file.
  written(name, law) {
    if (law.scale === undefined) return law;
    const { taps, sections } = this.numbersOf(name, law), recursive = [];
    for (let i = 0; i < sections.length; i += 4) {
      const [b0, b1, a1, a2] = sections.subarray(i, i + 4);
      recursive.push({ b0, b1, a1, a2 });
    }
    return { kind: "fir", taps, ...(recursive.length ? { recursive } : {}) };
  }

  // Corners of the path of an axis' hand through its target at every tick.
  path(n) {
    const { period } = this.data.device, targets = this.targets[n], ticks = this.seq, found = [];
    for (let k = 0; k < ticks; k++) {
      const rests = k > 0 && k < ticks - 1 && targets[k] === targets[k - 1] && targets[k] === targets[k + 1];
      if (!rests) found.push([k * period, targets[k]]);
    }
    return found;
  }
}

// A value as YAML in one line. A number needs its point: 1e-7 would be a text.
const yaml = (value) => {
  if (typeof value === "number") {
    const text = Object.is(value, -0) ? "-0.0" : String(value);
    return /^-?\d+e/.test(text) ? text.replace("e", ".0e") : text;
  }
  if (value === null || typeof value !== "object") return JSON.stringify(value);
  if (Array.isArray(value) || ArrayBuffer.isView(value)) return `[${Array.from(value, yaml).join(", ")}]`;
  const entries = Object.entries(value).filter(([, one]) => one !== undefined);
  return `{${entries.map(([name, one]) => `${name}: ${yaml(one)}`).join(", ")}}`;
};

class Beside {
  constructor(session, name, law) {
    const { player } = session, begin = session.until;
    top_ = begin;
    this.player = new Player({ ...player.image, law: player.name });
    this.name = name;
    this.begun = player.driver.seq;
    this.position = [];
    this.force = [];
    // A's memory, moved: the same layout behind it.
    const offset = begin - 8;
    HEAP.copyWithin(begin / 8, 1, session.until / 8);
    top_ = begin + session.until - 8;
    PAIRS.clear();
    const moved = (state, from, addresses) => {
      for (const [field, value] of Object.entries(from)) {
        if (ArrayBuffer.isView(value)) state[field].set(value);
        else state[field] = addresses.includes(field) && value ? value + offset : value;
      }
    };
    const b = this.player;
    moved(b.driver, player.driver, ["places", "lines", "lines_room"]);
    b.devices.forEach((d, n) => moved(d, player.devices[n], ["path", "masses"]));
    moved(b.environment, player.environment, []);
    moved(b.coupling, player.coupling, []);
    b.memory.set(player.memory);
    b.table.set(player.table);
    b.rings.forEach((ring, n) => ring.set(player.rings[n]));
    b.schedule = [];
    b.leaving = [];
    b.active = player.active.map((one) => copied(one));
    b.store();
    b.coupling.fade_ramp = 0;
    b.swap(name, session.numbersOf(name, law), 0);
  }

  tick() {
    const { player: b } = this, [axis] = b.axes, one = b.axes.length === 1;
    b.tick();
    b.events.length = 0;
    this.position.push(one ? b.driver.position[axis] : Array.from(b.driver.position));
    this.force.push(one ? b.driver.force[axis] : Array.from(b.driver.force));
  }
}

const copied = (law) => Object.assign(Object.create(Object.getPrototypeOf(law)), law, { state: law.state.slice() });
