"""The drill: its judgement on constructed runs at the limit, and some real faults."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from messages.types import DeviceState
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import SafetyParameters, lower
from nodes.launcher import launch_file
from nodes.launcher.runs import alive
from nodes.parameters.store import convert
from sim.device.driver import SimDevice, SimDriverParameters
from sim.drill import devices, drill, intruders, people
from sim.drill.faults import faults
from sim.drill.witness import UNEXPLAINED, largest
from sim.measure.haptic_commands import MeasurementError, within
from sim.measure.rig import Rig
from tests.support import slowly
from tests.support.devices import real_devices
from tests.support.launching import HAPTIC, typed_in, wait_for
from tests.support.setups import setup_of

HELD = (0.0, 0.0, 1.0)


def state(
    seq: int,
    force_seq: int,
    z: float = 1.0,
    safety: str = "active",
    energy: float = 0.0,
) -> DeviceState:
    return DeviceState(
        seq=seq,
        stamp=0.0,
        position=(0.0, 0.0, 0.0),
        force=(0.0, 0.0, z),
        force_seq=force_seq,
        safety=safety,
        energy=energy,
    )


# -- the judgement
# --------------------------------------------------------------------------------------------------


def test_fresh_forces_are_safe_at_any_age() -> None:
    assert drill.time_to_safe([state(k, k - 1) for k in range(10)], 25) == 0
    assert drill.time_to_safe([state(k, k - 4) for k in range(4, 14)], 25) == 0
    assert drill.time_to_safe([], 25) == 0


def test_time_to_safe_runs_from_the_last_fresh_force_to_zero() -> None:
    # The force of tick 1 is told by state 2; it is held, then damped, and state 14 tells zero.
    run = [
        state(1, 0),
        state(2, 1),
        *(state(k, 1) for k in range(3, 12)),
        state(12, 1, 0.1, "damping"),
    ]
    run += [
        state(13, 1, 0.1, "damping"),
        state(14, 1, 0.0, "zero"),
        state(15, 1, 0.0, "zero"),
    ]
    assert drill.time_to_safe(run, 25) == 11


def test_a_driver_that_hangs_is_safe_when_the_device_lets_go() -> None:
    run = [state(1, 0), state(2, 1), state(202, 1, 0.0, "zero")]
    assert drill.time_to_safe(run, 25) == 25
    assert drill.time_to_safe(run, 1000) == 200
    # Nobody renewed the force while it was held, so that the device's time runs from the last fresh
    # one.
    run = [
        state(1, 0),
        state(2, 1),
        *(state(k, 1) for k in range(3, 11)),
        state(110, 1, 0.0, "zero"),
    ]
    assert drill.time_to_safe(run, 25) == 25
    # No force, no danger.
    assert drill.time_to_safe([state(1, 0, 0.0), state(200, 0, 0.0)], 25) == 0


def test_ticks_that_a_damping_driver_slept_through_are_the_device_s() -> None:
    # Held from 2 on, damped from 12, away from 19 to 33: the device would hold that force until 44.
    run = [
        state(1, 0),
        *(state(k, 1) for k in range(2, 12)),
        *(state(k, 1, 0.1, "damping") for k in range(12, 20)),
    ]
    run += [state(33, 1, 0.0, "zero")]
    assert drill.time_to_safe(run, 25) == 31
    assert drill.driven_to_safe(run, 25) == 31 - 13
    # No excuse for a driver that was there, nor for one that left an active force.
    late = [*run[:-1], *(state(k, 1, 0.1, "damping") for k in range(20, 33)), run[-1]]
    assert drill.driven_to_safe(late, 25) == drill.time_to_safe(late, 25) == 30
    left = [state(1, 0), state(2, 1), state(202, 1, 0.0, "zero")]
    assert drill.driven_to_safe(left, 25) == 25


def test_ticks_after_a_ramp_are_the_device_s_too() -> None:
    # Answered in 1 last, up by the ramp without answers until 10, away until 32: the device would
    # hold that force until 35.
    ramp = [
        state(1, 0, 0.1, "ramp"),
        *(state(k, 1, 0.1 * k, "ramp") for k in range(2, 11)),
    ]
    run = [*ramp, state(32, 1, 1.0, "zero"), state(33, 1, 0.0, "zero")]
    assert drill.time_to_safe(run, 25) == 30
    assert drill.driven_to_safe(run, 25) == 30 - 21
    # A force that stayed the same is the one that was answered: no excuse.
    held = [
        state(1, 0),
        *(state(k, 1) for k in range(2, 11)),
        state(32, 1, 0.0, "zero"),
    ]
    assert drill.driven_to_safe(held, 25) == 25


def test_energy_goes_on_through_a_respawned_driver() -> None:
    run = [
        state(1, 0, energy=0.5),
        state(2, 1, energy=0.7),
        state(9, -1, 0.0, energy=0.0),
        state(10, 9, energy=0.3),
    ]
    assert drill.energy_given_out(run) == pytest.approx(0.5)
    assert (
        drill.energy_given_out([state(1, 0, energy=0.5), state(2, 1, energy=0.4)])
        == 0.0
    )


def test_damping_may_not_be_stronger_than_a_damper() -> None:
    # 2 mm in ten lost ticks are 0.1 m/s: 0.05 N of 0.5 N s/m. By one period they would be 1 m/s.
    def moved(seq: int, x: float, z: float) -> DeviceState:
        held = state(seq, 1, z, "damping")
        return DeviceState(
            seq=seq,
            stamp=0.0,
            position=(0.0, 0.0, x),
            force=held.force,
            force_seq=1,
            safety="damping",
        )

    right = 0.002 / (10 / drill.RATE) * drill.DAMPING
    for force, excess in ((right, 0.0), (10.0 * right, 9.0 * right)):
        run = [moved(5, 0.0, 0.0), moved(15, 0.002, 0.0), moved(16, 0.002, -force)]
        # the factor on the allowed force
        assert drill.overdamped(run) == pytest.approx(excess, abs=1e-9)
    # A larger force on its way down is none of damping's.
    assert (
        drill.overdamped([moved(5, 0.0, 3.0), moved(6, 0.0, 2.0), moved(7, 0.0, 1.0)])
        == 0.0
    )


def test_a_cause_is_what_was_counted_for_long_enough() -> None:
    def look(
        waited: float, ran: float, stolen: float
    ) -> dict[tuple[str, int, str], float]:
        return {
            ("coupling", 7, "waited"): waited,
            ("driver", 6, "computed"): ran,
            ("the machine", 0, "stolen"): stolen,
        }

    # A quarter of 2 ms is enough, a little less is not; computing counts beyond half of the time.
    assert (
        largest(look(0.0, 0.0, 0.0), look(0.0005, 0.0, 0.0), 0.01, 0.002)
        == "coupling waited"
    )
    assert (
        largest(look(0.0, 0.0, 0.0), look(0.00049, 0.0049, 0.0), 0.01, 0.002)
        == UNEXPLAINED
    )
    assert (
        largest(look(0.0, 0.0, 0.0), look(0.0005, 0.008, 0.0), 0.01, 0.002)
        == "driver computed"
    )
    # A respawned node's counts begin anew: another process.
    assert largest({}, look(1.0, 1.0, 1.0), 0.01, 0.002) == UNEXPLAINED


def _sunk(first: int, shares: Sequence[float], given: float = 0.0) -> list[DeviceState]:
    """Return states of a hand 20 mm deep: a force, none, then shares of the peak; energy [J]."""
    told = [
        (0.2, "active", 0.0),
        (0.0, "zero", 0.0),
        *((share, "ramp", given) for share in shares),
    ]
    return [
        DeviceState(
            seq=seq,
            stamp=0.0,
            position=(0.0, 0.0, -0.02),
            force=(0.0, 0.0, people.PEAK * share),
            force_seq=seq,
            safety=safety,
            energy=energy,
        )
        for seq, (share, safety, energy) in enumerate(told, first)
    ]


def test_a_force_that_comes_back_keeps_its_ramp_and_throws_nobody() -> None:
    ramp = round(SafetyParameters().recovery * drill.RATE)
    shares = [(n + 1) / ramp for n in range(ramp)]
    right, later = _sunk(0, shares), 10 * ramp
    assert people.thrown([*right, *_sunk(later, shares)]) == []
    assert people.thrown(right) == ["the force came back 1 times, not twice"]
    assert (
        "1 ticks after none"
        in people.thrown([*right, *_sunk(later, [1.01 / ramp, *shares[1:]])])[0]
    )
    # 9 N over 20 mm, the damping of the way and the speed at its end: 0.217 J.
    assert people.thrown([*right, *_sunk(later, [0.0], 0.215)]) == []
    assert (
        "the return needs 217 mJ"
        in people.thrown([*right, *_sunk(later, [0.0], 0.22)])[0]
    )


def test_a_push_that_nobody_asked_for_is_seen() -> None:
    assert (
        people.unasked([state(1, 0, 1.7), state(2, 1, 1.75), state(3, 2, 1.62)]) == []
    )
    assert people.unasked([state(1, 0, 1.7), state(2, 1, 1.0)]) != []
    # Right after a gap of the machine's the hand is still on its way.
    late = [
        state(1, 0, 1.7),
        state(2, 1, 0.0, "zero"),
        *(state(k, k - 1, 1.0) for k in range(3, 4 + people.SETTLED)),
    ]
    assert people.unasked(late[:-1]) == []
    assert people.unasked(late) != []


def test_recovery_needs_calm() -> None:
    run = [state(k, k - 1) for k in range(drill.CALM)]
    assert drill.in_order(run)
    assert not drill.in_order(run[1:])
    assert not drill.in_order([*run, state(drill.CALM, drill.CALM - 1, safety="ramp")])
    assert not drill.in_order(
        [*run[:10], *(state(k, 9) for k in range(10, 10 + drill.CALM))]
    )


def test_the_limit_is_that_of_the_drill_s_own_safety(tmp_path: Path) -> None:
    path = tmp_path / "drill.yaml"
    path.write_text(json.dumps(drill.scene()))
    launch = launch_file.read(str(path), {})
    parameters = convert(
        launch.nodes["driver"].parameters, SimDriverParameters, "driver"
    )
    limits = lower(parameters.safety, DeviceLimits(), launch.run.period)
    assert limits.peak is not None
    assert limits.slew is not None
    down = limits.peak / limits.slew
    hold = parameters.hold / launch.run.period
    assert max(limits.watchdog + limits.damping_ticks + down, hold) + 2 <= drill.LIMIT


class Unmoved:
    """A rig on which nothing that is done to it shows."""

    states = (state(1, 0),)

    def __init__(self, folder: Path) -> None:
        self.folder = self.runtime_dir = folder
        self.errors = ""

    def call(self, *_: str, **__: Any) -> dict[str, int]:
        """Count the same at any time."""
        return dict.fromkeys(("skipped", "refused", "received", "ticks", "pid"), 3)

    def let_pass(self, _: float) -> None:
        """Return at once."""

    def pid(self, _: str) -> int:
        """Name a process that nothing happens to."""
        return os.getpid()


@pytest.mark.parametrize(
    "name",
    [
        *(
            "flood",
            "dead link",
            "lossy link",
            "slow link",
            "reordering link",
            "garbage",
            "oversize message",
        ),
        *(
            "hung device",
            "driver exits",
            "huge position",
            "slow logger",
            "stopped reaper",
        ),
    ],
)
def test_a_fault_that_does_not_show_has_not_struck(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drill that passes because nothing was done to the launch would prove nothing."""
    monkeypatch.setattr(drill, "within", lambda condition, _: condition())
    rig: Any = Unmoved(tmp_path)
    with pytest.raises(MeasurementError, match="not struck: "):
        next(fault for fault in faults() if fault.name == name).strike(rig)


