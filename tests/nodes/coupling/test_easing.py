"""Jumps without motion: no velocity, no impact; the force is ramped, in every player."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.codec import Decoder
from messages.types import Force, Proxy
from nodes.arithmetic import eased, sections, settle
from nodes.coupling.law_book import LawBook
from nodes.coupling.law_on_axis import History, LawOnAxis
from nodes.coupling.node import Coupling
from nodes.coupling.parameters import CouplingParameters
from nodes.environment.shapes.tables import SKIN
from nodes.environment.shapes.touchable import TOOL_RADIUS
from nodes.launcher import launch_file
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.parameters.store import convert
from sim.play.chain import Instead
from sim.play.given import Given
from sim.play.launched import LaunchedScene, from_launch
from sim.play.one_axis import run
from sim.play.player import play
from sim.play.trace import ChainTrace
from tests.support.setups import setup_of
from tests.support.shapes import wander

FIXTURES = Path(__file__).parents[2] / "fixtures" / "begin"
EASE = 0.15  # the coupling's own [s]
PERIOD = 0.002
RAMP = round(EASE / PERIOD)  # the same [ticks]
STIFFNESS, DAMPING = 800.0, 2.0
EPSILON = 1e-12  # rounding of forces of some 100 N


def drop(law: str, height: float, **coupling: Any) -> LaunchedScene:
    """Prepare the drop of the paper from a height [m]."""
    return from_launch(with_values(dropped(law, height), "coupling", coupling))


def force_of(scene: LaunchedScene, ticks: int | None = None) -> np.ndarray[Any, Any]:
    """Play a drop by the loop of one axis, interpreted; return its force [N]."""
    return run(scene.scene, scene.law, ticks or scene.ticks, interpreted=True).force


def led(
    launch: Launch,
    path: np.ndarray[Any, Any],
    changes: Sequence[tuple[int, dict[str, Any]]],
) -> ChainTrace:
    """Play a way that the device is led, over surfaces that change."""
    surfaces = [(tick, {"surface": surface}) for tick, surface in changes]
    instead = Instead(environment=surfaces)
    return play(launch, ticks=len(path), instead=instead, given=Given(path=path))


def dropped(law: str, height: float) -> Launch:
    """Return the launch of that drop without the driver's own ramp."""
    launch = launch_file.read(
        "floor_drop", {"law": law, "height": height, "duration": 0.6}
    )
    return with_values(
        launch,
        "driver",
        {"safety": {**launch.nodes["driver"].parameters["safety"], "ramp": 0.0}},
    )


def gain_at_rest(law: CompiledLaw) -> float:
    """Return force over deflection of a law at constant deflection [N/m]."""
    return sum(law.taps) + sum(
        (b0 + b1) / (1.0 + a1 + a2) for b0, b1, a1, a2 in law.sections
    )


def with_values(launch: Launch, name: str, values: dict[str, Any]) -> Launch:
    """Return a launch with parameters of a node changed."""
    node = launch.nodes[name]
    parameters = {**node.parameters, **values}
    nodes = {**launch.nodes, name: msgspec.structs.replace(node, parameters=parameters)}
    return msgspec.structs.replace(launch, nodes=nodes)


@pytest.mark.parametrize("law", ["pd", "pd_alpha", "multi_term", "designed_d0"])
@pytest.mark.parametrize("height", [-0.002, -0.0005])
def test_a_drop_that_begins_inside_the_floor_begins_softly(
    law: str, height: float
) -> None:
    """The first force was B/T times the depth too: 5.0, 4.6 and 6.3 N instead of 2.0 N."""
    scene = drop(law, height)
    force = force_of(scene)
    assert (
        0.0
        < force[0]
        == pytest.approx(-gain_at_rest(scene.law) * height / RAMP, rel=1e-9)
    )
    # It never pushes harder than a device that is let down on the surface itself.
    assert force.max() < 1.3 * force_of(drop(law, 0.0)).max()


