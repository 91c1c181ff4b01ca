// The last moments before a stop, played again from what the page has kept, slowly.
const BEFORE = 0.3, MARGIN = 0.04, SLOWER = 15;

export class SlowMotion {
  constructor() { this.run = null; }

  // Waits until the bins of the stop have come.
  start(store, axis, { t, span_s: span }, surface) {
    this.run = { store, axis, from: t - Math.max(BEFORE, span + MARGIN), to: t + MARGIN, surface, begun: null };
  }

  again() { if (this.run) this.run.begun = performance.now(); }

  end() { this.run = null; }

  get on() { return this.run !== null; }

  // Where it is: the window and the time in it. It stays at its end until it is ended.
  window() {
    const { run } = this;
    if (!run || run.store.end < run.to) return null;
    run.begun ??= performance.now();
    return { sight: [run.from, run.to], at: Math.min(run.to, run.from + (performance.now() - run.begun) / 1e3 / SLOWER) };
  }

  // What the scene shows at a time, put together from the bins.
  now(at) {
    const { store, axis, surface } = this.run, n = Math.min(store.find(at), store.head - 1) % store.size;
    const along = (name) => [..."xyz"].map((letter) => {
      const i = store.index(`${name}.${letter}`);
      if (i < 0) return 0;
      // The stronger of a bin's two values: a spike is what is looked for here.
      const low = store.low[i][n], high = store.high[i][n];
      return Math.abs(low) > Math.abs(high) ? low : high;
    });
    const position = along("position"), normal = [0, 0, 0];
    const distance = surface ? (position[axis] - surface.at) * surface.side : NaN;
    if (surface) normal[axis] = surface.side;
    return {
      t: store.times[n], position, proxy: along("proxy"), normal, asked: along("law_force"), force: along("force"), target: along("target"),
      distance, contact: Number(distance < 0), delay: NaN,
    };
  }
}
