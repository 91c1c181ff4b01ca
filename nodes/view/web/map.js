// Stability map: stable K and B for the active kind of law, and the present point.
import { digits, figure, fixed, rough, step, unbroken } from "./format.js";
import { blank } from "./strokes.js";
import { colour, onTheme } from "./theme.js";

export class StabilityMap {
  // `move` is called with the point dragged to: stiffness and damping, or stiffness and device
  // delay.
  constructor(canvas, words, button, move) {
    this.trail = [];
    this.move = move;
    this.drag(canvas);
    this.canvas = canvas;
    this.words = words;
    this.whole = false;
    this.map = null;
    button.addEventListener("click", () => {
      this.whole = !this.whole;
      button.setAttribute("aria-pressed", this.whole);
      this.draw();
    });
    this.button = button;
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // The dot is a handle; it can go beyond the limit only if the dial may.
  drag(canvas) {
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.frame || !this.movable) return;
      canvas.setPointerCapture(event.pointerId);
      this.pulls = event.offsetX > this.frame.end ? "delay" : "damping";
      this.pull(event);
    });
    canvas.addEventListener("pointermove", (event) => { if (canvas.hasPointerCapture(event.pointerId)) this.pull(event); });
  }

  pull(event) {
    if (!this.frame) return;
    const { left, bottom, top, end, right, most, begin, last, far } = this.frame, within = (part) => Math.min(1, Math.max(0, part));
    const later = this.pulls === "delay";
    if (later && !this.delays) return;
    const own = this.map.delay_ticks - this.own, stiffness = within((bottom - event.offsetY) / (bottom - top)) * most;
    const along = later ? Math.max(own, within((event.offsetX - begin) / (last - begin)) * far) : within((event.offsetX - left) / (end - left)) * right;
    const row = (later ? this.map.over_delay : this.map.edge).reduce((best, each) => (Math.abs(each[0] - along) < Math.abs(best[0] - along) ? each : best));
    const edge = row[2] ?? Infinity, wanted = Math.max(this.beyond() ? stiffness : Math.min(stiffness, 0.98 * edge), most / 200);
    this.move({ stiffness: wanted, [this.pulls]: later ? along - own : along }, wanted >= edge);
  }

  // Device delay at which the present stiffness becomes unstable; null if beyond the map.
  delayEdge() {
    const { map, own } = this;
    if (!map?.over_delay || (map.stable && map.delay_margin_ticks === null)) return null;
    if (map.stable) return own + map.delay_margin_ticks;
    const k = map.k_n_per_m, rows = map.over_delay, n = rows.findIndex(([, , high]) => high !== null && high < k);
    const part = n > 0 ? (rows[n - 1][2] - k) / (rows[n - 1][2] - rows[n][2]) : 0;
    return n < 0 ? null : own - map.delay_ticks + (n ? rows[n - 1][0] + part * (rows[n][0] - rows[n - 1][0]) : 0);
  }

  show(map) {
    const before = this.map;
    // The device's share of the delay for which the map was drawn; it may have changed since.
    this.own = map.device_delay ?? 0;
    this.map = this.kept = map;
    this.canvas.classList.remove("old");
    if (before?.edge && map.edge && (before.k_n_per_m !== map.k_n_per_m || before.b_n_s_per_m !== map.b_n_s_per_m)) this.trail = [...this.trail.slice(-40), [before.b_n_s_per_m, before.k_n_per_m]];
    this.canvas.hidden = !map.edge;
    this.button.hidden = !map.edge;
    this.words.replaceChildren(...this.tell(map).map((part) => (typeof part === "string" ? unbroken(part) : part)));
    this.canvas.setAttribute("aria-label", this.words.textContent);
    this.draw();
  }

  // The map is of a law no longer active: keep it in its place, faint, until the next one comes.
  forget() {
    if (!this.map) return;
    this.kept = this.map;
    this.map = this.frame = null;
    this.trail = [];
    this.canvas.classList.add("old");
    this.words.textContent = "The map of the law before; the next one is coming.";
    this.canvas.setAttribute("aria-label", "Map of stability");
  }

  tell(map) {
    if (map.why) return [map.why];
    const bold = (text, bad) => Object.assign(document.createElement("b"), { textContent: unbroken(text), className: bad ? "bad" : "" });
    const { mass, heaviest } = map.plant, least = figure(mass), most = figure(heaviest ?? mass);
    const worst = heaviest ? ` and with ${figure(map.mass_kg)} kg, the worst of ${least} to ${most} kg` : "";
    const at = ` at a delay of ${fixed(map.delay_ticks, 1)} ticks${worst}`;
    // An observed instability outweighs the computation.
    if (this.stopped) return [bold("It swung, and the driver stopped it", true), map.stable ? `, though the declared device would be stable${at}: the real loop is not this one.` : `: unstable${at}.`];
    if (!map.stable) {
      const edge = map.k_max_n_per_m === null ? "no stiffness is stable" : `stable up to K = ${rough(map.k_max_n_per_m)} N/m`;
      return [bold("Unstable", true), `${at}: ${edge}.`];
    }
    const k = map.k_max_n_per_m === null ? "without limit" : `${rough(map.k_max_n_per_m / map.k_n_per_m)} × K`;
    const delay = map.delay_margin_ticks === null ? "over 20 ticks" : `${rough(map.delay_margin_ticks)} ticks`;
    return ["Stable", `${at}. To the edge: `, bold(k), map.k_max_n_per_m === null ? "" : ` (${rough(map.k_max_n_per_m)} N/m)`, ", or ", bold(`${delay} more delay`), `. ${this.moving(map)}`];
  }

  // Certified for a moving wall: any passive world that answers in the same tick.
  moving(map) {
    if (!map.any_world) return "";
    const k = map.k_max_any_world_n_per_m;
    const worlds = map.stepped ? "Whatever the tool touches" : "With any world that answers in the same tick";
    return k === null ? `${worlds}: no K is certified.` : `${worlds}: K up to ${rough(k)} N/m (dashed).`;
  }

  // Whether the driver stopped the loop, whatever is computed.
  stop(stopped) {
    if (this.stopped === stopped) return;
    this.stopped = stopped;
    if (this.map) this.show(this.map);
  }

  draw() {
    const { canvas, kept: map } = this;
    if (!map?.edge || !canvas.clientWidth) return;
    const width = canvas.clientWidth, height = canvas.clientHeight, g = blank(canvas);
    const rows = map.edge.filter(([b]) => this.whole || b <= map.near * 1.0001);
    const most = Math.max(map.k_n_per_m * 1.25, ...rows.map(([, , high]) => (high ?? 0) * 1.12));
    const right = this.whole ? Math.max(...rows.map(([b]) => b)) : map.near;
    // Two panels with a common K axis: limit over damping, and limit over delay.
    g.font = "12px system-ui, sans-serif";
    // The longest figure beside the axis of K is seen whole.
    const left = Math.ceil(Math.max(50, ...nice(most, 4).map(([, text]) => g.measureText(text).width + 12))), bottom = height - 30, top = 8, end = left + Math.round((width - left) * 0.58), begin = end + 20, last = width - 10;
    const over = map.over_delay, far = over.at(-1)[0], u = (delay) => begin + (delay / far) * (last - begin);
    const x = (b) => left + (b / right) * (end - left), y = (k) => bottom - (k / most) * (bottom - top);
    this.axes(g, x, y, right, most, { left, bottom, top, end });
    const stable = rows.filter(([, low]) => low !== null);
    g.beginPath();
    stable.forEach(([b, , high], n) => g[n ? "lineTo" : "moveTo"](x(b), y(high ?? most)));
    [...stable].reverse().forEach(([b, low]) => g.lineTo(x(b), y(low)));
    g.closePath();
    g.fillStyle = colour("safe");
    g.fill();
    g.strokeStyle = colour("good");
    g.lineWidth = 2;
    g.lineJoin = "round";
    g.beginPath();
    stable.forEach(([b, , high], n) => g[n ? "lineTo" : "moveTo"](x(b), y(high ?? most)));
    g.stroke();
    const frame = { left, bottom, top, end, right, most, begin, last, far };
    this.frame = this.map && frame;
    this.regions(g, stable, x, y, right, most);
    this.later(g, over, u, y, frame);
    this.dashed(g, map.any_world, x, y);
    this.dashed(g, map.any_world_over_delay, u, y);
    this.where(g, x, y);
    const dot = y(map.k_n_per_m), b = x(Math.min(map.b_n_s_per_m, right)), margin = map.delay_margin_ticks;
    this.point(g, b, dot, map.k_max_n_per_m === null ? null : [b, y(map.k_max_n_per_m)]);
    this.point(g, u(Math.min(map.delay_ticks, far)), dot, map.stable ? [margin === null ? last : u(Math.min(far, map.delay_ticks + margin)), dot] : null);
  }

  regions(g, stable, x, y, right, most) {
    if (!stable.length) return;
    const [b, , high] = stable[Math.floor(stable.length * 0.62)];
    g.font = "600 12px system-ui, sans-serif";
    g.textAlign = "center";
    g.fillStyle = colour("good");
    g.fillText("rests", x(Math.min(b, right)), y((high ?? most) * 0.45));
    g.fillStyle = colour("bad");
    if ((high ?? most) < 0.9 * most) g.fillText("sings", x(stable[Math.floor(stable.length * 0.35)][0]), y(0.94 * most) + 16);
  }

  // Limit over the delay of the whole loop.
  later(g, rows, u, y, { bottom, top, begin, last, most, far }) {
    const stable = rows.filter(([, low]) => low !== null);
    g.save();
    g.beginPath();
    g.rect(begin, top, last - begin, bottom - top);
    g.clip();
    g.beginPath();
    stable.forEach(([delay, , high], n) => g[n ? "lineTo" : "moveTo"](u(delay), y(high ?? 2 * most)));
    g.strokeStyle = colour("good");
    g.lineWidth = 2;
    g.stroke();
    [...stable].reverse().forEach(([delay, low]) => g.lineTo(u(delay), y(low)));
    g.closePath();
    g.fillStyle = colour("safe");
    g.fill();
    g.restore();
    g.strokeStyle = colour("grid");
    g.fillStyle = colour("soft");
    g.font = "12px system-ui, sans-serif";
    g.lineWidth = 1;
    g.strokeRect(begin, top, last - begin, bottom - top);
    g.textAlign = "center";
    for (const [delay, text] of nice(far, 3)) g.fillText(text, u(delay), bottom + 14);
    g.textAlign = "right";
    g.fillText("delay [ticks]", last, bottom + 27);
  }

  // Limit for any moving world.
  dashed(g, rows, across, y) {
    g.save();
    g.setLineDash([5, 4]);
    g.strokeStyle = colour("good");
    g.lineWidth = 1.5;
    g.beginPath();
    let on = false;
    for (const [at, k] of rows ?? []) {
      if (k !== null) g[on ? "lineTo" : "moveTo"](across(at), y(k));
      on = k !== null;
    }
    g.stroke();
    g.restore();
  }

  // Previous points.
  where(g, x, y) {
    this.trail.forEach(([b, k], n) => {
      g.globalAlpha = 0.15 + (0.45 * n) / this.trail.length;
      g.fillStyle = colour("device");
      g.beginPath();
      g.arc(x(b), y(k), 2.5, 0, 2 * Math.PI);
      g.fill();
    });
    g.globalAlpha = 1;
  }

  point(g, u, v, edge) {
    const tint = colour(this.kept.stable ? "device" : "bad");
    g.strokeStyle = g.fillStyle = tint;
    if (edge !== null) {
      g.setLineDash([3, 4]);
      g.lineWidth = 1.5;
      g.beginPath();
      g.moveTo(u, v);
      g.lineTo(...edge);
      g.stroke();
      g.setLineDash([]);
    }
    g.beginPath();
    g.arc(u, v, 6, 0, 2 * Math.PI);
    g.fill();
    g.strokeStyle = colour("card");
    g.lineWidth = 2;
    g.stroke();
  }

  axes(g, x, y, right, most, { left, bottom, top, end }) {
    g.strokeStyle = colour("grid");
    g.fillStyle = colour("soft");
    g.lineWidth = 1;
    g.textAlign = "right";
    for (const [k, text] of nice(most, 4)) {
      g.beginPath(); g.moveTo(left, y(k)); g.lineTo(end, y(k)); g.stroke();
      g.fillText(text, left - 6, y(k) + 4);
    }
    g.textAlign = "center";
    for (const [b, text] of nice(right, 5)) {
      g.beginPath(); g.moveTo(x(b), top); g.lineTo(x(b), bottom); g.stroke();
      g.fillText(text, x(b), bottom + 14);
    }
    g.textAlign = "right";
    g.fillText("B [N s/m]", end, bottom + 27);
    g.textAlign = "left";
    g.fillText("K [N/m]", left + 5, top + 10);
  }
}

// Round numbers from 0, with labels.
function nice(most, count) {
  const every = step(most / count), found = [];
  for (let n = 0; n * every <= most; n++) found.push([n * every, fixed(n * every, digits(every))]);
  return found;
}
