// A camera in parallel projection, and where a drag on the screen moves a point in the scene.
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const plus = (a, b, by = 1) => [a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const size = (a) => Math.sqrt(dot(a, a));

// What a drag moves along, by its letter on the keyboard.
export const MODES = { v: "view", g: "ground", s: "surface" };
const UP = [0, 0, 1];
const ROOM = 1.15; // half of a picture, of the farthest point in it
// A plane seen from its edge: a drag moves no farther than so many times its way on the screen.
const STEEPEST = 4;

// Directions to the right, up and away on the screen: yaw about z, then pitch.
export function axesOf({ yaw, pitch }) {
  const right = [Math.cos(yaw), Math.sin(yaw), 0];
  const away = [-Math.sin(yaw) * Math.cos(pitch), Math.cos(yaw) * Math.cos(pitch), -Math.sin(pitch)];
  return { right, up: cross(right, away), away };
}

// Normal of the plane in which a drag moves; null for the camera's own.
export function planeOf(mode, normal) {
  if (mode === "ground") return UP;
  return mode === "surface" && normal && normal.some(Boolean) ? normal : null;
}

// The step [m] in a plane whose picture is `across` to the right and `above` upwards [m].
export function stepOf({ right, up, away }, normal, across, above) {
  const flat = plus([across * right[0], across * right[1], across * right[2]], up, above);
  if (!normal) return flat;
  const along = dot(flat, normal), facing = dot(away, normal);
  const most = STEEPEST * Math.hypot(across, above);
  if (Math.abs(along) <= most * Math.abs(facing)) return facing === 0 ? flat : plus(flat, away, -along / facing);
  // Nearly from the edge: limited, then back into the plane.
  const far = plus(flat, away, -most * Math.sign(along) * (Math.sign(facing) || 1));
  return plus(far, normal, -dot(far, normal));
}

// Direction of the wheel: away from the viewer, down to the ground, or into the surface.
export function depthOf(mode, { away }, normal) {
  const across = planeOf(mode, normal);
  return across ? across.map((each) => -each) : away;
}

// A target that was dragged along a surface, brought back to its depth below the proxy [m].
export function atDepth(target, proxy, normal, depth) {
  return plus(target, normal, -depth - dot(minus(target, proxy), normal));
}

// Half of the smaller side [m] of a picture across two axes that contains some points.
export function reachOf(points, middle, axes, sides) {
  const least = Math.min(...sides), far = points.flatMap((point) => axes.map((axis, k) => (Math.abs(point[axis] - middle[axis]) * least) / sides[k]));
  return ROOM * Math.max(0, ...far.filter(Number.isFinite));
}
