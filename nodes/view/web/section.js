// Plane of section through the device: the cut, and device, proxy and force projected onto it;
// plots use its axes.
import { reachOf } from "./camera.js";
import { fixed, step } from "./format.js";
import { colour } from "./theme.js";
import { blank, dotAt, line, ring, zigzag } from "./strokes.js";

const LETTERS = "xyz", ARROW = 0.01;

export class Section {
  // `turned` is called with the letters of the plane's two axes.
  constructor(canvas, picker, turned) {
    Object.assign(this, { canvas, picker, plane: "", solids: null, far: 0 });
    picker.addEventListener("change", () => { this.plane = picker.value; this.far = 0; turned([...this.plane]); });
  }

  // Planes of the scene's axes; upright ones first, as most objects lie below.
  start(solids, axes) {
    this.solids = solids;
    this.far = 0;
    const planes = ["xz", "yz", "xy"].filter((plane) => [...plane].every((letter) => axes.includes(letter)));
    this.picker.replaceChildren(...planes.map((plane) => new Option(plane)));
    this.picker.parentElement.hidden = !solids;
    this.plane = planes[0] ?? "";
  }

  get axes() { return [...this.plane].map((letter) => LETTERS.indexOf(letter)); }
  get across() { return 3 - this.axes[0] - this.axes[1]; }

  // Position of the plane; the 3D view shows the same.
  lines(now) { return this.solids.cut(this.across, now.position[this.across]); }

  // `reach`: half of the visible size [m], about the scene's middle; a close view follows the
  // device.
  draw(now, { reach: whole, scale, middle: centre }) {
    const { canvas } = this, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !this.solids || !now?.position.every(Number.isFinite)) return;
    const close = scale > 1.2, middle = close ? now.position : centre, least = Math.min(width, height);
    // A picture that stays contains device and target wherever they were so far.
    if (!close) this.far = Math.max(this.far, reachOf([now.position, now.target], centre, this.axes, [width, height]));
    const reach = close ? (0.8 * whole) / scale : Math.max((0.8 * whole) / scale, this.far);
    const g = blank(canvas), [across, up] = this.axes, pixels = least / (2 * reach);
    const at = (point) => [(point[across] - middle[across]) * pixels, -(point[up] - middle[up]) * pixels];
    g.translate(width / 2, height / 2);
    for (const [from, to] of this.lines(now)) line(g, "wall-edge", 2, [at(from), at(to)]);
    dotAt(g, "target", at(now.target), 5);
    line(g, "target", 1, [at(now.position), at(now.target)], [4, 3]);
    if (now.contact === 1) {
      line(g, "proxy", 2, zigzag(at(now.position), at(now.proxy)));
      ring(g, "proxy", at(now.proxy), 8, 2.5);
    }
    dotAt(g, "device", at(now.position), 6);
    const tip = now.position.map((each, k) => each + ARROW * now.force[k]);
    if (Math.hypot(now.force[across], now.force[up]) > 0.02) line(g, "force", 3, [at(now.position), at(tip)]);
    this.words(g, width, height, pixels);
  }

  words(g, width, height, pixels) {
    // In the corner of a phone's scene it would cover the content; the label beside it names the
    // plane.
    if (width < 160) return;
    const long = step(50 / pixels), [u, v] = [width / 2 - 12, height / 2 - 14];
    line(g, "soft", 1.5, [[u - long * pixels, v], [u, v]]);
    g.font = "12px system-ui, sans-serif";
    g.fillStyle = colour("soft");
    g.textAlign = "right";
    g.fillText(`${fixed(long * 1e3, long < 1e-3 ? 1 : 0)} mm`, u, v - 6);
    g.textAlign = "left";
    g.fillText(`${this.plane[0]} →, ${this.plane[1]} ↑`, 12 - width / 2, v);
  }
}
