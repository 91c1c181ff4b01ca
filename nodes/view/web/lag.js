// Measure the latency from a hand movement to the driver's force and to the picture.
const KEPT = 200, MOVED = 1e-3, THERE = 5e-4;

export class Lag {
  constructor() { Object.assign(this, { all: [], forces: [], sent: null, seen: null, axis: 0, back: Infinity }); }

  // Start following a target [m], one at a time, along the visible axis; a repeated target is
  // ignored.
  leave(target) {
    if (target === null) this.sent = null;
    else if (this.sent === null && this.seen !== null && Math.abs(target[this.axis] - this.seen) > MOVED) this.sent = { wanted: target[this.axis], at: performance.now() };
  }

  // Find the first bin in which the driver's target passes the sent one; `index` is the target's
  // series.
  arrive({ now: { t, target }, times, count, low, high }, axis, index) {
    const here = performance.now(), { sent } = this;
    Object.assign(this, { axis, seen: target[axis] });
    // The return path in the page's time: the shortest so far, so the force latency is an upper
    // estimate.
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
