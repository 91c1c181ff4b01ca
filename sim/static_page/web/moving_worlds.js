// Largest K certified for any passive world that answers in the same tick, on a known device, as
// nodes/stability finds it (loop_region.py, k_window.py). With H = K + h, the loop cannot oscillate
// at ωT iff a K² + b K + c > 0; the limit is the top of the lowest gap between the excluded K.

// D'P at an angle: the position's step over the force, exact at small angles: [real, imaginary].
const knownAnswer = (device) => {
  const { period, delay } = device, whole = Math.floor(delay), part = delay - whole;
  const [a11, a12, a21, a22, g1, g2] = deviceMap(device, period);
  let now = [g1, g2], old = [0, 0];
  if (part > 0) {
    const late = deviceMap(device, (1 - part) * period), early = deviceMap(device, part * period);
    now = [late[4], late[5]];
    old = [late[0] * early[4] + late[1] * early[5], late[2] * early[4] + late[3] * early[5]];
  }
  return (theta) => {
    const c = Math.cos(theta), s = Math.sin(theta), aheadR = -2 * Math.sin(0.5 * theta) ** 2;
    const xr = now[0] + c * old[0], xi = -s * old[0], vr = now[1] + c * old[1], vi = -s * old[1];
    const er = aheadR + (1 - a22); // z − a22, whose imaginary part is s
    const tr = er * xr - s * xi + a12 * vr, ti = er * xi + s * xr + a12 * vi;
    const wr = Math.cos((whole + 1) * theta), wi = -Math.sin((whole + 1) * theta);
    let nr = wr * tr - wi * ti, ni = wr * ti + wi * tr, dr = er, di = s;
    if (device.stiffness !== 0) {
      const fr = aheadR + (1 - a11);
      [nr, ni] = [nr * aheadR - ni * s, nr * s + ni * aheadR];
      [dr, di] = [fr * er - s * s - a12 * a21, s * (fr + er)];
    }
    const q = dr * dr + di * di;
    return [(nr * dr + ni * di) / q, (ni * dr - nr * di) / q];
  };
};

// Coefficients of the inequality at an angle: {theta, a, b, c}.
const inequality = (known, law) => (theta) => {
  const c = Math.cos(theta), s = Math.sin(theta), [h, g] = response(law, c, s);
  const step = 2 * Math.sin(0.5 * theta) ** 2, [room] = known(theta);
  return { theta, a: room, b: 2 * room * h + step, c: room * (h * h + g * g) + step * h + s * g };
};

// `count` numbers from `low` to `high` in a constant ratio.
const geometric = (low, high, count) =>
  Array.from({ length: count }, (_, i) => low * (high / low) ** (i / (count - 1)));

// Angles that resolve every turn of device and law, those at which the wall's loop oscillates too.
const movingAngles = (device, law, swings) => {
  const { period, mass, damping, stiffness, delay } = device, found = [];
  const turns = 16 * (law.taps.length + Math.ceil(delay) + 8);
  for (let i = 1; i <= turns; i++) found.push((Math.PI * i) / turns);
  const lowest = Math.min(1e-6, Math.max((1e-3 * damping * period) / mass, 1e-9));
  found.push(...geometric(lowest, Math.PI, law.sections.length ? 2001 : 801));
  const around = (at, aways) => {
    for (const away of [0, ...aways]) found.push(at - away, at + away);
  };
  const rings = period * Math.sqrt(stiffness / mass);
  if (rings > 0) around(rings, geometric(1e-6, 0.5, 60).map((by) => by * rings));
  for (const { theta } of swings) around(theta, geometric(1e-9, 1e-2, 22).map((by) => by * theta));
  for (let n = 0; n < law.sections.length; n += 4) {
    const a1 = law.sections[n + 2], a2 = law.sections[n + 3], square = 0.25 * a1 * a1 - a2;
    const poles = square < 0 ? [[Math.sqrt(a2), Math.acos(-0.5 * a1 / Math.sqrt(a2))]]
      : [1, -1].map((sign) => -0.5 * a1 + sign * Math.sqrt(square)).map((z) => [Math.abs(z), z < 0 ? Math.PI : 0]);
    for (const [size, angle] of poles) {
      around(angle, geometric(0.05 * Math.max(1 - size, 1e-12), Math.PI, 80));
    }
  }
  return [...new Set(found.filter((theta) => theta > 0 && theta <= Math.PI))].sort((x, y) => x - y);
};

