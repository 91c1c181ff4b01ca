"""Links: followed as a whole, in a safe order; what cannot be followed is said, in node."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import pytest

import nodes.view
from tests.support.in_node import node

pytestmark = [pytest.mark.process, pytest.mark.smoke]

EDGES = {"pd": 6000.0, "alpha": 4000.0, "scaled": 15000.0}
"""Edge of each law without delay [N/m]; half of it with a delay of one tick, and so on."""

_RUN = """
import { readFileSync } from "node:fs";
globalThis.location = { hash: "", href: "http://here/#" };
const { linkOf, readState } = await import("./link_state.js");
const { follow } = await import("./follow.js");
const { shortened } = await import("./laws.js");
const { cases, edges, refusals } = JSON.parse(readFileSync(process.argv[2], "utf8"));
const visit = async ({ link, start, hello }) => {
  const laws = Object.fromEntries(Object.keys(edges).map((name) => [name,
    { kind: "pd", ...(name === "scaled" ? {} : { stiffness: start.k }) }]));
  const loop = { active: start.law, delay: start.delay, scaled: start.k }, passed = [];
  let other = "", begun = 0;
  const stiffness = () => laws[loop.active].stiffness ?? loop.scaled;
  const stable = () => stiffness() < edges[loop.active] / (1 + loop.delay);
  const ask = async ({ op, beyond = false, ...request }) => {
    const before = [{ ...loop }, structuredClone(laws)];
    if (op === "delay") loop.delay = request.ticks;
    if (op === "switch") loop.active = request.law;
    if (op === "law" && request.field === "hardness") loop.scaled = request.value;
    else if (op === "law") laws[request.law].stiffness = request.value;
    if (stable() || (beyond && hello.beyond)) {
      passed.push({ past: !stable(), beyond });
      return { ok: true };
    }
    Object.assign(loop, before[0]);
    Object.assign(laws, before[1]);
    return { ok: false, error: `${op} refused` };
  };
  const found = await follow(readState(link), {
    hello, scenarios: ["wall"], ask, begin: () => { begun++; },
    state: () => ({ active: start.law, laws: { ...laws, push: { kind: "excitation" } },
      device_delay: hello.delays ? start.delay : null }),
    field: (name) => (laws[name].stiffness === undefined ? "hardness" : "stiffness"),
    compare: (name) => { other = name; },
  });
  const now = { law: loop.active, k: stiffness(), delay: loop.delay };
  return { ...found, now, other, passed, begun, again: readState(new URL(linkOf({
    law: now.law, stiffness: now.k, delay: now.delay, beside: other })).hash) };
};
const visited = [];
for (const each of cases) visited.push(await visit(each));
console.log(JSON.stringify({ visited, told: refusals.map(shortened) }));
"""

FREE = {"beyond": True, "delays": True, "compares": True}
STRICT = {**FREE, "beyond": False}
NAMES, STIFFNESSES, DELAYS = tuple(EDGES), (500.0, 2500.0, 5500.0), (0.0, 0.5, 2.0)


def edge(state: Mapping[str, Any]) -> float:
    return EDGES[str(state["law"])] / (1.0 + float(state["delay"]))


def states() -> list[dict[str, Any]]:
    every = product(NAMES, STIFFNESSES, DELAYS)
    return [dict(zip(("law", "k", "delay"), each, strict=True)) for each in every]


def link(state: Mapping[str, Any]) -> str:
    return "#" + "&".join(f"{name}={value}" for name, value in state.items())


def run(
    tmp_path: Path,
    cases: Sequence[Mapping[str, Any]],
    refusals: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    web = Path(nodes.view.__file__).with_name("web")
    for each in web.glob("*.js"):
        (tmp_path / each.name).write_text(each.read_text(encoding="utf-8"))
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "run.js").write_text(_RUN)
    (tmp_path / "cases.json").write_text(
        json.dumps({"cases": cases, "edges": EDGES, "refusals": refusals})
    )
    words = [node(), str(tmp_path / "run.js"), str(tmp_path / "cases.json")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_from_any_state_a_link_leads_to_its_own_and_says_what_it_cannot(
    tmp_path: Path,
) -> None:
    """Nothing is lost silently: before, a delay past the edge was, and so was none."""
    starts = [each for each in states() if each["k"] < edge(each)]
    cases: list[dict[str, Any]] = [
        {"link": link(wanted), "start": start, "hello": hello}
        for wanted in states()
        for start in starts
        for hello in (FREE, STRICT)
    ]
    found = run(tmp_path, cases)["visited"]
    wanted = [
        dict(pair.split("=") for pair in each["link"][1:].split("&")) for each in cases
    ]
    for case, asked, one in zip(cases, wanted, found, strict=True):
        asked = {**asked, "k": float(asked["k"]), "delay": float(asked["delay"])}
        stable = asked["k"] < edge(asked)
        if case["hello"]["beyond"]:
            assert one["now"] == asked, case
            assert one["missed"] == [], case
        elif one["now"] != asked:
            assert one["missed"], case
        assert one["forced"] or stable or one["missed"], case
        # Forced only if a step without was refused; never where a page must not.
        assert all(each["past"] == each["beyond"] for each in one["passed"]), case
        assert case["hello"]["beyond"] or not one["forced"], case
        # Its session begins anew with what the link asks for.
        assert one["begun"] == bool(one["passed"]), case
        # The page's own link leads back to the same state.
        again = one["again"]
        assert [again["law"], again["stiffness"], again["delay"]] == list(
            one["now"].values()
        )


def test_within_one_law_no_step_is_refused_where_the_whole_is_stable(
    tmp_path: Path,
) -> None:
    stable = [each for each in states() if each["k"] < edge(each)]
    of_one_law = [
        (start, wanted)
        for start, wanted in product(stable, repeat=2)
        if start["law"] == wanted["law"]
    ]
    cases = [
        {"link": link(wanted), "start": start, "hello": STRICT}
        for start, wanted in of_one_law
    ]
    for (_, wanted), one in zip(
        of_one_law, run(tmp_path, cases)["visited"], strict=True
    ):
        assert (one["now"], one["missed"]) == (wanted, [])


WRONG = {
    "#law=nosuch&k=500": "names nosuch, a law that is not here",
    "#law=push": "names push, a law that is not here",
    "#b=nosuch": "compares with nosuch, a law that is not here",
    "#scenario=nosuch": "names nosuch, a scenario that is not here",
    "#k=-5": "has k=-5, which is no stiffness",
    "#k=": "has k=, which is no stiffness",
    "#delay=zz": "has delay=zz, which is no delay",
    "#d=-1": "has d=-1, which is no delay",
}


def test_what_a_link_has_wrong_is_said_and_changes_nothing(tmp_path: Path) -> None:
    start = {"law": "pd", "k": 1000.0, "delay": 0.0}
    cases = [{"link": asked, "start": start, "hello": FREE} for asked in WRONG]
    for said, one in zip(WRONG.values(), run(tmp_path, cases)["visited"], strict=True):
        assert len(one["missed"]) == 1, said
        assert said in one["missed"][0]["error"]
        assert (one["now"], one["passed"], one["begun"]) == (start, [], 0), said


def test_a_refusal_is_told_in_a_sentence_by_what_would_be_accepted(
    tmp_path: Path,
) -> None:
    """Also one without remedies, as of a lost connection."""
    ends: list[tuple[str, dict[str, float]]] = [
        ("at_most", {"laws.pd.stiffness": 5797.0}),
        ("at_most", {"hardness": 9540.0}),
        # Typed as it is told, each is accepted; three digits would be past the end.
        ("at_most", {"laws.pd.stiffness": 128.9}),
        ("at_most", {"laws.pd.damping": 3.456}),
        ("at_most", {"laws.pd.damping": 0.3}),
        ("at_least", {"laws.pd.stiffness": 66.43}),
    ]
    refusals: list[dict[str, Any]] = [
        {"error": "Unstable.", "remedies": [{"kind": kind, "values": each}]}
        for kind, each in ends
    ]
    # Both ends of a refused delay, as a node names them, and another reason.
    refusals += [
        {
            "error": "Unstable.",
            "remedies": [
                {"kind": "at_most", "values": {"driver.device.delay": 0.3689}},
                {"kind": "at_most", "values": {"coupling.laws.pd.stiffness": 47.4}},
            ],
        },
        {
            "error": "coupling.laws.a: H(1) = -5 N/m, it would pull into the wall",
            "remedies": [
                {"kind": "at_least", "values": {"coupling.laws.a.stiffness": 16.3}}
            ],
        },
    ]
    # Without a value the sentence is the reason, as from other programs' nodes.
    without: list[dict[str, Any]] = [{"values": {}}, {}]
    refusals += [
        {"error": "Too much.", "remedies": [{"kind": "at_most", **each}]}
        for each in without
    ]
    told = run(tmp_path, [], [*refusals, {"error": "There is no connection."}])["told"]
    assert told[7].startswith("Refused: it would pull into the wall. ")
    assert [each.rpartition("The ")[2] for each in told] == [
        "largest stiffness that is accepted is 5\u202f797.",
        "largest H(1) that is accepted is 9\u202f540.",
        "largest stiffness that is accepted is 128.",
        "largest damping that is accepted is 3.45.",
        "largest damping that is accepted is 0.300.",
        "smallest stiffness that is accepted is 66.5.",
        "largest delay that is accepted is 0.368\u00a0ticks, or the largest stiffness 47.4 with the"
        " rest as asked.",
        "smallest stiffness that is accepted is 16.3.",
        "Too much.",
        "Too much.",
        "There is no connection.",
    ]