@pytest.mark.parametrize("law", ["pd", "pd_alpha", "multi_term"])
def test_a_drop_that_begins_free_has_the_bits_of_one_without_easing(law: str) -> None:
    for height in (0.0, 0.01):
        drops = (drop(law, height, ease=ease) for ease in (EASE, 0.0))
        eased_, hard = (run(one.scene, one.law, 200, interpreted=True) for one in drops)
        assert np.array_equal(eased_.force, hard.force)
        assert np.array_equal(eased_.measured, hard.measured)


def test_without_easing_a_beginning_is_no_velocity_all_the_same() -> None:
    assert force_of(drop("pd", -0.002, ease=0.0), 10)[0] == pytest.approx(
        2.0, rel=1e-12
    )


@pytest.mark.parametrize("law", ["pd", "pd_alpha", "multi_term", "designed_d0"])
def test_the_compiled_loop_and_the_nodes_rules_begin_with_the_same_bits(
    law: str,
) -> None:
    """One process, interpreted over the loop's own rules and over the nodes' own parts."""
    force = force_of(drop(law, -0.0012), 150)
    nodes = play(dropped(law, -0.0012), ticks=150, how="nodes")
    assert np.array_equal(nodes.force[:, 2], force)


@given(
    st.floats(-50.0, 50.0),
    st.floats(-50.0, 50.0),
    st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=40),
    st.integers(1, 40),
)
def test_an_eased_force_lies_between_what_was_felt_and_what_is_asked(
    felt: float, asked: float, later: list[float], ramp: int
) -> None:
    """The ramp adds its share of the step; the rest follows the requested force."""
    before = felt
    for done, wanted in enumerate([asked, *later]):
        force = eased(wanted, felt, felt - asked, min(done, ramp), ramp)
        assert min(felt, wanted) <= force <= max(felt, wanted)
        moved = abs(wanted - (asked if done == 0 else [asked, *later][done - 1]))
        assert abs(force - before) <= abs(felt - asked) / ramp + moved + EPSILON
        before = force
        if done + 1 >= ramp:
            assert force == wanted


@given(st.floats(-1.9, 1.9), st.floats(0.0, 0.98), st.floats(-0.1, 0.1))
def test_a_section_that_is_settled_stays_where_it_is(
    angle: float, radius: float, value: float
) -> None:
    coefficients = [300.0, -120.0, -radius * angle, radius * radius]
    state = [0.0, 0.0]
    settle(coefficients, state, value)
    rest = state[0]
    for _ in range(200):
        sections(coefficients, state, value, value)
    assert state[0] == pytest.approx(rest, rel=1e-9, abs=1e-12)


# -- surfaces that are changed while they are touched
# ----------------------------------------------------------------------

SURFACES = st.one_of(
    st.builds(
        lambda at, radius: {"kind": "sphere", "position": list(at), "radius": radius},
        st.tuples(*3 * [st.floats(-0.02, 0.02)]),
        st.floats(0.01, 0.05),
    ),
    st.builds(
        lambda at, size, turn: {
            "kind": "box",
            "position": list(at),
            "size": list(size),
            "rotation": list(turn),
        },
        st.tuples(*3 * [st.floats(-0.02, 0.02)]),
        st.tuples(*3 * [st.floats(0.01, 0.08)]),
        st.tuples(*3 * [st.floats(-1.0, 1.0)]),
    ),
    st.builds(
        lambda at: {"kind": "plane", "axis": "z", "position": at},
        st.floats(-0.02, 0.02),
    ),
    st.builds(
        lambda at: {"kind": "anchor", "position": list(at)},
        st.tuples(*3 * [st.floats(-0.02, 0.02)]),
    ),
    st.builds(
        lambda at, turn: {
            "kind": "oriented_plane",
            "position": [0.0, 0.0, at],
            "normal": [*turn, 1.0],
        },
        st.floats(-0.02, 0.02),
        st.tuples(*2 * [st.floats(-0.5, 0.5)]),
    ),
    st.just({"kind": "free"}),
    st.builds(
        lambda at, ball: {
            "kind": "union",
            "shapes": [
                {"kind": "box", "position": [0.0, 0.0, at], "size": [0.1, 0.1, 0.01]},
                {"kind": "sphere", "position": [0.0, 0.0, ball], "radius": 0.01},
            ],
        },
        st.floats(-0.02, 0.02),
        st.floats(-0.02, 0.02),
    ),
)
FIRST_TAPS = np.array([STIFFNESS + DAMPING / PERIOD, -DAMPING / PERIOD])


