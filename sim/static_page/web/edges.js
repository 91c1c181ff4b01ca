// Stable stiffness of a law on a device with a delay, as nodes/stability/k_max.py finds it: all
// boundaries are real values of one curve on the unit circle; Schur–Cohn judges between them.
// A device is {period, mass, damping, stiffness, delay}: T [s], m, b, hand's k, delay [ticks].

// Exact map of the device over `duration` under a held force: a11, a12, a21, a22, b1, b2.
const deviceMap = ({ mass, damping, stiffness }, duration) => {
  const most = Math.max((damping / mass) * duration, Math.sqrt(stiffness / mass) * duration, 0.25);
  const halvings = Math.max(0, Math.ceil(Math.log2(most)) + 2), h = duration / 2 ** halvings;
  // Taylor series over a short step, then doublings; no libm, so alike in every browser.
  let older = 0, newer = (h * h) / (2 * mass), g1 = newer, g2 = h / mass;
  for (let j = 1; j < 40; j++) {
    const drag = ((damping / mass) * h / (j + 2)) * newer;
    const term = -drag - (((stiffness / mass) * h * h) / ((j + 1) * (j + 2))) * older;
    g1 += term;
    g2 += (term * (j + 2)) / h;
    older = newer;
    newer = term;
    if (Math.abs(newer) + Math.abs(older) < 1e-20 * g1) break;
  }
  let a12 = mass * g2, a11 = 1 - stiffness * g1, a21 = -stiffness * g2, a22 = a11 - damping * g2;
  for (let i = 0; i < halvings; i++) {
    [g1, g2] = [a11 * g1 + a12 * g2 + g1, a21 * g1 + a22 * g2 + g2];
    const both = a12 * a21;
    [a11, a12, a21, a22] = [a11 * a11 + both, a12 * (a11 + a22), a21 * (a11 + a22), a22 * a22 + both];
  }
  return [a11, a12, a21, a22, g1, g2];
};

// Position over force under zero-order hold: numerator and denominator in z, whole ticks of delay.
const heldDevice = (device) => {
  const { period, mass, damping, stiffness, delay } = device;
  const whole = Math.floor(delay), part = delay - whole;
  const [a11, a12, , a22, g1, g2] = deviceMap(device, period);
  let now = [g1, g2], old = [0, 0];
  if (part > 0) {
    const late = deviceMap(device, (1 - part) * period), early = deviceMap(device, part * period);
    now = [late[4], late[5]];
    old = [late[0] * early[4] + late[1] * early[5], late[2] * early[4] + late[3] * early[5]];
  }
  const det = Math.exp((-damping * period) / mass);
  const num = [now[0], a12 * now[1] - a22 * now[0] + old[0], a12 * old[1] - a22 * old[0]];
  return { whole, num, den: [1, -(stiffness === 0 ? 1 + det : a11 + a22), det] };
};

// Whether all roots of a polynomial, highest power first, lie inside the unit circle.
const isStable = (polynomial) => {
  let a = polynomial;
  while (a.length > 1) {
    const n = a.length - 1, ratio = a[n] / a[0];
    if (!(Math.abs(ratio) < 1)) return false;
    const next = new Array(n);
    for (let i = 0; i < n; i++) next[i] = a[i] - ratio * a[n - i];
    a = next;
  }
  return true;
};

// Closed loop of a law of taps: den·z^n + num·h = 0 with h in powers of 1/z.
const closedLoop = (held, { taps }) => {
  const num = Array.from(held.num);
  while (num.length > 1 && num.at(-1) === 0) num.pop();
  const total = new Array(Math.max(3, held.whole + num.length + taps.length)).fill(0);
  held.den.forEach((each, i) => { total[i] += each; });
  num.forEach((a, i) => taps.forEach((b, j) => { total[held.whole + 1 + i + j] += a * b; }));
  return total;
};

const GRIDS = new Map();
// Angles of the unit circle: even, and denser towards 0.
const angles = (count) => {
  if (!GRIDS.has(count)) {
    const found = new Set();
    for (let i = 1; i < count; i++) found.add((Math.PI * i) / count);
    for (let i = 0; i < 800; i++) found.add(1e-7 * (Math.PI / 1e-7) ** (i / 800));
    GRIDS.set(count, Float64Array.from(found).sort());
  }
  return GRIDS.get(count);
};

