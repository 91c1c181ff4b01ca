// Solids of a scene as triangles in the scene's axes: static ones, sent once, and bodies with a
// pose each.
export const REACH = 0.08;

export class Solids {
  constructor(shape) {
    this.shape = shape;
    this.still = [...corners(shape.triangles)];
    this.bodies = (shape.bodies ?? []).map(({ tool, triangles }) => ({ tool, corners: [...corners(triangles)] }));
    this.poses = null;
    this.version = 0;
  }

  // Per body: position, then rotation matrix by rows.
  pose(poses) {
    this.poses = poses;
    this.version++;
    this.placed = null;
  }

  // Return all triangles at their present place: three corners, and whether they belong to the
  // tool.
  all() {
    if (!this.placed) {
      this.placed = this.still.map((points) => ({ points, tool: false }));
      this.poses?.forEach((pose, k) => {
        for (const points of this.bodies[k]?.corners ?? []) this.placed.push({ points: points.map((point) => moved(pose, point)), tool: this.bodies[k].tool });
      });
    }
    return this.placed;
  }

  // Middle and half size of everything, including the origin, near which the device starts.
  extent() {
    const low = [0, 0, 0], high = [0, 0, 0];
    for (const { points } of this.all()) for (const point of points) for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], point[k]); high[k] = Math.max(high[k], point[k]); }
    return { middle: low.map((each, k) => (each + high[k]) / 2), reach: Math.max(0.02, Math.hypot(...high.map((each, k) => each - low[k])) / 2) };
  }

  // Return the segments in which a plane across an axis cuts the solids.
  cut(axis, at) {
    const found = [];
    for (const { points, tool } of this.all()) {
      const ends = [];
      for (let k = 0; k < 3; k++) {
        const a = points[k], b = points[(k + 1) % 3], u = a[axis] - at, v = b[axis] - at;
        if (u < 0 === v < 0) continue;
        const part = u / (u - v);
        ends.push(a.map((each, n) => each + part * (b[n] - each)));
      }
      if (ends.length === 2 && !tool) found.push(ends);
    }
    return found;
  }
}

function* corners(numbers) {
  for (let k = 0; k + 8 < numbers.length; k += 9) yield [0, 3, 6].map((at) => numbers.slice(k + at, k + at + 3));
}

function moved([x, y, z, a, b, c, d, e, f, g, h, i], [u, v, w]) {
  return [x + a * u + b * v + c * w, y + d * u + e * v + f * w, z + g * u + h * v + i * w];
}
