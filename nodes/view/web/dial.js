// Dial for the wall's stiffness. It ends at the stability limit; a virtual device may go beyond it.
import { figure, rough, unbroken } from "./format.js";

const STEPS = 1000, SOFTEST = 0.02, BELOW = 0.98, PAST = 8, RESTS = 700;

export class Dial {
  // `change` is called with a stiffness [N/m] and whether it is beyond the limit.
  constructor({ dial, hardness, edge, beyond, allowed }, change) {
    Object.assign(this, { dial, hardness, mark: edge, box: beyond, allowed, change, edge: null, stiffness: null, looked: false, turning: -Infinity });
    dial.addEventListener("input", () => {
      this.turning = performance.now();
      const wanted = this.value();
      this.write(wanted);
      change(wanted, this.isPast(wanted));
    });
    for (const event of ["change", "blur"]) dial.addEventListener(event, () => { this.turning = -Infinity; });
    beyond.addEventListener("change", () => {
      // Revoking the permission returns the dial to the limit.
      if (!beyond.checked && this.isPast(this.stiffness)) change(this.ends()[1], false);
      this.fill();
    });
  }

  start(hello) {
    this.allowed.hidden = !hello.beyond;
    this.off = hello.replay;
  }

  // Show stiffness, its limit and whether that was computed; null if the law has no stiffness or
  // limit. `loop` names the law, its other parameters and the device's delay.
  show(stiffness, edge, looked, loop) {
    this.looked = looked;
    const safe = this.edge;
    this.stiffness = stiffness;
    // Ignore small changes of a loop's limit, so that a varying delay does not move the dial under a
    // hand.
    if (!edge || !safe || loop !== this.loop || Math.abs(edge - safe) > 0.02 * safe) this.edge = edge;
    this.loop = loop;
    // Do not move it while it is dragged; a focused but resting dial may move.
    if (performance.now() - this.turning > RESTS) this.fill();
  }

  isPast(stiffness) { return this.edge !== null && stiffness >= this.edge; }

  ends() {
    // Without a known limit, the present stiffness is the maximum.
    const most = this.edge ?? this.stiffness ?? 1;
    return [most * SOFTEST, this.edge === null ? most : most * (this.box.checked ? PAST : BELOW)];
  }

  value() {
    const [least, most] = this.ends();
    // Rounding to three digits changes half a per cent at most, which stays below the limit.
    return Number((least * (most / least) ** (this.dial.value / STEPS)).toPrecision(3));
  }

  place(stiffness) {
    const [least, most] = this.ends();
    return Math.min(1, Math.max(0, Math.log(stiffness / least) / Math.log(most / least)));
  }

  // Act as if the dial were turned to this value.
  set(stiffness) {
    const wanted = Math.min(this.ends()[1], Number(stiffness.toPrecision(3)));
    this.change(wanted, this.isPast(wanted));
  }

  // Allow stiffness beyond the limit.
  let(times) {
    if (this.allowed.hidden || this.edge === null) return;
    this.box.checked = true;
    this.set(times * this.edge);
  }

  fill() {
    const { dial, stiffness, edge } = this;
    dial.disabled = this.off || stiffness === null;
    if (stiffness === null) {
      this.hardness.textContent = "–";
      this.mark.textContent = "This law has no single stiffness: its parameters are in the lab.";
      return;
    }
    dial.value = Math.round(STEPS * this.place(stiffness));
    const safe = edge === null ? 1 : this.place(edge);
    dial.style.setProperty("--safe-part", `${100 * safe}%`);
    this.write(stiffness);
  }

  write(stiffness) {
    const past = this.isPast(stiffness);
    this.hardness.textContent = unbroken(`${figure(stiffness)} N/m`);
    this.hardness.classList.toggle("bad", past);
    this.mark.textContent = unbroken(this.edge === null ? (this.looked ? "The edge is not known here." : "looking for the edge …")
      : past ? `${rough(stiffness / this.edge)} × the edge of ${rough(this.edge)} N/m`
      : `edge at ${rough(this.edge)} N/m: ${rough(this.edge / stiffness)} × this`);
    this.dial.setAttribute("aria-valuetext", `${this.hardness.textContent}, ${this.mark.textContent}`);
  }
}
