// Force over the last seconds below the scene, with the driver's limit; limited moments are red.
import { colour, onTheme } from "./theme.js";
import { fixed } from "./format.js";
import { blank } from "./strokes.js";

const SPAN = 4;

export class Strip {
  constructor(canvas) {
    Object.assign(this, { canvas, store: null, limit: null, high: 1, low: -0.2 });
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  start(store, { axes, peak_n: peak }) {
    Object.assign(this, { store, limit: peak ?? null, high: 1, low: -0.2 });
    this.look([axes[0]]);
  }

  // Set one axis, or the two of a section; the second one's force is dotted.
  look(letters) {
    this.letters = letters;
    this.series = [`law_force.${letters[0]}`, ...letters.map((letter) => `force.${letter}`)].map((name) => this.store.index(name));
  }

  // Draw a past window with the scene's time in it, or the present; and B, if chosen.
  draw(window = null, beside = null, now = null) {
    const { canvas } = this, store = window?.store ?? this.store;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!store || !width) return;
    const g = blank(canvas);
    // A recording's bins continue after the shown moment.
    const last = this.replayed && Number.isFinite(now) ? now : store.end, [from, to] = window ? window.sight : [last - SPAN, last];
    const left = 66, right = width - 10, top = 16, bottom = height - 8;
    const [times, asked, force, second] = store.columns(this.series, from, to, Math.round(right - left));
    this.settle(second ? [...force, ...second] : force);
    const x = (t) => left + ((t - from) / (to - from)) * (right - left);
    const y = (force) => bottom - ((force - this.low) / (this.high - this.low)) * (bottom - top);
    this.frame(g, y, left, right, window);
    if (beside?.part) this.name(g, beside.name, right, (right - left) / 2);
    g.save();
    g.beginPath();
    g.rect(left, 0, right - left, height);
    g.clip();
    this.curve(g, times, asked, x, y, "asked", 1.2, [4, 3]);
    this.curve(g, times, force, x, y, "force", 1.8, []);
    if (second) this.curve(g, times, second, x, y, "force", 1.8, [2, 3]);
    if (beside?.part) {
      const other = beside.part("force", this.letters[0], from, to);
      if (other) this.curve(g, other.times, other.values, x, y, "beside", 1.6, []);
    } else if (beside?.on) this.curve(g, beside.times, beside.force, x, y, "beside", 1.6, []);
    this.held(g, times, force, x, top);
    if (window) this.cursor(g, x(window.at), top, bottom);
    g.restore();
  }

  // Widens at once, narrows slowly; a law's demand far above the limit does not flatten the force.
  settle(force) {
    const seen = force.filter((value) => value !== null && Number.isFinite(value));
    const high = Math.max(0.5, ...seen) * 1.15, low = Math.min(-0.5, ...seen) * 1.15;
    this.high = high > this.high ? high : this.high + (high - this.high) * 0.02;
    this.low = low < this.low ? low : this.low + (low - this.low) * 0.02;
  }

  frame(g, y, left, right, window) {
    g.font = "12px system-ui, sans-serif";
    g.fillStyle = colour("soft");
    g.textAlign = "left";
    const along = this.letters.length > 1 ? ` along ${this.letters[0]}, dotted along ${this.letters[1]}` : "";
    g.fillText(`Force [N]${along}${window ? ", in slow motion" : ""}`, left + 2, 12);
    g.textAlign = "right";
    const marks = [0, ...[this.limit, -this.limit].filter((at) => at && at < this.high && at > this.low)];
    for (const end of [this.high, this.low]) {
      const at = Number((end / 1.15).toPrecision(2));
      if (Math.abs(at) > 0.3 && marks.every((mark) => Math.abs(y(mark) - y(at)) > 14)) marks.push(at);
    }
    for (const at of marks) {
      const limit = this.limit && Math.abs(at) === this.limit;
      g.strokeStyle = colour(limit ? "bad" : "grid");
      g.setLineDash(limit ? [6, 4] : []);
      g.lineWidth = 1;
      g.beginPath();
      g.moveTo(left, y(at));
      g.lineTo(right, y(at));
      g.stroke();
      g.fillStyle = colour(limit ? "bad" : "soft");
      g.fillText(limit ? `limit ${fixed(at, 0)}` : fixed(at, Math.abs(at) < 10 && at ? 1 : 0), left - 5, y(at) + 4);
    }
    g.setLineDash([]);
  }

  // Which curve is the other recording's.
  name(g, whole, right, room) {
    let name = whole;
    while (name.length > 4 && g.measureText(name).width > room) name = `${name.slice(0, -2)}…`;
    g.fillStyle = colour("beside-ink");
    g.textAlign = "right";
    g.fillText(name, right, 12);
    g.fillStyle = colour("beside");
    g.fillRect(right - g.measureText(name).width - 24, 7, 18, 3);
  }

  curve(g, times, values, x, y, tint, width, dash) {
    g.strokeStyle = colour(tint);
    g.lineWidth = width;
    g.lineJoin = "round";
    g.setLineDash(dash);
    g.beginPath();
    let pen = false;
    for (let k = 0; k < times.length; k++) {
      if (values[k] === null) { pen = false; continue; }
      g[pen ? "lineTo" : "moveTo"](x(times[k]), y(Math.max(this.low * 2, Math.min(this.high * 2, values[k]))));
      pen = true;
    }
    g.stroke();
    g.setLineDash([]);
  }

  // Moments at which the driver handed over its limit.
  held(g, times, force, x, top) {
    if (!this.limit) return;
    g.fillStyle = colour("bad");
    for (let k = 0; k < times.length; k++) if (force[k] !== null && Math.abs(force[k]) > 0.99 * this.limit) g.fillRect(x(times[k]) - 1.5, top, 3, 7);
  }

  cursor(g, x, top, bottom) {
    g.strokeStyle = colour("ink");
    g.lineWidth = 1.5;
    g.beginPath();
    g.moveTo(x, top);
    g.lineTo(x, bottom);
    g.stroke();
  }
}
