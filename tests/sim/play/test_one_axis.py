"""The one-process scene: compiled and interpreted bits, the nodes' kernels, closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from nodes.arithmetic import (
    deflection,
    fir,
    limit,
    one_sided,
    plane_distance,
    push,
    sections,
    settle,
)
from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from sim.device.hand import Hand
from sim.device.model import DeviceModel, quantise
from sim.device.state import VirtualDevice, device_tick
from sim.play.one_axis import PlannedSwap, Trace, run
from sim.play.one_axis_inputs import Scene, SceneSurface
from sim.play.one_axis_loop import play_compiled

PERIOD = 0.002
FLOOR = SceneSurface("plane")
DROPPED = DeviceModel(mass=0.1, damping=1.0, gravity=9.81, position=0.01)
DROP = Scene(device=DROPPED, surface=FLOOR, period=PERIOD, raw=False, clamp=True)
LAW = PD(stiffness=400.0, damping=1.0).compile(PERIOD)
# A leaky integrator beside a spring-damper: 1/(1 − 0.9 w), two real poles for the second.
RECURSIVE = CompiledLaw(
    (300.0, -200.0), ((20.0, 5.0, -0.9, 0.0), (-15.0, 3.0, -0.5, 0.06))
)
HAND = Hand(
    mass=0.02,
    damping=1.5,
    stiffness=300.0,
    path=[(0.0, 0.01), (0.2, -0.02), (0.4, 0.015)],
)


def scene(**changes: object) -> Scene:
    fields = {field.name for field in dataclasses.fields(Scene)}
    of_scene = {name: value for name, value in changes.items() if name in fields}
    of_device = {name: value for name, value in changes.items() if name not in fields}
    device = DeviceModel(
        **{name: getattr(DROPPED, name) for name in DROPPED.__struct_fields__}
        | of_device
    )
    return dataclasses.replace(DROP, device=device, **of_scene)  # type: ignore[arg-type]


def same_bits(one: Trace, other: Trace) -> bool:
    arrays = ("position", "velocity", "measured", "deflection", "force")
    return one.final == other.final and all(
        getattr(one, a).tobytes() == getattr(other, a).tobytes() for a in arrays
    )


SCENES = {
    "drop": scene(),
    "raw": scene(raw=True, clamp=False),
    "ceiling": scene(surface=SceneSurface("plane", 0.02, -1.0), gravity=-9.81),
    "free": scene(surface=SceneSurface("free")),
    "anchor": scene(surface=SceneSurface("anchor", 0.001), gravity=None),
    "next_tick": scene(next_tick=True),
    "fraction": scene(delay=0.37),
    "long_delay": scene(delay=3.25),
    "encoder": scene(resolution=2.3e-5),
    "friction": scene(friction=0.06),
    "motor": scene(peak_force=2.0),
    "limits": scene(peak=3.0, slew=0.5),
    "hand": scene(hand=HAND, gravity=None),
    "everything": scene(
        raw=True,
        delay=1.6,
        resolution=2.3e-5,
        friction=0.06,
        peak_force=7.9,
        hand=HAND,
        peak=6.0,
        slew=1.0,
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_compiled_bits_are_interpreted_bits(name: str) -> None:
    swaps = (
        PlannedSwap(150, PD(stiffness=900.0, damping=2.0).compile(PERIOD)),
        PlannedSwap(300, LAW, ramp=25),
    )
    fast = run(SCENES[name], LAW, 500, swaps)
    assert same_bits(fast, run(SCENES[name], LAW, 500, swaps, interpreted=True))
    assert np.isfinite(fast.position).all()
    assert np.ptp(fast.position) > 1e-3


def test_what_a_scene_lacks_makes_no_version_of_its_own() -> None:
    run(SCENES["drop"], LAW, 10)
    versions = list(play_compiled.signatures)
    # An encoder and friction are other arithmetic, and so are other versions.
    for here in [
        scene(workspace=(0.0, 0.1)),
        *(
            SCENES[name]
            for name in SCENES
            if name not in ("encoder", "friction", "everything")
        ),
    ]:
        run(here, LAW, 10)
    assert play_compiled.signatures == versions


@pytest.mark.parametrize("name", ["drop", "everything"])
def test_compiled_bits_with_recursive_laws(name: str) -> None:
    swaps = (
        PlannedSwap(60, RECURSIVE),
        PlannedSwap(100, LAW, ramp=10),
        PlannedSwap(105, RECURSIVE, ramp=40),
    )
    fast = run(SCENES[name], LAW, 400, swaps, memory=64)
    assert same_bits(
        fast, run(SCENES[name], LAW, 400, swaps, memory=64, interpreted=True)
    )


def test_compiled_bits_of_a_diverging_run() -> None:
    wild = CompiledLaw((1e6, -9.9e5))
    here = scene(resolution=2.3e-5, surface=SceneSurface("anchor"))
    fast = run(here, wild, 100)
    assert same_bits(fast, run(here, wild, 100, interpreted=True))
    assert np.max(np.abs(fast.position)) > 1e50


@pytest.mark.parametrize("name", SCENES)
def test_bits_of_the_nodes_kernels_by_hand(name: str) -> None:
    """The order of calls that the contract of the nodes states, over `VirtualDevice`."""
    here = SCENES[name]
    # Each law with sections costs a compilation of its own per kind of scene; two of them show that
    # they are in order.
    law = RECURSIVE if name in ("drop", "everything") else LAW
    trace = run(here, law, 200)
    device = VirtualDevice(here.device, PERIOD, here.next_tick)
    history, head, force = [0.0] * 4, 0, 0.0
    state = [0.0] * (2 * len(law.sections))
    flat = [c for section in law.sections for c in section]
    normal = here.surface.normal if here.surface.kind == "plane" else 0.0
    for k in range(200):
        measured = quantise(device.state.x, here.device.resolution)
        if here.surface.kind == "plane":
            distance = plane_distance(measured, here.surface.position, normal)
            contact = distance < 0.0
        else:
            distance, contact = 0.0, here.surface.kind == "anchor"
        proxy = here.surface.position if contact else measured
        newest = deflection(measured, proxy, distance, normal, contact, here.raw)
        head = push(history, head, 2, newest)
        if k == 0 and newest != 0.0:
            # It begins at rest, in contact.
            history = [newest] * 4
            settle(flat, state, newest)
        asked = fir(law.taps, history, head)
        if flat:
            asked += sections(flat, state, history[head], history[head + 1])
        force = limit(
            one_sided(asked, normal, asked * normal, contact, here.raw, here.clamp),
            force,
            here.peak,
            here.slew,
        )
        assert (device.state.x, measured, newest, force) == (
            trace.position[k],
            trace.measured[k],
            trace.deflection[k],
            trace.force[k],
        )
        device_tick(device.state, force)
    assert (device.state.x, device.state.v) == trace.final


def test_falls_as_a_parabola_and_lands_on_the_spring() -> None:
    trace = run(scene(damping=0.0), LAW, 6000)
    falling = trace.position > 0.0
    first = int(np.argmin(falling))
    # First contact at √(2·0.01/9.81) = 45.2 ms, tick 23. Undamped fall, exact at every tick: a few
    # roundings of 1 cm.
    assert first == 23
    expected = 0.01 - 0.5 * 9.81 * trace.time[:first] ** 2
    assert trace.position[:first] == pytest.approx(expected, abs=1e-16)
    # At rest m g = K x. The bounces decay at about (B − KT/2)/2m = 3 /s: e^{−36} is left after 12
    # s.
    assert trace.final[0] == pytest.approx(-0.1 * 9.81 / LAW.h1, rel=1e-9)


def test_clamped_wall_never_pulls_and_raw_history_pushes_only_in_contact() -> None:
    damped = PD(stiffness=400.0, damping=1.0).compile(PERIOD)
    thrown = scene(gravity=None, velocity=-0.3)
    clamped = run(thrown, damped, 500)
    pulling = run(dataclasses.replace(thrown, clamp=False), damped, 500)
    raw = run(dataclasses.replace(thrown, raw=True), damped, 500)
    assert clamped.force.min() >= 0.0
    assert pulling.force.min() < 0.0
    assert (raw.force[raw.position > 0.0] == 0.0).all()
    # At touch-down the raw history knows the approach, the cut one sees a jump from zero.
    k = int(np.argmax(raw.position < 0.0))
    assert raw.deflection[k - 1] == -raw.position[k - 1] < 0.0
    assert clamped.deflection[k - 1] == 0.0


def test_limits_hold_at_their_edge() -> None:
    trace = run(scene(peak=2.5, slew=0.4), LAW, 400)
    assert np.max(np.abs(trace.force)) == 2.5
    # A step is taken as previous ± slew, so the difference recovers it to a rounding of 2.5 N.
    assert np.max(np.abs(np.diff(trace.force))) == pytest.approx(0.4, rel=1e-15)


def test_friction_brings_it_to_a_dead_stop() -> None:
    trace = run(scene(friction=0.06), LAW, 2000)
    assert trace.final[1] == 0.0
    # It rests anywhere within f_c of balance.
    assert abs(LAW.h1 * trace.final[0] + 0.1 * 9.81) <= 0.06 * (1.0 + 1e-12)


def test_delay_shifts_what_the_device_feels() -> None:
    # A constant force from tick 0 (a spring without damping, anchored far away, so that x hardly
    # matters): 1 N on 0.1 kg.
    far = CompiledLaw((1e-6,))
    for delay in (0.0, 0.5, 2.0, 2.75):
        here = scene(
            surface=SceneSurface("anchor", 1e6),
            damping=0.0,
            gravity=None,
            position=0.0,
            delay=delay,
        )
        trace = run(here, far, 10)
        # 1e-6 N/m over 2 cm changes the force by 2e-8.
        assert trace.final[0] == pytest.approx(
            0.5 * 10.0 * ((10 - delay) * PERIOD) ** 2, rel=1e-7
        )


def test_swap_is_one_tick_and_keeps_the_history() -> None:
    stiff = PD(stiffness=900.0, damping=2.0).compile(PERIOD)
    trace = run(DROP, LAW, 200, (PlannedSwap(40, stiff),))
    before = run(DROP, LAW, 200)
    assert trace.force[:40].tobytes() == before.force[:40].tobytes()
    x = trace.deflection
    for k in (40, 41, 42):
        assert trace.force[k] == max(
            stiff.taps[0] * x[k] + stiff.taps[1] * x[k - 1], 0.0
        )


def test_cross_fade_mixes_both_laws_over_the_same_history() -> None:
    stiff = PD(stiffness=900.0, damping=2.0).compile(PERIOD)
    still = scene(clamp=False)
    trace = run(still, LAW, 200, (PlannedSwap(60, stiff, ramp=4),))
    x = trace.deflection
    for k in range(59, 66):
        share = min(max((k - 59) / 4.0, 0.0), 1.0)
        old, new = (law.taps[0] * x[k] + law.taps[1] * x[k - 1] for law in (LAW, stiff))
        # Same terms, other order of rounding.
        assert trace.force[k] == pytest.approx(
            (1.0 - share) * old + share * new, rel=1e-14
        )


def test_recursive_law_swaps_in_as_if_it_had_been_there() -> None:
    # Over a ring that reaches back to before tick 0 the replay is complete: the force equals that
    # of a law that ran all along over the same deflections. An open loop shows it: no force reaches
    # the device in time.
    open_loop = scene(
        surface=SceneSurface("anchor", 0.0), gravity=None, velocity=0.5, delay=1000.0
    )
    always = run(open_loop, RECURSIVE, 100)
    swapped = run(open_loop, LAW, 100, (PlannedSwap(50, RECURSIVE),), memory=512)
    assert swapped.deflection.tobytes() == always.deflection.tobytes()
    # 512 ticks of memory cover tick 0 to 49, and the rest before: the slower pole, 0.9, has
    # forgotten what was before that, and what is left is the rounding of a few hundred sums.
    assert swapped.force[50:] == pytest.approx(always.force[50:], rel=1e-12)
    short = run(open_loop, LAW, 100, (PlannedSwap(50, RECURSIVE),), memory=16)
    # With 16 ticks the slower pole, 0.9, has forgotten all but 0.9^16 ≈ 19 % of what came before.
    missing = abs(short.force[50] - always.force[50])
    assert 0.0 < missing < 0.19 * abs(always.force[50])


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ValueError, match="ticks is 0"):
        run(DROP, LAW, 0)
    with pytest.raises(ValueError, match=r"swaps\[1\].tick is 3, expected at least 5"):
        run(DROP, LAW, 10, (PlannedSwap(5, LAW), PlannedSwap(3, LAW)))
    with pytest.raises(ValueError, match=r"swaps\[0\].ramp is -1"):
        run(DROP, LAW, 10, (PlannedSwap(5, LAW, ramp=-1),))
    with pytest.raises(ValueError, match="law 0 of the run"):
        run(DROP, CompiledLaw((math.nan,)), 10)
    with pytest.raises(ValueError, match=r"surface\.normal is 0\.5"):
        SceneSurface("plane", 0.0, 0.5)
    with pytest.raises(ValueError, match="period is 0"):
        dataclasses.replace(DROP, period=0.0)
