// A chain in one process, as sim/play/chain.py plays it: the rules of the nodes in lockstep.
// What stands here passes values from rule to rule; the rules themselves are emitted.
// Constants whose names end in _ are those of the nodes; the build defines them.
const stateOf = (fields) => {
  const state = {};
  for (const [name, value] of Object.entries(fields)) {
    state[name] = ArrayBuffer.isView(value) ? value.slice() : value;
  }
  return state;
};
const stateWith = ({ fields, ...arrays }) => {
  const state = stateOf(fields);
  for (const [name, values] of Object.entries(arrays)) state[name] = placed(values);
  return state;
};

// Stiffness of a law to a constant deflection, as nodes/coupling/law_on_axis.py, `still_of`.
const stillOf = (taps, coefficients) => {
  let still = exactSum(taps);
  for (let i = 0; i < coefficients.length; i += 4) {
    const [b0, b1, a1, a2] = coefficients.slice(i, i + 4), whole = 1.0 + a1 + a2;
    if (whole === 0.0) return 0.0;
    still += (b0 + b1) / whole;
  }
  return Number.isFinite(still) ? still : 0.0;
};

class Law {
  constructor(name, { taps, sections: coefficients, own }) {
    Object.assign(this, { name, taps, coefficients });
    this.state = new Float64Array(coefficients.length / 2);
    this.gain = newest_gain(taps, coefficients);
    this.still = own.kind ? 0.0 : stillOf(taps, coefficients);
    this.own = null;
    if (own.kind === "windowed") this.own = (h, head) => windowed_force(own.numbers, h, head);
    if (own.kind === "pushed") {
      const numbers = stateOf(own.numbers);
      this.own = (history, head) => pushed_force(numbers, history, head);
    }
    this.plain = this.state.length === 0 && this.own === null;
  }
  warmUp(history, head) {
    if (!this.state.length) return;
    this.state.fill(0);
    warm_up(this.coefficients, this.state, history, head, history.length / 2);
  }
  force(history, head) {
    const force = evaluate(this.taps, this.coefficients, this.state, history, head);
    return this.own === null ? force : force + this.own(history, head);
  }
  see(history, head) {
    sections(this.coefficients, this.state, history[head], history[head + 1]);
  }
}

// Merge laws of taps, or drop the smallest others, until `LEAVING_` are left.
const joined = (shares) => {
  const plain = shares.filter(([law]) => law.plain);
  if (plain.length > 1) {
    const total = exactSum(plain.map(([, share]) => share));
    const taps = new Float64Array(Math.max(...plain.map(([law]) => law.taps.length)));
    for (const [law, share] of plain) {
      for (let m = 0; m < law.taps.length; m++) taps[m] += (share / total) * law.taps[m];
    }
    shares = shares.filter(([law]) => !law.plain);
    const none = new Float64Array(0);
    shares.push([new Law("mixed", { taps, sections: none, own: {} }), total]);
  }
  shares.sort((a, b) => b[1] - a[1]);
  while (shares.length > LEAVING_) {
    const [, least] = shares.pop();
    shares[0] = [shares[0][0], shares[0][1] + least];
  }
  return shares;
};
// Sum without rounding but of the result, as math.fsum.
const exactSum = (values) => {
  const parts = [];
  for (let x of values) {
    let i = 0;
    for (let y of parts) {
      if (Math.abs(x) < Math.abs(y)) [x, y] = [y, x];
      const high = x + y, low = y - (high - x);
      if (low) parts[i++] = low;
      x = high;
    }
    parts.length = i;
    parts.push(x);
  }
  let sum = parts.length ? parts.pop() : 0;
  while (parts.length) {
    const x = sum, y = parts.pop();
    sum = x + y;
    const low = y - (sum - x);
    if (low) {
      // Half way between two numbers: the rest decides.
      if (parts.length && low < 0 === parts.at(-1) < 0) {
        const twice = low * 2, more = sum + twice;
        if (twice === more - sum) sum = more;
      }
      break;
    }
  }
  return sum;
};

class Player {
  constructor(image) {
    this.image = image;
    this.axes = Array.from(image.axes);
    this.driver = stateWith(image.driver);
    this.devices = image.devices.map(stateWith);
    this.environment = stateOf(image.environment);
    this.coupling = stateOf(image.coupling);
    this.table = image.table.slice(); // shapes that move are written there
    this.memory = image.memory.slice();
    this.rings = this.axes.map(() => new Float64Array(2 * this.coupling.length));
    this.laws = this.axes.map(() => []); // laws of an axis, slot by slot
    this.leaving = [];
    this.schedule = Array.from(image.schedule);
    this.force = new Float64Array(3); // force of the law [N]
    this.contact = false;
    this.events = [];
    this.deflection = new Float64Array(3);
    this.before = this.devices.map(({ axis, x, v }) => ({ axis, x, v })); // when sampled
    this.use(image.law, image.laws[image.law]);
    const port = {
      ring: (_, n) => this.rings[n],
      force_of: (_, n, m, history, head) => this.laws[n][m].force(history, head),
      see: (_, n, m, history, head) => this.laws[n][m].see(history, head),
      gain_of: (_, n, m) => this.laws[n][m].gain,
      revise: (_, n, m, by) => {
        const law = this.laws[n][m];
        revise_sections(law.coefficients, law.state, by);
      },
    };
    [this.render] = make_render(port);
    [this.lockstep] = make_ticks({
      clock: () => 0.0,
      sleep_until: (_, deadline) => deadline,
      read: (s, seq) => this.read(s, seq),
      write: (s, seq, offset) => this.write(s, seq, offset),
      publish: () => {},
      receive: (s) => this.answer(s),
      aside: () => {},
      called: () => false,
    });
    this.driver.most = 1;
    this.driver.until = 2 ** 53;
  }

