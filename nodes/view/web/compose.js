// Device, proxy, plumb line and shadow over pixels of the solids: the rule of the shader COMPOSE in
// lit.js, for a picture that stays.
import { dot, minus } from "./camera.js";
import { AMBIENT, LIGHT } from "./light.js";

const FARTHEST = 16777215; // depth in three bytes
const c = [0, 0, 0, 0]; // the pixel's colour times alpha, and alpha

// Return a patch (left, bottom, width, height) of a picture as an image. `solids`: their picture from
// the top down, and depths from the bottom up; `canvas`: size of the picture [pixels].
export function composed(solids, canvas, view, { device, proxy, landing, tints }, [left, bottom, wide, high]) {
  const { image: { data: base }, depths, width, height } = solids, image = new ImageData(wide, high), { data } = image;
  const { matrix, middle, scale, pixel } = view, [right, up, away] = matrix;
  const at = (point) => { const from = minus(point, middle); return matrix.map((row) => dot(row, from)); };
  const [ax, ay, az] = at(device), [bx, by, bz] = at([device[0], device[1], landing]), wx = bx - ax, wy = by - ay;
  const square = Math.max(wx * wx + wy * wy, 1e-20), long = Math.sqrt(square);
  const light = matrix.map((row) => dot(row, LIGHT)); // as the camera has it
  const balls = [[proxy, tints.proxy], [device, tints.device]].filter(([one]) => one).map(([one, tint]) => ({ centre: at(one), radius: one[3], tint }));
  const near = device[3] * 1.1, below = device[2] - 0.2 * device[3];
  for (let row = 0; row < high; row++) {
    const v = (bottom + row + 0.5) / canvas.height, y = (2 * v - 1) / scale[1], line = Math.floor(v * height);
    for (let column = 0; column < wide; column++) {
      const u = (left + column + 0.5) / canvas.width, x = (2 * u - 1) / scale[0], place = Math.floor(u * width);
      const from = 4 * ((height - 1 - line) * width + place), to = 4 * ((high - 1 - row) * wide + column);
      const part = Math.min(1, Math.max(0, ((x - ax) * wx + (y - ay) * wy) / square)), off = Math.hypot(x - ax - part * wx, y - ay - part * wy);
      // Elsewhere, nothing but the solids is seen.
      let touched = off < 1.3 * pixel || Math.hypot(x - bx, y - by) < 2.5 * near;
      for (const { centre, radius } of balls) touched ||= Math.hypot(x - centre[0], y - centre[1]) <= radius + pixel;
      if (!touched) {
        for (let n = 0; n < 4; n++) data[to + n] = base[from + n];
        continue;
      }
      const deep = 4 * (line * width + place), d = (depths[deep] * 65536 + depths[deep + 1] * 256 + depths[deep + 2]) / FARTHEST, front = (2 * d - 1) / scale[2];
      c[3] = base[from + 3] / 255;
      for (let n = 0; n < 3; n++) c[n] = (base[from + n] / 255) * c[3];
      const z = x * right[2] + y * up[2] + front * away[2] + middle[2];
      if (d < 1 && z < below && Math.abs(z - landing) < 2 * near) {
        const far = Math.hypot(...[0, 1].map((n) => x * right[n] + y * up[n] + front * away[n] + middle[n] - device[n]));
        const dark = 1 - 0.5 * (1 - smooth(0.75 * near, near, far));
        for (let n = 0; n < 3; n++) c[n] *= dark;
      }
      // The plumb line, from the device to where it lands.
      const turns = (part * long) / (9 * pixel), drawn = turns - Math.floor(turns) >= 0.45 ? Math.min(1, Math.max(0, 1.3 - off / pixel)) : 0;
      over(tints.line, 1, drawn * (az + part * (bz - az) > front + 2 * pixel ? 0.25 : 0.9));
      // Balls in parallel projection; weaker where something is in front of them.
      for (const { centre, radius, tint } of balls) {
        const p = x - centre[0], q = y - centre[1], r = Math.hypot(p, q);
        if (r > radius + pixel) continue;
        const rise = Math.sqrt(Math.max(radius * radius - r * r, 0)), facing = (p * light[0] + q * light[1] - rise * light[2]) / radius;
        const shown = front <= centre[2] - rise - 2 * pixel ? 0.4 : 1;
        over(tint, AMBIENT + (1 - AMBIENT) * Math.max(facing, 0), shown * Math.min(1, Math.max(0, (radius - r) / pixel + 0.5)));
      }
      for (let n = 0; n < 3; n++) data[to + n] = c[3] ? (255 * c[n]) / c[3] : 0;
      data[to + 3] = 255 * c[3];
    }
  }
  return image;
}

function over(tint, lit, alpha) {
  for (let n = 0; n < 3; n++) c[n] = tint[n] * lit * alpha + c[n] * (1 - alpha);
  c[3] = alpha + c[3] * (1 - alpha);
}

// As smoothstep of GLSL.
function smooth(from, to, at) {
  const t = Math.min(1, Math.max(0, (at - from) / (to - from)));
  return t * t * (3 - 2 * t);
}
