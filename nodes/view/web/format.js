// Number formats of the page: no minus before zero, thin spaces between thousands, plurals.
const THIN = "\u202f";

// Format with a fixed number of digits after the point.
export function fixed(value, digits) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  const [whole, part] = (Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−")).split(".");
  const grouped = whole.replace(/\B(?=(\d{3})+$)/g, THIN);
  return part === undefined ? grouped : `${grouped}.${part}`;
}

// Format with three significant digits, or all digits of a larger integer.
export function figure(value) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  // Forces that fade have a hundred zeros, more than `toFixed` writes.
  if (Math.abs(value) < 1e-6) return value.toExponential(2).replaceAll("-", "−");
  return fixed(value, Math.max(0, 2 - Math.floor(Math.log10(Math.abs(value)))));
}

// Format with two significant digits, as what is measured deserves.
export function rough(value) {
  if (!Number.isFinite(value)) return "–";
  const near = Number(value.toPrecision(2));
  if (near === 0 || Math.abs(near) < 1e-6) return figure(near);
  return fixed(near, Math.max(0, 1 - Math.floor(Math.log10(Math.abs(near)))));
}

// Join a number and its unit with a non-breaking space.
export function unbroken(text) { return text.replace(/(\d) (?=(N|N\/m|N s\/m|mJ|mm|ms|µs|s|kg|Hz|ticks?|times|strokes)\b)/g, "$1\u00a0"); }

export function count(number, word) { return `${fixed(number, 0)}\u00a0${word}${number === 1 ? "" : "s"}`; }

// Digits needed to distinguish neighbouring ruler marks.
export function digits(step) { return Math.max(0, -Math.floor(Math.log10(step) + 1e-9)); }

// Return the smallest step of 1, 2 or 5 times a power of ten that is at least `least`.
export function step(least) {
  const decade = 10 ** Math.floor(Math.log10(least));
  return decade * [1, 2, 5, 10].find((factor) => factor * decade >= least * (1 - 1e-9));
}
