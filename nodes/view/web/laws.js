// Law panel: the active law, and a control per parameter built from the law's types and limits.
import { figure, unbroken } from "./format.js";

const WAIT = 60;
const READ = 12000;

const ENDS = { at_most: "largest", at_least: "smallest" };

// A figure of an end, rounded to the side that is accepted; but not for the last bit.
function within(kind, value) {
  const unit = value === 0 ? 1 : Math.min(1, 10 ** (Math.floor(Math.log10(Math.abs(value))) - 2)), units = value / unit;
  return figure(unit * (kind === "at_most" ? Math.floor(units + 1e-6) : Math.ceil(units - 1e-6)));
}

const NAMES = { hardness: "H(1)", device_delay: "delay" }, UNITS = { delay: " ticks", device_delay: " ticks" };

// Say which value would be accepted in place of a refused one.
function accepted({ kind, values }, joint) {
  const [[path, value]] = Object.entries(values), name = path.split(".").at(-1);
  return `${ENDS[kind]} ${NAMES[name] ?? name}${joint}${within(kind, value)}${UNITS[name] ?? ""}`;
}

// A refusal in a sentence, by what would be accepted where that is known.
export function shortened({ error, remedies = [] }) {
  const [first, ...more] = remedies.filter(({ kind, values }) => Object.hasOwn(ENDS, kind) && Object.keys(values ?? {}).length);
  if (!first) return unbroken(error);
  const why = error.includes("pull into the wall") ? "it would pull into the wall" : "the loop would be unstable";
  const other = more.map((one) => `, or the ${accepted(one, " ")} with the rest as asked`).join("");
  return unbroken(`Refused: ${why}. The ${accepted(first, " that is accepted is ")}${other}.`);
}

export class Laws {
  constructor(places, ask) {
    Object.assign(this, places);
    this.ask = ask;
    this.fields = {};
    this.state = null;
    this.edge = null;
    this.controls = new Map();
    this.wanted = new Map();
    this.busy = false;
    this.ramp.addEventListener("change", () => this.send({ op: "set", node: this.state.node, values: { ramp: Math.round(Number(this.ramp.value)) } }));
    this.undo.addEventListener("click", () => this.takeBack());
    addEventListener("keydown", (event) => {
      if ((event.ctrlKey || event.metaKey) && event.key === "z" && !event.target.matches("[type=number], [type=text]")) { event.preventDefault(); this.takeBack(); }
    });
  }

  start(fields, replay) {
    this.fields = fields;
    this.off = replay;
    this.picker.inert = this.sliders.inert = this.undo.hidden = replay;
    this.ramp.disabled = replay;
  }

  takeBack() { if (!this.off) this.send({ op: "undo" }); }

  async send(request) {
    const answer = await this.ask(request);
    if (answer.ok) this.settle();
    else this.refuse(answer);
    return answer;
  }

  // Reset controls to the active values; the reasons stay marked until they are read or another
  // change succeeds. Each refusal has `error` and, as an answer, `remedies`.
  refuse(...refusals) {
    const shorter = refusals.map(shortened), whole = refusals.map(({ error }) => unbroken(error)).join(" "), told = shorter.join(" ");
    const place = document.createElement(told === whole ? "span" : "details");
    if (told === whole) place.textContent = told;
    else place.append(Object.assign(document.createElement("summary"), { textContent: told }), whole);
    this.refusal.replaceChildren(place);
    this.refusal.hidden = false;
    clearTimeout(this.reading);
    this.reading = setTimeout(() => this.settle(), READ);
    for (const { row } of this.controls.values()) delete row.dataset.moving;
    this.fill();
  }

  settle() {
    clearTimeout(this.reading);
    this.refusal.hidden = true;
    for (const { row } of this.controls.values()) row.classList.remove("refused");
  }

