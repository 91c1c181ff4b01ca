// The scene along one axis, to scale, and beside it the last millimetre around the surface.
import { fixed, unbroken } from "./format.js";
import { Hand } from "./hand.js";
import { paint } from "./picture.js";
import { onTheme } from "./theme.js";

const INDEX = { x: 0, y: 1, z: 2 };
const TRACE_SECONDS = 1.6;
const ROOM = 0.008;
const WIDE = matchMedia("(min-width: 641px) and (min-height: 481px)");
const LENSES = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05];

export class Scene {
  constructor(canvas, lens, reading, move) {
    Object.assign(this, { canvas, lens, reading, now: null, trace: [], hand: false, limit: null });
    this.grip = new Hand(canvas, {
      coordinate: (event) => this.coordinate(event),
      target: () => this.now?.target[this.axis] || 0,
      ends: () => [this.middle - this.half, this.middle + this.half],
      scale: () => this.scale(),
    }, (held) => move(held === null ? null : [0, 1, 2].map((k) => (k === this.axis ? held : 0))));
    this.clear();
    onTheme(() => this.draw());
    for (const each of [canvas, lens]) new ResizeObserver(() => this.draw()).observe(each);
  }

  clear() {
    Object.assign(this, { axis: 0, letter: "x", upright: false, surface: null, trace: [], middle: 0, half: 0.03, forceScale: 4, deepest: 0 });
  }

  start({ axes, hand, has_hand: hasHand, peak_n: peak, shape }) {
    const picker = document.getElementById("axis");
    picker.replaceChildren(...(axes.length > 1 && shape?.parts?.length ? ["3-D"] : []).concat(axes).map((view) => new Option(view)));
    document.getElementById("axes").hidden = axes.length < 2;
    this.limit = peak ?? null;
    this.hand = hand || Boolean(hasHand);
    this.look(axes[0], hand);
  }

  look(letter, hand) {
    this.letGo();
    this.clear();
    Object.assign(this, { axis: INDEX[letter], letter, upright: letter === "z" });
    this.draggable = hand;
    // With role "application" it gets its arrow keys; a screen reader would keep them.
    this.canvas.setAttribute("role", hand ? "application" : "img");
    this.canvas.setAttribute("aria-label", hand
      ? "Scene. Drag to move the hand, or use the arrow keys; Escape lets go."
      : "Scene: device, surface and force.");
  }

  get draggable() { return this.grip.ready; }
  set draggable(can) { this.grip.ready = can; this.canvas.classList.toggle("hand", can); }
  get held() { return this.grip.held; }
  letGo() { this.grip.letGo(); }
  tell() { this.grip.tell(); }

  scale() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return (this.upright ? height : width) / (2 * this.half);
  }

  coordinate(event) {
    const box = this.canvas.getBoundingClientRect();
    const along = this.upright ? box.height / 2 - (event.clientY - box.top) : event.clientX - box.left - box.width / 2;
    return this.middle + along / this.scale();
  }

  // -- content ------------------------------------------------------------------------------------

  show(now) {
    this.now = now;
    const a = this.axis;
    if (now.normal[a]) this.surface = { at: now.position[a] - now.normal[a] * now.distance, side: now.normal[a] };
    else if (!now.normal.some(Boolean)) this.surface = null;
    if (now.target[a]) this.hand = true;
    this.trace.push([now.t, now.position[a]]);
    while (this.trace.length && (this.trace[0][0] < now.t - TRACE_SECONDS || this.trace[0][0] > now.t)) this.trace.shift();
    // Scale arrows to the strongest recent force, so that their meaning is stable; none before the
    // first answer.
    const strongest = Math.max(...[now.force[a], now.asked[a]].map((force) => (Number.isFinite(force) ? Math.abs(force) : 0)));
    this.forceScale = Math.max(2, Math.min(strongest, this.limit ?? Infinity), this.forceScale * 0.999);
    this.deepest = Math.max(now.contact === 1 ? Math.abs(now.distance) || 0 : 0, this.deepest * 0.99);
    this.fit();
  }

  // Keep everything relevant in view without moving under the user's hand.
  fit() {
    if (this.held !== null || !this.now) return;
    const a = this.axis, seen = [this.now.position[a], 0];
    // Include some space behind the surface, to push into.
    if (this.surface) seen.push(this.surface.at, this.surface.at - this.surface.side * ROOM);
    if (this.hand) seen.push(this.now.target[a]);
    const shown = seen.filter(Number.isFinite);
    const low = Math.min(...shown), high = Math.max(...shown);
    const wanted = Math.max(0.012, (high - low) * 0.5 * 1.3), middle = (low + high) / 2;
    // Grows at once, shrinks slowly.
    if (low < this.middle - this.half * 0.92 || high > this.middle + this.half * 0.92) {
      this.middle = middle;
      this.half = Math.max(this.half, wanted);
    } else if (this.half > wanted * 1.5) {
      this.half *= 0.99;
      this.middle += (middle - this.middle) * 0.02;
    }
  }

  draw() {
    this.grip.step();
    const { now, axis, letter, surface, trace, hand, held, limit, forceScale, upright } = this;
    const beside = now && this.beside?.at(now.t);
    const it = { now, beside, axis, letter, surface, trace, hand, held, limit, forceScale, handle: this.draggable, asks: this.draggable && !this.grip.used };
    paint(this.canvas, { upright, middle: this.middle, half: this.half, lens: false }, it);
    // In 3D there is no canvas for one axis.
    this.lens.hidden = !surface || !this.canvas.clientWidth;
    if (this.lens.hidden) return;
    const half = LENSES.find((size) => size > this.deepest * 1.15) ?? this.half;
    // Magnification, for the lens' title.
    it.times = ((upright ? this.lens.clientHeight : this.lens.clientWidth) / (2 * half)) / this.scale();
    paint(this.lens, { upright, middle: surface.at, half, lens: true }, it);
  }

  // The figures stand beside the surface, behind it; on a small screen in their corner.
  placeReading() {
    const { reading, surface, canvas, upright } = this;
    const at = surface && WIDE.matches ? (surface.at - this.middle) * this.scale() : null;
    if (at === null) { this.placed = ""; reading.style.left = reading.style.right = reading.style.top = ""; return; }
    const key = [at, canvas.clientWidth, canvas.clientHeight, reading.textContent.length].join();
    if (key === this.placed) return;
    this.placed = key;
    const along = upright ? canvas.clientHeight / 2 - at : canvas.clientWidth / 2 + at;
    const size = upright ? reading.offsetHeight : reading.offsetWidth, behind = (upright ? surface.side > 0 : surface.side < 0) ? 10 : -10 - size;
    const most = (upright ? canvas.clientHeight : canvas.clientWidth) - size - 10, place = Math.max(10, Math.min(most, along + behind));
    reading.style.right = "auto";
    reading.style.left = `${Math.round(upright ? 12 : place)}px`;
    reading.style.top = `${Math.round(upright ? place : 8)}px`;
  }

  // Figures of this moment, updated only as fast as one can read.
  read() {
    const { now, axis } = this;
    if (!now) return;
    const parts = [`${fixed(now.position[axis] * 1e3, 2)} mm`];
    if (now.contact === 1 && this.surface) parts.push(`${fixed(Math.abs(now.distance * 1e3), 2)} mm deep`);
    parts.push(`${fixed(now.force[axis], 2)} N`);
    const told = unbroken(parts.join("   ·   "));
    if (told !== this.reading.textContent) this.reading.textContent = told;
    this.placeReading();
  }
}
