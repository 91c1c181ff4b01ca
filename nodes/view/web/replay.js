// The time slider of a recording.
import { fixed, unbroken } from "./format.js";

export class Replay {
  constructor(places, ask) {
    Object.assign(this, places);
    this.ask = ask;
    this.playing = true;
    this.play.addEventListener("click", () => this.set(!this.playing));
    this.seek.addEventListener("input", () => { this.moving = true; this.ask({ op: "seek", t: Number(this.seek.value) }); });
    this.seek.addEventListener("change", () => { this.moving = false; });
    this.speed.addEventListener("change", () => this.ask({ op: "speed", factor: Number(this.speed.value) }));
  }

  // Seek to a clicked moment.
  go(t) { this.ask({ op: "seek", t: Math.min(Number(this.seek.max), Math.max(Number(this.seek.min), t)) }); }

  start(hello) {
    this.on = hello.replay;
    if (!this.on) return;
    this.seek.min = hello.begin_s;
    this.seek.max = hello.end_s;
    this.show(true);
  }

  // Pause at a time, for a link that carries it.
  stay(t) {
    this.set(false);
    this.go(t);
  }

  async set(playing) {
    const answer = await this.ask({ op: playing ? "play" : "pause" });
    if (answer.ok) this.show(playing);
  }

  show(playing) {
    this.playing = playing;
    this.play.textContent = playing ? "Pause" : "Play";
    this.play.setAttribute("aria-pressed", playing);
  }

  at(t) {
    if (!this.on || Number.isNaN(t)) return;
    if (!this.moving) this.seek.value = t;
    this.clock.textContent = unbroken(`${fixed(t, 2)} s`);
    if (this.playing && t >= Number(this.seek.max) - 1e-6) this.show(false);
  }
}
