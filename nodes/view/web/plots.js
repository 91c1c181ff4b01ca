// Time plots of position, force, energy and response; each pixel column shows its smallest and
// largest value.
import { digits, fixed, unbroken } from "./format.js";
import { colour, onTheme } from "./theme.js";

const UNIT = { position: ["Position [mm]", 1e3], force: ["Force [N]", 1], energy: ["Energy of the wall [mJ]: + given out, − taken in", 1e3], response: ["Response [µs]", 1e6] };
const UNITS = { position: "mm", force: "N", energy: "mJ", response: "µs" };
const PANELS = [
  { unit: "position", height: 170, lines: [["proxy", "proxy", "proxy"], ["target", "target", "hand’s target"], ["position", "device", "device"]] },
  { unit: "force", height: 150, lines: [["law_force", "asked", "law"], ["force", "force", "handed over"]] },
  { unit: "energy", height: 96, lines: [["energy", "device", ""]] },
  { unit: "response", height: 96, lines: [["response", "soft", ""]] },
];

export class Plots {
  // `picked` is called with a clicked time [s]; `over` returns other curves of the same time:
  // times, and values by unit, or an Over. `whole` is a coarse store of all of a recording.
  constructor(place, legend, values, viewChanged, picked) {
    Object.assign(this, { values, picked, over: null, whole: null, run: null, at: null, fingers: new Map() });
    this.place = place;
    this.legend = legend;
    this.viewChanged = viewChanged;
    this.span = 10;
    this.window = null;
    this.still = false;
    this.marks = [];
    this.panels = [];
    onTheme(() => this.panels.forEach(({ plot }) => plot.redraw(false, true)));
    new ResizeObserver(() => this.resize()).observe(place);
    for (const name of ["mouseup", "blur"]) addEventListener(name, () => { this.still = false; });
  }

  start(store, axes, hand) {
    this.store = store;
    this.letters = axes;
    this.place.replaceChildren();
    this.panels.forEach(({ plot }) => plot.destroy());
    this.legend.replaceChildren();
    this.panels = PANELS.map((panel) => this.panel(panel, axes, hand));
    if (axes.length > 1) this.legend.append(axes.map((axis, k) => `${axis} ${["solid", "dashed", "dash-dotted"][k]}`).join(", "));
    this.name();
    this.resize();
  }

  // The legend's entry of another recording.
  name() {
    this.named?.remove();
    const over = this.over?.();
    this.named = over?.name ? entry("beside", over.name) : null;
    if (this.named) this.legend.append(this.named);
  }

  panel({ unit, height, lines }, axes, hand) {
    const [title, factor] = UNIT[unit];
    const series = [{}], wanted = [];
    for (const [name, tint, label] of lines) {
      if (name === "target" && !hand) continue;
      const found = axes.length && this.store.index(`${name}.${axes[0]}`) >= 0 ? axes.map((axis) => `${name}.${axis}`) : [name];
      for (const [k, each] of found.entries()) {
        wanted.push(this.store.index(each));
        series.push({ stroke: () => colour(tint), width: 1.5, points: { show: false }, dash: k ? [[7, 4], [9, 3, 2, 3]][k - 1] : name === "law_force" ? [4, 3] : undefined });
      }
      if (label) this.legend.append(entry(tint, label));
    }
    const box = Object.assign(document.createElement("div"), { className: "plot" });
    box.append(Object.assign(document.createElement("h3"), { textContent: title }));
    this.place.append(box);
    const range = { low: null, high: null };
    const plot = new uPlot({
      width: 400, height, legend: { show: false }, padding: [6, 10, 0, 0],
      cursor: { sync: { key: "time" }, y: false, drag: { x: true, y: false, setScale: false }, points: { show: false } },
      scales: { x: { time: false, auto: false }, y: { range: (_, low, high) => calm(range, low, high) } },
      axes: [axis(unit === "response"), { ...axis(true), size: 58 }],
      series,
      hooks: { setSelect: [(u) => this.selected(u)], setCursor: [(u) => this.read(u)], draw: [(u) => this.drawOver(u, unit), (u) => this.drawMarks(u, unit === "position")] },
    }, [[], ...wanted.map(() => [])], box);
    const canvas = plot.root.querySelector("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", title);
    // Freeze while the user selects.
    plot.over.addEventListener("mousedown", () => { this.still = true; });
    plot.over.addEventListener("dblclick", () => this.follow());
    plot.over.addEventListener("click", (event) => { if (Math.abs(event.offsetX - this.pressed) < 4) this.picked(plot.posToVal(event.offsetX, "x")); });
    plot.over.addEventListener("pointerdown", (event) => { this.pressed = event.offsetX; this.finger(event, plot); });
    plot.over.addEventListener("pointermove", (event) => this.finger(event, plot));
    for (const name of ["pointerup", "pointercancel"]) plot.over.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    plot.over.addEventListener("wheel", (event) => this.wheel(event, plot), { passive: false });
    const names = lines.filter(([name]) => name !== "target" || hand).map(([, , label]) => label || unit);
    // With several axes, each label names its axis.
    const each = axes.length > 1 && lines.length > 1 ? names.flatMap((name) => axes.map((axis) => `${name} ${axis}`)) : names;
    return { plot, wanted, factor, unit, lines: each, height: height + (unit === "response" ? 18 : 0) };
  }

