// State in the page's link: law, stiffness, delay, comparison, open lab. The part after # is not
// sent to a server.
export function readState() {
  const found = new URLSearchParams(location.hash.slice(1)), stiffness = Number(found.get("k")), delay = Number(found.get("delay") ?? found.get("d"));
  return { law: found.get("law"), stiffness: stiffness > 0 ? stiffness : null, delay: delay > 0 ? delay : null, time: found.has("t") ? Number(found.get("t")) : null, beside: found.get("b"), lab: found.has("lab") };
}

export function linkOf({ law, stiffness, delay, beside, lab, scenario = "", time = null }) {
  const words = scenario ? [`scenario=${encodeURIComponent(scenario)}`] : [];
  if (time !== null) words.push(`t=${time.toFixed(3)}`);
  if (law) words.push(`law=${encodeURIComponent(law)}`);
  if (stiffness) words.push(`k=${Number(stiffness.toPrecision(4))}`);
  if (delay) words.push(`delay=${Number(delay.toPrecision(3))}`);
  if (beside) words.push(`b=${encodeURIComponent(beside)}`);
  if (lab) words.push("lab");
  return `${location.href.split("#")[0]}#${words.join("&")}`;
}
