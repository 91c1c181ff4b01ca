"""Identification: devices with known parameters, and runs without information."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.special import bdtr

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.recording.writer import RecordWriter
from sim.arrays import Array
from sim.device.friction import slide
from sim.device.hand import Hand
from sim.device.model import DeviceModel, coefficients
from sim.device.state import VirtualDevice, device_part
from sim.identify.conclude import _delays
from sim.identify.experiment import Experiment, encoder, lockstep, read
from sim.identify.identified import Estimate
from sim.identify.identified_motion import window
from sim.identify.identify import identify
from sim.lab.monte_carlo.virtual import draw, excite
from tests.support.launching import launch_json, typed_in
from tests.support.one_process import recorded
from tests.support.recorded import PUBLISHES, drop

T = 0.002
ROUNDING = 1.0 / math.sqrt(12.0)
"""Residual of an encoder's rounding alone [steps]."""


def holds(estimate: Estimate, truth: float) -> bool:
    _, low, high = estimate.known()
    return low <= truth <= high


@pytest.mark.parametrize("delay", [0.0, 1.0, 1.37])
def test_a_known_device_comes_back(delay: float) -> None:
    """Differences give 0.059 kg here; sub-stepped friction is 6 % off."""
    truth = DeviceModel(
        mass=0.1, damping=1.0, friction=0.03, delay=delay, resolution=23e-6
    )
    found = identify(excite(truth, T, 8.0, seed=1))
    # 0.1 %, 1 %, 2 %: ten times the errors that 4000 ticks of 23 µm leave; a systematic error of
    # method is larger.
    assert found.mass.value == pytest.approx(0.1, rel=1e-3)
    assert found.damping.value == pytest.approx(1.0, rel=1e-2)
    assert found.friction.value == pytest.approx(0.03, rel=2e-2)
    assert found.delay.value == pytest.approx(delay, abs=0.01)
    # The loop itself answers at once, always: the range is what is not known of the device.
    assert found.delay_range == pytest.approx(found.delay.known()[1:], abs=1e-12)
    assert found.encoder.value == pytest.approx(23e-6, rel=1e-9)
    assert not found.held
    assert found.steps(found.residual) == pytest.approx(ROUNDING, rel=0.05)
    assert found.steps(found.held_out) == pytest.approx(ROUNDING, rel=0.10)


def test_what_joint_would_not_show_is_told_with_its_frequency() -> None:
    """A joint with a quarter of the mass is excluded up to the frequency that is told."""
    truth = DeviceModel(
        mass=0.1, damping=1.0, friction=0.03, delay=1.2, resolution=23e-6
    )
    found = identify(excite(truth, T, 2.6, seed=1)).frequency
    assert found.value is None
    assert found.low is not None
    # Above what a push of some seconds resolves, below the Nyquist frequency.
    assert 20.0 < found.low < 0.5 / T
    assert found.why.startswith(f"none seen; one above {found.low:.0f} Hz,")


def test_a_hand_is_found_and_told_apart() -> None:
    hand = Hand(mass=0.1, damping=3.0, stiffness=300.0, path=[(0.0, 0.0)])
    truth = DeviceModel(
        mass=0.045, damping=0.5, friction=0.06, delay=1.2, resolution=23e-6, hand=hand
    )
    found = identify(excite(truth, T, 8.0, seed=2))
    assert found.held
    assert found.stiffness.value == pytest.approx(300.0, rel=1e-2)
    assert found.mass.value == pytest.approx(0.145, rel=1e-2)
    assert found.damping.value == pytest.approx(3.5, rel=2e-2)


@pytest.mark.slow
def test_intervals_hold_the_truth() -> None:
    """12 devices, 60 intervals: at 95 %, fewer than 85 % hold with probability below 1 %."""
    kept = []
    for number in range(12):
        model = draw(number, seed=5, held=number % 2 == 1)
        found = identify(excite(model, T, 8.0, seed=number))
        assert not found.refuted, f"{number}: {found.why}"
        kept += [
            holds(found.mass, model.moving_mass),
            holds(found.damping, model.moving_damping),
            holds(found.friction, model.friction or 0.0),
            holds(found.delay, model.delay),
            holds(found.encoder, model.resolution or 0.0),
        ]
    # The binomial distribution up to 85 % of the fits; scipy.stats takes 0.4 s to load.
    assert bdtr(0.85 * len(kept), len(kept), 0.95) < 0.01
    assert np.mean(kept) >= 0.85


