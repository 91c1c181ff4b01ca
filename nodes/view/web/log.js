// Log of changes, refusals and important events; newest first.
import { count, figure, fixed, unbroken } from "./format.js";

const KEPT = 200;

export class Log {
  constructor(list) { this.list = list; }

  clear() { this.list.replaceChildren(); }

  add(entry) {
    const item = document.createElement("li"), body = document.createElement("span");
    item.className = entry.action === "fallback" ? "fallback" : entry.kind;
    item.append(Object.assign(document.createElement("time"), { textContent: unbroken(`${fixed(entry.t, 1)} s`) }), body);
    body.append(unbroken(entry.kind === "event" ? `${entry.node}: ${entry.text}` : entry.text));
    if (entry.kind === "receipt") {
      const ramp = entry.ramp ? `, cross-fade of ${count(entry.ramp, "tick")}` : "", why = entry.reason && entry.reason !== "asked" ? `, ${entry.reason}` : "";
      body.append(Object.assign(document.createElement("small"), { textContent: unbroken(`receipt ${entry.revision}: force step ${figure(entry.force_step_n)} N${ramp}${why}`) }));
    }
    this.list.prepend(item);
    while (this.list.childElementCount > KEPT) this.list.lastElementChild.remove();
  }

  refused(text, t) { this.add({ kind: "refused", t, text }); }
}
