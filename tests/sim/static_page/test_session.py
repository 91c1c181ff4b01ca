"""A page's session in node: laws, edges, words, and its copy as `haptic.play`."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import haptic
import msgspec
import numpy as np
import pytest
import yaml

import nodes.view
from messages.errors import AT_MOST
from messages.types import DeviceState, Force, Proxy
from nodes.driver.force_words import explain
from nodes.driver.state import SAFETY
from nodes.launcher import launch_file, scenario_files
from nodes.laws.parse import LawRefusedError, compile_law, parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from nodes.stability.worlds import AnyWorld, world_k_max
from nodes.view.bundle import bundle
from nodes.view.ringing import Ringing
from nodes.view.stability_map import plant_of, stability_map, with_moving_worlds
from sim.play.player import play
from sim.static_page.emitted_rules import constant
from sim.static_page.law_parts import parts_of
from sim.static_page.site import data_of, session_script
from tests.support.in_node import node

T = 0.002

LAWS: dict[str, dict[str, Any]] = {
    "pd": {"kind": "pd"},
    "paper": {"kind": "pd_alpha", "order": 1.2, "taps": 10, "gains": "paper"},
    "unlimited": {"kind": "pd_alpha", "order": 0.7, "taps": 20, "gains": "unlimited"},
    "physical": {
        "kind": "pd_alpha",
        "order": 0.6,
        "taps": 11,
        "gains": "physical",
        "derivative": "oustaloup_tustin",
    },
    "multi_term": {"kind": "paper_optimum"},
    "filtered": {"kind": "pd_filtered", "cutoff": 80.0},
}

DEVICE = ("mass", "damping", "stiffness", "delay")

pytestmark = [pytest.mark.process, pytest.mark.smoke]


def run(directory: Path, script: str, scenario: str = "") -> Any:
    """Run a script behind a session's; return what it leaves in `result`."""
    path, out = directory / "session.js", directory / "session.json"
    data = constant("DATA", data_of(launch_file.read(scenario, {}))) if scenario else ""
    path.write_text(
        f"{data}{session_script()}let result;\n{script}\n"
        'require("fs").writeFileSync(process.argv[2], JSON.stringify(result, (_, x) =>\n'
        "  typeof x === 'number' && !Number.isFinite(x) ? String(x)\n"
        "  : ArrayBuffer.isView(x) ? Array.from(x) : x));\n"
    )
    done = subprocess.run(
        [node(), str(path), str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(out.read_text())


def page_script(first: str) -> str:
    """Return a module of the page with its imports, as ``$NAME``."""
    web = Path(nodes.view.__file__).with_name("web")
    sources = {path.name: path.read_text(encoding="utf-8") for path in web.glob("*.js")}
    return bundle(sources, first)


def law_of(name: str, stiffness: float, damping: float) -> Any:
    return parse_law({**LAWS[name], "stiffness": stiffness, "damping": damping}, name)


def numbers(values: Mapping[str, float]) -> list[float]:
    return [float(value) for value in values.values()]


def test_coefficients_follow_both_sliders_with_the_bits_of_compile(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(3)
    pairs = np.exp(
        rng.uniform(np.log([1.0, 0.01]), np.log([1e5, 1e2]), (60, 2))
    ).tolist()
    parts = {name: parts_of(law_of(name, 1.0, 1.0), T, 100, 1, name) for name in LAWS}
    found = run(
        tmp_path,
        f"const parts = {constant('P', parts).partition('=')[2]}const pairs = {json.dumps(pairs)};"
        "result = Object.fromEntries(Object.entries(parts).map(([name, one]) => [name,"
        " pairs.map(([stiffness, damping]) => compiled(one, { stiffness, damping }, 0.002))]));",
    )
    for name in LAWS:
        for (stiffness, damping), got in zip(pairs, found[name], strict=True):
            law = law_of(name, stiffness, damping).compile(T)
            assert tuple(got["taps"]) == law.taps, (name, stiffness, damping)
            assert tuple(got["sections"]) == tuple(np.ravel(law.sections)), name


def test_the_largest_stable_stiffness_is_that_of_the_poles(tmp_path: Path) -> None:
    """Curve and Schur–Cohn against the pole radii of nodes/stability, at any delay."""
    rng = np.random.default_rng(7)
    cases = []
    for n in range(90):
        mass, damping = np.exp(
            rng.uniform(np.log([0.02, 0.05]), np.log([1.0, 8.0]))
        ).tolist()
        delay = float(rng.choice([0.0, 0.4, 1.0, 1.7, 3.25, 7.0]))
        hand = float(rng.choice([0.0, 150.0, 800.0]))
        gain = float(np.exp(rng.uniform(np.log(0.1), np.log(6.0))))
        cases.append(
            (list(LAWS)[n % len(LAWS)], gain, Plant(T, mass, damping, delay, hand))
        )
    parts = {name: parts_of(law_of(name, 1.0, 1.0), T, 100, 1, name) for name in LAWS}
    given = [
        [
            name,
            gain,
            {"period": T, "mass": p.mass, "damping": p.damping, "delay": p.delay}
            | {"stiffness": p.stiffness},
        ]
        for name, gain, p in cases
    ]
    found = run(
        tmp_path,
        f"const parts = {constant('P', parts).partition('=')[2]}"
        f"result = {json.dumps(given)}.map(([name, damping, device]) => {{"
        " const law = { stiffness: 1, damping };"
        " const edge = stableStiffness(device, withoutSpring(parts[name], law, device.period));"
        " const stable = [0.9, 1.1].map((by) => loopIsStable(device, compiled(parts[name],"
        " { stiffness: by * (edge ? edge[1] : 1), damping }, device.period)));"
        " return [edge, stable]; });",
    )
    for (name, gain, plant), (edge, stable) in zip(cases, found, strict=True):
        want = k_max(without_spring(law_of(name, 1.0, gain), T), plant)
        if not want.stable:
            assert edge is None, (name, gain, plant)
            continue
        assert edge is not None, (name, gain, plant)
        # Both find roots of the same real function to about 1e-10 of the angle.
        assert edge == pytest.approx(want.stable[0], rel=1e-7, abs=1e-6), (
            name,
            gain,
            plant,
        )
        for by, verdict in zip((0.9, 1.1), stable, strict=True):
            law = law_of(name, by * edge[1], gain).compile(T)
            assert verdict == (pole_radius(law, plant) < 1.0), (name, gain, plant, by)


def test_the_limit_for_moving_worlds_is_that_of_the_certificate(tmp_path: Path) -> None:
    """Each law, hand and delay against `world_k_max`, which searches another grid."""
    rng = np.random.default_rng(11)
    cases = []
    for n in range(24):
        mass, damping = np.exp(
            rng.uniform(np.log([0.02, 0.05]), np.log([1.0, 8.0]))
        ).tolist()
        delay = (0.0, 0.4, 1.0, 3.25)[n % 4]
        hand = float(rng.choice([0.0, 150.0, 800.0]))
        gain = float(np.exp(rng.uniform(np.log(0.02), np.log(2.0))))
        cases.append(
            (list(LAWS)[n % len(LAWS)], gain, Plant(T, mass, damping, delay, hand))
        )
    cases.append(("pd", 1.0, Plant(T, 0.1, 0.0)))  # undamped: nothing is certified
    parts = {name: parts_of(law_of(name, 1.0, 1.0), T, 100, 1, name) for name in LAWS}
    given = [
        [name, gain, {key: getattr(p, key) for key in ("period", *DEVICE)}]
        for name, gain, p in cases
    ]
    found = run(
        tmp_path,
        f"const parts = {constant('P', parts).partition('=')[2]}"
        f"result = {json.dumps(given)}.map(([name, damping, device]) => movingLimit(device,"
        " withoutSpring(parts[name], { stiffness: 1, damping }, device.period)));",
    )
    wanted = [
        world_k_max(without_spring(law_of(n, 1.0, gain), T), p, AnyWorld())
        for n, gain, p in cases
    ]
    assert sum(one.k_max_n_per_m is not None for one in wanted) > len(cases) // 2
    for case, one, got in zip(cases, wanted, found, strict=True):
        # Both zoom into a dip to 1e-12 of the terms: the square root of that in the angle.
        want = one.k_max_n_per_m
        assert got == (want and pytest.approx(want, rel=1e-6)), case


def test_a_page_draws_the_limits_for_moving_worlds_of_the_live_page(
    tmp_path: Path,
) -> None:
    found = run(
        tmp_path,
        "const session = new Session(DATA), parts = DATA.parts[session.law];"
        " const law = session.laws[session.law], device = session.device();"
        " result = [...movingSteps(stabilityMap(device, parts, law), device, parts, law,"
        " DATA.world)].at(-1);",
        "touch_wall",
    )
    launch = launch_file.read("touch_wall", {})
    data = data_of(launch)
    law = parse_law(data["laws"].data[data["active"]], "law")
    plant = plant_of(None, launch.nodes["driver"].parameters)
    assert plant is not None
    begun = stability_map(law, T, plant, found["delay_ticks"])
    live = with_moving_worlds(begun, law, T, plant, found["delay_ticks"])
    assert found["world"] == live["world"]
    names = ("any_world", "any_world_over_delay")
    assert found["k_max_any_world_n_per_m"] == pytest.approx(
        live["k_max_any_world_n_per_m"], rel=1e-6
    )
    for name in names:
        for got, want in zip(found[name], live[name], strict=True):
            assert got == [
                pytest.approx(want[0], abs=1e-9),
                want[1] and pytest.approx(want[1], rel=1e-6),
            ], name


def state_of(**more: Any) -> DeviceState:
    return DeviceState(
        seq=5,
        stamp=0.0,
        position=(0.0, 0.0, 0.0),
        **{"safety": "active", "force_seq": 5, **more},
    )


def test_sentences_are_those_of_the_driver(tmp_path: Path) -> None:
    cases = []
    for safety in SAFETY:
        for force, asked in ((0.0, 0.0), (0.0049, 0.0049), (1.5, 1.5), (10.0, 31.25)):
            for contact, normal in (
                (False, 0.0),
                (False, -1.0),
                (True, -1.0),
                (True, 0.0),
            ):
                for why in ("", "ramp of 50 ticks done"):
                    for ringing in ("", "It rings at 22 Hz, up to 3.1 N"):
                        cases.append(
                            (safety, force, asked, contact, normal, why, ringing)
                        )
    found = run(
        tmp_path,
        f"result = {json.dumps(cases)}.map(([safety, f, a, contact, n, why, ringing]) =>"
        " explained({ safety, force: [f, 0, 0], asked: [a, 0, 0], age: 0, contact,"
        " normal: [n, 0, 0], distance: -0.00123, law: 'pd' }, why, ringing));",
    )
    for case, got in zip(cases, found, strict=True):
        safety, force, asked, contact, normal, why, ringing = case
        state = state_of(safety=safety, force=(force, 0.0, 0.0))
        zero = (0.0, 0.0, 0.0)
        proxy = Proxy(
            seq=5,
            stamp=0.0,
            position=zero,
            proxy=zero,
            normal=(normal, 0.0, 0.0),
            distance=-0.00123,
            contact=contact,
        )
        message = Force(seq=5, stamp=0.0, force=(asked, 0.0, 0.0), law="pd")
        assert tuple(got) == explain(state, proxy, message, 0.0, why, ringing), case


def test_numbers_are_formatted_as_python_formats_them(tmp_path: Path) -> None:
    formats = (".0f", ".1f", ".2f", ".3g", ".2g", ".4g", "g")
    values = [
        0.0,
        1.0,
        -1.0,
        0.1234567,
        12.3456,
        1234.56,
        9.996e-5,
        0.000123,
        123456.7,
        2e6,
        1e-9,
    ]
    found = run(
        tmp_path,
        f"result = {json.dumps(values)}.map((x) => {json.dumps(formats)}.map((f) =>"
        " formatted(x, f)));",
    )
    assert found == [[format(value, one) for one in formats] for value in values]


def test_ringing_is_found_in_the_same_ticks(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    time = np.arange(1500) * T
    sings = (time > 0.5) & (time < 2.0)
    # A force 30 degrees behind the position of a spring generates energy at every stroke.
    position = np.where(sings, 1e-3 * np.sin(2.0 * np.pi * 24.0 * time), 0.0)
    force = np.where(sings, -4.0 * np.sin(2.0 * np.pi * 24.0 * time - 0.5), 0.0)
    force = force + rng.normal(0.0, 0.02, len(time))
    energy = np.concatenate([[0.0], np.cumsum(force[:-1] * np.diff(position))])
    rows = list(zip(position.tolist(), force.tolist(), energy.tolist(), strict=True))
    found = run(
        tmp_path,
        f"const ringing = new Ringing(); result = {json.dumps(rows)}.map(([x, f, energy], k) => {{"
        " ringing.take(k * 0.002, { position: [x, 0, 0], force: [f, 0, 0], energy });"
        " return ringWords(ringing.ring()); });",
    )
    ringing, want = Ringing(), []
    for k, (x, f, energy_) in enumerate(rows):
        ringing.take(k * T, (x, 0.0, 0.0), (f, 0.0, 0.0), energy_)
        want.append(str(ringing.ring() or ""))
    assert found == want
    assert any(want)
    assert not all(want)


_VISIT = """
const session = new Session(DATA), rows = [], own = [];
const tick = (count) => { for (let n = 0; n < count; n++) {
  session.tick();
  const { position, force } = session.player.driver;
  rows.push([...position, ...force]);
} };
tick(150);
session.hand([0.03, 0.004, 0.003]);
tick(120);
session.setLaw("stiffness", 1700, false);
tick(40);
session.switchTo("pd_alpha", 60, false);
tick(90);
session.hand([0.036, 0.002, -0.003]);
session.setLaw("damping", 2.5, false);
tick(120);
session.switchTo("designed_d0", 0, true);
session.scale(900, true);
tick(60);
session.hand(null);
tick(200);
result = { rows, python: session.python() };
"""


def test_the_edge_of_a_scaled_law_is_the_same_however_far_it_was_scaled(
    tmp_path: Path,
) -> None:
    """A refused 10⁶ N/m was told that no stiffness is stable, though small ones are."""
    script = """
const session = new Session(DATA), edges = [1e-6, 1, 1e6].map((scale) =>
  session.edge("designed_d0", { ...session.laws.designed_d0, scale }));
session.switchTo("designed_d0", 0, true);
let remedies = null;
try { session.scale(1e9, false); } catch (error) { ({ remedies } = error); }
result = { edges, remedies };
"""
    found = run(tmp_path, script, "touch_wall")
    edge = found["edges"][1]
    assert edge > 0.0
    assert found["edges"] == [edge] * 3
    (most,) = found["remedies"]
    # Rounded down to four digits, a thousandth below.
    assert 0.998 * edge < most["values"]["designed_d0.hardness"] < edge


@pytest.mark.parametrize("scenario", ["touch_wall", "sphere_feel"])
def test_a_copied_session_gives_the_same_bits_in_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenario: str
) -> None:
    found = run(tmp_path, _VISIT, scenario)
    monkeypatch.chdir(tmp_path)
    played: dict[str, Any] = {"print": lambda *_: None}
    exec(found["python"].replace("print(haptic.play", "played = (haptic.play"), played)  # noqa: S102
    axes = [0] if scenario == "touch_wall" else [0, 1, 2]
    rows = np.array(found["rows"])
    want = played["played"]
    measured = want.measured_m.reshape(len(rows), len(axes))
    force = want.force_n.reshape(len(rows), len(axes))
    assert np.abs(force).max() > 0.5
    assert (rows[:, axes] == measured).all()
    assert (rows[:, [3 + axis for axis in axes]] == force).all()
    assert haptic.scenarios()


def test_beside_with_the_same_law_is_the_same_run(tmp_path: Path) -> None:
    """B is forked from A in contact, during a fade, and follows the same hand."""
    found = run(
        tmp_path,
        """
        const session = new Session(DATA), both = [];
        session.hand([0.03, 0, 0]);
        for (let n = 0; n < 300; n++) session.tick();
        session.compare("pd");
        const b = session.beside;
        for (let n = 0; n < 300; n++) {
          if (n === 100) session.hand([0.02, 0, 0]);
          session.tick();
          const { position, force } = session.player.driver;
          both.push([position[0], b.position.at(-1), force[0], b.force.at(-1)]);
        }
        session.compare("multi_term");
        for (let n = 0; n < 100; n++) session.tick();
        result = { both, other: session.beside.force };
        """,
        "touch_wall",
    )
    both = np.array(found["both"])
    assert (both[:, 0] == both[:, 1]).all()
    assert (both[:, 2] == both[:, 3]).all()
    assert np.abs(both[:, 2]).max() > 0.5


@pytest.mark.parametrize("delay", [0.37, 1.0, 1.7, 5.2])
def test_a_delay_set_at_the_start_is_the_device_with_that_delay(
    tmp_path: Path, delay: float
) -> None:
    found = run(
        tmp_path,
        f"""
        const session = new Session(DATA), rows = [];
        session.delayBy({delay});
        session.spoiled = "";
        for (let n = 0; n < 700; n++) {{
          session.tick();
          rows.push([session.player.driver.position[0], session.player.driver.force[0]]);
        }}
        result = {{ rows, stopped: session.player.driver.safety }};
        """,
        "touch_wall",
    )
    launch = launch_file.read("touch_wall", {})
    spec = launch.nodes["driver"]
    device = {**spec.parameters["device"], "delay": delay}
    changed = msgspec.structs.replace(
        spec, parameters={**spec.parameters, "device": device}
    )
    coupling = launch.nodes["coupling"]
    unjudged = {**coupling.parameters, "plant": None, "stability": "off"}
    coupling = msgspec.structs.replace(coupling, parameters=unjudged)
    nodes = {**launch.nodes, "driver": changed, "coupling": coupling}
    launch = msgspec.structs.replace(launch, nodes=nodes)
    trace = play(launch, ticks=700)
    rows = np.array(found["rows"])
    assert np.abs(rows[:, 1]).max() > 0.5
    assert (rows[:, 0] == trace.measured[:, 0]).all()
    assert (rows[:, 1] == trace.force[:, 0]).all()


def test_changes_past_the_edge_are_refused_with_the_edge(tmp_path: Path) -> None:
    found = run(
        tmp_path,
        """
        const session = new Session(DATA), said = [], ways = [];
        for (const change of [
          () => session.setLaw("stiffness", 1e5, false),
          () => session.setDelay(6, false),
          () => session.setLaw("order", 1, false),
          () => session.setLaw("stiffness", NaN, true),
        ]) try { change(); said.push(""); } catch (error) {
          said.push(error.message);
          ways.push(error.remedies);
        }
        // What is told is accepted, a hundredth of a tick more is not; then back.
        const most = ways[1][0].values.delay, taken = [most, most + 0.01].map((ticks) => {
          try { session.setDelay(ticks, false); return true; } catch { return false; }
        });
        session.setDelay(0, false);
        session.setLaw("stiffness", 15000, true);
        session.hand([0.04, 0, 0]);
        for (let n = 0; n < 2000; n++) session.tick();
        const stopped = session.player.driver.safety;
        session.setLaw("stiffness", 500, false);
        session.rearm();
        for (let n = 0; n < 600; n++) session.tick();
        const again = session.player.driver.safety;
        try { session.python(); } catch (error) { said.push(error.message); }
        session.begin();
        session.tick();
        result = { said, ways, taken, stopped, again, seq: session.seq, python: session.python() };
        """,
        "touch_wall",
    )
    largest, delay, fixed, number, spoiled = found["said"]
    assert "the largest pd.stiffness that is accepted is 5797" in largest
    assert found["ways"][0][0]["kind"] == AT_MOST
    ((field, most),) = found["ways"][0][0]["values"].items()
    assert field == "pd.stiffness"
    assert f"{field} that is accepted is {most}" in largest
    assert "unstable at a delay of 6 ticks" in delay
    assert (found["ways"][1][0]["kind"], found["taken"]) == (AT_MOST, [True, False])
    assert "pd.order is fixed on this page" in fixed
    assert "NaN is no stiffness" in number
    assert (SAFETY[found["stopped"]], SAFETY[found["again"]]) == ("stopped", "active")
    assert "rearmed" in spoiled
    assert found["seq"] == 1
    assert "stiffness: 500" in found["python"]


def test_a_law_refused_because_it_is_too_soft_is_told_the_smallest_stiffness(
    tmp_path: Path,
) -> None:
    """With less it would pull into the wall, as a launch says, too; told was the largest."""
    found = run(
        tmp_path,
        """
        const session = new Session(DATA), said = [];
        session.switchTo("multi_term", 0, true);
        session.setDelay(1, true);
        const tried = (value) => {
          try { session.setLaw("stiffness", value, false); } catch (error) { return error; }
          return null;
        };
        for (const value of [10, 1e5]) said.push(tried(value).remedies[0]);
        let forced = false;
        try { session.setLaw("stiffness", 10, true); forced = true; } catch { }
        const taken = said.map(({ values }) => tried(Object.values(values)[0]) === null);
        result = { said, taken, forced, law: session.laws.multi_term, device: session.device() };
        """,
        "touch_wall",
    )
    least, most = (next(iter(one["values"].values())) for one in found["said"])
    assert [one["kind"] for one in found["said"]] == ["at_least", "at_most"]
    assert found["taken"] == [True, True]
    assert not found["forced"]
    given = {**found["device"]}
    plant = Plant(
        T, given["mass"], given["damping"], given["delay"], given["stiffness"]
    )

    def stable(stiffness: float) -> bool:
        law = parse_law({**found["law"], "stiffness": stiffness}, "multi_term")
        return bool(pole_radius(law.compile(T), plant) < 1.0)

    # The largest is told a thousandth inside, in four digits; the smallest in three.
    assert [stable(least), stable(most), stable(1.002 * most)] == [True, True, False]
    compile_law(parse_law({**found["law"], "stiffness": least}), T)
    with pytest.raises(LawRefusedError, match="pull into the wall"):
        compile_law(parse_law({**found["law"], "stiffness": 0.989 * least}), T)


def test_one_button_lets_a_law_sing_and_a_stiffer_one_rest(tmp_path: Path) -> None:
    """A sings for seconds under the page's own hand; B, three times as stiff, settles."""
    found = run(
        tmp_path,
        page_script("sing")
        + """
        const session = new Session(DATA), state = { ...session, active: session.law };
        session.setDelay(0.5, true);
        state.named = session.data.named;
        const edges = Object.fromEntries(
          Object.keys(session.laws).map((name) => [name, session.edge(name)]));
        const facts = $sing.plan(state, edges), parts = session.data.parts[facts.beside];
        session.setLaw("stiffness", facts.stiffness, true);
        const by = facts.hardness / parts.rest, law = session.laws[facts.beside];
        session.compare(facts.beside,
          facts.scaled ? { ...law, scale: by } : { ...law, stiffness: facts.hardness });
        const a = new Ringing(), b = new Ringing();
        const heard = { a: 0, b: 0 };
        for (let k = 0; k < 3500; k++) {
          if (k % 8 === 0)
            session.hand([$sing.pressed(k * 0.002, { at: 0.02, side: -1 }), 0, 0]);
          session.tick();
          a.take(k * 0.002, session.player.driver);
          b.take(k * 0.002, session.beside.player.driver);
          if (a.ring()) heard.a++;
          if (k * 0.002 > 1.5 && b.ring()) heard.b++; // it has settled by then
        }
        result = { facts, heard, end: session.beside.force.slice(-250) };
        """,
        "touch_wall",
    )
    facts, heard = found["facts"], found["heard"]
    assert facts["law"] == "pd"
    assert facts["stiffness"] > facts["edge"]
    assert (facts["times"], facts["hardness"]) == (3, 3 * facts["stiffness"])
    assert facts["hardness"] < facts["besideEdge"]
    assert heard["a"] > 2500, "A sings for more than 5 s of 7"
    assert heard["b"] == 0
    end = np.abs(found["end"])
    # It holds the hand, and rests: the peak to peak force is below what counts as a reversal.
    assert end.min() > 0.5
    assert np.ptp(end) < 0.1


def test_a_law_that_bounces_below_its_edge_is_replaced_by_one_that_rests(
    tmp_path: Path,
) -> None:
    """At one tick of delay the law with the largest edge bounces off the wall for good."""
    found = run(
        tmp_path,
        page_script("sing")
        + """
        const edgesOf = (session) => Object.fromEntries(
          Object.keys(session.laws).map((name) => [name, session.edge(name)]));
        const play = (delay, rang) => {
          const session = new Session(DATA), { parts, named } = session.data;
          session.setDelay(delay, true);
          for (let k = 0; k < 20; k++) session.tick();
          const state = { laws: session.laws, active: session.law, named };
          const edges = edgesOf(session), facts = $sing.plan(state, edges, rang);
          session.setLaw("stiffness", facts.stiffness, true);
          const law = session.laws[facts.beside], by = facts.hardness;
          session.compare(facts.beside, facts.scaled
            ? { ...law, scale: by / parts[facts.beside].rest } : { ...law, stiffness: by });
          const b = new Ringing();
          let rings = 0;
          for (let k = 0; k < 3500; k++) {
            if (k % 8 === 0)
              session.hand([$sing.pressed(k * 0.002, { at: 0.02, side: -1 }), 0, 0]);
            session.tick();
            b.take(k * 0.002, session.beside.player.driver);
            if (k * 0.002 > 4 && b.ring()) rings++;
          }
          const force = session.beside.force.slice(-500);
          return { beside: facts.beside, times: facts.times, rings,
            swing: Math.max(...force) - Math.min(...force) };
        };
        result = [1, 3].map((delay) => {
          const tried = [];
          do tried.push(play(delay, tried)); while (tried.at(-1).rings && tried.length < 9);
          return tried;
        });
        """,
        "touch_wall",
    )
    assert [len(tried) for tried in found] == [2, 1]
    first, second = found[0]
    assert (first["swing"] > 1.0, first["times"]) == (True, 3)
    assert (second["beside"] != first["beside"], second["times"]) == (True, 3)
    # Below what counts as a stroke of a ring.
    assert all(tried[-1]["swing"] < 0.1 for tried in found)


def test_a_law_rests_up_to_its_edge_and_one_with_own_code_is_not_judged(
    tmp_path: Path,
) -> None:
    found = run(
        tmp_path,
        """
        const session = new Session(DATA), most = session.edge("pd"), said = [];
        for (const by of [0.99, 1.01]) {
          session.setLaw("stiffness", by * most, true);
          said.push(session.rests);
        }
        session.setLaw("stiffness", 0.5 * most, true);
        session.numbersOf = () => ({ own: { kind: "windowed" } });
        result = [...said, session.rests];
        """,
        "touch_wall",
    )
    assert found == [True, False, False]


MOVING: dict[str, Any] = {
    "kind": "union",
    "shapes": [
        {
            "kind": "sphere",
            "position": [0.05, 0.01, -0.03],
            "radius": 0.035,
            "friction": {"static": 0.3},
            "motion": {
                "path": [[0.0, 0, 0, 0], [1.0, 0, 0, 0.01], [2.0, 0, 0, 0]],
                "repeat": 2.0,
            },
        },
        {"kind": "box", "position": [0.05, 0.06, 0.0], "size": [0.04, 0.02, 0.04]},
    ],
}


def test_b_of_three_axes_with_the_law_of_a_is_a(tmp_path: Path) -> None:
    """From the middle of a contact on, with its friction and its moving ball, to the bit."""
    content = yaml.safe_load(scenario_files.find("sphere_feel").read_text())
    content["nodes"]["environment"]["parameters"]["surface"] = MOVING
    path = tmp_path / "moving.yaml"
    path.write_text(yaml.safe_dump(content))
    found = run(
        tmp_path,
        """const s = new Session(DATA);
        s.hand([0.05, 0.02, -0.005]);
        const rows = [];
        for (let k = 0; k < 900; k++) {
          if (k === 600) s.compare("pd");
          if (k % 50 === 0) s.hand([0.05 + 0.01 * Math.sin(k / 90), 0.02, -0.005]);
          s.tick();
          const { position, force } = s.player.driver;
          if (k >= 600) rows.push([[...position], [...force]]);
        }
        const { position, force } = s.beside;
        result = { rows, position, force, shift: s.player.table[ROWS_ + SHIFT_ + 2] };""",
        str(path),
    )
    a = np.array(found["rows"])
    assert np.array_equal(a[:, 0], found["position"])
    assert np.array_equal(a[:, 1], found["force"])
    assert np.abs(a[:, 1]).max(axis=0).min() > 0.02
    # At 1.8 s the ball is on its way back.
    assert found["shift"] == pytest.approx(0.01 * (2.0 - 899 * T), abs=1e-12)