def test_forces_count_from_the_instant_they_take_effect() -> None:
    """Against the driver's own device, forces arriving anywhere in a tick."""
    rng = np.random.default_rng(3)
    model = DeviceModel(mass=0.08, damping=0.7, friction=0.05)
    device = VirtualDevice(model, T)
    offsets, forces = rng.uniform(0.0, 1.0, 300), rng.normal(0.0, 1.0, 300)
    positions, acting = [], 0.0
    for offset, force in zip(offsets.tolist(), forces.tolist(), strict=True):
        positions.append(device.state.x)
        device_part(device.state, acting, offset * T)
        device_part(device.state, force, (1.0 - offset) * T)
        acting = force
    theta = np.array([1.0 / 0.08, 0.7 / 0.08, 0.05 / 0.08, *[0.0] * 9])
    out = np.empty(300)
    window(
        theta,
        np.array([0.0, 0.0, 0.0, 0.0]),
        0,
        300,
        T,
        np.arange(300) + offsets,
        forces,
        out,
    )
    # Rounding of 600 steps of a motion of centimetres.
    assert np.max(np.abs(out - positions)) < 1e-13


@pytest.mark.parametrize("sliver", [3e-12, 9e-11, 2e-10, 3e-10])
def test_a_force_may_take_effect_next_to_a_tick(sliver: float) -> None:
    """Too short a part of a tick for a step of its own, behind a lag: it moves nothing."""
    forces, found = np.random.default_rng(5).normal(0.0, 1.0, 50), []
    forces[0] = 0.0  # the window begins at rest, whichever force is the first
    for delay in (0.0, sliver):
        theta = np.array(
            [24.6, 89.3, 0.68, 0.0, 0.0, delay, 0.0, 1.3, 0.0, 0.0, 0.0, 0.0]
        )
        out = np.empty(50)
        window(theta, np.zeros(4), 0, 50, T, np.arange(50.0), forces, out)
        found.append(out)
    assert np.abs(found[0]).max() > 1e-5
    # The motion is late by the sliver: by less than its largest value for every thousandth tick.
    assert np.abs(found[1] - found[0]).max() < 1e3 * sliver * np.abs(found[0]).max()


def test_a_window_stuck_by_friction_stays() -> None:
    theta = np.array([10.0, 0.0, 1.0, *[0.0] * 9])
    out = np.empty(50)
    window(
        theta,
        np.array([0.01, 0.0, 0.0, 0.0]),
        0,
        50,
        T,
        np.arange(50.0),
        np.full(50, 0.0999),
        out,
    )
    assert set(out.tolist()) == {0.01}
    window(
        theta,
        np.array([0.01, 0.0, 0.0, 0.0]),
        0,
        50,
        T,
        np.arange(50.0),
        np.full(50, 0.1001),
        out,
    )
    # Just outside: the rest of the force moves it.
    x, _ = slide(
        0.01,
        0.0,
        1.001,
        49 * T,
        coefficients(1.0, 0.0, 0.0, 49 * T),
        1.0,
        0.0,
        0.0,
        1.0,
    )
    assert out[-1] == pytest.approx(x, rel=1e-12)
    assert out[-1] > 0.01


@pytest.mark.parametrize("step", [5e-6, 23e-6, 1e-4])
def test_encoder_step_is_read_off_the_grid(step: float) -> None:
    counts = np.random.default_rng(1).integers(-500, 500, 2000)
    found = encoder(np.asarray(counts * step + 0.0123, dtype=np.float64))
    value, low, high = found.known()
    assert value == pytest.approx(step, rel=1e-12)
    assert 0.0 < 0.5 * (high - low) < 1e-9 * step


def test_the_interval_of_a_step_is_twice_the_rounding_over_the_range() -> None:
    """Positions that stray by 1 % of the step, evenly: ± 2 · stray / counts."""
    counts = np.arange(201)
    step = 2.0**-16
    stray = 0.01 * step
    found = encoder(np.asarray(counts * step + stray * (-1.0) ** counts))
    value, low, high = found.known()
    assert value == pytest.approx(step, rel=1e-6)
    # The fitted line takes up the little of an alternation that is like a slope: below 1 %.
    assert 0.5 * (high - low) == pytest.approx(2.0 * stray / 200.0, rel=0.01)


def test_the_delay_of_a_run_has_an_interval_from_a_hundred_answers_on() -> None:
    """Delays of 1 and 2 ticks in turn: the middle between them, and a jitter of one tick."""
    run = lockstep(T, np.zeros(1000), np.zeros(1000))
    delay = np.tile([1.0, 2.0], 50)
    median, shortest, longest, jitter = _delays(replace(run, delay=delay))
    assert (median, shortest, longest, jitter.value) == (1.5, 1.0, 2.0, 1.0)
    assert (jitter.low, jitter.high) == (1.0, 1.0)
    *times, jitter = _delays(replace(run, delay=delay[1:]))
    assert times == [0.0, 0.0, 0.0]
    assert jitter.value is None
    assert jitter.why == "99 ticks were answered, at least 100 are needed"


