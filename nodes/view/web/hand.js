// Mouse, finger or arrow keys as a hand: moves the hand's target without jumps.
const STEP = 0.0005;
const GLIDE = 0.15;
const NEAR = 44;

export class Hand {
  // `place` returns a pointer's coordinate [m], the present target, both ends of the view, and
  // pixels per metre.
  constructor(canvas, place, move) {
    Object.assign(this, { canvas, place, move, held: null, by: "", grip: 0, wanted: 0, ready: false, used: false, finger: null });
    canvas.addEventListener("pointerdown", (event) => {
      // Ignore a second finger.
      if (!this.ready || event.button || this.finger !== null) return;
      this.finger = event.pointerId;
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      const target = this.held ?? this.place.target(), at = this.place.coordinate(event);
      // Near the handle, drag from the touched point; elsewhere, glide there.
      this.grip = Math.abs(at - target) * this.place.scale() < NEAR ? at - target : 0;
      this.take(target, at - this.grip, "pointer");
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.by === "pointer" && event.pointerId === this.finger) this.pull(this.place.coordinate(event) - this.grip);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => {
      if (event.pointerId !== this.finger) return;
      this.finger = null;
      this.letGo();
    });
    // Losing focus by Tab releases the keys, but not a mouse that still drags.
    canvas.addEventListener("blur", () => { if (this.by === "keys") this.letGo(); });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
      if (event.key === "Escape") this.letGo();
      else if (this.ready && step && this.by !== "pointer") {
        event.preventDefault();
        const from = this.held ?? this.place.target();
        this.take(from, from + step * STEP * (event.shiftKey ? 10 : 1), "keys");
      }
    });
  }

  take(from, to, by) {
    if (this.held === null) this.held = from;
    this.by = by;
    this.used = true;
    this.gliding = by === "pointer" && Math.abs(to - from) > 1e-6;
    this.since = performance.now();
    this.canvas.classList.add("held");
    this.pull(to);
  }

  pull(to) {
    const [low, high] = this.place.ends();
    this.wanted = Math.min(high, Math.max(low, to));
    this.step();
  }

  // Per frame: glide towards the pointer, then send. A hand close enough follows at once.
  step() {
    if (this.held === null) return;
    const now = performance.now(), most = GLIDE * Math.min(0.1, (now - this.since) / 1e3), way = this.wanted - this.held;
    this.since = now;
    if (this.gliding && Math.abs(way) > Math.max(most, 2e-4)) this.held += Math.sign(way) * most;
    else { this.held = this.wanted; this.gliding = false; }
    this.tell();
  }

  // Also ten times a second, so that a still hand does not fall silent.
  tell() { if (this.held !== null) this.move(this.held); }

  letGo() {
    if (this.held === null) return;
    this.held = null;
    this.by = "";
    this.canvas.classList.remove("held");
    this.move(null);
  }
}
