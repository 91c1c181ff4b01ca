// Slider for the delay of a virtual device, up to the stability limit, or beyond it if the dial may
// go there.
import { fixed, unbroken } from "./format.js";

const STEPS = 400, BELOW = 0.98, FARTHEST = 8, RESTS = 700;

export class Delay {
  // `change` is called with the device's delay [ticks] and whether the loop is unstable at it.
  constructor({ row, slider, told, beyond }, change) {
    Object.assign(this, { row, slider, told, box: beyond, change, ticks: null, edge: null, turning: -Infinity });
    slider.addEventListener("input", () => {
      this.turning = performance.now();
      this.set((slider.value / STEPS) * this.most());
    });
    for (const event of ["change", "blur"]) slider.addEventListener(event, () => { this.turning = -Infinity; });
    beyond.addEventListener("change", () => {
      if (!beyond.checked && this.isPast(this.ticks)) this.set(this.most());
      this.fill();
    });
  }

  start({ delays, rate_hz: rate }) { Object.assign(this, { offered: delays, period: 1000 / rate, ticks: null }); this.row.hidden = !delays; }

  // Show the device's present delay, and the delay at which the law becomes unstable (null if far).
  show(ticks, edge) {
    Object.assign(this, { ticks, edge });
    if (performance.now() - this.turning > RESTS) this.fill();
  }

  isPast(ticks) { return this.edge !== null && ticks >= this.edge; }

  most() { return this.box.checked || this.edge === null ? FARTHEST : Math.max(0, Math.min(FARTHEST, BELOW * this.edge)); }

  set(ticks) {
    const wanted = Math.min(this.most(), Number(ticks.toFixed(2)));
    this.write(wanted);
    this.change(wanted, this.isPast(wanted));
  }

  fill() {
    if (this.ticks === null) return;
    const most = this.most();
    this.slider.disabled = !most;
    this.slider.value = most ? Math.round((STEPS * this.ticks) / most) : 0;
    this.slider.style.setProperty("--safe-part", `${this.edge === null || !most ? 100 : Math.min(100, (100 * this.edge) / most)}%`);
    this.write(this.ticks);
  }

  write(ticks) {
    const edge = this.edge === null ? "" : this.edge <= 0 ? ", past the edge" : this.isPast(ticks) ? `, past the edge at ${fixed(this.edge, 1)}` : ` of ${fixed(this.edge, 1)} to the edge`;
    this.told.textContent = unbroken(`${fixed(ticks, 1)} ticks${edge} (${fixed(ticks * this.period, 1)} ms)`);
    this.told.classList.toggle("bad", this.isPast(ticks));
    this.slider.setAttribute("aria-valuetext", this.told.textContent);
  }
}