# -- the device's own deadline
# ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hold", "let_go"), [(0.02, 10), (None, None)])
def test_the_virtual_device_lets_go_after_its_deadline(
    hold: float | None, let_go: int | None
) -> None:
    period = 0.002
    setup = setup_of(period=period)
    model = convert(
        {"device": {"mass": 1.0, "damping": 0.0}}, SimDriverParameters, "driver"
    ).device
    device = SimDevice(model, setup, hold)
    device.read_position(0)
    device.write_force(HELD, 0, 0.0)
    speeds = []
    last = 0.0
    for seq in range(1, 21):
        position = device.read_position(seq)[2]
        speeds.append((position - last) / period)
        last = position
    # 1 N on 1 kg: the speed grows by T each tick as long as the force acts.
    grows = [k for k in range(1, 20) if speeds[k] - speeds[k - 1] > 0.5 * period]
    assert grows == list(range(1, 20 if let_go is None else let_go))


# -- on real processes
# ------------------------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.smoke("kill coupling")
@pytest.mark.parametrize(
    "name",
    [
        "kill coupling",
        "stop driver",
        *slowly(["dead link", "ticks lost by quota", "killed in start-up"]),
    ],
)
def test_faults_end_safe_recover_and_leave_nothing(name: str) -> None:
    fault = next(fault for fault in faults() if fault.name == name)
    outcome = drill.drill(fault)
    if outcome.skipped:
        pytest.skip(outcome.skipped)
    assert outcome.passed, outcome.reasons
    assert outcome.left == []
    assert outcome.safe_ticks <= drill.LIMIT
    assert outcome.recovered
    assert name == "killed in start-up" or outcome.lost_ticks > drill.WATCHDOG


