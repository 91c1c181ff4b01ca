// "Make it sing": a law past its edge, and beside it the law that bears most, which rests.
const OVER = 1.15; // stiffness of A, of its edge
const TIMES = [3, 2, 1], SAFE = 0.7; // stiffness of B: so many times A's, if below so much of its edge
const HALF_LATE = 0.5; // delay of the device [ticks], as in a loop of processes

// The law of A: plain PD where there is one, else the present law.
const singer = (session) => session.data.named.find((name) => session.laws[name].kind === "pd") ?? session.law;

// The law other than `name` that is stable up to the largest stiffness: [name, edge].
const strongest = (session, name) => {
  let best = null;
  for (const other of Object.keys(session.laws)) {
    const edge = other === name ? null : session.edge(other);
    if (edge !== null && (best === null || edge > best[1])) best = [other, edge];
  }
  return best;
};

// Let A sing and B rest under one hand. Return both laws with stiffness and edge [N/m].
const makeItSing = (session) => {
  if (session.delay < HALF_LATE && session.data.hello.delays) session.setDelay(HALF_LATE, true);
  const a = singer(session), edge = session.edge(a), other = strongest(session, a);
  if (edge === null || session.laws[a].stiffness === undefined || other === null) {
    throw new Error("No law here has an edge to go past.");
  }
  const stiffness = Number((OVER * edge).toPrecision(3));
  const times = TIMES.find((by) => by * stiffness <= SAFE * other[1]);
  if (times === undefined) throw new Error(`At a delay of ${session.delay} ticks no other law is safe at the stiffness at which ${a} sings.`);
  if (session.law !== a) session.switchTo(a, 0, true);
  session.setLaw("stiffness", stiffness, true);
  const [b, besideEdge] = other, hardness = times * stiffness;
  session.compare(b, stiffened(session, b, hardness));
  return { law: a, stiffness, edge, beside: b, hardness, besideEdge, times, delay: session.delay };
};

// A law with another stiffness: its own parameter, or all coefficients scaled.
const stiffened = (session, name, hardness) => {
  const law = session.laws[name];
  return law.stiffness === undefined ? { ...law, scale: hardness / session.data.parts[name].rest }
    : { ...law, stiffness: hardness };
};

// A hand that presses into the surface by itself, until a visitor takes it: its target at a time [s].
const PRESS = 9.0, DEPTH_ = 0.008, OUTSIDE = 0.004, EASE = 1.0;
const pressed = (at, surface, side) => {
  if (at >= PRESS) return null;
  const into = Math.min(1, at / EASE);
  return surface + side * (OUTSIDE - into * (OUTSIDE + DEPTH_));
};
