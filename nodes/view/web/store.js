// Ring buffer of bins, each series with its smallest and largest value; of fixed size.
export class Store {
  constructor(names, binSeconds, seconds) {
    this.names = names;
    this.size = Math.ceil(seconds / binSeconds) + 64;
    this.times = new Float64Array(this.size);
    this.low = names.map(() => new Float32Array(this.size));
    this.high = names.map(() => new Float32Array(this.size));
    this.clear();
  }

  clear() { this.head = 0; }

  index(name) { return this.names.indexOf(name); }

  add(frame) {
    if (frame.void) this.clear();
    for (let k = 0; k < frame.count; k++) this.times[(this.head + k) % this.size] = frame.times[k];
    for (let i = 0; i < this.names.length; i++) {
      const low = frame.low(i), high = frame.high(i);
      for (let k = 0; k < frame.count; k++) {
        const slot = (this.head + k) % this.size;
        this.low[i][slot] = low[k];
        this.high[i][slot] = high[k];
      }
    }
    this.head += frame.count;
  }

  get first() { return Math.max(0, this.head - this.size + 1); }
  get begin() { return this.head ? this.times[this.first % this.size] : 0; }
  get end() { return this.head ? this.times[(this.head - 1) % this.size] : 0; }

  // Return the number of the first bin at or after a time.
  find(time) {
    let low = this.first, high = this.head;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle % this.size] < time) low = middle + 1; else high = middle;
    }
    return low;
  }

  // Copy the bins of a time span and one more on each side, because the ring overwrites them later.
  part(from, to) {
    const first = Math.max(this.first, this.find(from) - 1), count = Math.max(0, Math.min(this.head, this.find(to) + 2) - first);
    const cut = (ring) => Float64Array.from({ length: count }, (_, k) => ring[(first + k) % this.size]), found = new Store(this.names, 1, count);
    found.add({ count, times: cut(this.times), low: (i) => cut(this.low[i]), high: (i) => cut(this.high[i]) });
    return found;
  }

  // Columns of a plot: smallest and largest value of all bins in a column, two points each. A spike
  // is never lost.
  columns(series, from, to, count) {
    const width = (to - from) / count;
    const x = [], y = series.map(() => []);
    let column = -Infinity;
    const low = series.map(() => NaN), high = series.map(() => NaN);
    const flush = () => {
      if (column === -Infinity) return;
      const at = (column + 0.5) * width;
      x.push(at, at);
      for (let s = 0; s < series.length; s++) {
        // Without a known order, a column shows its smallest value first.
        y[s].push(Number.isNaN(low[s]) ? null : low[s], Number.isNaN(high[s]) ? null : high[s]);
        low[s] = high[s] = NaN;
      }
    };
    const end = Math.min(this.head, this.find(to) + 1);
    for (let n = Math.max(this.first, this.find(from) - 1); n < end; n++) {
      const slot = n % this.size, here = Math.floor(this.times[slot] / width);
      if (here !== column) { flush(); column = here; }
      for (let s = 0; s < series.length; s++) {
        const a = this.low[series[s]][slot], b = this.high[series[s]][slot];
        if (!(a >= low[s])) if (!Number.isNaN(a)) low[s] = a;
        if (!(b <= high[s])) if (!Number.isNaN(b)) high[s] = b;
      }
    }
    flush();
    return [x, ...y];
  }
}
