// Replay of the last moments before a stop, from the page's stored bins, slowly.
const BEFORE = 0.3, MARGIN = 0.04, SLOWER = 15;
// Smallest distance between proxy and device in contact [m]; above rounding errors.
const TOUCHED = 1e-7;

export class SlowMotion {
  constructor() { this.run = null; }

  // Wait for the bins of the stop, then store them. With several axes the proxy is at the surface.
  start(store, axis, { t, span_s: span }, surface) {
    this.run = { store, axis, from: t - Math.max(BEFORE, span + MARGIN), to: t + MARGIN, surface, begun: null };
  }

  again() { if (this.run?.begun) this.run.begun = performance.now(); }

  end() { this.run = null; }

  get on() { return this.run !== null; }

  // Return window, present time and bins. It stays at its end until closed; a page opened too late
  // has none.
  window() {
    const { run } = this;
    if (!run || (run.begun === null && run.store.end < run.to)) return null;
    if (run.begun === null) {
      if (run.store.begin > run.to) return this.end() ?? null;
      run.store = run.store.part(run.from, run.to);
      run.begun = performance.now();
    }
    return { sight: [run.from, run.to], at: Math.min(run.to, run.from + (performance.now() - run.begun) / 1e3 / SLOWER), store: run.store };
  }

  // Return the scene's state at a time, from the bins.
  now(at) {
    const { store, axis, surface } = this.run, n = Math.min(store.find(at), store.head - 1) % store.size;
    const along = (name) => [..."xyz"].map((letter) => {
      const i = store.index(`${name}.${letter}`);
      if (i < 0) return 0;
      // Use the stronger of a bin's two values, to show spikes.
      const low = store.low[i][n], high = store.high[i][n];
      return Math.abs(low) > Math.abs(high) ? low : high;
    });
    const position = along("position"), proxy = along("proxy"), out = proxy.map((each, k) => each - position[k]), deep = Math.hypot(...out);
    const normal = surface ? [0, 0, 0] : out.map((each) => (deep > TOUCHED ? each / deep : 0));
    const distance = surface ? (position[axis] - surface.at) * surface.side : deep > TOUCHED ? -deep : NaN;
    if (surface) normal[axis] = surface.side;
    return {
      t: store.times[n], position, proxy, normal, asked: along("law_force"), force: along("force"), target: along("target"),
      distance, contact: Number(distance < 0), delay: NaN,
    };
  }
}