  // Show a new state of the coupling: rebuild controls of changed kind, refill changed values.
  show(state) {
    const before = this.state;
    this.state = state;
    const listed = ({ laws, named, active }) => [Object.keys(laws), named, (named ?? []).includes(active) || active].join();
    if (!before || listed(before) !== listed(state)) this.build(Object.keys(state.laws));
    for (const input of this.picker.querySelectorAll("input")) input.checked = input.value === state.active;
    const law = state.laws[state.active];
    const shape = law && JSON.stringify([state.active, law.kind, Object.entries(law).map(([key, value]) => [key, Array.isArray(value) ? value.length : 0])]);
    if (shape !== this.shape) {
      this.shape = shape;
      this.controls.clear();
      this.sliders.replaceChildren();
      // A pending change belongs to its law; drop it when another law becomes active.
      const { active } = state;
      if (law) for (const field of this.fields[law.kind] ?? []) this.control(field, law[field.name], field.name, (value) => this.change(field.name, value, false, active));
    }
    if (document.activeElement !== this.ramp && state.ramp !== undefined) this.ramp.value = state.ramp;
    this.fill();
  }

  // The launch's laws as buttons, other installed laws in a list, without laws that only measure a
  // device.
  build(names) {
    const { named = names, active, laws } = this.state;
    const offered = names.filter((name) => laws[name].kind !== "excitation" || name === active);
    const first = offered.filter((name) => named.includes(name) || name === active);
    const more = document.createElement("select");
    more.setAttribute("aria-label", "More laws");
    more.append(new Option("more…", ""), ...offered.filter((name) => !first.includes(name)).map((name) => new Option(name)));
    more.addEventListener("change", () => { if (more.value) this.choose(more.value); more.value = ""; });
    this.picker.replaceChildren(...first.map((name) => {
      const label = document.createElement("label"), input = document.createElement("input");
      Object.assign(input, { type: "radio", name: "law", value: name });
      input.addEventListener("change", () => this.choose(name));
      label.title = laws[name].kind;
      label.append(input, name);
      return label;
    }), ...(more.length > 1 ? [more] : []));
  }

  async choose(law) {
    const answer = await this.send({ op: "switch", law });
    if (!answer.ok) this.show(this.state);
  }

  // -- controls -----------------------------------------------------------------------------------

  control(field, value, path, change) {
    if (field.type === "list") {
      for (const [k, item] of (value ?? []).entries()) {
        for (const inner of field.fields) {
          this.control(inner, item[inner.name], `${path}[${k}].${inner.name}`, (now) => {
            const law = this.state.laws[this.state.active];
            const pending = this.wanted.get(field.name)?.value ?? law[field.name];
            change(pending.map((old, i) => i === k ? { ...old, [inner.name]: now } : old));
          });
        }
      }
      return;
    }
    const row = document.createElement("label"), name = document.createElement("span");
    row.className = "slider";
    row.title = field.told;
    name.append(words(path), Object.assign(document.createElement("small"), { textContent: field.unit ? `  ${field.unit}` : "" }));
    row.append(name);
    const made = (field.type === "choice" ? choice : field.type === "numbers" ? numbers : slider)(field, row, change);
    if (field.fixed) {
      row.inert = true;
      row.classList.add("fixed");
      row.title = `${field.told} Fixed on this page.`;
    }
    this.sliders.append(row);
    this.controls.set(path, { ...made, row });
  }

  fill() {
    const law = this.state?.laws[this.state.active];
    if (!law) return;
    for (const [path, { set, row }] of this.controls) {
      // Do not overwrite a control in use.
      if (row.contains(document.activeElement) && row.dataset.moving) continue;
      set(path.split(/[.[\]]+/).filter(Boolean).reduce((value, step) => value?.[step], law), path === "stiffness" ? this.edge : null);
    }
  }

  // Send only the newest value of a dragged slider, one request at a time; beyond the limit if
  // asked to.
  change(name, value, beyond = false, law = this.state?.active ?? "") {
    this.wanted.set(name, { value, beyond, law });
    if (!this.busy) this.flush();
  }

  async flush() {
    this.busy = true;
    while (this.wanted.size) {
      const [[name, wanted]] = this.wanted;
      this.wanted.delete(name);
      const { value, beyond } = wanted;
      const answer = await this.send(name === "delay" ? { op: "delay", ticks: value, beyond } : { op: "law", field: name, ...wanted });
      if (!answer.ok && !this.wanted.has(name)) this.flash(name);
      await new Promise((done) => setTimeout(done, WAIT));
    }
    this.busy = false;
    this.fill();
  }

  flash(name) {
    const row = this.controls.get(name)?.row;
    row?.classList.add("refused");
    setTimeout(() => row?.classList.remove("refused"), 1500);
  }
}

// "terms[0].gain" becomes "term 1: gain".
function words(path) { return path.replace(/(\w+?)s?\[(\d+)\]\./g, (_, list, k) => `${list} ${Number(k) + 1}: `).replaceAll("_", " "); }

