// Why there is a force, or none: the sentences of nodes/driver/force_words.py and ringing.py.
// STATES_ and NOTES_ are its tables; the build writes them.

// Numbers as Python formats them: .2f, .0f, .3g, g.
const formatted = (value, format) => {
  const [, digits, kind] = /^(?:\.(\d+))?([fg]?)$/.exec(format);
  if (kind === "f") return value.toFixed(digits === undefined ? 6 : Number(digits));
  if (kind !== "g") return String(value);
  const precision = digits === undefined ? 6 : Number(digits) || 1;
  if (value === 0 || !Number.isFinite(value)) return String(value);
  const [mantissa, power] = value.toExponential(precision - 1).split("e").map(Number);
  if (power < -4 || power >= precision) {
    return `${mantissa}e${power < 0 ? "-" : "+"}${String(Math.abs(power)).padStart(2, "0")}`;
  }
  return String(Number(value.toPrecision(precision)));
};

const filled = (text, data) => text.replace(/\{(\w+)(?::([^}]*))?\}/g, (_, name, format = "") =>
  name === "axis" ? "xyz"[data.axis] : formatted(data[name], format));

// What a note of the driver's rules says: its kind, a sentence for the log and one for the page.
const noted = ([code, tick, change, ...numbers]) => {
  const { kind, fields, text, short } = NOTES_[code];
  const data = { tick };
  fields.forEach((name, n) => { data[name] = numbers[n]; });
  const why = filled(short || text, data);
  let reason = filled(text, data);
  if (change >= 0) {
    reason = `${SAFETY_[change >> 3]} → ${SAFETY_[change & 7]} at tick ${tick}: ${reason}`;
  }
  return { kind, reason, why, data, changes: change >= 0 };
};

const length = (vector) => Math.sqrt(vector.reduce((sum, part) => sum + part * part, 0));

// Level and sentence, from the loop's present state.
const NO_FORCE = 1e-9, LEAST_SHOWN = 0.005; // [N]; less than the second is 0.00 N in words
const explained = ({ safety, force, asked, age, contact, normal, distance, law }, why, ringing) => {
  const given = length(force), words = STATES_[safety] ?? "", because = why ? ` (${why})` : "";
  const n = given.toFixed(2);
  if (safety === "stopped") return ["stop", `Too hard: ${words}${why ? `: ${why}` : ""}.`];
  if (words && safety !== "active" && safety !== "ramp") {
    if (safety !== "damping" && given <= NO_FORCE) return ["stop", `No force: ${words}${because}.`];
    return ["warn", `${n} N: ${words}${because}.`];
  }
  if (safety === "ramp") return ["warn", `${n} N: ${words}.`];
  if (ringing) return ["warn", `${ringing}: this wall is harder than the loop can render.`];
  const surface = normal.some((part) => part !== 0);
  if (!contact) {
    return ["rest", surface
      ? `No force: nothing is touched; the surface is ${(Math.abs(distance) * 1e3).toFixed(1)} mm away.`
      : "No force: there is nothing to touch."];
  }
  const wanted = length(asked);
  if (wanted > given + 0.02 * wanted + NO_FORCE && age === 0 && wanted > 0.05) {
    return ["warn", `${n} N of the ${wanted.toFixed(2)} N that the law asks for: the driver's limits hold the rest back.`];
  }
  if (given <= NO_FORCE) return ["rest", `No force: ${law} renders none at this deflection.`];
  if (given < LEAST_SHOWN) return ["rest", `No force to feel: ${law} renders less than 0.01 N.`];
  const deep = surface ? `, ${(Math.abs(distance) * 1e3).toFixed(2)} mm deep` : "";
  return ["ok", `${n} N: ${law} pushes back${deep}.`];
};

// A force that generates energy at every stroke, by the rules of nodes/view/ringing.py.
class Ringing {
  constructor(axis = 0) {
    Object.assign(this, structuredClone(STROKES_), { axis });
  }

  take(time, { position, force, energy }) { observe_stroke(this, time, position, force, energy); }

  // Frequency [Hz] and largest force [N], or null.
  ring() { return is_ringing(this) ? { frequency: 1 / this.cycle, force: this.most } : null; }
}
const ringWords = (ring) => ring === null ? ""
  : `It rings at ${ring.frequency.toFixed(0)} Hz, up to ${ring.force.toFixed(1)} N`;
