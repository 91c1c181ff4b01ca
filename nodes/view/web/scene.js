// The scene to scale, along one axis of those that the loop computes: surface, device, proxy, the hand's target, the force.
import { colour, onTheme } from "./theme.js";

const INDEX = { x: 0, y: 1, z: 2 };
const STEP = 0.0005;
const FORCE_PIXELS = 42;
const TRACE_SECONDS = 1.6;
const ROOM = 0.008;

export class Scene {
  constructor(canvas, reading, move) {
    this.canvas = canvas;
    this.reading = reading;
    this.move = move;
    this.axis = 0;
    this.upright = false;
    this.magnify = 1;
    this.now = null;
    this.trace = [];
    this.middle = 0;
    this.half = 0.03;
    this.held = null;
    this.draggable = false;
    this.surface = null;
    this.springy = false;
    this.forceScale = 4;
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
    this.listen();
  }

  start(axes, hand) {
    const picker = document.getElementById("axis");
    picker.replaceChildren(...axes.map((letter) => new Option(letter)));
    // A hand pulls along the first one.
    picker.onchange = () => this.look(picker.value, hand && picker.value === axes[0]);
    document.getElementById("axes").hidden = axes.length < 2;
    this.look(axes[0], hand);
  }

  look(letter, hand) {
    this.letGo();
    this.axis = INDEX[letter];
    this.letter = letter;
    this.upright = letter === "z";
    Object.assign(this, { surface: null, springy: false, trace: [], middle: 0, half: 0.03 });
    this.draggable = hand;
    this.canvas.classList.toggle("hand", hand);
    this.canvas.setAttribute("aria-label", hand
      ? "Scene. Drag to move the hand, or use the arrow keys; Escape lets go."
      : "Scene: device, surface and force.");
  }

  // -- the hand ---------------------------------------------------------------------------------------------------

  listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.draggable || event.button) return;
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      this.take(this.coordinate(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.held !== null && canvas.hasPointerCapture(event.pointerId)) this.take(this.coordinate(event));
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => this.letGo());
    canvas.addEventListener("blur", () => this.letGo());
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };
      if (event.key === "Escape") this.letGo();
      else if (this.draggable && event.key in steps) {
        event.preventDefault();
        const from = this.held ?? this.now?.target[this.axis] ?? 0;
        this.take(from + steps[event.key] * STEP * (event.shiftKey ? 10 : 1));
      }
    });
  }

  take(coordinate) {
    this.held = Math.min(this.middle + this.half, Math.max(this.middle - this.half, coordinate));
    this.canvas.classList.add("held");
    this.tell();
  }

  letGo() {
    if (this.held === null) return;
    this.held = null;
    this.canvas.classList.remove("held");
    this.move(null);
  }

  // Called some ten times a second too, so that a still hand does not fall silent.
  tell() {
    if (this.held === null) return;
    const target = [0, 0, 0];
    target[this.axis] = this.held;
    this.move(target);
  }

  coordinate(event) {
    const box = this.canvas.getBoundingClientRect();
    const along = this.upright ? box.height / 2 - (event.clientY - box.top) : event.clientX - box.left - box.width / 2;
    return this.middle + along / this.pixels(box.width, box.height);
  }

  // -- what is shown ----------------------------------------------------------------------------------------------

  show(now) {
    this.now = now;
    const a = this.axis;
    if (now.normal[a]) this.surface = { at: now.position[a] - now.normal[a] * now.distance, side: now.normal[a] };
    else if (!now.normal.some(Boolean)) this.surface = null;
    if (now.target[a] !== 0) this.springy = true;
    this.trace.push([now.t, now.position[a]]);
    while (this.trace.length && (this.trace[0][0] < now.t - TRACE_SECONDS || this.trace[0][0] > now.t)) this.trace.shift();
    this.fit();
  }

  // Keep all that matters in sight, without moving under somebody's hand.
  fit(anyway = false) {
    if ((this.held !== null && !anyway) || !this.now) return;
    const a = this.axis, seen = [this.shown(this.now.position[a]), 0];
    // Some of what lies behind the surface too: room to push.
    if (this.surface) seen.push(this.surface.at, this.surface.at - this.surface.side * ROOM);
    if (this.springy) seen.push(this.now.target[a]);
    const shown = seen.filter(Number.isFinite);
    const low = Math.min(...shown), high = Math.max(...shown);
    const wanted = Math.max(0.012, (high - low) * 0.5 * 1.3), middle = (low + high) / 2;
    // Grows at once, shrinks slowly.
    if (low < this.middle - this.half * 0.92 || high > this.middle + this.half * 0.92) {
      this.middle = middle;
      this.half = Math.max(this.half, wanted);
    } else if (this.half > wanted * 2.2) {
      this.half *= 0.99;
      this.middle += (middle - this.middle) * 0.02;
    }
  }

  pixels(width, height) { return (this.upright ? height : width) / (2 * this.half); }

  // Where a coordinate is along the axis [pixels from the middle]; what is inside the surface may be magnified.
  along(value, scale) { return (this.shown(value) - this.middle) * scale; }

  shown(value) {
    const { surface, magnify } = this;
    const depth = surface && magnify > 1 ? (surface.at - value) * surface.side : 0;
    return depth > 0 ? surface.at - depth * magnify * surface.side : value;
  }

  draw() {
    const { canvas } = this;
    const width = canvas.clientWidth, height = canvas.clientHeight, ratio = devicePixelRatio || 1;
    if (!width) return;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, width, height);
    g.translate(width / 2, height / 2);
    const length = this.upright ? height : width, breadth = this.upright ? width : height;
    const scale = this.pixels(width, height);
    const lines = this.lines(scale);
    this.ruler(g, lines, breadth);
    g.save();
    // From here on u runs along the axis and v across it, upwards or to the left.
    if (this.upright) g.rotate(-Math.PI / 2);
    this.wall(g, length, breadth, scale);
    g.restore();
    this.labels(g, lines, length, breadth);
    if (this.upright) g.rotate(-Math.PI / 2);
    if (this.now && Number.isFinite(this.now.position[this.axis])) this.bodies(g, breadth, scale);
  }

  // Where the ruler has its lines: pixels from the middle, and what is written there.
  lines(scale) {
    const raw = 70 / scale, decade = 10 ** Math.floor(Math.log10(raw));
    const step = decade * [1, 2, 5, 10].find((factor) => factor * decade >= raw);
    const found = [];
    for (let n = Math.ceil((this.middle - this.half) / step); n * step <= this.middle + this.half; n++) {
      // Inside a magnified surface it does not hold.
      if (this.shown(n * step) === n * step) found.push([Math.round((n * step - this.middle) * scale) + 0.5, `${+(n * step * 1e3).toPrecision(6)}`]);
    }
    return found;
  }

  ruler(g, lines, breadth) {
    g.lineWidth = 1;
    g.strokeStyle = colour("grid");
    g.beginPath();
    for (const [u] of lines) {
      if (this.upright) { g.moveTo(-breadth / 2, -u); g.lineTo(breadth / 2, -u); } else { g.moveTo(u, -breadth / 2); g.lineTo(u, breadth / 2); }
    }
    g.stroke();
  }

  labels(g, lines, length, breadth) {
    g.font = "11.5px system-ui, sans-serif";
    g.fillStyle = colour("soft");
    for (const [u, text] of lines) {
      if (Math.abs(u) > length / 2 - 28) continue;
      g.textAlign = this.upright ? "left" : "center";
      if (this.upright) g.fillText(text, -breadth / 2 + 16, -u - 4); else g.fillText(text, u, breadth / 2 - 10);
    }
    g.textAlign = "right";
    g.fillText(`${this.letter ?? "x"} [mm]`, (this.upright ? breadth : length) / 2 - 14, (this.upright ? length : breadth) / 2 - 26);
  }

  wall(g, length, breadth, scale) {
    if (!this.surface) return;
    const at = (this.surface.at - this.middle) * scale, inward = -this.surface.side;
    const end = inward * (length / 2 + Math.abs(at) + 10);
    g.save();
    g.beginPath();
    g.rect(Math.min(at, end), -breadth, Math.abs(end - at), 2 * breadth);
    g.clip();
    g.fillStyle = colour("wall");
    g.fillRect(Math.min(at, end), -breadth, Math.abs(end - at), 2 * breadth);
    g.strokeStyle = colour("wall-edge");
    g.globalAlpha = 0.22;
    g.lineWidth = 1.5;
    g.beginPath();
    for (let v = -2 * breadth; v < 2 * breadth; v += 14) { g.moveTo(at, v); g.lineTo(at + inward * breadth, v + breadth); }
    g.stroke();
    g.restore();
    const { now } = this;
    const push = now && now.contact ? Math.min(1, Math.abs(now.force[this.axis]) / this.forceScale) : 0;
    if (push > 0) {
      const glow = g.createRadialGradient(at, 0, 2, at, 0, 46 + 60 * push);
      glow.addColorStop(0, colour("force"));
      glow.addColorStop(1, `${colour("force")}00`);
      g.globalAlpha = 0.1 + 0.3 * push;
      g.fillStyle = glow;
      g.fillRect(at - 120, -120, 240, 240);
      g.globalAlpha = 1;
    }
    g.strokeStyle = colour("wall-edge");
    g.lineWidth = 2;
    g.beginPath();
    g.moveTo(at, -breadth / 2);
    g.lineTo(at, breadth / 2);
    g.stroke();
  }

  bodies(g, breadth, scale) {
    const { now, axis } = this;
    const u = this.along(now.position[axis], scale), radius = 13;
    // What was: time runs away across the axis.
    g.lineWidth = 1.5;
    g.strokeStyle = colour("device");
    for (let k = 1; k < this.trace.length; k++) {
      const age = (now.t - this.trace[k][0]) / TRACE_SECONDS, before = (now.t - this.trace[k - 1][0]) / TRACE_SECONDS;
      g.globalAlpha = 0.5 * (1 - age);
      g.beginPath();
      g.moveTo(this.along(this.trace[k - 1][1], scale), -before * breadth * 0.5);
      g.lineTo(this.along(this.trace[k][1], scale), -age * breadth * 0.5);
      g.stroke();
    }
    g.globalAlpha = 1;
    const target = this.held ?? now.target[axis];
    if (this.springy || this.held !== null) this.spring(g, u, (target - this.middle) * scale, (now.target[axis] - this.middle) * scale);
    if (now.contact) {
      const proxy = (now.proxy[axis] - this.middle) * scale;
      g.strokeStyle = colour("proxy");
      g.lineWidth = 2.5;
      g.beginPath();
      g.arc(proxy, 0, radius, 0, 2 * Math.PI);
      g.stroke();
    }
    g.fillStyle = colour("device");
    g.beginPath();
    g.arc(u, 0, radius - 3, 0, 2 * Math.PI);
    g.fill();
    const given = now.force[axis], asked = now.asked[axis];
    // Settles on the strongest force of late, so that arrows keep their meaning.
    this.forceScale = Math.max(2, Math.abs(given), Math.abs(asked), this.forceScale * 0.999);
    this.arrow(g, u, asked, "asked", 1.5);
    this.arrow(g, u, given, "force", 4);
  }

  spring(g, u, wanted, taken) {
    g.strokeStyle = g.fillStyle = colour("target");
    g.lineWidth = 1.4;
    g.globalAlpha = 0.75;
    const turns = 9, v = 26;
    g.beginPath();
    g.moveTo(u, 8);
    g.lineTo(u, v);
    for (let k = 1; k < turns; k++) g.lineTo(u + (taken - u) * (k / turns), v + (k % 2 ? 5 : -5));
    g.lineTo(taken, v);
    g.stroke();
    g.globalAlpha = 1;
    g.lineWidth = 2;
    g.beginPath();
    g.arc(taken, v, 6, 0, 2 * Math.PI);
    g.fill();
    if (this.held !== null) {
      // Where the hand is wanted; what it has taken lags behind at the speed limit.
      g.beginPath();
      g.arc(wanted, v, 13, 0, 2 * Math.PI);
      g.stroke();
    }
  }

  arrow(g, u, force, name, width) {
    const size = (force / this.forceScale) * FORCE_PIXELS * 3;
    if (!(Math.abs(size) > 1.5)) return;
    const tip = u + size, sign = Math.sign(size), v = -26;
    g.strokeStyle = g.fillStyle = colour(name);
    g.lineWidth = width;
    g.lineCap = "round";
    g.beginPath();
    g.moveTo(u, v);
    g.lineTo(tip - sign * 5, v);
    g.stroke();
    g.beginPath();
    g.moveTo(tip, v);
    g.lineTo(tip - sign * (6 + width), v - 3 - width);
    g.lineTo(tip - sign * (6 + width), v + 3 + width);
    g.fill();
  }

  // The figures of this very moment, a few times a second: faster cannot be read.
  read() {
    const { now, axis } = this;
    if (!now) return;
    const parts = [`${(now.position[axis] * 1e3).toFixed(2)} mm`];
    if (now.contact && this.surface) parts.push(`${Math.abs(now.distance * 1e3).toFixed(2)} mm deep`);
    parts.push(`${now.force[axis].toFixed(2)} N`);
    this.reading.textContent = parts.join("   ·   ");
  }
}
