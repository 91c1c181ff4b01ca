// Convert the loop's force to a tone, about 50 ms late. The force itself is inaudible on a laptop: a
// ring lies at 20 Hz. So its changes modulate a tone: a ring is a siren, a knock a click, a clean
// contact soft, a constant force silent.
const BEHIND = 0.05, KEPT = 4096;
// Pitch without force [Hz], octaves that a change of force moves it at most, and loudness per newton.
const PITCH = 440, OCTAVES = 1, LOUD = 0.25;
// Times after which a change counts as constant, and over which the tone dies away [s].
const FORGETS = 0.03, FADES = 0.02;

export class Voice {
  // `rate`: sample rate of the sound card [Hz].
  constructor(rate) {
    Object.assign(this, { rate, times: new Float64Array(KEPT), forces: new Float32Array(KEPT), head: 0, at: null, before: 0, steady: 0, loud: 0, phase: 0 });
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

  // Fill a block of the sound card.
  fill(block) {
    const keeps = Math.exp(-1 / (this.rate * FORGETS)), fades = Math.exp(-1 / (this.rate * FADES));
    for (let k = 0; k < block.length; k++) {
      if (this.at === null) { block[k] = 0; continue; }
      const force = this.force();
      this.steady = force - this.before + keeps * this.steady;
      this.before = force;
      this.loud = Math.max(Math.abs(this.steady), fades * this.loud);
      this.phase += (PITCH / this.rate) * 2 ** (OCTAVES * Math.tanh(this.steady));
      this.phase -= Math.floor(this.phase);
      block[k] = Math.tanh(LOUD * this.loud) * Math.sin(2 * Math.PI * this.phase);
      // Wait for lost values instead of guessing them.
      if (this.next < this.head) this.at += 1 / this.rate;
    }
  }
}
