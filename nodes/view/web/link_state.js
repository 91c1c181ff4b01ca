// A link that carries what the page shows: law, stiffness, comparison, and whether the lab is open. After the # nothing is sent anywhere.
export function readState() {
  const found = new URLSearchParams(location.hash.slice(1)), stiffness = Number(found.get("k"));
  return { law: found.get("law"), stiffness: stiffness > 0 ? stiffness : null, beside: found.get("b"), lab: found.has("lab") };
}

export function linkOf({ law, stiffness, beside, lab }) {
  const words = [];
  if (law) words.push(`law=${encodeURIComponent(law)}`);
  if (stiffness) words.push(`k=${Number(stiffness.toPrecision(4))}`);
  if (beside) words.push(`b=${encodeURIComponent(beside)}`);
  if (lab) words.push("lab");
  return `${location.origin}${location.pathname}#${words.join("&")}`;
}
