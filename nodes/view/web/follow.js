// Follows a link: its law, stiffness, delay and comparison, in an order in which no step is less
// stable than the whole. Past the edge only where the dial may go there, too.

// `page`: hello, scenarios (of a page without a server), state (laws), ask, compare, field (of a law's
// stiffness), begin (null: the session goes on).
// Return whether anything lies past the edge, and refusals of what could not be followed.
export async function follow({ scenario, law, stiffness, delay, beside, wrong }, page) {
  const { hello, scenarios, state } = page, { laws } = state(), missed = [];
  const names = Object.keys(laws).filter((name) => laws[name].kind !== "excitation");
  const miss = (error) => { missed.push({ error }); return false; };
  wrong.forEach(miss);
  let forced = false, changed = false;
  const change = async (request) => {
    let answer = await page.ask(request);
    if (!answer.ok && hello.beyond) {
      answer = await page.ask({ ...request, beyond: true });
      if (answer.ok) forced = true;
    }
    if (answer.ok) changed = true; else missed.push(answer);
    return answer.ok;
  };
  if (scenario && scenarios.length && !scenarios.includes(scenario)) miss(`The link names ${scenario}, a scenario that is not here; here are ${scenarios.join(", ")}.`);
  const here = (name, what) => names.includes(name) || miss(`${what} ${name}, a law that is not here; here are ${names.join(", ")}.`);
  const wait = (ticks) => change({ op: "delay", ticks });
  const late = state().device_delay;
  if (delay !== null && !hello.delays) miss("The link has a delay, which cannot be changed here.");
  const delayed = delay !== null && hello.delays && delay !== late;
  // The shorter of both delays while law and stiffness change.
  if (delayed && delay < late) await wait(delay);
  let there = true;
  if (law !== null) there = here(law, "The link names") && (law === state().active || await change({ op: "switch", law }));
  // A stiffness belongs to its law.
  const name = law ?? state().active;
  if (there && stiffness !== null) await change({ op: "law", field: page.field(name), value: stiffness, law: name });
  if (delayed && delay > late) await wait(delay);
  if (changed) await page.begin?.();
  if (beside !== null && beside !== "" && !hello.compares) miss("The link compares two laws, which this run cannot.");
  else if (beside && here(beside, "The link compares with")) await page.compare(beside);
  return { forced, missed };
}
