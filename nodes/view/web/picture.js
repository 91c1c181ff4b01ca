// Draws one axis of the scene on a canvas: wall, trail, hand, coupling, forces. u runs along the
// axis, v across [px].
import { colour } from "./theme.js";
import { digits, fixed, step } from "./format.js";
import { blank, line, strokes } from "./strokes.js";

const ARROW = 110;
const TRACE_SECONDS = 1.6;
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

// `view`: orientation, middle and half of the visible axis [m], and whether it is the lens. `it`:
// data to show.
export function paint(canvas, view, it) {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !height) return;
  const g = blank(canvas), { upright } = view;
  const length = upright ? height : width, breadth = upright ? width : height, scale = length / (2 * view.half);
  const p = { g, upright, length, breadth, scale, lens: view.lens, at: (value) => (value - view.middle) * scale };
  g.translate(width / 2, height / 2);
  const lines = rulerLines(view, scale);
  turned(p, () => {
    ruler(p, lines);
    if (it.surface) wall(p, it);
  });
  labels(p, lines, it.letter, it.times);
  if (!it.now || !Number.isFinite(it.now.position[it.axis])) return;
  turned(p, () => {
    if (!p.lens) trail(p, it);
    if (it.hand) hand(p, it);
    bodies(p, it);
  });
}

function turned(p, draw) {
  p.g.save();
  if (p.upright) p.g.rotate(-Math.PI / 2);
  draw();
  p.g.restore();
}

// Draw upright text at a position along and across the axis.
function text(p, u, v, words, align = "center") {
  const { g } = p;
  g.save();
  g.translate(u, v);
  if (p.upright) g.rotate(Math.PI / 2);
  g.textAlign = align;
  g.font = "600 12px system-ui, sans-serif";
  g.fillText(words, 0, 4);
  g.restore();
}

function circle(g, tint, u, v, radius, width = 0) {
  g.strokeStyle = g.fillStyle = colour(tint);
  g.lineWidth = width;
  g.beginPath();
  g.arc(u, v, radius, 0, 2 * Math.PI);
  if (width) g.stroke(); else g.fill();
}

// -- the ruler ------------------------------------------------------------------------------------

function rulerLines({ middle, half }, scale) {
  const every = step(70 / scale), written = digits(every * 1e3), found = [];
  for (let n = Math.ceil((middle - half) / every); n * every <= middle + half; n++) found.push([Math.round((n * every - middle) * scale) + 0.5, fixed(n * every * 1e3, written)]);
  return found;
}

function ruler({ g, breadth }, lines) {
  for (const [u] of lines) line(g, "grid", 1, [[u, -breadth / 2], [u, breadth / 2]]);
}

function labels({ g, upright, length, breadth, lens }, lines, letter, times) {
  g.font = "12px system-ui, sans-serif";
  g.fillStyle = colour("soft");
  for (const [u, words] of lines) {
    if (Math.abs(u) > length / 2 - 28) continue;
    g.textAlign = upright ? "left" : "center";
    if (upright) g.fillText(words, 10 - breadth / 2, -u - 4); else g.fillText(words, u, breadth / 2 - 10);
  }
  if (lens && times > 1.05) {
    g.textAlign = "left";
    g.font = "600 12px system-ui, sans-serif";
    const [u, v] = [8 - (upright ? breadth : length) / 2, 16 - (upright ? length : breadth) / 2];
    const by = times < 10 ? fixed(times, 1) : fixed(times, 0);
    g.fillText((upright ? breadth : length) < 200 ? `× ${by}` : `The surface, ${by} times as large`, u, v);
    g.font = "12px system-ui, sans-serif";
  }
  // In the small lens of a phone it would cover the content.
  if (Math.max(length, breadth) < 160) return;
  g.textAlign = "right";
  g.fillText(`${letter} [mm]`, (upright ? breadth : length) / 2 - 12, (upright ? length : breadth) / 2 - 26);
}

// -- the wall -------------------------------------------------------------------------------------