// The law's response H at an angle of the circle, cosine and sine given: [real, imaginary].
const response = ({ taps, sections }, c, s) => {
  let r = 0, i = 0; // Horner in 1/z
  for (let m = taps.length - 1; m >= 0; m--) [r, i] = [r * c + i * s + taps[m], i * c - r * s];
  for (let n = 0; n < sections.length; n += 4) {
    const ur = sections[n] + sections[n + 1] * c, ui = -sections[n + 1] * s;
    const vr = 1 + sections[n + 2] * c + sections[n + 3] * (c * c - s * s);
    const vi = -sections[n + 2] * s - sections[n + 3] * 2 * c * s, v = vr * vr + vi * vi;
    [r, i] = [r + (ur * vr + ui * vi) / v, i + (ui * vr - ur * vi) / v];
  }
  return [r, i];
};

// Numerator of the device, and den z^(whole+1), at an angle.
const ofDevice = ({ num, den, whole }, c, s) => {
  const nr = (num[0] * c + num[1]) * c - num[0] * s * s + num[2], ni = num[0] * 2 * c * s + num[1] * s;
  let dr = (den[0] * c + den[1]) * c - den[0] * s * s + den[2], di = den[0] * 2 * c * s + den[1] * s;
  for (let i = 0; i <= whole; i++) [dr, di] = [dr * c - di * s, dr * s + di * c];
  return [nr, ni, dr, di];
};

// K at an angle of the circle: −(den z^(whole+1) + num D)/num, real and imaginary part; the angle.
const boundary = (held, law, theta, out) => {
  out[2] = theta;
  const c = Math.cos(theta), s = Math.sin(theta), [nr, ni, dr, di] = ofDevice(held, c, s);
  const [r, i] = response(law, c, s), q = nr * nr + ni * ni;
  out[0] = -((dr * nr + di * ni) / q + r);
  out[1] = -((di * nr - dr * ni) / q + i);
};

// Whether a loop with recursive sections is stable. Their poles lie near 1, where a polynomial loses
// all digits; so den z^(whole+1) + num H is followed along the half circle instead: it turns by
// π(whole + 3) if no root lies outside.
const turnsAsStable = (held, law) => {
  const at = (theta) => {
    const c = Math.cos(theta), s = Math.sin(theta), [nr, ni, dr, di] = ofDevice(held, c, s);
    const [r, i] = response(law, c, s);
    return [dr + nr * r - ni * i, di + nr * i + ni * r];
  };
  const turn = (a, p, b, q, depth) => {
    const angle = Math.atan2(p[0] * q[1] - p[1] * q[0], p[0] * q[0] + p[1] * q[1]);
    if (Math.abs(angle) < 1 || depth === 0) return angle;
    const middle = 0.5 * (a + b), m = at(middle);
    return turn(a, p, middle, m, depth - 1) + turn(middle, m, b, q, depth - 1);
  };
  const grid = angles(16 * (law.taps.length + held.whole + 8));
  let before = 0, p = at(0), total = 0;
  for (const theta of [...grid, Math.PI]) {
    const q = at(theta);
    total += turn(before, p, theta, q, 40);
    [before, p] = [theta, q];
  }
  return Math.abs(total / Math.PI - (held.whole + 3)) < 0.5;
};

const isStableLoop = (held, law) =>
  law.sections.length ? turnsAsStable(held, law) : isStable(closedLoop(held, law));

// Angle between two at which the imaginary part crosses zero: Illinois steps, then halves.
const crossing = (held, law, a, b, fa, fb, out) => {
  for (let i = 0; i < 60 && b - a > 1e-15 * b; i++) {
    let m = i < 40 ? (a * fb - b * fa) / (fb - fa) : 0.5 * (a + b);
    if (!(m > a && m < b)) m = 0.5 * (a + b);
    boundary(held, law, m, out);
    if (out[1] === 0) return;
    if (out[1] * fb < 0) { [a, fa] = [m, out[1]]; if (i % 2) fb *= 0.5; } else { [b, fb] = [m, out[1]]; if (i % 2) fa *= 0.5; }
  }
  boundary(held, law, Math.abs(fa) < Math.abs(fb) ? a : b, out);
};

// Where the imaginary part is zero within the half circle: {k, theta}.
const wallSwings = (law, held) => {
  const out = [0, 0, 0], swings = [];
  const grid = angles(16 * (law.taps.length + 2 * (law.sections.length / 4) + held.whole + 8));
  let before = 0;
  for (let n = 0; n < grid.length; n++) {
    boundary(held, law, grid[n], out);
    const [at, part] = out;
    if (part === 0) swings.push({ k: at, theta: grid[n] });
    else if (n && before * part < 0) {
      crossing(held, law, grid[n - 1], grid[n], before, part, out);
      swings.push({ k: out[0], theta: out[2] });
    }
    before = part;
  }
  return swings;
};

