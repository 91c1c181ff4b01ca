// Another recording, drawn over the one that is shown.
export class Over {
  // Its name, times [s] and values by kind and axis, as the server sends them.
  constructor({ name, times, position, force }) {
    Object.assign(this, { name, times, position, force, on: times.length > 0 });
  }

  curve(kind, letter) { return this[kind]?.[letter] ?? null; }

  // Times and values of a span, with one more on each side.
  part(kind, letter, from, to) {
    const values = this.curve(kind, letter);
    if (!values) return null;
    const find = (t) => {
      let low = 0, high = this.times.length;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.times[middle] < t) low = middle + 1; else high = middle;
      }
      return low;
    };
    const first = Math.max(0, find(from) - 1), last = find(to) + 1;
    return { times: this.times.slice(first, last), values: values.slice(first, last) };
  }
}