// The wall dents as deep as the device penetrates.
function wall(p, { now, axis, surface, forceScale }) {
  const { g, breadth, length } = p, at = p.at(surface.at), inward = -surface.side, end = inward * (length + Math.abs(at));
  const touches = now?.contact === 1, wide = p.lens ? 46 : 26;
  const depth = touches ? (p.at(now.position[axis]) - at) * inward : 0;
  const edge = [];
  for (let v = -breadth / 2; v <= breadth / 2 + 4; v += 4) edge.push([at + inward * Math.max(0, depth) * Math.exp(-((v / wide) ** 2)), v]);
  g.save();
  g.beginPath();
  edge.forEach(([u, v], n) => g[n ? "lineTo" : "moveTo"](u, v));
  g.lineTo(end, breadth / 2 + 4);
  g.lineTo(end, -breadth / 2);
  g.closePath();
  g.clip();
  g.fillStyle = colour("wall");
  g.fillRect(-length, -breadth, 2 * length, 2 * breadth);
  g.globalAlpha = 0.22;
  // Hatching: all visible lines in one stroke, each across the whole view.
  const far = Math.max(0, length / 2 - inward * at), cross = [];
  for (let v = 14 * Math.ceil((-breadth / 2 - far) / 14); v < breadth / 2; v += 14) cross.push([[at, v], [at + inward * far, v + far]]);
  strokes(g, "wall-edge", 1.5, cross);
  g.globalAlpha = 1;
  const push = touches ? Math.min(1, Math.abs(now.force[axis]) / forceScale) : 0;
  if (push > 0) {
    const glow = g.createRadialGradient(at, 0, 2, at, 0, 46 + 60 * push);
    glow.addColorStop(0, colour("force"));
    glow.addColorStop(1, `${colour("force")}00`);
    g.globalAlpha = 0.1 + 0.3 * push;
    g.fillStyle = glow;
    g.fillRect(at - 120, -120, 240, 240);
  }
  g.restore();
  line(g, "wall-edge", 2, edge);
}

// -- moving parts ---------------------------------------------------------------------------------

// Trail of the past; time runs across the axis.
function trail(p, { now, trace }) {
  const { g, breadth } = p;
  const point = ([t, x]) => [p.at(x), (-(now.t - t) / TRACE_SECONDS) * breadth * 0.5];
  for (let k = 1; k < trace.length; k++) {
    g.globalAlpha = Math.max(0, 0.5 * (1 - (now.t - trace[k][0]) / TRACE_SECONDS));
    line(g, "device", 1.5, [point(trace[k - 1]), point(trace[k])]);
  }
  g.globalAlpha = 1;
}

// Draw a zigzag between two points at the same height.
function spring(g, tint, from, to, v, width, turns = 8, high = 5) {
  const points = [[from, v]];
  for (let k = 1; k < turns; k++) points.push([from + ((to - from) * (k - 0.5)) / (turns - 1), v + (k % 2 ? high : -high)]);
  line(g, tint, width, [...points, [to, v]]);
}

// The hand: a spring from the device to its target, and the handle to drag.
function hand(p, { now, axis, held, asks, handle }) {
  const { g } = p, v = 30, u = p.at(now.position[axis]), taken = p.at(now.target[axis]);
  line(g, "target", 1.5, [[u, 8], [u, v]]);
  g.globalAlpha = 0.75;
  spring(g, "target", u, taken, v, 1.5, 10);
  g.globalAlpha = 1;
  circle(g, "target", taken, v, p.lens ? 5 : 9);
  if (p.lens) return;
  // Where the hand is wanted; its target follows at the speed limit.
  if (held !== null) circle(g, "target", p.at(held), v, 14, 2);
  else if (handle) {
    const pulse = asks && !STILL.matches ? 2 + 2 * Math.sin(performance.now() / 250) : 0;
    circle(g, "target", taken, v, 14 + pulse, asks ? 2.5 : 1.5);
    if (asks) {
      g.fillStyle = colour("target");
      // Its label stays inside the picture, beside the handle if there is no room below.
      const most = p.length / 2 - 34, low = !p.upright && p.breadth < 210;
      text(p, p.upright ? taken : Math.min(most, Math.max(-most, taken + (low ? 50 : 0))), v + (p.upright ? 60 : low ? 0 : 34), "pull me");
    }
  }
}

