// Triangles of a part sorted into slabs along an axis, so that a cut or a plumb line meets few.
const MOST = 512;

export class Slabs {
  constructor({ points, faces, box }, axis) {
    const count = faces.length / 3;
    this.slabs = Math.max(1, Math.min(MOST, Math.ceil(Math.sqrt(count))));
    this.low = box[0][axis];
    this.width = (box[1][axis] - this.low) / this.slabs || 1;
    Object.assign(this, { points, faces, axis });
    const range = (k) => {
      const a = points[3 * faces[k] + axis], b = points[3 * faces[k + 1] + axis], c = points[3 * faces[k + 2] + axis];
      return [this.slab(Math.min(a, b, c)), this.slab(Math.max(a, b, c))];
    };
    // Counted first, then filled: the triangles of slab n stand at starts[n] to starts[n + 1].
    this.starts = new Uint32Array(this.slabs + 1);
    for (let k = 0; k < faces.length; k += 3) {
      const [first, last] = range(k);
      for (let n = first; n <= last; n++) this.starts[n + 1]++;
    }
    for (let n = 0; n < this.slabs; n++) this.starts[n + 1] += this.starts[n];
    const next = this.starts.slice();
    this.inside = new Uint32Array(this.starts[this.slabs]);
    for (let k = 0; k < faces.length; k += 3) {
      const [first, last] = range(k);
      for (let n = first; n <= last; n++) this.inside[next[n]++] = k;
    }
  }

  slab(at) { return Math.max(0, Math.min(this.slabs - 1, Math.floor((at - this.low) / this.width))); }

  // First faces of the triangles that may contain a coordinate.
  near(at) {
    const n = (at - this.low) / this.width;
    if (!(n > -1e-3 && n < this.slabs + 1e-3)) return new Uint32Array(0);
    const slab = this.slab(at);
    return this.inside.subarray(this.starts[slab], this.starts[slab + 1]);
  }

  // Return the segments in which the plane at a coordinate cuts the triangles.
  cut(at) {
    const found = [];
    for (const k of this.near(at)) {
      const ends = cutOf(this.points, this.corners(k), this.axis, at);
      if (ends) found.push(ends);
    }
    return found;
  }

  // Height of the first triangle below a point, by slabs along x; −Infinity without one.
  below(x, y, z) {
    const { points } = this;
    let most = -Infinity;
    for (const k of this.near(x)) {
      const [i, j, m] = this.corners(k);
      const ax = points[i] - x, ay = points[i + 1] - y, bx = points[j] - x, by = points[j + 1] - y, cx = points[m] - x, cy = points[m + 1] - y;
      const u = bx * cy - by * cx, v = cx * ay - cy * ax, w = ax * by - ay * bx, sum = u + v + w;
      if (sum === 0 || u * sum < 0 || v * sum < 0 || w * sum < 0) continue;
      const height = (u * points[i + 2] + v * points[j + 2] + w * points[m + 2]) / sum;
      if (height <= z && height > most) most = height;
    }
    return most;
  }

  corners(k) { return [3 * this.faces[k], 3 * this.faces[k + 1], 3 * this.faces[k + 2]]; }
}

// Ends of the segment in which the plane at a coordinate cuts a triangle, or null.
export function cutOf(points, corners, axis, at) {
  const ends = [];
  for (let n = 0; n < 3; n++) {
    const i = corners[n], j = corners[(n + 1) % 3], u = points[i + axis] - at, v = points[j + axis] - at;
    if (u < 0 === v < 0) continue;
    const part = u / (u - v);
    ends.push([0, 1, 2].map((m) => points[i + m] + part * (points[j + m] - points[i + m])));
  }
  return ends.length === 2 ? ends : null;
}
