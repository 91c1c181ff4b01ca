// The whole run at once, behind the slider of a recording: force and position of one axis, the other
// recording, and where the law was switched.
import { colour, onTheme } from "./theme.js";
import { blank } from "./strokes.js";

export class Whole {
  constructor(canvas) {
    Object.assign(this, { canvas, store: null, over: null, marks: [] });
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // A store of the whole run, its ends [s], and the axis that is drawn.
  start(store, begin, end) {
    Object.assign(this, { store, begin, end });
    this.draw();
  }

  look(letter) {
    this.letter = letter;
    this.draw();
  }

  draw() {
    const { canvas, store, begin, end, letter } = this, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!store || !letter || !width || !height) return;
    const g = blank(canvas), x = (t) => ((t - begin) / Math.max(end - begin, 1e-9)) * (width - 4) + 2;
    const names = [`position.${letter}`, `force.${letter}`].map((name) => store.index(name));
    const [times, position, force] = store.columns(names, begin, end, Math.max(50, Math.round(width)));
    const over = this.over?.curve("force", letter);
    this.line(g, times.map(x), position, height, "device", 1, position);
    const forces = over ? [...force, ...over] : force;
    this.line(g, times.map(x), force, height, "force", 1.3, forces);
    if (over) this.line(g, this.over.times.map(x), over, height, "beside", 1, forces);
    g.fillStyle = colour("soft");
    for (const { t, text } of this.marks) if (text) g.fillRect(x(t), 0, 1, height);
  }

  line(g, x, values, height, tint, width, among) {
    let low = Infinity, high = -Infinity;
    for (const each of among) if (each !== null && Number.isFinite(each)) { low = Math.min(low, each); high = Math.max(high, each); }
    const span = Math.max(high - low, 1e-9);
    g.strokeStyle = colour(tint);
    g.lineWidth = width;
    g.beginPath();
    let pen = false;
    for (let k = 0; k < x.length; k++) {
      if (values[k] === null || !Number.isFinite(values[k])) { pen = false; continue; }
      g[pen ? "lineTo" : "moveTo"](x[k], height - 3 - ((values[k] - low) / span) * (height - 6));
      pen = true;
    }
    g.stroke();
  }
}
