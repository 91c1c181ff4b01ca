// The time of a recording: play, pause, and a slider over the whole run.
import { fixed, unbroken } from "./format.js";

export class Replay {
  constructor(places, ask) {
    Object.assign(this, places);
    this.ask = ask;
    this.playing = true;
    // Whether it plays on once the slider is let go; null while it is not pulled.
    this.goesOn = null;
    this.wanted = null;
    this.play.addEventListener("click", () => this.set(!this.playing));
    this.seek.addEventListener("input", () => this.pull());
    this.seek.addEventListener("change", () => this.letGo());
    this.speed.addEventListener("change", () => this.ask({ op: "speed", factor: Number(this.speed.value) }));
  }

  get begin() { return Number(this.seek.min); }
  get end() { return Number(this.seek.max); }

  // Seek to a clicked moment.
  go(t) { return this.ask({ op: "seek", t: Math.min(this.end, Math.max(this.begin, t)) }); }

  // Time stands still while the slider is pulled, or it would run away from the hand.
  pull() {
    if (this.goesOn === null) {
      this.goesOn = this.playing;
      if (this.playing) this.ask({ op: "pause" });
    }
    this.tell(Number(this.seek.value));
    this.wanted = Number(this.seek.value);
    this.chase();
  }

  // One request at a time, always for the newest place.
  async chase() {
    if (this.chasing) return;
    this.chasing = true;
    while (this.wanted !== null) {
      const t = this.wanted;
      this.wanted = null;
      await this.go(t);
    }
    this.chasing = false;
  }

  async letGo() {
    const t = Number(this.seek.value), goesOn = this.goesOn && t < this.end - 1e-6;
    this.wanted = null;
    await this.go(t);
    if (goesOn) await this.ask({ op: "play" });
    else this.show(false);
    this.goesOn = null;
  }

  start(hello) {
    this.on = hello.replay;
    if (!this.on) return;
    this.seek.min = hello.begin_s;
    this.seek.max = hello.end_s;
    this.seek.step = hello.period_s ?? 0.01;
    this.goesOn = null;
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

  // Go on by some seconds, for the arrow keys.
  by(seconds) { if (this.on) this.go(Number(this.seek.value) + seconds); }

  at(t) {
    if (!this.on || Number.isNaN(t)) return;
    // Pictures of moments before the slider's are still under way.
    if (this.goesOn !== null) return;
    this.seek.value = t;
    this.tell(t);
    if (this.playing && t >= this.end - 1e-6) this.show(false);
  }

  tell(t) {
    this.clock.textContent = unbroken(`${fixed(t, 2)} s`);
    this.seek.setAttribute("aria-valuetext", `${fixed(t, 2)} of ${fixed(this.end, 2)} seconds`);
  }
}
