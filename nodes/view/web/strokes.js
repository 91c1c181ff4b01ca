// What both pictures of a scene of several axes are drawn with: lines, dots, rings and springs, in pixels.
import { colour } from "./theme.js";

export function line(g, tint, width, points, dash = []) {
  g.strokeStyle = colour(tint);
  g.lineWidth = width;
  g.setLineDash(dash);
  g.beginPath();
  points.forEach(([u, v], n) => g[n ? "lineTo" : "moveTo"](u, v));
  g.stroke();
  g.setLineDash([]);
}

export function dotAt(g, tint, [u, v], radius) {
  g.fillStyle = colour(tint);
  g.beginPath();
  g.arc(u, v, radius, 0, 2 * Math.PI);
  g.fill();
}

export function ring(g, tint, [u, v], radius, width) {
  g.strokeStyle = colour(tint);
  g.lineWidth = width;
  g.beginPath();
  g.arc(u, v, radius, 0, 2 * Math.PI);
  g.stroke();
}

export function zigzag(from, to) {
  const long = Math.hypot(to[0] - from[0], to[1] - from[1]);
  if (long < 4) return [from, to];
  const across = [(-(to[1] - from[1]) / long) * 4, ((to[0] - from[0]) / long) * 4], points = [from];
  for (let k = 1; k < 8; k++) points.push([from[0] + ((to[0] - from[0]) * k) / 8 + (k % 2 ? 1 : -1) * across[0], from[1] + ((to[1] - from[1]) * k) / 8 + (k % 2 ? 1 : -1) * across[1]]);
  return [...points, to];
}
