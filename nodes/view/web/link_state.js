// State in the page's link: law, stiffness, delay, comparison, open lab. The part after # is not
// sent to a server.

// What a link asks for, null where it asks for nothing; and in words what it has wrong.
export function readState(hash = location.hash) {
  const found = new URLSearchParams(hash.slice(1)), wrong = [];
  const number = (names, fits, told) => {
    const name = names.find((one) => found.has(one));
    if (name === undefined) return null;
    const text = found.get(name), value = text.trim() === "" ? NaN : Number(text);
    if (Number.isFinite(value) && fits(value)) return value;
    wrong.push(`The link has ${name}=${text.slice(0, 20)}, which is no ${told}.`);
    return null;
  };
  return {
    scenario: found.get("scenario"), law: found.get("law") || null,
    stiffness: number(["k"], (value) => value > 0, "stiffness above 0 N/m"),
    delay: number(["delay", "d"], (value) => value >= 0, "delay of 0 ticks or more"),
    time: number(["t"], () => true, "time in seconds"),
    beside: found.get("b"), lab: found.has("lab"), wrong,
  };
}

export function linkOf({ law, stiffness, delay, beside, lab, scenario = "", time = null }) {
  const words = scenario ? [`scenario=${encodeURIComponent(scenario)}`] : [];
  if (time !== null) words.push(`t=${time.toFixed(3)}`);
  if (law) words.push(`law=${encodeURIComponent(law)}`);
  if (stiffness) words.push(`k=${Number(stiffness.toPrecision(4))}`);
  // Also none: the page that opens the link may have another one.
  if (delay !== null) words.push(`delay=${Number(delay.toPrecision(3))}`);
  if (beside) words.push(`b=${encodeURIComponent(beside)}`);
  if (lab) words.push("lab");
  return `${location.href.split("#")[0]}#${words.join("&")}`;
}
