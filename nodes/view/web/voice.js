// From the loop's forces to sound: what is heard is the force itself, 500 samples a second, some 50 ms late.
const BEHIND = 0.05, KEPT = 4096, LOUD = 0.25;

export class Voice {
  // `rate` is the sound card's [Hz].
  constructor(rate) {
    Object.assign(this, { rate, times: new Float64Array(KEPT), forces: new Float32Array(KEPT), head: 0, at: null, before: 0, steady: 0 });
  }

  // One value per tick of the run [s, N].
  feed(times, forces) {
    for (let k = 0; k < times.length; k++) {
      this.times[this.head % KEPT] = times[k];
      this.forces[this.head % KEPT] = forces[k];
      this.head++;
    }
    const newest = times[times.length - 1];
    // In the beginning, after silence or a seek, and when it has run away: so far behind the newest, from here on.
    if (newest !== undefined && (this.at === null || Math.abs(newest - BEHIND - this.at) > 4 * BEHIND)) {
      this.at = newest - BEHIND;
      this.next = Math.max(0, this.head - KEPT);
    }
  }

  // The force at the moment that is heard [N]: straight between two ticks.
  force() {
    while (this.next < this.head && this.times[this.next % KEPT] <= this.at) this.next++;
    const after = this.next % KEPT, before = (this.next + KEPT - 1) % KEPT;
    if (this.next >= this.head || this.next === 0) return this.forces[before];
    const part = (this.at - this.times[before]) / (this.times[after] - this.times[before]);
    return this.forces[before] + (this.forces[after] - this.forces[before]) * Math.max(0, part);
  }

  // Fill a block of the sound card. A force that stays is silent: only its changes are heard.
  fill(block) {
    for (let k = 0; k < block.length; k++) {
      if (this.at === null) { block[k] = 0; continue; }
      const force = this.force();
      this.steady = force - this.before + 0.998 * this.steady;
      this.before = force;
      block[k] = Math.tanh(LOUD * this.steady);
      // What is lost is waited for, not guessed.
      if (this.next < this.head) this.at += 1 / this.rate;
    }
  }
}