// Discriminant and sorted roots; without real roots both are their common real part.
const rootsOf = ({ a, b, c }) => {
  const square = b * b - 4 * a * c;
  const half = -0.5 * (b + (b < 0 ? -1 : 1) * Math.sqrt(Math.max(square, 0)));
  const first = half / a, second = half === 0 ? 0 : c / half;
  return [square, Math.min(first, second), Math.max(first, second)];
};

// Gaps of K above `floor` that no angle excludes: [low, high].
const gapsOf = (rows, floor) => {
  let low = floor, high = Infinity;
  const ends = [];
  for (const row of rows) {
    const { a, b, c } = row, [square, below, above] = rootsOf(row);
    if (!Number.isFinite(a + b + c)) return [];
    if (a > 0) {
      if (square > 0) ends.push([below, above]);
    } else if (a < 0) {
      if (square < 0) return [];
      low = Math.max(low, below);
      high = Math.min(high, above);
    } else if (b > 0) low = Math.max(low, -c / b);
    else if (b < 0) high = Math.min(high, -c / b);
    else if (c <= 0) return [];
  }
  const gaps = [];
  for (const [start, end] of ends.sort((x, y) => x[0] - y[0] || x[1] - y[1])) {
    if (end <= low || start >= high) continue;
    if (start > low) gaps.push([low, start]);
    low = Math.max(low, end);
  }
  return low < high ? [...gaps, [low, high]] : gaps;
};

// Gaps divided at the K at which the wall's loop oscillates.
const dividedGaps = (gaps, swings) => gaps.flatMap(([low, high]) => {
  const inner = [...new Set(swings.map(({ k }) => k).filter((k) => low < k && k < high))].sort((x, y) => x - y);
  return [low, ...inner].map((start, n) => [start, inner[n] ?? high]);
});

const DIPS = 8, ZOOMS = 8, CELLS = 17, EXCHANGES = 60, HALVINGS = 40;

// Angles of the deepest dips at which the inequality fails beyond rounding.
const violatedAngles = (rows, at, k) => {
  const margin = ({ theta, a, b, c }) => {
    const value = ((a * k + b) * k + c) / Math.sin(0.5 * theta) ** 2;
    return Number.isNaN(value) ? Infinity : value;
  };
  const values = rows.map(margin), lowest = [];
  values.forEach((value, n) => {
    if (value <= (values[n - 1] ?? Infinity) && value <= (values[n + 1] ?? Infinity) && Number.isFinite(value)) lowest.push(n);
  });
  lowest.sort((x, y) => values[x] - values[y]).length = Math.min(DIPS, lowest.length);
  return lowest.map((n) => {
    let left = rows[Math.max(n - 1, 0)].theta, right = rows[Math.min(n + 1, rows.length - 1)].theta, best = null;
    for (let zoom = 0; zoom < ZOOMS; zoom++) {
      const width = (right - left) / (CELLS - 1);
      let least = Infinity;
      best = null;
      for (let i = 0; i < CELLS; i++) {
        const row = at(left + i * width), value = margin(row);
        if (best === null || value < least) [best, least] = [row, value];
      }
      [left, right] = [Math.max(left, best.theta - width), Math.min(right, best.theta + width)];
    }
    return best;
  }).filter(({ a, b, c }) =>
    (a * k + b) * k + c < -1e-12 * (Math.abs(a) * k * k + Math.abs(b * k) + Math.abs(c)));
};