// Smallest and largest stable K of the lowest stable interval, or null. `law` is without spring.
const stableStiffness = (device, law) => {
  const held = heldDevice(device), out = [0, 0, 0];
  const cuts = wallSwings(law, held).map(({ k }) => k);
  const rest = restStiffness(law), floor = Math.max(0, -rest);
  cuts.push(-device.stiffness - rest);
  const [n0, n1, n2] = held.num, top = n0 - n1 + n2;
  if (Math.abs(top) > 1e-12 * (Math.abs(n0) + Math.abs(n1) + Math.abs(n2))) {
    boundary(held, law, Math.PI, out);
    cuts.push(out[0]);
  }
  const above = cuts.filter((k) => k > floor * (1 + 1e-12) + 1e-12).sort((a, b) => a - b);
  const ends = [floor, ...above, Infinity];
  for (let n = 0; n + 1 < ends.length; n++) {
    const [low, high] = [ends[n], ends[n + 1]], taps = Float64Array.from(law.taps);
    taps[0] += high < Infinity ? 0.5 * (low + high) : 2 * low + 1;
    if (isStableLoop(held, { taps, sections: law.sections })) return [low, high];
  }
  return null;
};

const loopIsStable = (device, law) => isStableLoop(heldDevice(device), law);

// Largest H(1) of a law that is scaled as a whole [N/m]; null without limit.
const scaledEdge = (device, law) => {
  const rest = restStiffness(law), at = (by) => loopIsStable(device, scaled({ ...law, own: {} }, by));
  let inside = 1e-3, outside = null;
  if (!at(inside)) return null;
  for (let by = 1.1e-3; by < 1e3 && outside === null; by *= 1.1) if (at(by)) inside = by; else outside = by;
  if (outside === null) return null;
  for (let n = 0; n < 40; n++) {
    const middle = 0.5 * (inside + outside);
    if (at(middle)) inside = middle; else outside = middle;
  }
  return inside * rest;
};

const FARTHEST_DELAY = 20; // search limit [ticks]
// More delay at which the loop becomes unstable [ticks]; null beyond the limit.
const delayMargin = (device, law) => {
  const stable = (delay) => loopIsStable({ ...device, delay }, law);
  if (!stable(device.delay)) return 0;
  let inside = device.delay;
  for (let i = 1; i <= FARTHEST_DELAY * 10; i++) {
    let outside = device.delay + i * 0.1;
    if (!stable(outside)) {
      for (let n = 0; n < 30; n++) {
        const middle = 0.5 * (inside + outside);
        if (stable(middle)) inside = middle; else outside = middle;
      }
      return inside - device.delay;
    }
    inside = outside;
  }
  return null;
};

// Map of the page: stable K over damping and over delay, as nodes/view/stability_map.py has it.
const stabilityMap = (device, parts, law) => {
  const now = compiled(parts, law, device.period), B = law.damping;
  if (now.own.kind) return { why: "No map: the law has code beside its taps, so it has no poles." };
  const at = (damping) => withoutSpring(parts, { ...law, damping }, device.period);
  const row = (x, edge) => [x, edge && edge[0], edge && edge[1] < Infinity ? edge[1] : null];
  const edge = stableStiffness(device, withoutSpring(parts, law, device.period));
  const margin = delayMargin(device, now);
  const found = {
    delay_ticks: device.delay, mass_kg: device.mass, stable: loopIsStable(device, now),
    k_n_per_m: law.stiffness ?? restStiffness(now),
    k_max_n_per_m: edge && edge[1] < Infinity ? edge[1] : null, delay_margin_ticks: margin,
  };
  if (law.stiffness === undefined || B === undefined || parts.form === "fixed") return found;
  const near = 2 ** Math.ceil(Math.log2(Math.max(2 * B, device.damping, 1e-3)));
  const rows = [];
  for (let i = 0; i < 33; i++) rows.push(row((near * i) / 32, stableStiffness(device, at((near * i) / 32))));
  let end = near;
  while (end < near * 4096 && stableStiffness(device, at(2 * end))) end *= 2;
  for (let i = 1; end > near && i < 24; i++) {
    const damping = near * (end / near) ** (i / 23);
    rows.push(row(damping, stableStiffness(device, at(damping))));
  }
  const meets = Math.max(1.1 * (device.delay + (margin ?? FARTHEST_DELAY)), 2);
  const far = Math.min(FARTHEST_DELAY, 2 ** Math.ceil(Math.log2(meets))), later = [];
  for (let i = 0; i < 25; i++) {
    const delay = (far * i) / 24;
    later.push(row(delay, stableStiffness({ ...device, delay }, at(B))));
  }
  return { ...found, b_n_s_per_m: B, near, edge: rows, over_delay: later };
};
