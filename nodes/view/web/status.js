// Status: one sentence, and the figures.
import { count, fixed, unbroken } from "./format.js";

export class Status {
  constructor(places) { Object.assign(this, places); this.rows = new Map(); this.ended = false; this.lost = 0; this.measures = true; this.replay = false; }

  connected(open) {
    clearTimeout(this.lost);
    if (open) this.notice.hidden = true;
    else if (!this.ended) this.lost = setTimeout(() => this.tell("The page has lost its connection and tries again…"), 400);
  }

  // The launcher serves the page of a run that has ended: it can start another one.
  end({ reason, recordings }) {
    this.ended = true;
    this.notice.hidden = true;
    const where = recordings.length ? ` Recorded: ${recordings.join(", ")}.` : "";
    this.overTold.textContent = unbroken(`The run has ended: ${reason.replace(/\.$/, "")}.${where} What was received stays here to be looked at.`);
    this.over.hidden = this.again.disabled = false;
    this.again.textContent = "Start again";
  }

  starting() {
    this.again.disabled = true;
    this.again.textContent = "Starting …";
  }

  begun() {
    this.ended = false;
    this.over.hidden = true;
  }

  tell(text) {
    this.notice.textContent = unbroken(text);
    this.notice.hidden = text === "";
  }

  show(found) {
    const words = unbroken(found.words), kind = words.replace(/[\d.]+/g, "");
    if (this.words.textContent !== words) this.words.textContent = words;
    // Announce to screen readers only when the kind of sentence changes, not for each number.
    if (kind !== this.kind) Object.assign(this, { kind }).told.textContent = words;
    this.words.dataset.level = this.dot.dataset.level = found.level;
    if (!this.replay) this.row("rate", found.rate_hz ? `${fixed(found.rate_hz, 1)} Hz` : "–");
    if (this.measures) {
      this.row("response p50", micro(found.response_us.p50));
      this.row("p99", micro(found.response_us.p99));
    }
    this.row("delay", `${fixed(found.delay_ticks, 2)} ticks`);
    const lately = found.missed_lately;
    if (this.measures) this.row("missed", lately ? `${fixed(found.missed, 0)} (${count(lately, "tick")} in 10 s)` : fixed(found.missed, 0), lately > 0);
    if (found.overruns) this.row("overruns", fixed(found.overruns, 0), lately > 0);
    this.row("time", `${fixed(found.t, 1)} s`);
    // Unchanged, it costs no layout.
    const nodes = JSON.stringify(found.nodes);
    if (nodes !== this.listed) this.nodes.replaceChildren(...Object.entries(found.nodes).map(([name, { state, silent_s: silent }]) =>
      Object.assign(document.createElement("li"), { textContent: silent ? `${name}: silent for ${fixed(silent, 0)} s` : name, className: silent || state === "failed" ? "silent" : state === "ended" ? "ended" : "", title: state })));
    this.listed = nodes;
    if (found.ended && !this.ended) {
      this.ended = true;
      this.tell(`The run has ended: ${found.ended}. What was received stays here to be looked at.`);
    }
  }

  row(name, told, bad = false) {
    const text = unbroken(told);
    if (!this.rows.has(name)) {
      const row = document.createElement("div"), value = document.createElement("dd");
      row.append(Object.assign(document.createElement("dt"), { textContent: name }), value);
      this.figures.append(row);
      this.rows.set(name, value);
    }
    const value = this.rows.get(name);
    if (value.textContent !== text) value.textContent = text;
    value.classList.toggle("bad", bad);
  }
}

function micro(value) { return value === undefined ? "–" : `${fixed(value, 0)} µs`; }
