"""The passivity guard: its bound for every law and motion, and what it leaves unchanged."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.transport.requests import ControlError
from nodes.driver.motion import act, sample
from nodes.driver.passivity import (
    PassivityParameters,
    backlog,
    control,
    count_step,
    forget,
    guarded,
    line_of,
    observe,
    set_guard,
    through,
)
from nodes.launcher import launch_file
from nodes.laws.pd import PD
from nodes.recording.reader import Recording
from sim.device.model import DeviceModel
from sim.play.one_axis import Trace, run
from sim.play.one_axis_inputs import Scene, SceneSurface
from sim.play.player import play
from tests.support.launching import haptic, launch_json, running, wait_for
from tests.support.safety import state_of

T = 0.002
ON = PassivityParameters()

forces = st.floats(-50.0, 50.0)
steps = st.floats(-5e-3, 5e-3)


class Guard:
    """The guard of one axis with its own driver state."""

    def __init__(self, parameters: PassivityParameters, axis: int) -> None:
        self.s, self._axis = state_of((axis,)), axis
        self.s.elapsed = 1
        set_guard(self.s, parameters)

    @property
    def energy(self) -> float:
        """Energy counted as given out [J]."""
        return float(self.s.guard_energy[self._axis])

    def observe(self, acting: float, before: float, position: float) -> None:
        """Account for a step."""
        (
            self.s.acted[self._axis],
            self.s.before[self._axis],
            self.s.position[self._axis],
        ) = (acting, before, position)
        count_step(self.s)

    def control(self, force: float) -> float:
        """Return the permitted force."""
        self.s.wanted[self._axis] = force
        guarded(self.s, 0.0)
        return float(self.s.wanted[self._axis])


# -- the kernels at their edges
# ---------------------------------------------------------------------------------------


def test_energy_is_exact_in_samples() -> None:
    # 2 N through 3 mm, then −1 N through −4 mm: 6 mJ + 4 mJ.
    assert observe(observe(0.0, 2.0, 0.003), -1.0, -0.004) == pytest.approx(
        0.010, rel=1e-15
    )


def test_what_is_in_store_may_leave_to_the_last_bit_and_no_more() -> None:
    assert control(-0.5, 2.0, 0.25, 0.0) == 2.0
    lowered = control(-0.5, math.nextafter(2.0, 3.0), 0.25, 0.0)
    assert lowered == 2.0
    assert control(-0.5, 400.0, 0.25, 0.0) == 2.0
    assert control(0.0, 2.0, 0.25, 0.0) == 0.0
    assert control(-1e-300, 2.0, 0.25, 0.0) == 4e-300


def test_absorbing_forces_pass_and_a_debt_is_taken_back_with_at_most_the_damper() -> (
    None
):
    assert control(-1.0, 2.0, -0.25, 7.0) == 2.0
    assert control(0.0, 2.0, -0.25, 7.0) == 2.0
    # 2 N would take all back at once: the damper's limit holds
    assert control(0.5, 2.0, -0.25, 7.0) == 2.0 + 7.0 * 0.25
    assert control(0.5, 2.0, -0.25, 8.0) == 2.0 + 2.0
    assert control(0.5, 2.0, -0.25, 9.0) == 2.0 + 2.0  # no more than is owed
    assert control(0.5, -2.0, 0.25, 9.0) == -4.0


def test_at_rest_and_in_free_space_nothing_is_changed() -> None:
    assert control(1.0, 2.0, 0.0, 5.0) == 2.0
    assert control(1.0, 0.0, 0.25, 5.0) == 0.0


def test_credit_is_forgotten_down_to_what_a_spring_holds_and_a_debt_never() -> None:
    assert forget(-1.0, 2.0, None) == -1.0
    assert forget(-1.0, 0.0, None) == 0.0
    assert forget(-1.0, 2.0, 4.0) == -0.5  # 2²/(2·4)
    assert forget(-0.25, 2.0, 4.0) == -0.25
    assert [forget(0.3, force, 4.0) for force in (0.0, 2.0)] == [0.3, 0.3]


def test_what_is_allowed_leaves_untouched_and_no_more() -> None:
    """2 N over 1 mm a tick is 2 mJ; with 10 mJ allowed, the sixth tick is too much."""
    guard = Guard(PassivityParameters(allowance=0.0101), 0)
    force, given = 2.0, []
    for k in range(8):
        guard.observe(force if k else 0.0, 0.001 * k, 0.001 * (k + 1))
        force = guard.control(2.0)
        given.append(force)
    assert given[:5] == [2.0] * 5
    assert given[5] == pytest.approx(0.1, rel=1e-9)  # 0.1 mJ is left for a step of 1 mm
    assert given[6:] == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.slow
def test_a_running_driver_takes_a_guard_up_and_keeps_the_launch_files(
    tmp_path: Path,
) -> None:
    with running(tmp_path, "floor_guarded", "guard:=off", "duration:=0") as launch:
        guard = {"guard": "on", "stiffness": 5000.0, "damping": 10.0}
        launch.call("driver", "param.set", values={"passivity": guard})
        assert launch.call("driver", "param.get", name="passivity")["damping"] == 10.0
        taken_up = launch.call("driver", "progress")["tick"]
        wait_for(
            lambda: launch.call("driver", "progress")["tick"] > taken_up + 250,
            "the mass to be thrown up again",
        )
        assert launch.finish(signal.SIGINT, code=None)["guard"]["lowered"] > 0
    with running(tmp_path, "floor_guarded", "duration:=0") as launch:
        with pytest.raises(ControlError, match="own guard is fixed"):
            launch.call("driver", "param.set", values={"passivity": None})
        launch.finish(signal.SIGINT, code=None)


# -- several axes
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", ["sphere_feel", "rough_plane"])
def test_a_guard_leaves_alone_what_makes_no_energy_along_a_surface(
    scenario: str,
) -> None:
    """One axis returns what another takes; separate accounts would brake the slide."""
    free = launch_file.read(scenario, {"duration": 1.3})
    driver = free.nodes["driver"]
    parameters = {**driver.parameters, "passivity": {"guard": "on"}}
    nodes = {
        **free.nodes,
        "driver": msgspec.structs.replace(driver, parameters=parameters),
    }
    alone, watched = play(free), play(msgspec.structs.replace(free, nodes=nodes))
    assert np.abs(alone.force).max() > 0.1
    assert np.array_equal(alone.force, watched.force)
    assert np.array_equal(alone.position, watched.position)


@given(data=st.data())
@settings(max_examples=50)
def test_no_more_leaves_in_space_than_the_change_of_a_step_explains(
    data: st.DataObject,
) -> None:
    """E_{k+1} ≤ max(E_k, 0) + F_k·(Δ_{k+1} − Δ_k); the force keeps its direction."""
    s = state_of((0, 1, 2))
    s.elapsed = 1
    set_guard(s, ON)
    rng = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    position, last, force, energy = np.zeros(3), np.zeros(3), np.zeros(3), 0.0
    for _ in range(60):
        moved = last + rng.normal(scale=1e-3, size=3)
        after = energy + float(force @ moved)
        # Rounding of a few products of some newtons and millimetres.
        assert after <= max(energy, 0.0) + float(force @ (moved - last)) + 1e-14
        s.before[:], s.position[:], s.acted[:] = position, position + moved, force
        count_step(s)
        position, last = position + moved, moved
        wanted = rng.normal(scale=5.0, size=3)
        s.wanted[:] = wanted
        guarded(s, 0.0)
        energy = s.guard_energy[0]
        assert energy == pytest.approx(
            after if np.any(wanted) else max(after, 0.0), abs=1e-14
        )
        force = np.array(s.wanted[:])
        assert force == pytest.approx(
            wanted * (np.linalg.norm(force) / np.linalg.norm(wanted)), abs=1e-12
        )


# -- the bound
# --------------------------------------------------------------------------------------------------


@given(
    energy=st.floats(-1.0, 1.0),
    law=forces,
    step=steps,
    following=steps,
    rate=st.floats(0.0, 1e5),
    stiffness=st.one_of(st.none(), st.floats(1.0, 1e5)),
)
def test_one_tick_gives_out_no_more_than_force_times_the_change_of_displacement(
    energy: float,
    law: float,
    step: float,
    following: float,
    rate: float,
    stiffness: float | None,
) -> None:
    before = forget(energy, law, stiffness)
    assert before >= energy
    force = control(before, law, step, rate)
    after = observe(before, force, following)
    # a few roundings of its own terms
    slack = 1e-12 * (abs(before) + abs(force) * (abs(step) + abs(following)))
    assert after <= max(before, 0.0) + force * (following - step) + slack
    assert force * law >= 0.0
    assert (force == 0.0) or (law != 0.0)
    # Where nothing is owed, forces are lowered only.
    assert before > 0.0 or abs(force) <= abs(law)


@given(
    run_=st.lists(st.tuples(forces, steps), min_size=2, max_size=80),
    stiffness=st.one_of(st.none(), st.floats(1.0, 1e5)),
    damping=st.floats(0.0, 20.0),
)
def test_over_a_whole_run_only_the_changes_of_displacement_add_up(
    run_: list[tuple[float, float]], stiffness: float | None, damping: float
) -> None:
    guard = Guard(PassivityParameters(stiffness=stiffness, damping=damping), 2)
    position, energy, allowed = 0.0, 0.0, 0.0
    acting, last = 0.0, 0.0
    for law, step in run_:
        guard.observe(acting, position, position + step)
        taken = (position + step) - position
        position += step
        energy += acting * taken
        allowed += max(acting * (taken - last), 0.0)
        # Forgetting credit only ever makes the guard stricter than the true energy.
        assert guard.energy >= energy - 1e-9
        assert energy <= allowed + 1e-9  # 80 sums of terms up to 0.25 J
        acting = guard.control(law)
        last = taken


# -- in the loop
# --------------------------------------------------------------------------------------------------


def scene(
    guard: PassivityParameters | None,
    mass: float = 0.1,
    next_tick: bool = False,
    resolution: float | None = None,
    latency: float = 0.0,
) -> Scene:
    device = DeviceModel(
        mass=mass,
        damping=1.0,
        gravity=9.81,
        position=0.01,
        resolution=resolution,
        delay=latency,
    )
    return Scene(
        device=device,
        surface=SceneSurface("plane"),
        period=T,
        raw=False,
        clamp=True,
        next_tick=next_tick,
        passivity=guard,
    )


def given_out(trace: Trace, delay: float = 0.0) -> Any:
    """Return the energy given out until each sample [J], from forces and positions alone."""
    whole, part = int(delay), delay - int(delay)
    late = np.concatenate((np.zeros(whole + 1), trace.force))
    acting = (
        late[1 : len(trace.force)]
        if part == 0.0
        else part * late[: len(trace.force) - 1]
        + (1.0 - part) * late[1 : len(trace.force)]
    )
    return np.concatenate(([0.0], np.cumsum(acting * np.diff(trace.measured))))


@given(
    ratio=st.floats(0.1, 0.5),
    damping=st.floats(0.0, 5.0),
    mass=st.floats(0.05, 0.5),
    credit=st.booleans(),
)
def test_a_dropped_mass_never_gains_more_than_one_tick_allows(
    ratio: float, damping: float, mass: float, credit: bool
) -> None:
    stiffness = ratio * mass / T**2
    guard = PassivityParameters(stiffness=stiffness if credit else None)
    trace = run(
        scene(guard, mass), PD(stiffness=stiffness, damping=damping).compile(T), 1500
    )
    energy = given_out(trace)
    force = trace.force[:-1]
    step = np.diff(trace.measured, prepend=trace.measured[0])
    allowed = (
        np.maximum(energy[:-1], 0.0)
        + force * np.diff(trace.measured)
        - force * step[:-1]
    )
    assert np.all(energy[1:] <= allowed + 1e-12)  # sums of some 1e-3 J over 1500 ticks
    # The mass has what it fell with, and what was given out: it cannot fly higher than that.
    most = 0.01 + max(float(energy.max()), 0.0) / (mass * 9.81)
    assert trace.position.max() <= most * (1.0 + 1e-9)


@pytest.mark.parametrize("next_tick", [False, True])
def test_an_unstable_wall_throws_the_mass_up_without_the_guard_and_lets_it_lie_with_it(
    next_tick: bool,
) -> None:
    law = PD(stiffness=2000.0 if next_tick else 5000.0, damping=3.0).compile(T)
    wild = run(scene(None, next_tick=next_tick), law, 3000)
    calm = run(scene(ON, next_tick=next_tick), law, 3000)
    lively = float(np.ptp(wild.position[-500:]))
    quiet = float(np.ptp(calm.position[-500:]))
    # it goes on giving: 119 mJ after 6 s here, 40 mJ per second
    assert given_out(wild, next_tick).max() > 0.1
    assert given_out(calm, next_tick).max() < 0.006
    assert lively > 2e-3
    assert quiet < 0.1 * lively
    assert calm.position[-500:].max() < 0.0  # it lies on the floor
    # What carries the weight is still the wall.
    assert calm.force[-1000:].mean() == pytest.approx(0.981, rel=0.03)


def test_a_device_that_is_late_is_guarded_as_one() -> None:
    """THEORY.md §6: with a latency, an account without it sees a tenth of the energy."""
    law = PD(stiffness=3000.0, damping=3.0).compile(T)
    wild, calm = (
        run(scene(None, latency=1.0), law, 1500),
        run(scene(ON, latency=1.0), law, 1500),
    )
    assert given_out(wild, 1.0).max() > 0.5
    # Falsely reassuring: the same run, forces taken to act when they are handed over.
    assert given_out(wild, 0.0).max() < 0.1
    assert given_out(calm, 1.0).max() < 0.01
    assert (
        float(np.ptp(calm.position[-500:]))
        < 0.5e-3
        < 20e-3
        < float(np.ptp(wild.position[-500:]))
    )


@pytest.mark.parametrize("latency", [0.0, 0.25, 1.0, 2.75])
def test_what_goes_through_a_line_comes_out_late_and_whole(latency: float) -> None:
    line, part = line_of(latency)
    handed = [1.0, 5.0, -2.0, 4.0, 0.0, 0.0, 0.0, 0.0]
    acted = []
    for force in handed:
        acted.append(through(line, force, part))
        # All that was handed over has acted or is on its way.
        assert sum(acted) + backlog(line, part) == pytest.approx(
            sum(handed[: len(acted)]), abs=1e-15
        )
    whole, part = int(latency), latency - int(latency)
    expected = np.convolve(handed, [*[0.0] * whole, 1.0 - part, part])[: len(handed)]
    assert acted == pytest.approx(expected, abs=1e-15)


def guarded_along_a_line(axes: tuple[int, ...], direction: Any, normal: Any) -> Any:
    """Return the forces [N] of a late spring to 0 that a guarded device moves along a line."""
    s = state_of(axes, latency=1.5)
    # So much is taken back that the account is near zero, where forces under way decide.
    set_guard(s, PassivityParameters(damping=20.0, allowance=2e-3))
    s.normal[:] = normal
    given = []
    for place in (5e-3 * np.sin(0.4 * np.arange(120))).tolist():
        s.place[:] = place * direction
        if sample(s, 0.0):
            count_step(s)
        s.wanted[:] = -800.0 * place * direction
        guarded(s, 0.25)
        s.handed[:] = s.mean[:] = s.wanted[:]
        given.append(float(np.dot(s.wanted[:], direction)))
        act(s, 1)
    assert min(s.lowered, s.raised) > 5
    return given


def test_a_guard_counts_the_forces_that_are_on_their_way_along_its_own_axis() -> None:
    one, *others = (
        guarded_along_a_line((i,), np.eye(3)[i], np.zeros(3)) for i in range(3)
    )
    assert others == [one, one]


@pytest.mark.parametrize("direction", [*np.eye(3), [0.6, 0.0, 0.8], [-0.48, 0.6, 0.64]])
def test_along_the_normal_a_guard_in_space_is_that_of_one_axis(direction: Any) -> None:
    """Account, step and forces under way along a line in space are those of one axis."""
    line = np.array(direction)
    one = guarded_along_a_line((0,), np.eye(3)[0], np.zeros(3))
    # Products of three components each, over 120 ticks of some newtons.
    assert guarded_along_a_line((0, 1, 2), line, line) == pytest.approx(one, abs=1e-12)


def test_ticks_that_were_left_out_go_through_the_line_too() -> None:
    one, held = state_of(latency=1.5), state_of(latency=1.5)
    ticks = []
    for s, at_once in ((one, 1), (held, 4)):
        sample(s, 0.0)
        for _ in range(4 // at_once):
            s.mean[0] = 3.0
            act(s, at_once)
            sample(s, 0.0)
            ticks.append(s.acted[0])
    assert ticks[4] == pytest.approx(sum(ticks[:4]) / 4.0)
    assert list(one.kept[1]) == list(held.kept[1])


def test_a_wall_that_is_stable_is_not_touched() -> None:
    law = PD(stiffness=1000.0, damping=3.0).compile(T)
    free, guarded = run(scene(None), law, 2000), run(scene(ON), law, 2000)
    assert np.array_equal(free.force, guarded.force)
    assert np.array_equal(free.position, guarded.position)


def test_guarded_runs_compiled_and_interpreted_give_the_same_bits() -> None:
    guard = PassivityParameters(stiffness=5000.0, damping=10.0)
    law = PD(stiffness=5000.0, damping=3.0).compile(T)
    for next_tick in (False, True):
        place = scene(guard, next_tick=next_tick, resolution=2.3e-5)
        a, b = run(place, law, 500), run(place, law, 500, interpreted=True)
        assert np.array_equal(a.force, b.force)
        assert np.array_equal(a.position, b.position)


def test_credit_of_dissipated_energy_does_not_feed_an_instability() -> None:
    # A mass on a two-sided coupling: a second of damping gives credit; then the law is swapped for
    # one that pumps.
    from nodes.laws import CompiledLaw
    from sim.play.one_axis import PlannedSwap

    # It starts with a velocity, not deflected: before tick 0 nothing is in store.
    device = DeviceModel(mass=0.1, damping=0.0, velocity=1.0)
    calm = PD(stiffness=500.0, damping=1.0).compile(T)
    pump = CompiledLaw((500.0 - 1.0 / T, 1.0 / T))  # negative damping
    worst = {}
    for name, guard in {
        "none": None,
        "plain": PassivityParameters(),
        "spring": PassivityParameters(stiffness=500.0),
    }.items():
        place = Scene(
            device=device,
            surface=SceneSurface("anchor"),
            period=T,
            raw=False,
            clamp=False,
            passivity=guard,
        )
        trace = run(place, calm, 1500, [PlannedSwap(250, pump)])
        worst[name] = float(np.abs(trace.position[250:]).max())
    assert worst["none"] > 1e3
    # The plain observer hands the 50 mJ of the first half second back, which is 14 mm of this
    # spring and a little more; with no more in store than the spring holds, the motion that was
    # left at the swap stays what it was.
    assert 10e-3 < worst["plain"] < 20e-3
    assert worst["spring"] < 4e-3


# -- four processes
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.parametrize(
    ("apply", "latency"),
    [
        *(
            pytest.param("on_arrival", latency, marks=pytest.mark.slow)
            for latency in (0.0, 1.0)
        ),
        ("next_tick", 0.3),
    ],
)
def test_lockstep_equals_one_process_and_publishes_its_energy(
    tmp_path: Path, apply: str, latency: float
) -> None:
    words = {
        "pace": "lockstep",
        "duration": 0.6,
        "apply": apply,
        "height": 0.002,
        "latency": latency,
    }
    figures = launch_json(
        tmp_path,
        "floor_guarded",
        *(f"{name}:={value}" for name, value in words.items()),
    )
    recording = Recording(tmp_path / figures["recording"])
    state = recording.arrays("/device/state")
    trace = play(launch_file.read("floor_guarded", words)).along()
    assert np.array_equal(state["position"][:-1, 2], trace.measured)
    assert np.array_equal(state["force"][1:, 2], trace.force)
    energy = given_out(trace, latency + (apply == "next_tick"))
    # Whole ticks: the very sum. A fraction is taken as its share of an even motion, in another
    # order of two additions.
    assert state["energy"][:-1] == pytest.approx(
        energy, rel=0.0, abs=0.0 if latency % 1.0 == 0.0 else 1e-12
    )
    assert figures["energy_max_j"] == max(energy.max(), state["energy"][-1])
    assert figures["guard"]["lowered"] > 0
    assert state["guard"].any()
    assert np.all(state["guard"] >= state["energy"] - 1e-15)


@pytest.mark.slow
def test_study_guard_answers_with_what_it_costs(tmp_path: Path) -> None:
    words = "--json --points 2 --low 1000 --high 8000 --duration 6 --out ."
    done = haptic(tmp_path, "study", "guard", *words.split())
    figures = json.loads(done.stdout.splitlines()[-1])
    soft, soft_guarded, stiff, stiff_guarded = figures["drops"]
    # Below K_max the guard changes nothing but the way to rest; both walls are felt as K.
    assert soft["felt_n_per_m"] == pytest.approx(1000.0, rel=1e-6)
    assert soft_guarded["felt_n_per_m"] == pytest.approx(1000.0, rel=1e-6)
    # Above it the mass never lies still without the guard; with it, it falls no deeper than g T²
    # between two pushes.
    assert stiff["felt_n_per_m"] is None
    assert stiff["energy_max_j"] > 0.05
    assert stiff_guarded["energy_max_j"] < 2e-3
    assert stiff_guarded["unrest_m"] <= 1.1 * 9.81 * T**2
    assert 0.5 < stiff_guarded["felt_n_per_m"] / 8000.0 < 0.6
    assert (tmp_path / "guard.png").stat().st_size > 10_000


@pytest.mark.parametrize("law", ["pd", "pd_alpha", "multi_term"])
@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
def test_a_beginning_in_contact_comes_by_the_ramp_under_a_guard_too(
    law: str, apply: str
) -> None:
    """The force that the guard removed returned at once: 15.7 N instead of 3.2 N."""
    launch = launch_file.read(
        "floor_drop", {"law": law, "height": -0.02, "duration": 0.5, "apply": apply}
    )
    driver = launch.nodes["driver"]
    parameters = {**driver.parameters, "passivity": {"stiffness": 1000.0}}
    watched = msgspec.structs.replace(driver, parameters=parameters)
    bare = play(launch, ticks=250).force[:, 2]
    force = play(
        msgspec.structs.replace(launch, nodes={**launch.nodes, "driver": watched}),
        ticks=250,
    ).force[:, 2]
    # 20 N asked at first, over a ramp of 75 ticks in the driver and one in the coupling: no rise is
    # steeper than one of them.
    assert np.diff(force).max() < 2.0 * 20.0 / 75.0
    assert force.max() < 1.1 * bare.max()