// Rows joined by angle; angles that are there already are left out.
const joinedRows = (rows, more) => {
  const known = new Set(rows.map(({ theta }) => theta));
  const fresh = more.filter(({ theta }) => !known.has(theta) && known.add(theta));
  return fresh.length ? [...rows, ...fresh].sort((x, y) => x.theta - y.theta) : rows;
};

// Rows between neighbours whose excluded intervals are disjoint.
const unresolvedRows = (rows, at) => {
  const found = [], ends = rows.map(rootsOf), whole = ({ a }, [square]) => a > 0 && square > 0;
  for (let n = 0; n + 1 < rows.length; n++) {
    const [, below, above] = ends[n], [, nextBelow, nextAbove] = ends[n + 1];
    const left = rows[n].theta, right = rows[n + 1].theta;
    if (whole(rows[n], ends[n]) && whole(rows[n + 1], ends[n + 1]) && right - left > 1e-12 * right
      && (nextBelow > above || below > nextAbove)) found.push(at(0.5 * (left + right)));
  }
  return found;
};

// Largest K certified for moving worlds [N/m]; null if none is, or all are. `law`: without spring.
const movingLimit = (device, law) => {
  if (device.damping === 0) return null; // every proof needs the device's damping
  const held = heldDevice(device), swings = wallSwings(law, held);
  const at = inequality(knownAnswer(device), law), floor = Math.max(0, -restStiffness(law));
  let sum = floor + 1;
  law.taps.forEach((tap) => { sum += Math.abs(tap); });
  law.sections.forEach((each, i) => { if (i % 4 < 2) sum += Math.abs(each); });
  let rows = movingAngles(device, law, swings).map(at);
  for (let n = 0; n < HALVINGS; n++) {
    const between = unresolvedRows(rows, at);
    if (!between.length) break;
    rows = joinedRows(rows, between);
  }
  const refused = [];
  for (let n = 0; n < EXCHANGES; n++) {
    const gap = dividedGaps(gapsOf(rows, floor), swings).find(([low, high]) =>
      high - low > 1e-9 * sum && !refused.some((k) => low < k && k < high));
    if (!gap) return null;
    const [low, high] = gap, middle = high < Infinity ? 0.5 * (low + high) : 2 * low + 1e3;
    const tried = [low, middle, high].filter((k) => k > floor && k < Infinity);
    const joined = joinedRows(rows, tried.flatMap((k) => violatedAngles(rows, at, k)));
    if (joined !== rows) {
      rows = joined;
      continue;
    }
    const taps = Float64Array.from(law.taps);
    taps[0] += middle;
    if (isStableLoop(held, { taps, sections: law.sections })) return high < Infinity ? high : null;
    refused.push(middle);
  }
  return null;
};

const ANY_NEAR = 13, ANY_DELAYS = 9;

// Steps that add the limits for moving worlds to a map, as nodes/view/stability_map.py does; each
// takes a few ms, and the last one yields the map. Nothing for a map without a plane.
const movingSteps = function* (found, device, parts, law, world) {
  if (!found.edge || !world) return;
  const at = (damping) => withoutSpring(parts, { ...law, damping }, device.period);
  const far = found.over_delay.at(-1)[0], gains = [], later = [];
  const now = movingLimit(device, at(law.damping));
  for (let i = 0; i < ANY_NEAR; i++) {
    yield null;
    const damping = (found.near * i) / (ANY_NEAR - 1);
    gains.push([damping, movingLimit(device, at(damping))]);
  }
  for (let i = 0; i < ANY_DELAYS; i++) {
    yield null;
    // The limit falls fastest at small delays.
    const delay = far * (i / (ANY_DELAYS - 1)) ** 2;
    later.push([delay, movingLimit({ ...device, delay }, at(law.damping))]);
  }
  yield { ...found, world, k_max_any_world_n_per_m: now, any_world: gains, any_world_over_delay: later };
};
