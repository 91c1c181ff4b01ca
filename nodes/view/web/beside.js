// A | B comparison: draw what the same hand feels with another law, simulated beside the launch.
import { fixed, unbroken } from "./format.js";

const KEPT = 8000;

export class Beside {
  constructor({ other, told }, ask) {
    Object.assign(this, { other, told, ask, law: "", times: [], places: [], forces: [], axis: 0 });
    other.addEventListener("change", () => this.choose(other.value));
  }

  start(hello) {
    this.offered = hello.compares;
    this.other.parentElement.hidden = !hello.compares;
    this.clear();
  }

  async choose(law) {
    const answer = await this.ask({ op: "compare", law });
    if (!answer.ok) this.other.value = this.law;
  }

  laws(names) {
    if (names.join() === this.names) return;
    this.names = names.join();
    this.other.replaceChildren(new Option("nothing", ""), ...names.map((name) => new Option(name)));
    this.other.value = this.law;
  }

  clear() { this.times = []; this.places = []; this.forces = []; this.look(this.axis); }

  // Choose the axis whose curves are drawn; a launch of one axis has single numbers.
  look(axis) {
    const along = (each) => (Array.isArray(each) ? each[axis] : each);
    this.axis = axis;
    this.position = this.places.map(along);
    this.force = this.forces.map(along);
  }

  // Replace samples that overlap.
  show({ law, t, period, position, force, why }) {
    if (law !== this.law) this.clear();
    this.law = this.other.value = law;
    this.told.textContent = why ?? (law ? "coming …" : "");
    if (!position) return;
    while (this.times.length && this.times[this.times.length - 1] >= t - period / 2) { this.times.pop(); this.places.pop(); this.forces.pop(); }
    position.forEach((x, k) => { this.times.push(t + k * period); this.places.push(x); this.forces.push(force[k]); });
    const over = this.times.length - KEPT;
    if (over > 0) for (const list of [this.times, this.places, this.forces]) list.splice(0, over);
    this.look(this.axis);
    const strongest = force.reduce((most, each) => Math.max(most, Math.hypot(...[each].flat())), 0);
    this.told.textContent = unbroken(`up to ${fixed(strongest, 2)} N`);
  }

  get on() { return this.law !== "" && this.times.length > 0; }

  // Return the samples of a time span; B's arrive a little later than A's.
  at(t) {
    if (!this.on || t < this.times[0]) return null;
    let low = 0, high = this.times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= t) low = middle; else high = middle - 1;
    }
    return { t: this.times[low], position: this.position[low], force: this.force[low], place: this.places[low], whole: this.forces[low] };
  }
}
