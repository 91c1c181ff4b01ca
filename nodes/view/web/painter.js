// Solids on a 2-D canvas, for a browser without WebGL 2: from far to near, lit by the same light.
import { axesOf, cross, dot, minus, size } from "./camera.js";
import { AMBIENT, LIGHT } from "./light.js";
import { coarser, moved } from "./solids.js";

const MOST = 6000; // triangles of a part; a finer one is drawn coarser, and closed

export class Painter {
  constructor(canvas) { this.canvas = canvas; }

  load(solids) {
    this.solids = solids;
    this.coarse = new Map(solids.parts.map((part) => [part, coarser(part, MOST)]));
    // The first triangles count for the picture only if nothing was joined.
    this.isWhole = solids.parts.every((part) => this.coarse.get(part) === part);
  }

  draw({ turn, pixels, width, height, tints }) {
    const g = this.canvas.getContext("2d"), ratio = this.canvas.width / width;
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, this.canvas.width, this.canvas.height);
    g.setTransform(ratio, 0, 0, ratio, (width * ratio) / 2, (height * ratio) / 2);
    const camera = axesOf(turn), faces = [];
    for (const [part, pose] of this.solids.placed()) {
      const tint = tints[this.solids.parts.indexOf(part)], { points, faces: corners } = this.coarse.get(part);
      const placed = [];
      for (let k = 0; k < points.length; k += 3) placed.push(minus(moved(pose, points.subarray(k, k + 3)), turn.middle));
      const seen = placed.map((from) => [dot(from, camera.right) * pixels, -dot(from, camera.up) * pixels, dot(from, camera.away)]);
      for (let k = 0; k < corners.length; k += 3) {
        const three = [corners[k], corners[k + 1], corners[k + 2]], [a, b, c] = three.map((n) => placed[n]);
        const normal = cross(minus(b, a), minus(c, a)), long = size(normal);
        if (long < 1e-15) continue;
        const side = (dot(normal, camera.away) > 0 ? -1 : 1) / long;
        const lit = AMBIENT * (0.8 + 0.2 * side * normal[2]) + (1 - AMBIENT) * Math.max(0, side * dot(normal, LIGHT)), at = three.map((n) => seen[n]);
        faces.push([at[0][2] + at[1][2] + at[2][2], at, tint.map((each) => Math.round(255 * each * lit))]);
      }
    }
    faces.sort((one, other) => other[0] - one[0]);
    g.lineWidth = 1;
    for (const [, points, [red, green, blue]] of faces) {
      g.beginPath();
      points.forEach(([u, v], n) => g[n ? "lineTo" : "moveTo"](u, v));
      g.closePath();
      g.fillStyle = g.strokeStyle = `rgb(${red} ${green} ${blue})`;
      g.fill();
      g.stroke();
    }
    return false;
  }

  finish() { /* the overlay draws device and proxy */ }
}
