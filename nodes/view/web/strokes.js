// Drawing primitives: cleared canvas, lines, dots, rings and springs, in pixels.
import { colour } from "./theme.js";

// Clear a canvas whose unit is a CSS pixel; resize it only if its size changed, because that is
// slow.
export function blank(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, ratio = devicePixelRatio || 1;
  for (const [side, long] of [["width", width], ["height", height]]) if (canvas[side] !== Math.round(long * ratio)) canvas[side] = Math.round(long * ratio);
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  return g;
}

export function line(g, tint, width, points, dash = []) {
  strokes(g, tint, width, [points], dash);
}

// Many lines in one stroke, as cheap as one.
export function strokes(g, tint, width, lines, dash = []) {
  g.strokeStyle = colour(tint);
  g.lineWidth = width;
  g.setLineDash(dash);
  g.beginPath();
  for (const points of lines) points.forEach(([u, v], n) => g[n ? "lineTo" : "moveTo"](u, v));
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
