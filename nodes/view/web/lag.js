// How long after the hand has moved the driver's force is that of its new place, and the picture shows it.
const KEPT = 200, MOVED = 1e-3, THERE = 5e-4;

export class Lag {
  constructor() { Object.assign(this, { all: [], forces: [], sent: null, seen: null, axis: 0, back: Infinity }); }

  // A target that leaves now [m]; one at a time is followed, along the axis that is looked at. One that is renewed tells nothing.
  leave(target) {
    if (target === null) this.sent = null;
    else if (this.sent === null && this.seen !== null && Math.abs(target[this.axis] - this.seen) > MOVED) this.sent = { wanted: target[this.axis], at: performance.now() };
  }

  // The first bin in which the driver's hand comes by what was sent; `index` is that of the series of its target.
  arrive({ now: { t, target }, times, count, low, high }, axis, index) {
    const here = performance.now(), { sent } = this;
    Object.assign(this, { axis, seen: target[axis] });
    // The way back, in the page's time: the shortest so far, so that what is told of the force is rather too long.
    if (Number.isFinite(t)) this.back = Math.min(this.back, here - 1e3 * t);
    if (!sent) return;
    const least = low(index), most = high(index);
    let k = 0;
    while (k < count && !(least[k] - THERE <= sent.wanted && sent.wanted <= most[k] + THERE)) k++;
    if (k < count) {
      this.all = [...this.all.slice(1 - KEPT), here - sent.at];
      this.forces = [...this.forces.slice(1 - KEPT), Math.max(0, 1e3 * times[k] + this.back - sent.at)];
    }
    if (k < count || here - sent.at > 1000) this.sent = null;
  }

  get median() { return middle(this.all); }
  get force() { return middle(this.forces); }
}

function middle(all) { return all.length ? [...all].sort((a, b) => a - b)[all.length >> 1] : null; }
