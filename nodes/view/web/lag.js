// How long after the hand has moved the picture shows it: there and back through view, driver and browser.
const KEPT = 200;

export class Lag {
  constructor() { Object.assign(this, { all: [], sent: null }); }

  // A target that leaves now [m]; one at a time is followed.
  leave(target) {
    if (target === null) this.sent = null;
    else if (this.sent === null) this.sent = { target: [...target], at: performance.now() };
  }

  // What the driver's hand has reached: at least as far on the way as what was sent.
  arrive(target) {
    if (!this.sent || !target.every((each, k) => Math.abs(each - this.sent.target[k]) < 5e-4)) {
      if (this.sent && performance.now() - this.sent.at > 1000) this.sent = null;
      return;
    }
    this.all = [...this.all.slice(1 - KEPT), performance.now() - this.sent.at];
    this.sent = null;
  }

  get median() { return this.all.length ? [...this.all].sort((a, b) => a - b)[this.all.length >> 1] : null; }
}
