// Convert the loop's force to sound: the force itself, 500 samples a second, about 50 ms late.
const BEHIND = 0.05, KEPT = 4096, LOUD = 0.25;

export class Voice {
  // `rate`: sample rate of the sound card [Hz].
  constructor(rate) {
    Object.assign(this, { rate, times: new Float64Array(KEPT), forces: new Float32Array(KEPT), head: 0, at: null, before: 0, steady: 0 });
  }

  // Add one value per tick of the run [s, N].
  feed(times, forces) {
    for (let k = 0; k < times.length; k++) {
      this.times[this.head % KEPT] = times[k];
      this.forces[this.head % KEPT] = forces[k];
      this.head++;
    }
    const newest = times[times.length - 1];
    // Synchronise at the start, after silence or a seek, and when too far behind the newest value.
    if (newest !== undefined && (this.at === null || Math.abs(newest - BEHIND - this.at) > 4 * BEHIND)) {
      this.at = newest - BEHIND;
      this.next = Math.max(0, this.head - KEPT);
    }
  }

  // Force at the moment heard [N], linear between two ticks.
  force() {
    while (this.next < this.head && this.times[this.next % KEPT] <= this.at) this.next++;
    const after = this.next % KEPT, before = (this.next + KEPT - 1) % KEPT;
    if (this.next >= this.head || this.next === 0) return this.forces[before];
    const part = (this.at - this.times[before]) / (this.times[after] - this.times[before]);
    return this.forces[before] + (this.forces[after] - this.forces[before]) * Math.max(0, part);
  }

  // Fill a block of the sound card. A constant force is silent: only changes are heard.
  fill(block) {
    for (let k = 0; k < block.length; k++) {
      if (this.at === null) { block[k] = 0; continue; }
      const force = this.force();
      this.steady = force - this.before + 0.998 * this.steady;
      this.before = force;
      block[k] = Math.tanh(LOUD * this.steady);
      // Wait for lost values instead of guessing them.
      if (this.next < this.head) this.at += 1 / this.rate;
    }
  }
}