// Device and proxy, the coupling between them, and the forces.
function bodies(p, it) {
  const { g } = p, { now, axis, limit } = it, u = p.at(now.position[axis]), radius = 10;
  if (now.contact === 1) {
    const proxy = p.at(now.proxy[axis]), wide = Math.abs(u - proxy);
    circle(g, "proxy", proxy, 0, radius + 3, 2.5);
    if (wide > 14) coupling(g, proxy, u);
  }
  if (it.beside) other(p, it, radius);
  circle(g, "device", u, 0, radius);
  if (it.beside && !p.lens) letter(p, "device", u, 0, "A");
  const given = now.force[axis], asked = now.asked[axis];
  if (limit && Math.abs(given) >= 0.99 * limit) {
    circle(g, "bad", u, 0, radius + 8, 3);
    g.fillStyle = colour("bad");
    text(p, u, p.upright ? -64 : -54, `limit ${fixed(limit, 0)} N`);
  }
  arrow(p, u, asked, it.forceScale, "asked", 1.5);
  arrow(p, u, given, it.forceScale, "force", 4, true);
}

// B under the same hand, in a lane of its own, so that a fraction of a millimetre is seen.
function other(p, { now, axis, beside }, radius) {
  const { g } = p, u = p.at(beside.position), v = -Math.min(84, 0.32 * p.breadth);
  const wall = Math.abs(beside.force) > 0 && now.contact === 1 ? p.at(now.proxy[axis]) : null;
  if (wall !== null && Math.abs(u - wall) > 14) spring(g, "beside", wall, u, v, 2, 8, 4);
  circle(g, "beside", u, v, radius);
  if (!p.lens) letter(p, "beside-ink", u, v, `B  ${fixed(Math.abs(beside.force), 1)} N`);
}

// Text beside a disc, on the free side of its surface.
function letter(p, tint, u, v, words) {
  p.g.fillStyle = colour(tint);
  text(p, p.upright ? u : u - 16, p.upright ? v - 16 : v, words, "right");
}

// A spring with a damper below: symbol of a law with stiffness and damping.
function coupling(g, from, to) {
  spring(g, "proxy", from, to, -7, 2, 8, 4);
  const middle = (from + to) / 2, half = Math.min(7, Math.abs(to - from) / 4) * Math.sign(to - from);
  line(g, "proxy", 2, [[from, 8], [middle, 8]]);
  line(g, "proxy", 2, [[middle, 4], [middle, 12]]);
  line(g, "proxy", 2, [[middle - half, 3], [middle + half, 3], [middle + half, 13], [middle - half, 13]]);
  line(g, "proxy", 2, [[middle + half, 8], [to, 8]]);
}

function arrow(p, u, force, forceScale, tint, width, named = false) {
  // On a phone, avoid the corner with the lens.
  const size = (force / forceScale) * Math.min(ARROW, 0.2 * p.length), v = -28;
  if (!(Math.abs(size) > 1.5)) return;
  const { g } = p, tip = u + size, sign = Math.sign(size);
  line(g, tint, width, [[u, v], [tip - sign * 5, v]], named ? [] : [5, 4]);
  g.fillStyle = colour(tint);
  g.beginPath();
  g.moveTo(tip, v);
  g.lineTo(tip - sign * (6 + width), v - 3 - width);
  g.lineTo(tip - sign * (6 + width), v + 3 + width);
  g.fill();
  if (named && !p.lens) text(p, tip + sign * (p.upright ? 14 : 30), v, `${fixed(Math.abs(force), Math.abs(force) < 10 ? 1 : 0)} N`);
}