  resize() {
    const width = this.place.clientWidth;
    if (width) this.panels.forEach(({ plot, height }) => plot.setSize({ width, height }));
    this.dirty = true;
  }

  // -- visible time span --------------------------------------------------------------------------

  // Live: the newest span; otherwise the chosen window.
  sight() {
    if (this.window) return this.window;
    // Recording: the page of the time line that contains the present moment, so that any moment can
    // be clicked.
    if (this.replayed && this.run && this.span === Infinity) return this.run;
    if (this.replayed && this.at !== null) {
      const { at, span } = this, begin = this.page ?? -Infinity;
      if (at < begin || at > begin + 0.95 * span || this.paged !== span) Object.assign(this, { page: Math.max(this.store.begin, at - 0.1 * span), paged: span });
      return [this.page, this.page + span];
    }
    const from = Math.max(this.store.begin, this.store.end - this.span);
    return [from, from + this.span];
  }

  look(from, to) {
    this.window = [from, Math.max(to, from + 1e-3)];
    this.dirty = true;
    this.viewChanged(false);
  }

  pause() { const [from, to] = this.sight(); this.look(from, to); }

  follow() { this.window = null; this.dirty = true; this.viewChanged(true); }

  selected(plot) {
    if (plot.select.width < 4) return;
    const from = plot.posToVal(plot.select.left, "x"), to = plot.posToVal(plot.select.left + plot.select.width, "x");
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.look(from, to);
  }

  wheel(event, plot) {
    if (!event.ctrlKey && !event.shiftKey && this.window === null) return;
    event.preventDefault();
    const [from, to] = this.sight(), at = plot.posToVal(event.offsetX, "x"), factor = Math.exp((event.deltaY || event.deltaX) * 0.0015);
    this.look(at - (at - from) * factor, at + (to - at) * factor);
  }

  // One finger pans, two zoom.
  finger(event, plot) {
    if (event.pointerType !== "touch" || (event.type === "pointermove" && !this.fingers.has(event.pointerId))) return;
    const before = [...this.fingers.values()];
    this.fingers.set(event.pointerId, event.offsetX);
    const now = [...this.fingers.values()];
    if (before.length !== now.length || now.length > 2) return;
    const [from, to] = this.sight(), width = plot.over.clientWidth, mean = (all) => all.reduce((sum, each) => sum + each, 0) / all.length;
    const spread = (all) => Math.max(10, Math.abs(all[0] - (all[1] ?? all[0] + 10)));
    const scale = now.length === 2 ? spread(before) / spread(now) : 1, middle = from + (mean(before) / width) * (to - from);
    const begin = middle - (mean(now) / width) * (to - from) * scale;
    this.look(begin, begin + (to - from) * scale);
  }

  // Values under the pointer, in all panels.
  read(plot) {
    const { left, idx } = plot.cursor;
    if (left < 0 || idx === null || idx === undefined || plot !== this.panels[0]?.plot) return;
    const parts = [`${fixed(plot.data[0][idx] ?? 0, 3)} s`];
    for (const { plot: { data }, lines, unit } of this.panels) {
      for (const [k, label] of lines.entries()) {
        const value = data[k + 1]?.[idx];
        if (value !== null && value !== undefined) parts.push(`${label} ${fixed(value, unit === "response" ? 0 : 2)} ${UNITS[unit]}`);
      }
    }
    this.values.textContent = unbroken(parts.join(" · "));
  }

  zoom(factor) {
    const [from, to] = this.sight(), middle = (from + to) / 2, half = ((to - from) / 2) * factor;
    this.look(middle - half, middle + half);
  }

  shift(part) {
    const [from, to] = this.sight(), by = (to - from) * part;
    this.look(from + by, to + by);
  }

  // -- drawing ------------------------------------------------------------------------------------