// -- one parameter --------------------------------------------------------------------------------

// Map 0…1 to a value: linear if both limits are close, else logarithmic towards zero.
function mapping(field, value, edge) {
  const least = field.ge ?? field.gt, most = field.le ?? field.lt;
  const whole = field.type === "integer";
  if (least !== undefined && most !== undefined) {
    const wide = least > 0 && most / least > 100;
    return wide
      ? { to: (s) => least * (most / least) ** s, from: (v) => Math.log(v / least) / Math.log(most / least), least, most, whole }
      : { to: (s) => least + (most - least) * s, from: (v) => (v - least) / (most - least), least, most, whole };
  }
  const top = round(Math.max(Math.abs(value || 0) * 3, edge ? edge * 1.25 : 0) || 10);
  if (least !== undefined && least >= 0) return { to: (s) => least + (top - least) * s * s, from: (v) => Math.sqrt(Math.max(0, v - least) / (top - least)), least, most: top, whole };
  return { to: (s) => -top + 2 * top * s, from: (v) => (v + top) / (2 * top), least: -top, most: top, whole };
}

function round(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return decade * [1, 1.5, 2, 3, 5, 7, 10].find((factor) => factor * decade >= value * 0.999);
}

function slider(field, row, change) {
  const range = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 1000, step: 1 });
  const number = Object.assign(document.createElement("input"), { type: "number", step: "any" });
  range.setAttribute("aria-label", field.name);
  number.setAttribute("aria-label", `${field.name}, exact value`);
  row.append(number, range);
  let map = mapping(field, 1), filled = false, fitted = null;
  const tidy = (value) => map.whole ? Math.round(value) : Number(value.toPrecision(4));
  range.addEventListener("input", () => {
    row.dataset.moving = "1";
    let value = tidy(map.to(range.value / 1000));
    // An exclusive limit is itself not allowed.
    if (field.gt !== undefined && value <= field.gt) value = tidy(map.to(0.004));
    if (field.lt !== undefined && value >= field.lt) value = tidy(map.to(0.996));
    number.value = value;
    change(value);
  });
  // A key changes an integer by one, however fine the scale.
  range.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
    if (!map.whole || !by) return;
    event.preventDefault();
    number.value = Number(number.value) + by;
    change(Number(number.value));
  });
  keepWhileTyped(number, row);
  for (const event of ["change", "blur"]) range.addEventListener(event, () => { delete row.dataset.moving; });
  number.addEventListener("change", () => { if (number.value !== "") change(map.whole ? Math.round(Number(number.value)) : Number(number.value)); });
  return {
    set(value, edge) {
      if (value === undefined || value === null) { number.value = ""; return; }
      const low = map.least, high = map.most;
      // Rescale only if the value no longer fits well.
      if (!filled || value > high * 0.97 || value < low || (edge && Math.abs(edge - fitted) > 0.3 * edge) || (value && value < high / 50 && field.lt === undefined && field.le === undefined)) {
        map = mapping(field, value, edge);
        fitted = edge;
      }
      filled = true;
      number.value = Number(value.toPrecision(6));
      range.value = Math.round(1000 * Math.min(1, Math.max(0, map.from(value))));
    },
  };
}

// Do not overwrite a value that is being typed.
function keepWhileTyped(input, row) {
  input.addEventListener("input", () => { row.dataset.moving = "1"; });
  for (const event of ["change", "blur"]) input.addEventListener(event, () => { delete row.dataset.moving; });
}

function choice(field, row, change) {
  const select = document.createElement("select");
  select.setAttribute("aria-label", field.name);
  select.append(...field.choices.map((value) => new Option(String(value), JSON.stringify(value))));
  select.addEventListener("change", () => change(JSON.parse(select.value)));
  row.append(select);
  return { set(value) { select.value = JSON.stringify(value ?? field.default); } };
}

function numbers(field, row, change) {
  const text = Object.assign(document.createElement("input"), { type: "text" });
  text.setAttribute("aria-label", field.name);
  keepWhileTyped(text, row);
  text.addEventListener("change", () => change(text.value.split(/[\s,]+/).filter(Boolean).map(Number)));
  row.append(text);
  return { set(value) { text.value = (value ?? []).join(", "); } };
}