def with_surface(surface: dict[str, Any], **given_: Any) -> Launch:
    """Return the scene in space with a surface."""
    launch = launch_file.read(str(FIXTURES / "space.yaml"), given_)
    node = msgspec.structs.replace(
        launch.nodes["environment"], parameters={"surface": surface}
    )
    return msgspec.structs.replace(launch, nodes={**launch.nodes, "environment": node})


def couplings(surface: dict[str, Any], law: str) -> CouplingParameters:
    """Return the coupling's parameters in space."""
    made: CouplingParameters = convert(
        with_surface(surface, law=law).nodes["coupling"].parameters,
        CouplingParameters,
        "coupling",
    )
    return made


def unexplained(found: ChainTrace, changes: Sequence[int]) -> float:
    """Return the largest force change per tick beyond ramp and motion, for pd [N].

    The requested force is computed from the trace by the law's equation in world axes, without
    velocity over a jump; the ramp may add its share of each jump's step while it lasts.
    """
    deflection = np.where(found.contact[:, None], found.proxy - found.measured, 0.0)
    before = np.vstack([deflection[:1], deflection[:-1]])
    for tick in changes:
        before[tick] = deflection[tick]
    asked = FIRST_TAPS[0] * deflection + FIRST_TAPS[1] * before
    along = np.einsum("ij,ij->i", asked, found.normal)
    asked = np.where(
        (along < 0.0)[:, None], asked - along[:, None] * found.normal, asked
    )
    worst, felt, share = 0.0, np.zeros(3), np.zeros(3)
    for k, force in enumerate(found.force):
        # A jump that leaves the deflection as it is (free air before and after) is none, and its
        # easing goes on.
        if k == 0 or (k in changes and (deflection[k] != deflection[k - 1]).any()):
            share = np.abs(felt - asked[k]) / RAMP
            moved = np.zeros(3)
        else:
            moved = np.abs(asked[k] - asked[k - 1])
        worst = max(worst, float((np.abs(force - felt) - share - moved).max()))
        felt = force
    return worst


@settings(max_examples=40, deadline=None)
@given(
    st.lists(SURFACES, min_size=2, max_size=4),
    st.tuples(*3 * [st.floats(-0.025, 0.025)]),
    st.lists(st.integers(1, 60), min_size=3, max_size=3),
    st.integers(0, 2**32 - 1),
)
def test_no_change_of_a_surface_makes_a_force_that_no_motion_made(
    surfaces: list[dict[str, Any]],
    start: tuple[float, float, float],
    gaps: list[int],
    seed: int,
) -> None:
    """Random surfaces, starts, paths and live changes, also during easing."""
    path = np.array(start) + wander(
        np.random.default_rng(seed), 240, 2e-4, (0.02, 0.02, 0.02), (0.0, 0.0, 0.0)
    )
    path += np.array(start) - path[0]
    ticks = np.cumsum(gaps)[: len(surfaces) - 1].tolist()
    changes = list(zip(ticks, surfaces[1:], strict=False))
    found = led(with_surface(surfaces[0], frame="world"), path, changes)
    jumps = [
        tick
        for tick, one, other in zip(ticks, surfaces, surfaces[1:], strict=False)
        if one != other
    ]
    assert unexplained(found, jumps) <= EPSILON


