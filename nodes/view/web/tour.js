// Tour: sentences, each with an action; the next one appears when it is done, the last says what was
// seen.
import { rough, unbroken } from "./format.js";

export class Tour {
  constructor({ tour, sentence, act, leave, begin }, page) {
    Object.assign(this, { place: tour, sentence, act, page, at: -1 });
    begin.addEventListener("click", () => this.go(this.at < 0 ? 0 : -1));
    leave.addEventListener("click", () => this.go(-1));
    act.addEventListener("click", () => this.steps()[this.at].action?.());
    this.begin = begin;
    setInterval(() => {
      if (this.at < 0) return;
      if (this.steps()[this.at].done()) this.go(this.at + 1); else this.write();
    }, 200);
  }

  steps() {
    const { page } = this, { dial, delay } = page, below = () => !page.stopped() && dial.edge !== null && dial.stiffness < dial.edge;
    const [mine, other] = page.edges(), both = mine.edge !== null && other.edge !== null;
    const drawn = `${other.name || "The other law"} is drawn beside yours now, under the same hand${both ? `; at this delay it bears ${rough(other.edge)} N/m, ${mine.name} ${rough(mine.edge)}` : ""}:`;
    const steps = [
      { text: "A computer pushes back 500 times a second, and that is a wall. Touch it: pull the handle into the grey.",
        done: () => page.touched() },
      { text: "The stiffer its spring, the harder the wall. Make it harder: turn the dial up to its end.",
        action: () => dial.set(dial.edge * 0.9), label: "Turn it up", done: () => dial.edge !== null && dial.stiffness > 0.7 * dial.edge },
      { text: "Each answer comes a little late, so too hard a wall pushes out more than was put in, and sings. Go past the edge and touch it.",
        action: () => dial.let(1.6), label: "Too hard", done: () => page.stopped() || (dial.isPast(dial.stiffness) && page.rings()), needs: dial.allowed.hidden === false },
      { text: "The later the answer, the softer a wall has to be: in the map the edge comes down as the delay grows. Go back below it, then let the answer come later.",
        action: () => (below() ? delay.set(0.5 * delay.most()) : page.calm()), label: below() ? "Later" : "Back below", done: () => below() && (!delay.offered || delay.ticks >= 0.3) },
      { text: "Another law bears more at the same delay. Put one beside yours: the same hand, felt twice.",
        action: () => page.compare(), label: "Compare", done: () => page.compared() },
      { text: `You have felt a wall, heard it sing past its edge, and seen the edge come down with the delay. ${drawn} the law decides how hard a wall can be.`,
        action: () => this.go(-1), label: "Done", done: () => false },
    ];
    return steps.filter(({ needs }) => needs !== false);
  }

  go(at) {
    this.at = at >= this.steps().length ? -1 : at;
    this.place.hidden = this.at < 0;
    this.begin.setAttribute("aria-pressed", this.at >= 0);
    if (this.at >= 0) this.write();
  }

  write() {
    const steps = this.steps(), { text, label = "" } = steps[this.at], told = unbroken(`${this.at + 1} of ${steps.length}. ${text}`);
    // Unchanged, it is not read out again.
    if (this.sentence.textContent !== told) this.sentence.textContent = told;
    this.act.hidden = !label;
    if (this.act.textContent !== label) this.act.textContent = label;
  }
}
