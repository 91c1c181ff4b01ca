// "Make it sing": plain PD past its edge, and beside it, under the same hand, the law that bears
// most, which rests. One rule for a launch and for the page without a server.
import { figure, fixed, rough, unbroken } from "./format.js";

const OVER = 1.15; // stiffness of A, of its edge
const TIMES = [3, 2, 1], SAFE = [0.7, 0.95]; // stiffness of B: so many times A's, below so much of its edge
const HALF_LATE = 0.5; // delay of the device at least [ticks]
// The page's own hand presses until a visitor takes it: [s], depth and begin [m], time to get there [s].
const PRESS = 9, DEPTH = 0.008, OUTSIDE = 0.004, EASE = 1, EVERY = 40;
const WAITS = 8e3, B_WAITS = 40e3; // longest wait for the change to be seen, and for B [ms]
const SETTLED = 1.5; // time after which B is said to rest, or to ring [s]
const JUDGED = 4; // time after which a B that rings is replaced: it does not settle [s]

// Return both laws with stiffness and edge [N/m]. `rang` has those that rang as B: below its edge a
// law can still bounce off the wall for good.
export function plan({ laws, named = Object.keys(laws), active }, edges, rang = []) {
  const a = named.find((name) => laws[name]?.kind === "pd") ?? active, edge = edges[a];
  const others = Object.keys(laws).filter((name) => name !== a && edges[name]);
  if (!edge || laws[a].stiffness === undefined || !others.length) throw new Error("No law here has an edge to go past.");
  const stiffness = Number((OVER * edge).toPrecision(3)), most = others.sort((x, y) => edges[y] - edges[x]);
  const every = SAFE.flatMap((part) => TIMES.flatMap((times) => most.map((beside) => ({ beside, times, part }))));
  const b = every.find(({ beside, times, part }) => times * stiffness <= part * edges[beside]
    && !rang.some((one) => one.beside === beside && one.times <= times));
  if (!b) throw new Error(`At this delay no other law ${rang.length ? "rests" : "is safe"} at the stiffness at which ${a} sings.`);
  const { beside, times } = b;
  return { law: a, stiffness, edge, beside, hardness: times * stiffness, besideEdge: edges[beside], times, scaled: laws[beside].stiffness === undefined };
}

function figures({ frequency, force }) { return `at ${fixed(frequency, 0)} Hz, up to ${fixed(force, 1)} N`; }

// Target of a hand that presses into a surface [m], a time after its begin [s]; null when it is done.
export function pressed(time, { at, side }) {
  return time >= PRESS ? null : at + side * (OUTSIDE - Math.min(1, time / EASE) * (OUTSIDE + DEPTH));
}

export class Sing {
  // `page`: ask, state (laws), edgesAt (delay), stopped, soft, compared, surface, hand.
  constructor({ button, told, beyond }, page) {
    Object.assign(this, { button, told, beyond, page, facts: null, pressing: null });
    button.addEventListener("click", async () => {
      button.disabled = true;
      try { await this.begin(); } catch (error) { this.say(error.message); }
      button.disabled = false;
    });
  }

  start(hello) {
    this.button.hidden = !hello.sings;
    this.delays = hello.delays;
    this.leave();
    this.facts = null;
    this.show(null);
  }

  async ask(request) {
    const answer = await this.page.ask(request);
    if (!answer.ok) throw new Error(answer.error);
  }

  compare({ beside, hardness, scaled }) {
    return this.ask({ op: "compare", law: beside, [scaled ? "hardness" : "stiffness"]: hardness });
  }

  // Put the next law beside A, because this one rings below its edge.
  async next() {
    const { facts } = this, { beside, times } = facts, rang = [...facts.rang, { beside, times }];
    this.leave();
    try {
      const found = plan(this.page.state(), facts.edges, rang);
      this.facts = { ...facts, ...found, rang, asked: performance.now(), begun: Infinity, seen: false };
      this.show(null);
      await this.compare(found);
    } catch (error) {
      this.facts = null;
      this.say(error.message);
    }
  }