  draw() {
    if (!this.store || !this.panels.length || this.still || document.hidden) return;
    if (!this.dirty && this.window && this.at === this.drawn) return;
    this.drawn = this.at;
    this.dirty = false;
    const [from, to] = this.sight(), store = this.storeOf(from, to);
    for (const { plot, wanted, factor } of this.panels) {
      const columns = Math.max(50, Math.round(plot.over.clientWidth));
      const data = store.columns(wanted, from, to, columns);
      if (factor !== 1) for (const line of data.slice(1)) for (let k = 0; k < line.length; k++) if (line[k] !== null) line[k] *= factor;
      plot.batch(() => {
        plot.setData(data, false);
        plot.setScale("x", { min: from, max: to });
      });
    }
  }

  // Half a minute around the moment in full; the whole of a recording is coarser.
  storeOf(from, to) {
    const { store, whole, run } = this;
    if (!whole || !run) return store;
    const slack = 0.01 * (to - from);
    return store.begin <= Math.max(from, run[0]) + slack && store.end >= Math.min(to, run[1]) - slack ? store : whole;
  }

  // Curves of another law or recording.
  drawOver(plot, unit) {
    const found = this.over?.();
    const curves = found?.curve ? this.letters.map((letter) => found.curve(unit, letter)) : [found?.[unit]];
    for (const [k, values] of curves.entries()) {
      if (!values || !found.times.length) continue;
      const { ctx, bbox } = plot, [from, to] = this.sight(), factor = UNIT[unit][1];
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      ctx.strokeStyle = colour("beside");
      ctx.lineWidth = 1.5 * devicePixelRatio;
      ctx.setLineDash(k ? [[7, 4], [9, 3, 2, 3]][k - 1].map((part) => part * devicePixelRatio) : []);
      ctx.beginPath();
      let pen = false;
      for (let n = 0; n < values.length; n++) {
        if (found.times[n] < from || found.times[n] > to || values[n] === null) continue;
        ctx[pen ? "lineTo" : "moveTo"](plot.valToPos(found.times[n], "x", true), plot.valToPos(values[n] * factor, "y", true));
        pen = true;
      }
      ctx.stroke();
      ctx.restore();
    }
    // Cursor at the moment that the scene shows.
    if (this.at !== null) {
      const x = plot.valToPos(this.at, "x", true);
      plot.ctx.fillStyle = colour("ink");
      if (x >= plot.bbox.left && x <= plot.bbox.left + plot.bbox.width) plot.ctx.fillRect(x - 1, plot.bbox.top, 2, plot.bbox.height);
    }
  }

  drawMarks(plot, named) {
    const { ctx, bbox } = plot, [from, to] = this.sight();
    ctx.save();
    ctx.textAlign = "left";
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    let free = -Infinity;
    for (const { t, text: whole } of this.marks) {
      const text = whole.length > 24 ? `${whole.slice(0, 23)}…` : whole;
      if (t < from || t > to) continue;
      const x = Math.round(plot.valToPos(t, "x", true)) + 0.5;
      ctx.strokeStyle = ctx.fillStyle = colour("soft");
      ctx.globalAlpha = 0.8;
      ctx.setLineDash([4 * devicePixelRatio, 4 * devicePixelRatio]);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      if (named && text && x > free) {
        ctx.fillText(text, x + 5 * devicePixelRatio, bbox.top + 12 * devicePixelRatio);
        free = x + ctx.measureText(text).width + 12 * devicePixelRatio;
      }
    }
    ctx.restore();
  }

  mark(t, text) {
    this.marks.push({ t, text });
    if (this.marks.length > 400) this.marks.shift();
    this.dirty = true;
  }
}

function axis(shown) {
  return {
    stroke: () => colour("soft"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false },
    // uPlot scales to whole pixels only.
    font: "12px system-ui, sans-serif", values: (_, splits, __, ___, every) => splits.map((at) => (at === null || !shown ? "" : fixed(at, digits(every)))),
    ...(shown ? {} : { size: 8 }),
  };
}

function entry(tint, label) {
  const found = document.createElement("span"), line = document.createElement("i");
  line.style.background = `var(--${tint})`;
  found.append(line, label);
  return found;
}

// Widens at once and narrows slowly, so that the axis does not flicker.
function calm(range, low, high) {
  if (low === null || high === null || !Number.isFinite(low)) return [range.low ?? -1, range.high ?? 1];
  const margin = Math.max((high - low) * 0.08, Math.abs(high) * 1e-3, 1e-4); // what its labels have room for
  low -= margin; high += margin;
  range.low = range.low === null || low < range.low ? low : range.low + (low - range.low) * 0.03;
  range.high = range.high === null || high > range.high ? high : range.high + (high - range.high) * 0.03;
  return [range.low, range.high];
}