  // Play one tick. Notes of the driver are left in `notes`: code, tick, change, five numbers.
  tick() {
    const s = this.driver, seq = s.seq;
    while (s.seq === seq) this.lockstep(s);
    for (let i = 0; i < s.notes_count; i++) this.events.push(s.notes.slice(8 * i, 8 * i + 8));
    s.notes_count = 0;
  }

  read(s, seq) {
    s.place.fill(0);
    s.target.fill(0);
    for (const d of this.devices) {
      s.place[d.axis] = read_axis(d, seq);
      s.target[d.axis] = d.pull;
    }
    this.before = this.devices.map(({ axis, x, v }) => ({ axis, x, v }));
    return true;
  }

  write(s, seq, offset) {
    for (const d of this.devices) write_axis(d, s.handed[d.axis], seq, offset);
    return true;
  }

  // Environment and coupling: from the published state to the force that answers it.
  answer(s) {
    const e = this.environment, met = e.met, seq = s.seq, p = s.position;
    if (!(0 <= e.answered && e.answered < seq) || s.rebased !== e.driver_rebased) {
      if (e.answered >= 0 && e.kind === SHAPES_) this.memory[PLACED_] = NEVER_;
      if (!(0 <= e.answered && e.answered < seq) || s.rebased <= e.rebased) {
        e.rebased = seq;
        e.ease = 0;
      }
      e.driver_rebased = s.rebased;
    }
    note_tick(e.kind, this.memory, seq, s.force[0], s.force[1], s.force[2]);
    const contact = meet(e.kind, this.table, this.memory, p[0], p[1], p[2], met);
    if (e.kind === SHAPES_ || e.inside !== 0) {
      if (met[JUMPED_] !== 0) [e.rebased, e.ease] = [seq, 0];
      e.inside = this.memory[INSIDE_];
    }
    tell_jump(e);
    const proxy = met.subarray(0, 3), normal = met.subarray(3, 6), distance = met[6];
    this.follow(e, p, proxy, distance, normal, contact);
    while (this.schedule.length && this.schedule[0].tick <= seq) {
      const { law, ramp } = this.schedule.shift();
      this.swap(law, this.image.laws[law], ramp);
    }
    const c = this.coupling, due = c.pushes[this.axes.length - 1] + 1;
    const feltAs = [0.0, met[STIFFNESS_], met[DAMPING_]]; // compliance [m/N], factors of the law
    if (!this.render(c, p, proxy, normal, distance, contact, feltAs, this.force, due)) {
      throw new RangeError(`tick ${seq}: ${this.name} returned a force that is not finite`);
    }
    if (this.leaving.length && c.fade_ramp === 0) {
      this.leaving = [];
      this.store();
    }
    this.axes.forEach((i, n) => { this.deflection[i] = this.rings[n][c.head[n]]; });
    e.seq = e.answered = c.seq = c.answered = seq;
    this.contact = contact;
    s.got_seq = seq;
    for (let i = 0; i < 3; i++) {
      s.got[i] = this.force[i];
      s.got_normal[i] = contact ? normal[i] : 0.0;
    }
    s.got_credit = 0.0;
    return GOT_;
  }

  // Histories restart at rest at the first tick, and after a jump without motion.
  follow(e, position, proxy, distance, normal, contact) {
    const c = this.coupling;
    if (c.answered >= 0 && e.told_rebased === c.rebased && c.jumps === 0) return;
    const conventions = c.answered >= 0 && c.jumps !== 0;
    [c.rebased, c.jumps, c.field_due] = [e.told_rebased, 0, 0];
    const values = this.axes.map((_, n) =>
      deflection_along(c, n, position, proxy, distance, normal, contact));
    c.upright.fill(0);
    if (!conventions && values.every((value, n) => value === this.rings[n][c.head[n]])) return;
    values.forEach((value, n) => {
      this.rings[n].fill(value);
      c.pushes[n] += c.length;
      for (const law of this.laws[n]) settle(law.coefficients, law.state, value);
    });
    c.ease_ramp = Math.max(e.told_ease || c.ease_usual, 1);
    c.ease_done = 0;
  }

  use(name, numbers) {
    this.name = name;
    this.active = this.axes.map(() => new Law(name, numbers));
    this.store();
  }

  store() {
    const c = this.coupling;
    c.leaving = this.leaving.length ? this.leaving[0].length : 0;
    this.axes.forEach((_, n) => {
      const shares = [[this.active[n], 0.0], ...(this.leaving[n] ?? [])];
      this.laws[n] = shares.map(([law]) => law);
      shares.forEach(([law, weight], m) => {
        c.weight[SLOTS_ * n + m] = weight;
        c.still[SLOTS_ * n + m] = law.still;
      });
    });
  }

  // Make another law active from this tick on, faded in over `ramp` ticks.
  swap(name, numbers, ramp) {
    const c = this.coupling;
    const weight = c.fade_ramp ? min_(c.fade_done / c.fade_ramp, 1.0) : 1.0;
    const leaving = this.axes.map((_, n) => {
      const before = (this.leaving[n] ?? []).map(([law, share]) => [law, share * (1.0 - weight)]);
      const shares = [...before, [this.active[n], weight]].filter(([, share]) => share > 0.0);
      return shares.length <= LEAVING_ ? shares : joined(shares);
    });
    this.leaving = ramp > 0 ? leaving : [];
    c.fade_ramp = ramp;
    c.fade_done = 0;
    this.name = name;
    this.active = this.axes.map((_, n) => {
      const law = new Law(name, numbers);
      law.warmUp(this.rings[n], c.head[n]);
      return law;
    });
    this.store();
  }
}
