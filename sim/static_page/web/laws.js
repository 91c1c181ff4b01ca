// Taps and sections of a law from its stiffness and damping, with the bits of its Python `compile`.
// Everything else of a law is fixed here: PARTS has its derivatives, and what libm computed.
const gainOf = (damping, part) => {
  if (part.gain !== undefined) return damping * part.gain;
  const unlimited = damping * part.power;
  return part.two === undefined ? unlimited : (unlimited * part.two) / part.sum;
};

// A law whose coefficients are given, all of them multiplied.
const scaled = ({ taps, sections, own }, by) => by === 1 ? { taps, sections, own } : {
  taps: taps.map((tap) => by * tap), own,
  sections: sections.map((each, i) => (i % 4 < 2 ? by * each : each)),
};

const compiled = (parts, law, period) => {
  const { stiffness: K, damping: B } = law;
  if (parts.form === "fixed") return scaled(parts, law.scale ?? 1);
  if (parts.form === "pd") {
    return { taps: Float64Array.of(K + B / period, -B / period), sections: new Float64Array(0), own: {} };
  }
  if (parts.form === "filtered") {
    const gain = (B * parts.rest) / period;
    return { taps: Float64Array.of(K), sections: Float64Array.of(gain, -gain, -parts.pole, 0.0), own: {} };
  }
  const taps = new Float64Array(Math.max(1, ...parts.terms.map(({ taps: unit }) => unit.length)));
  const coefficients = [];
  for (const part of parts.terms) {
    const gain = gainOf(B, part);
    part.taps.forEach((tap, m) => { taps[m] += gain * tap; });
    for (let i = 0; i < part.sections.length; i += 4) {
      const [b0, b1, a1, a2] = part.sections.subarray(i, i + 4);
      coefficients.push(gain * b0, gain * b1, a1, a2);
    }
  }
  taps[0] += K;
  return { taps, sections: Float64Array.from(coefficients), own: {} };
};

// The part of a law without its spring.
const withoutSpring = (parts, law, period) => {
  const { taps, sections } = compiled(parts, law, period);
  const rest = Float64Array.from(taps);
  rest[0] -= law.stiffness ?? restStiffness({ taps, sections });
  return { taps: rest, sections };
};

// H(1): the force of a held deflection, per metre [N/m].
const restStiffness = ({ taps, sections }) => {
  let sum = taps.reduce((total, tap) => total + tap, 0);
  for (let i = 0; i < sections.length; i += 4) {
    sum += (sections[i] + sections[i + 1]) / (1 + sections[i + 2] + sections[i + 3]);
  }
  return sum;
};
