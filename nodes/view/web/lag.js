// How long after the hand has moved the driver's force is that of its new place, and the picture shows it.
const KEPT = 200;

export class Lag {
  constructor() { Object.assign(this, { all: [], forces: [], sent: null, back: Infinity }); }

  // A target that leaves now [m]; one at a time is followed.
  leave(target) {
    if (target === null) this.sent = null;
    else if (this.sent === null) this.sent = { target: [...target], at: performance.now() };
  }

  // What the driver's hand has reached: at least as far on the way as what was sent. And the bins that tell when.
  arrive({ now: { t, target }, times, count, high }, series) {
    const here = performance.now();
    // The way back, in the page's time: the shortest so far, so that what is told of the force is rather too long.
    if (Number.isFinite(t)) this.back = Math.min(this.back, here - 1e3 * t);
    if (!this.sent || !target.every((each, k) => Math.abs(each - this.sent.target[k]) < 5e-4)) {
      if (this.sent && here - this.sent.at > 1000) this.sent = null;
      return;
    }
    this.all = [...this.all.slice(1 - KEPT), here - this.sent.at];
    const { axis, index } = series, there = high(index), wanted = this.sent.target[axis];
    let k = 0;
    while (k < count && Math.abs(there[k] - wanted) >= 5e-4) k++;
    this.forces = [...this.forces.slice(1 - KEPT), Math.max(0, 1e3 * (k < count ? times[k] : t) + this.back - this.sent.at)];
    this.sent = null;
  }

  get median() { return middle(this.all); }
  get force() { return middle(this.forces); }
}

function middle(all) { return all.length ? [...all].sort((a, b) => a - b)[all.length >> 1] : null; }