  async begin() {
    const { page } = this, ask = (request) => this.ask(request);
    this.leave();
    this.facts = null;
    const { device_delay: delay, active } = page.state();
    if (page.stopped()) await ask({ op: "again", ...page.soft() });
    const later = this.delays && delay < HALF_LATE ? HALF_LATE : delay;
    if (later !== delay) await ask({ op: "delay", ticks: later, beyond: true });
    this.say("Looking for the edges at this delay …");
    const edges = await page.edgesAt(later), facts = plan(page.state(), edges), { law, stiffness } = facts;
    if (active !== law) await ask({ op: "switch", law, ramp: 0, beyond: true });
    // A is past its edge now, so the dials show what lies there.
    this.beyond.checked = true;
    await ask({ op: "law", field: "stiffness", value: stiffness, beyond: true, law });
    await this.compare(facts);
    this.beyond.dispatchEvent(new Event("change"));
    this.facts = { ...facts, edges, rang: [], delay: later, asked: performance.now(), begun: Infinity, sang: null, seen: false };
    this.show(null);
  }

  // Press once B is played, too; its player takes a second to start.
  press() {
    const begun = this.facts.begun = performance.now(), surface = this.page.surface();
    if (!surface) return;
    const step = () => {
      const target = pressed((performance.now() - begun) / 1e3, surface);
      if (target === null) this.leave(); else this.page.hand(target);
    };
    this.pressing = setInterval(step, EVERY);
    step();
  }

  // Let go; a visitor's own hand takes over without.
  leave(taken = false) {
    if (this.pressing === null) return;
    clearInterval(this.pressing);
    this.pressing = null;
    if (!taken) this.page.hand(null);
  }

  // Say what both do, by what was detected; nothing once a law or its stiffness is another one.
  status({ sings, safety }, law, stiffness, beside) {
    const { facts } = this;
    if (!facts) return;
    const same = law === facts.law && stiffness === facts.stiffness && beside === facts.beside;
    // The change itself may come after the answer to it.
    if (!same && (facts.seen || performance.now() - facts.asked > WAITS)) {
      this.facts = null;
      this.leave();
      return this.show(null);
    }
    facts.seen ||= same;
    if (facts.begun === Infinity && (this.page.compared() || performance.now() - facts.asked > B_WAITS)) this.press();
    facts.sang = sings?.a || facts.sang;
    facts.stopped = safety === "stopped";
    // Under the page's own hand only: what a visitor does may shake B.
    if (sings?.b && facts.seen && this.pressing !== null && performance.now() - facts.begun > 1e3 * JUDGED) this.next();
    else this.show(sings);
  }

  say(text) {
    this.told.hidden = false;
    this.told.textContent = unbroken(text);
  }

  show(sings) {
    const { facts } = this;
    this.told.hidden = facts === null;
    if (!facts) return;
    const times = facts.times === 1 ? "as stiff" : `${["", "", "twice", "three times"][facts.times]} as stiff`;
    const late = `The answer comes ${fixed(facts.delay, 1)} ticks late.`, sang = facts.sang && figures(facts.sang);
    const past = performance.now() - facts.begun, over = past > 1e3 * PRESS && this.pressing === null;
    const does = facts.stopped && sang ? `sang ${sang}, until the driver stopped it` : sings?.a ? `sings ${sang}`
      : sang && over ? `sang ${sang}` : facts.begun === Infinity ? "waits" : "is pressed";
    const other = !this.page.compared() ? "is coming" : past < 1e3 * SETTLED ? "is pressed by the same hand"
      : sings?.b ? `rings ${figures(sings.b)}` : over ? "rested" : "rests";
    this.say(`${late} A, ${facts.law} at ${figure(facts.stiffness)} N/m (edge ${rough(facts.edge)}), ${does}. B, ${facts.beside} at ${figure(facts.hardness)} N/m (edge ${rough(facts.besideEdge)}), ${times}, ${other}.`);
  }
}