@pytest.mark.parametrize("law", ["pd_alpha", "multi_term", "designed_d0"])
@pytest.mark.parametrize("frame", ["world", "surface"])
def test_a_surface_that_moves_under_a_hand_at_rest_is_felt_by_the_ramp_alone(
    law: str, frame: str
) -> None:
    """Pressed 3 mm deep, the surface comes 10 mm nearer: before, 40 N at once."""
    path = np.concatenate(
        [
            np.linspace([0.0, 0.0, 0.04], [0.0, 0.0, 0.027], 100),
            np.tile([0.0, 0.0, 0.027], (1400, 1)),
        ]
    )
    ball, moved = (
        {"kind": "sphere", "position": [0.0, 0.0, z], "radius": 0.03}
        for z in (0.0, 0.01)
    )
    found = led(with_surface(ball, law=law, frame=frame), path, [(1200, moved)])
    force = found.force[:, 2]
    step = np.abs(np.diff(force[1100:])).max()
    gain = gain_at_rest(LawBook("coupling", PERIOD).compile(couplings(ball, law), law))
    assert force[-1] == pytest.approx(
        gain * (0.013 + TOOL_RADIUS), abs=2.0 * gain * SKIN
    )
    # Of what a law remembers of the way in, nothing is left but what fades with the ramp.
    assert step <= 1.02 * (gain * 0.013 - force[1199]) / RAMP


@pytest.mark.parametrize(
    ("radius", "moved"),
    [(0.022, 0.01), (0.022, 0.1), (0.022, -0.02), (0.037, -0.02), (0.037, 0.05)],
)
def test_a_surface_that_asks_for_more_than_the_driver_gives_comes_by_the_whole_ramp(
    radius: float, moved: float
) -> None:
    """The requested 80 N reached the driver's 7.9 N after a tenth of the ramp."""
    path = np.concatenate(
        [
            np.linspace([0.0, 0.0, 0.04], [0.0, 0.0, 0.02], 100),
            np.tile([0.0, 0.0, 0.02], (300, 1)),
        ]
    )
    launch = with_surface({"kind": "sphere", "radius": radius})
    limits = {
        **launch.nodes["driver"].parameters["safety"],
        "peak_force": 7.9,
        "slew": 4000.0,
    }
    launch = with_values(launch, "driver", {"safety": limits})
    changes = [(250, {"kind": "sphere", "radius": radius + moved})]
    force = led(launch, path, changes).force[:, 2]
    deep = radius + TOOL_RADIUS - 0.02
    before, after = (
        min(max(STIFFNESS * deflection, 0.0), 7.9)
        for deflection in (deep, deep + moved)
    )
    line = before + (after - before) * np.minimum(np.arange(1, 151) / RAMP, 1.0)
    # The skin of a surface is 0.1 nm.
    assert force[250:] == pytest.approx(line, abs=1e-6)


def test_a_solid_that_moves_onto_a_free_device_is_not_felt_until_it_is_outside() -> (
    None
):
    path = np.concatenate(
        [
            np.tile([0.0, 0.0, 0.04], (50, 1)),
            np.linspace([0.0, 0.0, 0.04], [0.0, 0.0, 0.08], 300),
        ]
    )
    path = np.concatenate([path, np.linspace([0.0, 0.0, 0.08], [0.0, 0.0, 0.058], 150)])
    ball, moved = (
        {"kind": "sphere", "position": [0.0, 0.0, z], "radius": 0.03}
        for z in (0.0, 0.03)
    )
    found = led(with_surface(ball), path, [(20, moved)])
    assert not found.force[:350].any()
    assert found.force[-1, 2] > 1.0


# -- the node
# --------------------------------------------------------------------------------------------------

PD = {"kind": "pd", "stiffness": STIFFNESS, "damping": 0.0}


def coupling(**given_: Any) -> Coupling:
    node = Coupling(
        setup_of(
            name="coupling",
            parameters={"law": "pd", "laws": {"pd": PD}, "stability": "off", **given_},
        )
    )
    node.configure()
    return node


