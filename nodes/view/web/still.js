// Whether what comes differs visibly from what came before, so that a loop at rest costs nothing.
const NEAR = 2e-5, WEAK = 0.01; // differences that nobody sees [m], [N]
const LENGTHS = ["position", "proxy", "target"], FORCES = ["force", "asked"];

export class Still {
  constructor() { this.shown = null; }

  // Compare a frame with the last one that differed; a spike within its bins counts, too. `axes`:
  // number of axes; of each series there is one an axis, three of lengths before two of forces.
  is({ now, count, low, high }, axes) {
    const { shown } = this;
    const same = shown !== null && now.contact === shown.contact
      && LENGTHS.every((name) => alike(now[name], shown[name], NEAR)) && FORCES.every((name) => alike(now[name], shown[name], WEAK));
    if (!same) this.shown = now;
    for (let i = 0; same && i < 5 * axes; i++) if (spikes(count, low(i), high(i), i < 3 * axes ? NEAR : WEAK)) return false;
    return same;
  }
}

function alike(a, b, most) { return [0, 1, 2].every((k) => Math.abs(a[k] - b[k]) <= most || Number.isNaN(a[k]) === Number.isNaN(b[k]) && !Number.isFinite(a[k] - b[k])); }

function spikes(count, low, high, most) {
  let least = Infinity, largest = -Infinity;
  for (let k = 0; k < count; k++) {
    if (low[k] < least) least = low[k];
    if (high[k] > largest) largest = high[k];
  }
  return largest - least > most;
}
