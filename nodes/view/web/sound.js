// Make the loop audible, and tangible on phones; off until clicked.
const KNOCK = 0.5;

export class Sound {
  constructor(button) {
    Object.assign(this, { button, on: false, node: null, context: null, touched: false, fed: 0 });
    button.addEventListener("click", () => this.set(!this.on));
  }

  // With several axes, use the force's magnitude: ringing may occur along any axis.
  start(store, axes) {
    this.store = store;
    this.series = axes.map((letter) => store.index(`force.${letter}`));
    this.from = store.head;
  }

  async set(on) {
    this.on = on;
    this.button.setAttribute("aria-pressed", on);
    if (!on) return this.context?.suspend();
    if (!this.context) {
      this.context = new AudioContext();
      try {
        await this.context.audioWorklet.addModule("voice_worklet.js");
      } catch {
        // A page opened as a file may not load it.
        Object.assign(this, { on: false, context: null });
        Object.assign(this.button, { disabled: true, title: "No sound: a browser plays it only from a web address, not from a file" });
        this.button.setAttribute("aria-pressed", false);
        return undefined;
      }
      this.node = new AudioWorkletNode(this.context, "voice", { outputChannelCount: [1] });
      this.node.connect(this.context.destination);
    }
    this.from = this.store.head;
    return this.context.resume();
  }

  // Called with new bins: each becomes one sample, the stronger of its two values. A recording is
  // heard up to the cursor.
  hear(until = Infinity) {
    const { store } = this, head = !store ? 0 : until < store.end ? store.find(until) : store.head;
    if (!this.on || !this.node || this.from > head) { this.from = head; return; }
    const count = head - this.from, times = new Float64Array(count), forces = new Float32Array(count);
    for (let k = 0; k < count; k++) {
      const n = (this.from + k) % store.size;
      const along = this.series.map((series) => (Math.abs(store.low[series][n]) > Math.abs(store.high[series][n]) ? store.low : store.high)[series][n]);
      times[k] = store.times[n];
      forces[k] = along.length > 1 ? Math.hypot(...along) : along[0];
      if (Number.isNaN(forces[k])) forces[k] = 0;
    }
    this.from = head;
    this.knock(forces);
    this.fed += count;
    this.last = { times, forces };
    this.node.port.postMessage(this.last);
  }

  knock(forces) {
    const strongest = forces.reduce((most, force) => Math.max(most, Math.abs(force)), 0);
    if (strongest > KNOCK && !this.touched) navigator.vibrate?.(Math.min(40, 8 + 4 * strongest));
    this.touched = strongest > 0;
  }
}