def test_no_grid_no_step() -> None:
    found = encoder(np.random.default_rng(1).normal(size=2000))
    assert found.value is None
    assert "no regular grid" in found.why
    assert "only 3" in encoder(np.array([0.0, 1e-5, 2e-5] * 100)).why


def flat(force: float, ticks: int = 2000) -> Experiment:
    rng = np.random.default_rng(1)
    position = (
        np.round(np.sin(np.arange(ticks) * 0.01) * 0.01 / 2e-5) * 2e-5
        + 0.0 * rng.normal()
    )
    return lockstep(T, position, np.full(ticks, force))


def test_without_a_changing_force_it_says_so() -> None:
    found = identify(flat(0.5))
    for estimate in (found.mass, found.damping, found.friction, found.delay):
        assert estimate.value is None
        assert "force never changed" in estimate.why
    assert found.encoder.value == pytest.approx(2e-5)


def test_a_motion_that_the_force_does_not_make_is_not_explained_by_it() -> None:
    """A hand moves the device; a tiny unrelated force changes now and then."""
    rng = np.random.default_rng(7)
    ticks = 4000
    hand = np.cumsum(np.cumsum(rng.normal(size=ticks))) * 1e-7
    force = np.repeat(rng.choice([-1e-3, 1e-3], ticks // 20), 20)
    found = identify(lockstep(T, np.round(hand / 2e-5) * 2e-5, force))
    assert found.mass.value is None
    assert found.mass.why
    assert found.friction.value is None


def test_a_short_run_is_refused_with_what_to_do() -> None:
    with pytest.raises(
        ValueError, match=r"11 windows of 100 ticks, at least 12 .* record 1200 ticks"
    ):
        identify(lockstep(T, np.zeros(1199), np.zeros(1199)))


def test_no_window_spans_a_gap() -> None:
    truth = DeviceModel(
        mass=0.1, damping=1.0, friction=0.03, delay=1.0, resolution=23e-6
    )
    whole = excite(truth, T, 8.0, seed=1)
    position = whole.position.copy()
    # What is missing is filled with nonsense that must not be looked at.
    position[1000:1010] = 1.0
    gap = Experiment(
        T, position, ((0, 1000), (1010, 4000)), whole.at, whole.force, whole.delay
    )
    found = identify(gap)
    assert found.mass.value == pytest.approx(0.1, rel=1e-3)


def test_ticks_that_were_slept_through_are_bridged() -> None:
    """20 of every 80 ticks are missing, but the forces held meanwhile are known."""
    truth = DeviceModel(
        mass=0.1, damping=1.0, friction=0.03, delay=1.0, resolution=23e-6
    )
    whole = excite(truth, T, 8.0, seed=1)
    missing = np.arange(len(whole.position)) % 100 >= 80
    # What is filled in there must not be compared with.
    position = np.where(missing, whole.position + 0.01, whole.position)
    found = identify(replace(whole, position=position, unread=missing))
    assert found.mass.value == pytest.approx(0.1, rel=1e-3)
    assert found.encoder.value == pytest.approx(23e-6, rel=1e-9)


def test_a_record_tells_where_an_answer_came_late(tmp_path: Path) -> None:
    """Ticks 100 and 101 keep the force of 99; the driver sleeps from 200 to 209."""
    path = tmp_path / "late.mcap"
    answered = {101: 99, 102: 99}
    with RecordWriter(path, {"rate_hz": "500", "publishes": PUBLISHES}) as writer:
        for topic, message in drop(600):
            if isinstance(message, DeviceState) and not 200 <= message.seq < 210:
                seq = (
                    199
                    if message.seq == 210
                    else answered.get(message.seq, message.force_seq)
                )
                writer.write(
                    topic,
                    msgspec.structs.replace(message, force_seq=seq),
                    message.stamp,
                )
    late = read(path, "z").late
    assert late is not None
    # In 102 the answers of 100 and 101 may have come before its own, which is the one that state
    # 103 tells.
    assert np.flatnonzero(late).tolist() == [102]


def impulse(at: Array, force: Array, ticks: Array) -> Array:
    """Return the integral of held forces until given ticks [N ticks]."""
    total = np.concatenate([[0.0], np.cumsum(force[:-1] * np.diff(at))])
    last = np.searchsorted(at, ticks, "right") - 1
    return np.where(last >= 0, total[last] + force[last] * (ticks - at[last]), 0.0)


@pytest.mark.parametrize("slept", [0, 1, 7])
def test_the_forces_of_a_tick_are_rebuilt_from_its_mean(
    slept: int, tmp_path: Path
) -> None:
    """Every seventh answer comes a tick later, before that tick's own.

    From 300 on the driver sleeps, and states 401 to 405 are not recorded.
    """
    rng = np.random.default_rng(3)
    answered = np.array([k for k in range(600) if not 300 <= k < 300 + slept])
    late = answered % 7 == 3
    at = answered + np.where(late, 1.2, rng.uniform(0.3, 0.9, len(answered)))
    force = rng.uniform(-1.0, 1.0, len(answered))
    sampled = np.concatenate([answered, [600]]).astype(np.float64)
    since = np.concatenate([[-1.0], sampled[:-1]])
    between = np.diff(impulse(at, force, sampled), prepend=0.0)
    with RecordWriter(
        tmp_path / "run.mcap", {"rate_hz": "500", "publishes": PUBLISHES}
    ) as writer:
        for seq, before, given in zip(
            sampled.tolist(), since.tolist(), between.tolist(), strict=True
        ):
            if 400 < seq <= 405:
                continue
            newest, tick = int(np.searchsorted(at, seq, "right")) - 1, int(before)
            state = DeviceState(
                seq=int(seq),
                stamp=seq * T,
                position=(0.0, 0.0, 1e-3 * math.sin(0.1 * seq)),
                force=(0.0, 0.0, float(force[newest]) if newest >= 0 else 0.0),
                mean_force=(0.0, 0.0, given / (seq - before)),
                changed_at=next(
                    (
                        float(one - tick)
                        for one in at[max(newest - 1, 0) : newest + 1]
                        if one > tick
                    ),
                    1.0,
                ),
                force_seq=int(answered[newest]) if newest >= 0 else -1,
                age=tick - int(answered[newest]) if newest >= 0 else 0,
                delay=float(at[newest] - answered[newest]) if newest >= 0 else 0.0,
                overruns=slept if seq >= 300 + slept else 0,
            )
            writer.write(DEVICE_STATE, state, seq * T)
    found = read(tmp_path / "run.mcap", "z")
    # Sums of 600 terms of up to 1, and a mean that is divided by a tenth of a tick at least.
    rebuilt = impulse(found.at, found.force, sampled) - impulse(
        found.at, found.force, since
    )
    recorded = (sampled <= 400) | (sampled > 405)
    assert np.allclose(rebuilt[recorded], between[recorded], rtol=0.0, atol=1e-11)
    # Those that came late too.
    assert found.delay.max() == pytest.approx(1.2, abs=1e-9)
    assert np.count_nonzero(found.delay > 1.0) > 80
    awake = (at < 400) | (at > 406)
    assert np.count_nonzero(late & awake) > 80
    for when, size in zip(at[awake][:-1], force[awake][:-1], strict=True):
        n = int(np.argmin(np.abs(found.at - when)))
        assert (found.at[n], found.force[n]) == pytest.approx((when, size), abs=1e-11)


def test_forces_without_their_mean_are_refused(tmp_path: Path) -> None:
    with RecordWriter(
        tmp_path / "old.mcap", {"rate_hz": "500", "publishes": PUBLISHES}
    ) as writer:
        for topic, message in drop(600):
            told = (
                msgspec.structs.replace(message, mean_force=(0.0, 0.0, 0.0))
                if isinstance(message, DeviceState)
                else message
            )
            writer.write(topic, told, message.stamp)
    with pytest.raises(ValueError, match=r"reports no mean_force.*record it again"):
        read(tmp_path / "old.mcap", "z")


@pytest.mark.process
def test_study_identify_reads_a_launch(tmp_path: Path) -> None:
    run = launch_json(
        tmp_path,
        "identify",
        "pace:=lockstep",
        "apply:=next_tick",
        "delay:=0.4",
        "duration:=5",
    )
    done = typed_in(tmp_path, "study", "identify", run["recording"], "--json")
    figures = json.loads(done.stdout.splitlines()[-1])
    truth = {
        "mass_kg": 0.1,
        "damping_n_s_per_m": 1.0,
        "friction_n": 0.03,
        "delay_ticks": 1.4,
        "device_delay_ticks": 0.4,
        "encoder_m": 2.3e-5,
    }
    for key, value in truth.items():
        # Five times the half width: one run must not fail by the 5 % that 95 % leave.
        half = figures[key]["high"] - figures[key]["low"]
        assert abs(figures[key]["value"] - value) <= 2.5 * half, key
    assert figures["jitter_ticks"]["value"] == 0.0
    assert figures["residual_steps"] == pytest.approx(ROUNDING, rel=0.06)
    assert figures["axis"] == "x"


def test_study_identify_of_a_run_without_force(tmp_path: Path) -> None:
    path = recorded(tmp_path, "free_space", "duration:=3")
    done = typed_in(tmp_path, "study", "identify", str(path), "--json", code=1)
    figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["mass_kg"]["value"] is None
    assert "force never changed" in figures["mass_kg"]["why"]