def force_at(node: Coupling, seq: int, depth: float, **given_: Any) -> float:
    """Return the force along z [N] at a depth behind a floor [m]."""
    contact: dict[str, Any] = {
        "normal": (0.0, 0.0, 1.0),
        "distance": -depth,
        "contact": depth > 0.0,
    }
    place = (0.0, 0.0, -depth)
    proxy = (0.0, 0.0, 0.0) if depth > 0.0 else place
    payload = node.respond(
        Proxy(seq=seq, stamp=0.0, position=place, proxy=proxy, **contact, **given_)
    )
    node.counters.seq = node.counters.answered = seq
    return Decoder(Force).decode(payload).force[2]


def test_a_jump_has_the_ramp_that_its_message_asks_for_and_the_next_one_begins_where_that_is() -> (
    None
):
    node = coupling()
    assert force_at(node, 0, 0.0) == 0.0
    assert [
        force_at(node, k, 0.01, rebased=1, ease=4) for k in range(1, 6)
    ] == pytest.approx([2.0, 4.0, 6.0, 8.0, 8.0])
    # Lost ticks are no motion either: the message after them tells of the jump.
    assert force_at(node, 9, 0.02, rebased=8, ease=4) == pytest.approx(8.0 + 2.0)
    assert force_at(node, 10, 0.02, rebased=8, ease=4) == pytest.approx(8.0 + 4.0)
    # In the middle of it another one, to nothing.
    assert [
        force_at(node, k, 0.0, rebased=11, ease=3) for k in range(11, 15)
    ] == pytest.approx([8.0, 4.0, 0.0, 0.0])


def test_a_coupling_that_is_started_again_begins_at_rest_from_nothing() -> None:
    node = coupling(laws={"pd": {**PD, "damping": 8.0}})
    assert force_at(node, 5000, 0.01, rebased=12) == pytest.approx(8.0 / RAMP)
    assert node.counters.rebased == 12


def test_a_driver_that_counts_anew_is_no_velocity() -> None:
    """In lockstep a restarted driver begins at tick 0; its new position is no motion."""
    node = coupling(laws={"pd": {**PD, "damping": 8.0}})
    for k in range(20):
        force_at(node, k, 0.0)
    assert [force_at(node, k, 0.01) for k in range(2)] == pytest.approx(
        [8.0 / RAMP, 16.0 / RAMP]
    )


def test_a_law_that_is_prepared_while_a_jump_fills_the_history_rests_as_one_that_renders() -> (
    None
):
    """Its slow section kept the deflection before the jump: 0.5 N instead of 2.2 N."""
    law = CompiledLaw(taps=(100.0,), sections=((5.0, -4.9, -1.99, 0.9901),))
    history = History(16)
    for _ in range(50):
        history.push(0.01)
    prepared, renders = LawOnAxis(law, history), LawOnAxis(law, history)
    prepared.warm_up(history.snapshot())
    history.fill(0.002)
    renders.settle(0.002)
    for value in (0.002, 0.0021, 0.0025):
        history.push(value)
        renders.see(history.head)
    prepared.catch_up()
    assert prepared.state == renders.state
    assert prepared.present() == renders.present()


def test_conventions_that_are_changed_while_they_act_are_a_jump() -> None:
    """Clamping a pulling law ramps its 4 N down instead of dropping them."""
    node = coupling(laws={"pd": {**PD, "damping": 8.0}}, clamp=False, ease=0.008)
    force_at(node, 0, 0.0)
    force_at(node, 1, 0.010)
    pulls = force_at(node, 2, 0.007)
    assert pulls == pytest.approx(800.0 * 0.007 - 8.0 * 0.003 / PERIOD)
    changed = node.store.changed({"clamp": True})
    node.prepare(changed)(3)
    node.store.accept(changed)
    rest = 800.0 * 0.007
    found = [force_at(node, k, 0.007) for k in range(3, 8)]
    assert found == pytest.approx(
        [pulls + (rest - pulls) * share for share in (0.25, 0.5, 0.75, 1.0, 1.0)]
    )
