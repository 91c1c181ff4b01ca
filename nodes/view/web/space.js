// The scene in 3D: solids redrawn only when they or the camera move; device, proxy and force on
// top.
import { fixed, unbroken } from "./format.js";
import { Solids } from "./solids.js";
import { dotAt, line, ring, zigzag } from "./strokes.js";
import { colour, onTheme } from "./theme.js";

const LIGHT = [0.35, -0.5, 0.79];
const TRACE_SECONDS = 2;
const STEP = 0.0005;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const plus = (a, b, by = 1) => [a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const size = (a) => Math.sqrt(dot(a, a));

export class Space {
  // `move` is called with the wanted position of the hand [m], or null on release.
  constructor(canvas, move) {
    Object.assign(this, { canvas, move, still: document.createElement("canvas"), shape: null, solids: null, section: null, finger: null, now: null, trace: [], held: null, ready: false, by: "" });
    this.turn = { yaw: -0.7, pitch: 0.45, scale: 1, middle: [0, 0, 0] };
    onTheme(() => { this.drawn = ""; });
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => { if (event.pointerId === this.finger) this.lift(); });
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("blur", () => { if (!this.by) this.letGo(); });
  }

  start({ shape, hand, axes }) {
    this.shape = axes.length > 1 && (shape?.triangles?.length || shape?.bodies) ? shape : null;
    this.solids = this.shape && new Solids(shape);
    this.ready = hand;
    this.drawn = "";
    this.trace.length = 0;
    if (this.shape) Object.assign(this.turn, this.solids.extent());
  }

  // Set the poses of the bodies.
  pose(poses) {
    if (!this.solids) return;
    const first = !this.solids.poses;
    this.solids.pose(poses);
    if (first) Object.assign(this.turn, this.solids.extent());
  }

  // -- the camera ---------------------------------------------------------------------------------

  axes() {
    const { yaw, pitch } = this.turn;
    const right = [Math.cos(yaw), Math.sin(yaw), 0], away = [-Math.sin(yaw) * Math.cos(pitch), Math.cos(yaw) * Math.cos(pitch), -Math.sin(pitch)];
    return { right, up: cross(right, away), away };
  }

  // Project to pixels from the middle, and depth [m].
  seen(point) {
    const { right, up, away } = this.camera, from = minus(point, this.turn.middle);
    return [dot(from, right) * this.pixels, -dot(from, up) * this.pixels, dot(from, away)];
  }

  press(event) {
    // Ignore a second finger.
    if (event.button || this.finger !== null) return;
    this.finger = event.pointerId;
    this.canvas.setPointerCapture(event.pointerId);
    this.last = [event.offsetX, event.offsetY];
    const [u, v] = this.now ? this.seen(this.now.target) : [1e9, 0], { clientWidth: width, clientHeight: height } = this.canvas;
    const near = Math.hypot(event.offsetX - width / 2 - u, event.offsetY - height / 2 - v) < 40;
    this.by = this.ready && near ? "hand" : "camera";
    if (this.by === "hand") this.held = [...this.now.target];
  }

  // The handle moves in the camera's plane; dragging anywhere else turns the camera.
  drag(event) {
    if (!this.by || event.pointerId !== this.finger) return;
    const du = event.offsetX - this.last[0], dv = event.offsetY - this.last[1];
    this.last = [event.offsetX, event.offsetY];
    if (this.by === "camera") {
      this.turn.yaw -= du * 0.008;
      this.turn.pitch = Math.min(1.5, Math.max(-1.5, this.turn.pitch + dv * 0.008));
      return;
    }
    // Released meanwhile: the connection was lost, or another page holds the hand.
    if (!this.held) return;
    this.held = plus(plus(this.held, this.camera.right, du / this.pixels), this.camera.up, -dv / this.pixels);
    this.tell();
  }

  lift() {
    this.by = "";
    this.finger = null;
    this.letGo();
  }

  // Arrow keys move the hand in the camera's plane, Page Up and Page Down in depth; Escape releases
  // it.
  key(event) {
    if (event.key === "Escape") return this.letGo();
    const { right, up, away } = this.camera ?? {}, way = { ArrowRight: [right, 1], ArrowLeft: [right, -1], ArrowUp: [up, 1], ArrowDown: [up, -1], PageUp: [away, 1], PageDown: [away, -1] }[event.key];
    if (!way || !right || !this.ready || !this.now || this.by) return;
    event.preventDefault();
    this.held = plus(this.held ?? [...this.now.target], way[0], way[1] * STEP * (event.shiftKey ? 10 : 1));
    this.tell();
  }

  // The wheel moves the hand in depth while it is held, else the camera.
  wheel(event) {
    event.preventDefault();
    if (this.held) {
      this.held = plus(this.held, this.camera.away, -event.deltaY * 2e-5);
      this.tell();
    } else this.turn.scale = Math.min(8, Math.max(0.2, this.turn.scale * Math.exp(-event.deltaY * 0.001)));
  }

  tell() { if (this.held) this.move(this.held); }

  letGo() {
    if (!this.held) return;
    this.held = null;
    this.move(null);
  }

  // -- content ------------------------------------------------------------------------------------

  show(now) {
    this.now = now;
    this.trace.push([now.t, [...now.position], Math.hypot(...now.force)]);
    while (this.trace.length && (this.trace[0][0] < now.t - TRACE_SECONDS || this.trace[0][0] > now.t)) this.trace.shift();
  }

  draw() {
    const { canvas, still } = this, width = canvas.clientWidth, height = canvas.clientHeight, ratio = devicePixelRatio || 1;
    if (!width || !this.shape) return;
    const { yaw, pitch, scale, reach } = this.turn, view = [yaw, pitch, scale, width, height, ratio, this.solids.version].join();
    this.camera = this.axes();
    this.pixels = (0.42 * Math.min(width, height) * scale) / reach;
    for (const each of [canvas, still]) if (each.width !== Math.round(width * ratio) || each.height !== Math.round(height * ratio)) { each.width = Math.round(width * ratio); each.height = Math.round(height * ratio); }
    const middle = (g) => g.setTransform(ratio, 0, 0, ratio, (width * ratio) / 2, (height * ratio) / 2);
    if (this.drawn !== view) {
      const g = still.getContext("2d");
      g.setTransform(1, 0, 0, 1, 0, 0);
      g.clearRect(0, 0, still.width, still.height);
      middle(g);
      this.paint(g);
      this.drawn = view;
    }
    const g = canvas.getContext("2d");
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, canvas.width, canvas.height);
    g.drawImage(still, 0, 0);
    middle(g);
    if (this.now && this.now.position.every(Number.isFinite)) this.bodies(g);
  }

  // From far to near, brighter towards the light.
  paint(g) {
    const faces = [];
    for (const { points: [a, b, c], tool } of this.solids.all()) {
      const normal = cross(minus(b, a), minus(c, a)), length = size(normal);
      if (length < 1e-15) continue;
      const points = [a, b, c].map((point) => this.seen(point));
      faces.push([points[0][2] + points[1][2] + points[2][2], points, Math.abs(dot(normal, LIGHT)) / length, tool]);
    }
    faces.sort((one, other) => other[0] - one[0]);
    g.lineWidth = 1;
    for (const [, points, bright, tool] of faces) {
      g.beginPath();
      points.forEach(([u, v], n) => g[n ? "lineTo" : "moveTo"](u, v));
      g.closePath();
      g.fillStyle = g.strokeStyle = `color-mix(in srgb, ${colour(tool ? "proxy" : "wall-edge")} ${Math.round(100 - 75 * bright)}%, ${colour("wall")})`;
      g.fill();
      g.stroke();
    }
    this.directions(g);
  }

  directions(g) {
    g.font = "600 12px system-ui, sans-serif";
    [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].forEach(([letter, axis]) => {
      const { right, up } = this.camera, u = 26 * dot(axis, right), v = -26 * dot(axis, up);
      const { clientWidth: width, clientHeight: height } = this.canvas, [x, y] = [width / 2 - 52, height / 2 - 40];
      line(g, "soft", 1.5, [[x, y], [x + u, y + v]]);
      g.fillStyle = colour("soft");
      g.fillText(letter, x + 1.3 * u - 3, y + 1.3 * v + 4);
    });
  }

  bodies(g) {
    const { now } = this, device = this.seen(now.position), target = this.seen(this.held ?? now.target), taken = this.seen(now.target);
    for (let k = 1; k < this.trace.length; k++) {
      g.globalAlpha = 0.6 * (1 - (now.t - this.trace[k][0]) / TRACE_SECONDS);
      line(g, this.trace[k][2] > 0.05 ? "force" : "device", 1.5, [this.seen(this.trace[k - 1][1]), this.seen(this.trace[k][1])]);
    }
    g.globalAlpha = 0.7;
    for (const ends of this.section?.lines(now) ?? []) line(g, "ink", 1, ends.map((point) => this.seen(point)));
    g.globalAlpha = 1;
    line(g, "target", 1.5, [device, taken], [4, 3]);
    dotAt(g, "target", taken, 8);
    ring(g, "target", target, 13, 1.5);
    if (now.contact === 1) {
      const proxy = this.seen(now.proxy);
      this.cone(g, now);
      line(g, "proxy", 2, zigzag(device, proxy));
      if (!this.shape.bodies) dotAt(g, "proxy", proxy, 7);
      line(g, "wall-edge", 2, [proxy, this.seen(plus(now.proxy, now.normal, 0.008))]);
    }
    // Draw the device transparent while it is inside.
    g.globalAlpha = now.contact === 1 ? 0.55 : 1;
    dotAt(g, "device", device, 9);
    g.globalAlpha = 1;
    const force = Math.hypot(...now.force);
    if (force > 0.02) {
      const tip = this.seen(plus(now.position, now.force, 0.01));
      line(g, "force", 3.5, [device, tip]);
      g.fillStyle = colour("force");
      g.font = "600 12px system-ui, sans-serif";
      g.fillText(`${fixed(force, 1)} N`, tip[0] + 6, tip[1] - 4);
    }
  }

  // Figures of this moment.
  read(place) {
    if (!this.now) return;
    const { contact, distance, normal, force } = this.now, parts = [];
    if (contact === 1 && normal.some(Boolean)) parts.push(`${fixed(Math.abs(distance) * 1e3, 2)} mm deep`);
    place.textContent = unbroken([...parts, `${fixed(Math.hypot(...force), 2)} N`].join("   ·   "));
  }

  // Friction cone: inside it the contact sticks; red when the force is on it or outside.
  cone(g, { proxy, normal, force }) {
    const mu = this.shape.friction;
    if (!mu) return;
    const straight = dot(force, normal), aside = size(minus(force, normal.map((each) => each * straight)));
    const slides = aside > 0.98 * mu * Math.abs(straight), first = cross(normal, Math.abs(normal[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]), long = size(first);
    const a = first.map((each) => each / long), b = cross(normal, a), points = [];
    for (let k = 0; k <= 24; k++) {
      const angle = (2 * Math.PI * k) / 24;
      points.push(this.seen(plus(plus(plus(proxy, normal, 0.012), a, 0.012 * mu * Math.cos(angle)), b, 0.012 * mu * Math.sin(angle))));
    }
    line(g, slides ? "bad" : "good", 1.5, points);
    for (const k of [0, 6, 12, 18]) line(g, slides ? "bad" : "good", 1, [this.seen(proxy), points[k]]);
  }
}
