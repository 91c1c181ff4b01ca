// The map of stability: which K and B of the present kind of law the loop bears, and where the law stands.
import { colour, onTheme } from "./theme.js";

export class StabilityMap {
  constructor(canvas, words, button) {
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

  show(map) {
    this.map = map;
    this.canvas.hidden = !map.edge;
    this.button.hidden = !map.edge;
    this.words.replaceChildren(...this.tell(map));
    this.canvas.setAttribute("aria-label", this.words.textContent);
    this.draw();
  }

  tell(map) {
    if (map.why) return [map.why];
    const bold = (text, bad) => Object.assign(document.createElement("b"), { textContent: text, className: bad ? "bad" : "" });
    const at = ` at a delay of ${map.delay_ticks.toFixed(2)} ticks`;
    if (!map.stable) {
      const edge = map.k_max_n_per_m === null ? "no K is stable" : `stable up to K = ${figure(map.k_max_n_per_m)} N/m`;
      return [bold("Unstable", true), `${at}: ${edge}.`];
    }
    const k = map.k_max_n_per_m === null ? "without limit" : `${(map.k_max_n_per_m / map.k_n_per_m).toPrecision(3)} × K`;
    const delay = map.delay_margin_ticks === null ? "over 20 ticks" : `${map.delay_margin_ticks.toFixed(2)} ticks`;
    return ["Stable", `${at}. To the edge: `, bold(k), map.k_max_n_per_m === null ? "" : ` (${figure(map.k_max_n_per_m)} N/m)`, ", or ", bold(`${delay} more delay`), "."];
  }

  draw() {
    const { canvas, map } = this;
    if (!map?.edge || !canvas.clientWidth) return;
    const width = canvas.clientWidth, height = canvas.clientHeight, ratio = devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    const rows = map.edge.filter(([b]) => this.whole || b <= map.near * 1.0001);
    const most = Math.max(map.k_n_per_m * 1.25, ...rows.map(([, , high]) => (high ?? 0) * 1.12));
    const right = this.whole ? Math.max(...rows.map(([b]) => b)) : map.near;
    const left = 50, bottom = height - 30, top = 8, end = width - 10;
    const x = (b) => left + (b / right) * (end - left), y = (k) => bottom - (k / most) * (bottom - top);
    g.font = "11.5px system-ui, sans-serif";
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
    this.point(g, x(Math.min(map.b_n_s_per_m, right)), y(map.k_n_per_m), map.k_max_n_per_m === null ? null : y(map.k_max_n_per_m));
  }

  point(g, u, v, edge) {
    const tint = colour(this.map.stable ? "device" : "bad");
    g.strokeStyle = g.fillStyle = tint;
    if (edge !== null) {
      g.setLineDash([3, 4]);
      g.lineWidth = 1.5;
      g.beginPath();
      g.moveTo(u, v);
      g.lineTo(u, edge);
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
    for (const k of nice(most, 4)) {
      g.beginPath(); g.moveTo(left, y(k)); g.lineTo(end, y(k)); g.stroke();
      g.fillText(k >= 10000 ? `${k / 1000}k` : `${k}`, left - 6, y(k) + 4);
    }
    g.textAlign = "center";
    for (const b of nice(right, 5)) {
      g.beginPath(); g.moveTo(x(b), top); g.lineTo(x(b), bottom); g.stroke();
      g.fillText(`${b}`, x(b), bottom + 14);
    }
    g.textAlign = "right";
    g.fillText("B [N s/m]", end, bottom + 27);
    g.textAlign = "left";
    g.fillText("K [N/m]", left + 5, top + 10);
  }
}

function nice(most, count) {
  const raw = most / count, decade = 10 ** Math.floor(Math.log10(raw));
  const step = decade * [1, 2, 5, 10].find((factor) => factor * decade >= raw);
  const found = [];
  for (let n = 0; n * step <= most; n++) found.push(+(n * step).toPrecision(6));
  return found;
}

function figure(value) { return value >= 100 ? Math.round(value).toLocaleString("en").replaceAll(",", " ") : value.toPrecision(3); }
