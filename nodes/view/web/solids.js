// Solids of a scene: parts with corners and triangles, static ones and those with a pose each.
import { cutOf, Slabs } from "./slabs.js";

export class Solids {
  constructor(shape) {
    this.parts = shape.parts.map(decoded);
    this.poses = this.shown = null;
    this.version = 0;
    this.slabs = new Map();
  }

  // Number of triangles.
  get count() { return this.parts.reduce((sum, { faces }) => sum + faces.length / 3, 0); }

  // Per pose: position, then rotation matrix by rows. What moved by less than `least` [m] in all is
  // drawn where it was.
  pose(poses, least = 0) {
    this.poses = poses;
    if (this.shown && !this.parts.some((part) => part.pose >= 0 && apart(this.shown[part.pose], poses[part.pose], part.box) > least)) return;
    this.shown = poses;
    this.version++;
  }

  // The pose of a part; undefined while it is not known.
  at(part) { return part.pose < 0 ? STILL : this.poses?.[part.pose]; }

  // The parts whose place is known, each with its pose.
  *placed() {
    for (const part of this.parts) {
      const pose = this.at(part);
      if (pose) yield [part, pose];
    }
  }

  // Middle and half size of everything, including the origin, near which the device starts.
  extent() {
    const low = [0, 0, 0], high = [0, 0, 0];
    for (const [{ box }, pose] of this.placed()) {
      for (let k = 0; k < 8; k++) {
        moved(pose, [0, 1, 2].map((n) => box[(k >> n) & 1][n])).forEach((each, n) => {
          low[n] = Math.min(low[n], each);
          high[n] = Math.max(high[n], each);
        });
      }
    }
    return { middle: low.map((each, k) => (each + high[k]) / 2), reach: Math.max(0.02, Math.hypot(...high.map((each, k) => each - low[k])) / 2), low: low[2] };
  }

  slabsOf(part, axis) {
    const key = `${this.parts.indexOf(part)} ${axis}`;
    if (!this.slabs.has(key)) this.slabs.set(key, new Slabs(part, axis));
    return this.slabs.get(key);
  }

  // Return the segments in which a plane across an axis cuts the solids.
  cut(axis, at) {
    const found = [];
    for (const [part, pose] of this.placed()) {
      if (part.tool) continue;
      if (isShift(pose)) {
        const from = pose.slice(0, 3), ends = this.slabsOf(part, axis).cut(at - from[axis]);
        for (const pair of ends) found.push(pair.map((point) => point.map((each, k) => each + from[k])));
      } else found.push(...cutMoved(part, pose, axis, at));
    }
    return found;
  }

  // Height of the first surface below a point, or of the ground [m].
  below([x, y, z], ground) {
    let most = ground;
    for (const [part, pose] of this.placed()) {
      if (part.tool || !isShift(pose)) continue;
      const found = this.slabsOf(part, 0).below(x - pose[0], y - pose[1], z - pose[2]) + pose[2];
      if (found > most) most = found;
    }
    return most;
  }
}

const STILL = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1];

// Largest distance between two places of a box's corners [m].
function apart(before, after, box) {
  if (!before || !after) return before === after ? 0 : Infinity;
  let most = 0;
  for (let k = 0; k < 8; k++) {
    const corner = [0, 1, 2].map((n) => box[(k >> n) & 1][n]), from = moved(before, corner), to = moved(after, corner);
    most = Math.max(most, Math.hypot(...to.map((each, n) => each - from[n])));
  }
  return most;
}

function isShift(pose) { return STILL.every((each, k) => k < 3 || pose[k] === each); }

function bytes(text) {
  const found = atob(text), out = new Uint8Array(found.length);
  for (let k = 0; k < found.length; k++) out[k] = found.charCodeAt(k);
  return out.buffer;
}

function decoded(part) {
  const points = new Float32Array(bytes(part.points));
  const faces = new (part.wide ? Uint32Array : Uint16Array)(bytes(part.faces));
  const box = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (let k = 0; k < points.length; k++) {
    const n = k % 3;
    if (points[k] < box[0][n]) box[0][n] = points[k];
    if (points[k] > box[1][n]) box[1][n] = points[k];
  }
  return { ...part, points, faces, box };
}

export function moved([x, y, z, a, b, c, d, e, f, g, h, i], [u, v, w]) {
  return [x + a * u + b * v + c * w, y + d * u + e * v + f * w, z + g * u + h * v + i * w];
}

// Normals of the corners: sums of the triangles' normals, by area.
export function normalsOf({ points, faces }) {
  const sum = new Float32Array(points.length);
  for (let k = 0; k < faces.length; k += 3) {
    const i = 3 * faces[k], j = 3 * faces[k + 1], m = 3 * faces[k + 2];
    const ax = points[j] - points[i], ay = points[j + 1] - points[i + 1], az = points[j + 2] - points[i + 2];
    const bx = points[m] - points[i], by = points[m + 1] - points[i + 1], bz = points[m + 2] - points[i + 2];
    const x = ay * bz - az * by, y = az * bx - ax * bz, z = ax * by - ay * bx;
    for (const at of [i, j, m]) { sum[at] += x; sum[at + 1] += y; sum[at + 2] += z; }
  }
  for (let k = 0; k < sum.length; k += 3) {
    const long = Math.hypot(sum[k], sum[k + 1], sum[k + 2]) || 1;
    sum[k] /= long; sum[k + 1] /= long; sum[k + 2] /= long;
  }
  return sum;
}

// A closed surface of fewer triangles: corners in the same cell of a grid become one.
export function coarser(part, most) {
  if (part.faces.length / 3 <= most) return part;
  const { points, faces, box } = part, wide = Math.max(...box[1].map((each, k) => each - box[0][k]));
  for (let cells = Math.ceil(Math.sqrt(most)); cells > 2; cells = Math.floor(cells * 0.8)) {
    const of = new Map(), sums = [], which = new Uint32Array(points.length / 3), edge = wide / cells;
    for (let k = 0; k < which.length; k++) {
      const p = [0, 1, 2].map((n) => points[3 * k + n]), cell = p.map((each, n) => Math.floor((each - box[0][n]) / edge));
      const key = (cell[0] * 4096 + cell[1]) * 4096 + cell[2];
      if (!of.has(key)) { of.set(key, sums.length); sums.push([0, 0, 0, 0]); }
      which[k] = of.get(key);
      const sum = sums[which[k]];
      for (let n = 0; n < 3; n++) sum[n] += p[n];
      sum[3]++;
    }
    const left = [];
    for (let k = 0; k < faces.length; k += 3) {
      const [a, b, c] = [which[faces[k]], which[faces[k + 1]], which[faces[k + 2]]];
      if (a !== b && b !== c && c !== a) left.push(a, b, c);
    }
    if (left.length / 3 <= most) return { ...part, points: Float32Array.from(sums.flatMap(([x, y, z, n]) => [x / n, y / n, z / n])), faces: Uint32Array.from(left) };
  }
  return part;
}

// As `Slabs.cut`, for a part that is turned: all its triangles, in the scene's axes.
function cutMoved({ points, faces }, pose, axis, at) {
  const found = [], placed = new Float64Array(points.length);
  for (let k = 0; k < points.length; k += 3) placed.set(moved(pose, points.subarray(k, k + 3)), k);
  for (let k = 0; k < faces.length; k += 3) {
    const ends = cutOf(placed, [3 * faces[k], 3 * faces[k + 1], 3 * faces[k + 2]], axis, at);
    if (ends) found.push(ends);
  }
  return found;
}