@pytest.mark.process
@pytest.mark.parametrize(
    "name",
    [
        *("driver exits", "hand sinks in"),
        *slowly(
            [
                "oversize message",
                "impostor",
                "fd exhaustion",
                "stopped reaper",
                "revoked key",
                "unruly listeners",
                "slow logger",
                "tune ended",
                "pressed device",
                "verb suspended",
            ]
        ),
    ],
)
def test_intruders_libraries_and_people_do_no_harm_and_the_loop_goes_on(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # tests/messages/transport/test_gate.py comes some hundred times to each kind of socket; here it
    # is a whole launch's.
    monkeypatch.setattr(intruders, "VISITS", 60)
    outcome = drill.drill(next(fault for fault in faults() if fault.name == name))
    assert outcome.passed, outcome.reasons
    assert outcome.left == []


@pytest.mark.process
@pytest.mark.parametrize(
    "name",
    [
        "Inverse3 service dies",
        *slowly(
            [
                "Touch swapped",
                "Force Dimension read fails",
                "Touch read blocks",
                "Force Dimension unplugged",
                "Inverse3 read fails",
                "Inverse3 answers twice",
            ]
        ),
    ],
)
def test_faults_of_real_devices_leave_no_force_on_the_arm(name: str) -> None:
    outcome = drill.drill(next(fault for fault in faults() if fault.name == name))
    assert outcome.passed, outcome.reasons
    assert outcome.lost_ticks > drill.WATCHDOG


@pytest.mark.process
def test_a_force_that_stays_on_an_arm_fails_the_drill(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stand = devices.StandIn(devices.KINDS[1])

    def strike(rig: Rig) -> None:
        # Nobody unplugs it: the wall goes on pushing.
        monkeypatch.setattr(devices, "FORCE_TIMEOUT", 0.2)
        stand.force_ends()
        assert rig.states

    outcome = drill.drill(drill.fault_of(stand, "held", "nothing", strike))
    assert not outcome.passed
    assert any("the arm had a force for" in reason for reason in outcome.reasons)


def test_every_real_device_is_drilled() -> None:
    assert {kind.kind for kind in devices.KINDS} == set(real_devices())


@pytest.mark.process
def test_a_launch_that_does_not_recover_fails_the_drill() -> None:
    def strike(rig: Rig) -> None:
        rig.call("link", "param.set", values={"drop": 1.0})
        within(lambda: rig.states[-1].safety == "zero", 10.0)
        rig.process.terminate()
        rig.process.wait(20.0)

    def change(content: dict[str, Any]) -> None:
        content["nodes"]["link"] = {"kind": "link"}

    broken = drill.Fault(
        name="ended",
        what="the launcher is ended half-way",
        strike=strike,
        change=change,
    )
    outcome = drill.drill(broken, timeout=0.2)
    assert not outcome.passed
    assert not outcome.recovered
    assert outcome.safe_ticks <= drill.LIMIT
    assert any("not recovered" in reason for reason in outcome.reasons)


@pytest.mark.process
def test_verb_lists_refuses_and_answers(tmp_path: Path) -> None:
    listed = json.loads(typed_in(tmp_path, "drill", "--list", "--json").stdout)[
        "faults"
    ]
    assert {
        "kill driver",
        "flood",
        "clock step",
        "starvation",
        "blocked stderr",
        "hung device",
    } <= set(listed)
    refused = typed_in(tmp_path, "drill", "earthquake", code=2)
    assert "no fault is named 'earthquake'" in refused.stderr
    figures = json.loads(
        typed_in(tmp_path, "drill", "full disk", "--json").stdout.splitlines()[-1]
    )
    assert figures["passed"] is True
    assert (
        figures["drills"][0]["skipped"]
        or figures["drills"][0]["safe_ticks"] <= figures["limit_ticks"]
    )


@pytest.mark.process
@pytest.mark.parametrize(
    "number", slowly([signal.SIGTERM, signal.SIGKILL], but=[signal.SIGKILL])
)
def test_a_drill_that_is_ended_itself_leaves_no_launch_behind(
    tmp_path: Path, number: signal.Signals
) -> None:
    drilling = subprocess.Popen(
        [*HAPTIC, "drill", "soak"], cwd=tmp_path, stderr=subprocess.DEVNULL
    )

    def children(parents: set[int]) -> set[int]:
        found = set()
        for path in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                if int(path.read_text().rsplit(")", 1)[1].split()[1]) in parents:
                    found.add(int(path.parent.name))
        return found

    try:
        # The drill's child is the launcher; the launcher's are the reaper and four nodes.
        launcher = wait_for(lambda: children({drilling.pid}), "the launcher starts")
        nodes = wait_for(
            lambda: found if len(found := children(launcher)) >= 5 else None,
            "nodes start",
        )
        folder = Path(f"/proc/{min(launcher)}/cwd").resolve()
        drilling.send_signal(number)
        drilling.wait()
        wait_for(
            lambda: not any(map(alive, launcher | nodes)),
            "launcher, reaper and nodes end",
        )
        # What was killed cannot tidy up its own working folder; the sockets in it are gone all the
        # same.
        assert folder.exists() == (number == signal.SIGKILL)
        assert not list(folder.glob("run/runs/*"))
        shutil.rmtree(folder, ignore_errors=True)
    finally:
        drilling.kill()
        drilling.wait()
