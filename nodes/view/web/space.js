// The scene in 3D: solids redrawn only when they or the camera move; device, proxy and force on
// top.
import { fixed, step, unbroken } from "./format.js";
import { atDepth, axesOf, cross, depthOf, dot, minus, MODES, planeOf, plus, size, stepOf } from "./camera.js";
import { Lit } from "./lit.js";
import { Painter } from "./painter.js";
import { Solids } from "./solids.js";
import { dotAt, line, ring, zigzag } from "./strokes.js";
import { colour, onTheme } from "./theme.js";

const TRACE_SECONDS = 2;
const STEP = 0.0005;
const REST = 200; // time after which the camera rests [ms]
const UNSEEN = 0.25; // motion of a body that no picture shows [pixels]
const REACH = 40; // how far from the handle a press still takes it [pixels]
const CATCH_SECONDS = 0.5; // a handle that moves is taken where it was this long ago, too
const BALL = 8; // smallest radius of the device's ball [pixels]

export class Space {
  // `move` is called with the wanted position of the hand [m], or null on release; `modes` are the
  // buttons of what a drag moves along.
  constructor(canvas, move, modes = []) {
    Object.assign(this, { canvas, move, modes: [...modes], mode: "view", shape: null, solids: null, section: null, finger: null, now: null, trace: [], held: null, ready: false, by: "", drawn: "", loaded: null });
    this.turn = { yaw: -0.7, pitch: 0.45, scale: 1, middle: [0, 0, 0] };
    this.newStill(true);
    onTheme(() => { this.drawn = ""; });
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => { if (event.pointerId === this.finger) this.lift(); });
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("blur", () => { if (!this.by) this.letGo(); });
    for (const button of this.modes) button.addEventListener("click", () => this.choose(button.dataset.mode));
  }

  // A picture by WebGL 2; by the processor where a browser has none, or loses it.
  newStill(wanted) {
    this.lit = wanted ? Lit.made() : null;
    this.picture = this.lit ?? new Painter(document.createElement("canvas"));
    this.still = this.picture.canvas;
    this.loaded = null;
    this.drawn = "";
    this.lit?.gl.canvas.addEventListener("webglcontextlost", () => this.newStill(false));
  }

  // What a drag moves along: view, ground or surface.
  choose(mode) {
    this.mode = mode;
    for (const button of this.modes) button.setAttribute("aria-pressed", button.dataset.mode === mode);
  }

  start({ shape, hand, axes }) {
    this.shape = axes.length > 1 && shape?.parts?.length ? shape : null;
    this.solids = this.shape && new Solids(shape);
    this.ready = hand;
    this.replaced = false;
    this.drawn = "";
    this.loaded = null;
    this.trace.length = 0;
    if (this.shape) this.fit();
    for (const button of this.modes) button.parentElement.hidden = !this.shape || !hand;
  }

  // Replace the shape; the camera stays as long as it sees the new one as well.
  reshape(shape) {
    if (!this.shape) return;
    this.shape = { tool_radius: 0, friction: 0, parts: [], ...shape };
    this.solids = new Solids(this.shape);
    this.drawn = "";
    this.replaced = true;
    // Bodies have no place before their poses come.
    if (this.shape.parts.length && this.solids.parts.every(({ pose }) => pose < 0)) this.place();
  }

  // Fit the first shape; of a later one only the ground, as long as the camera sees it as well.
  place() {
    const { middle, reach, low } = this.solids.extent(), near = size(minus(middle, this.turn.middle)) < 0.5 * this.turn.reach;
    if (this.replaced && near && reach < 1.5 * this.turn.reach && reach > 0.5 * this.turn.reach) this.ground.at = Math.min(this.ground.at, low - 0.004 * reach);
    else this.fit();
  }

  // Camera and ground for everything that is placed.
  fit() {
    const { middle, reach, low } = this.solids.extent();
    Object.assign(this.turn, { middle, reach });
    this.ground = { at: low - 0.004 * reach, cell: step(reach / 4) };
    this.drawn = "";
  }

  // Set the poses of the bodies. Return whether a picture shows it.
  pose(poses) {
    if (!this.solids) return false;
    const first = !this.solids.poses, { version } = this.solids;
    this.solids.pose(poses, this.pixels ? UNSEEN / this.pixels : 0);
    if (first) this.place();
    return version !== this.solids.version;
  }

  // -- the camera ---------------------------------------------------------------------------------

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
    this.by = this.ready && this.catches(event) ? "hand" : "camera";
    if (this.by === "hand") this.take();
  }

  // Whether a press is near the handle or the device, as they are or were when it was aimed.
  catches({ offsetX, offsetY }) {
    if (!this.now) return false;
    const x = offsetX - this.canvas.clientWidth / 2, y = offsetY - this.canvas.clientHeight / 2;
    const late = this.trace.filter(([t]) => t > this.now.t - CATCH_SECONDS).map(([, position]) => position);
    return [this.now.target, ...late].some((point) => {
      const [u, v] = this.seen(point);
      return Math.hypot(x - u, y - v) < REACH;
    });
  }

  // The handle moves along what was chosen; dragging anywhere else turns the camera.
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
    this.shift(du / this.pixels, -dv / this.pixels);
  }

  // Move the hand by a step of the picture [m].
  shift(across, above) {
    this.held = plus(this.held, stepOf(this.camera, planeOf(this.mode, this.normal), across, above));
    this.tell();
  }

  // Move the hand in depth: away, to the ground, or into the surface [m].
  push(by) {
    this.held = plus(this.held, depthOf(this.mode, this.camera, this.normal), by);
    if (this.depth !== null) this.depth += by;
    this.tell();
  }

  take() {
    this.held ??= [...this.now.target];
    this.depth ??= null;
    if (this.now.contact === 1 && this.now.normal.some(Boolean)) this.depth ??= -dot(minus(this.held, this.now.proxy), this.now.normal);
  }

  // Along a surface, the target follows its curvature at the depth at which it was taken.
  follow() {
    const { now } = this, touches = now.contact === 1 && now.normal.some(Boolean);
    if (touches) this.normal = [...now.normal];
    if (!this.held || this.mode !== "surface") { if (!this.held) this.depth = null; return; }
    if (!touches) return;
    this.depth ??= -dot(minus(this.held, now.proxy), now.normal);
    this.held = atDepth(this.held, now.proxy, now.normal, this.depth);
  }

  lift() {
    this.by = "";
    this.finger = null;
    this.letGo();
  }

  // Arrow keys move the hand along what was chosen, Page Up and Page Down in depth; V, G and S
  // choose; Escape releases it.
  key(event) {
    if (event.key === "Escape") return this.letGo();
    const mode = MODES[event.key.toLowerCase()];
    if (mode && !event.ctrlKey && !event.metaKey && !event.altKey) return this.choose(mode);
    const way = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1], PageUp: [0, 0, 1], PageDown: [0, 0, -1] }[event.key];
    if (!way || !this.camera || !this.ready || !this.now || this.by) return;
    event.preventDefault();
    this.take();
    const by = STEP * (event.shiftKey ? 10 : 1);
    if (way[2]) this.push(way[2] * by); else this.shift(way[0] * by, way[1] * by);
  }

  // The wheel moves the hand in depth while it is held, else the camera.
  wheel(event) {
    event.preventDefault();
    if (this.held) this.push(-event.deltaY * 2e-5);
    else this.turn.scale = Math.min(8, Math.max(0.2, this.turn.scale * Math.exp(-event.deltaY * 0.001)));
  }

  tell() { if (this.held) this.move(this.held); }

  letGo() {
    if (!this.held) return;
    this.held = this.depth = null;
    this.move(null);
  }

  // -- content ------------------------------------------------------------------------------------

  show(now) {
    this.now = now;
    this.follow();
    this.trace.push([now.t, [...now.position], Math.hypot(...now.force)]);
    while (this.trace.length && (this.trace[0][0] < now.t - TRACE_SECONDS || this.trace[0][0] > now.t)) this.trace.shift();
  }

  draw() {
    const { canvas, still } = this, width = canvas.clientWidth, height = canvas.clientHeight, ratio = devicePixelRatio || 1;
    if (!width || !this.shape) return;
    const { yaw, pitch, scale, reach } = this.turn, sight = [yaw, pitch, scale, width, height, ratio].join(), view = `${sight},${this.solids.version}`;
    this.camera = axesOf(this.turn);
    this.pixels = (0.42 * Math.min(width, height) * scale) / reach;
    for (const each of [canvas, still]) if (each.width !== Math.round(width * ratio) || each.height !== Math.round(height * ratio)) { each.width = Math.round(width * ratio); each.height = Math.round(height * ratio); }
    if (this.loaded !== this.solids) {
      this.picture.load(this.solids);
      this.loaded = this.solids;
    }
    // A picture of less detail, while the camera turns, is replaced when it rests.
    const time = performance.now(), turning = this.drawn !== view && this.drawn !== "";
    if (turning) this.turned = time;
    // Bodies that move before a still camera are looked at: not coarser than half.
    const least = sight === this.sight ? 0.5 : 0;
    this.sight = sight;
    if (this.drawn !== view || (this.rough && time - this.turned > REST)) {
      this.rough = this.picture.draw({ turn: this.turn, pixels: this.pixels, width, height, ground: this.ground, tints: this.tints(), turning, least });
      this.drawn = view;
    }
    const there = this.now !== null && this.now.position.every(Number.isFinite);
    this.picture.finish(this.balls(there));
    const g = canvas.getContext("2d");
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, canvas.width, canvas.height);
    g.drawImage(still, 0, 0);
    g.setTransform(ratio, 0, 0, ratio, (width * ratio) / 2, (height * ratio) / 2);
    this.directions(g);
    if (there) this.bodies(g);
  }

  // Colours of the parts: their own, or those of the page.
  tints() {
    const found = this.solids.parts.map((part) => part.colour ?? rgb(part.tool ? "proxy" : "solid"));
    return Object.assign(found, { ground: rgb("ground") });
  }

  // Device and proxy as balls, and where a plumb line from the device lands.
  balls(there) {
    const tints = { device: rgb("device"), proxy: rgb("proxy"), line: rgb("soft") }, { now } = this;
    if (!there) return { device: null, proxy: null, landing: 0, tints };
    const radius = Math.max(this.shape.tool_radius, BALL / this.pixels);
    const proxy = now.contact === 1 && !this.shape.bodies ? [...now.proxy, Math.max(this.shape.tool_radius, 0.75 * radius)] : null;
    return { device: [...now.position, radius], proxy, landing: this.solids.below(now.position, this.ground.at), tints };
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
    dotAt(g, "target", taken, 4);
    ring(g, "target", target, 13, 1.5);
    if (now.contact === 1) {
      const proxy = this.seen(now.proxy);
      this.cone(g, now);
      line(g, "proxy", 2, zigzag(device, proxy));
      if (!this.shape.bodies && !this.lit) dotAt(g, "proxy", proxy, 7);
      line(g, "wall-edge", 2, [proxy, this.seen(plus(now.proxy, now.normal, 0.008))]);
    }
    // Without depth, the device is transparent while it is inside.
    if (!this.lit) {
      g.globalAlpha = now.contact === 1 ? 0.55 : 1;
      dotAt(g, "device", device, 9);
      g.globalAlpha = 1;
    }
    const other = this.beside?.at(now.t);
    if (Array.isArray(other?.place)) {
      ring(g, "beside", this.seen(other.place), BALL + 1, 3);
      line(g, "beside", 2, [this.seen(other.place), this.seen(plus(other.place, other.whole, 0.01))]);
    }
    const force = Math.hypot(...now.force);
    if (force > 0.02) {
      const tip = this.seen(plus(now.position, now.force, 0.01));
      line(g, "force", 3.5, [device, tip]);
      g.fillStyle = colour("force");
      g.font = "600 12px system-ui, sans-serif";
      g.fillText(`${fixed(force, force < 0.1 ? 2 : 1)} N`, tip[0] + 6, tip[1] - 4);
    }
  }

  // Whether the force lies on the friction cone, or outside.
  slides() {
    const { force, normal } = this.now, straight = dot(force, normal);
    return size(minus(force, normal.map((each) => each * straight))) > 0.98 * this.shape.friction * Math.abs(straight);
  }

  // Figures of this moment.
  read(place) {
    if (!this.now) return;
    const { contact, distance, normal, force } = this.now, parts = [];
    if (contact === 1 && normal.some(Boolean)) parts.push(`${fixed(Math.abs(distance) * 1e3, 2)} mm deep`);
    if (parts.length && this.shape.friction && size(force) > 0.02) parts.push(this.slides() ? "slides" : "sticks");
    place.textContent = unbroken([...parts, `${fixed(Math.hypot(...force), 2)} N`].join("   ·   "));
  }

  // Friction cone: inside it the contact sticks; red when the force is on it or outside.
  cone(g, { proxy, normal }) {
    const mu = this.shape.friction;
    if (!mu) return;
    const slides = this.slides(), first = cross(normal, Math.abs(normal[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]), long = size(first);
    const a = first.map((each) => each / long), b = cross(normal, a), points = [];
    for (let k = 0; k <= 24; k++) {
      const angle = (2 * Math.PI * k) / 24;
      points.push(this.seen(plus(plus(plus(proxy, normal, 0.012), a, 0.012 * mu * Math.cos(angle)), b, 0.012 * mu * Math.sin(angle))));
    }
    line(g, slides ? "bad" : "good", 1.5, points);
    for (const k of [0, 6, 12, 18]) line(g, slides ? "bad" : "good", 1, [this.seen(proxy), points[k]]);
  }
}

// A colour of the page as red, green and blue of 1.
function rgb(name) {
  const code = colour(name);
  return [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16) / 255);
}
