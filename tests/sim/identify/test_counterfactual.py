"""Replays reproduce the recording, and predictions what another launch then does."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.launcher import launch_file
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from sim.cli.bag.replay import at_most
from sim.device.hand import Hand, path_position
from sim.device.model import DeviceModel, coefficients
from sim.identify import counterfactual
from sim.identify.counterfactual import _smooth, missing_force, nudges, replay
from sim.identify.experiment import read
from sim.identify.identify import identify
from sim.identify.recorded_scene import another_law, rebuild
from sim.play.given import Given
from sim.play.launched import from_launch
from sim.play.one_axis import run
from tests.support.launching import launch_json, typed_in
from tests.support.one_process import recorded
from tests.support.recorded import rewritten

STEP = 2.3e-5
"""Encoder step of floor_buzz [m]."""


WORDS = ("floor_buzz", "apply:=next_tick")
OTHER = ("law:=pd_alpha", "stiffness:=700")


@pytest.fixture(scope="module")
def buzz(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Record the same drop with two laws, in this process."""
    folder = tmp_path_factory.mktemp("buzz")
    return recorded(folder, *WORDS), recorded(folder, *WORDS, *OTHER, name="other")


@pytest.fixture(scope="module")
def launched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Record the same by launches in lockstep."""
    folder = tmp_path_factory.mktemp("launched")
    pd = launch_json(folder, *WORDS, "pace:=lockstep")["recording"]
    other = launch_json(folder, *WORDS, *OTHER, "pace:=lockstep")["recording"]
    return folder / pd, folder / other


def figures(recording: Path, *words: str) -> dict[str, Any]:
    done = typed_in(recording.parent, "bag", "replay", str(recording), *words, "--json")
    told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return told


def positions(recording: Path) -> list[float]:
    return [state.position[2] for state in Recording(recording).messages(DEVICE_STATE)]


@pytest.mark.process
def test_the_same_law_gives_the_same_bits_and_another_what_a_launch_of_it_does(
    launched: tuple[Path, Path],
) -> None:
    scene = rebuild(launched[0])
    same = replay(scene)
    assert same.measured.tolist() == positions(launched[0])
    law, _ = another_law(scene, {"law": "pd_alpha", "stiffness": 700.0})
    assert replay(scene, law).measured.tolist() == positions(launched[1])


def test_rounding_is_not_told_in_digits() -> None:
    assert [at_most(metres) for metres in (0.0, 3.47e-18, 2.5e-6)] == [
        "0 µm",
        "1e-06 µm",
        "2.5 µm",
    ]


def test_tick_by_tick_is_the_compiled_loop(buzz: tuple[Path, Path]) -> None:
    """Forces at their recorded instants, interpreted: equal to rounding."""
    scene = rebuild(buzz[0])
    assert scene.lockstep
    slow = replay(scene, external=np.zeros(len(scene.position)))
    assert np.max(np.abs(slow.measured - scene.position)) <= 1e-12


def test_an_identified_model_comes_back_tells_its_error_and_predicts_within_it(
    buzz: tuple[Path, Path],
) -> None:
    told = figures(buzz[0], "law:=pd_alpha", "stiffness:=700", "--model", "identified")
    assert told["model"] == "identified"
    # Nudged into the steps that were read the forces are the recorded ones, bit for bit; one step
    # is what is promised.
    assert told["self_error_steps"] <= 1.0
    # A step is the most that a model this close is off between two ticks; no nudge hides a wrong
    # one.
    assert 0 < told["nudges"]["ticks"] < 0.1 * told["ticks"]
    assert told["nudges"]["largest_m"] < STEP
    # Alone, every bounce multiplies what the model is off; some steps are left of a fall of 400.
    assert told["self_error_steps"] < told["model_error_steps"] < 10.0
    truth = np.array(positions(buzz[1]))
    quarter = truth[-(len(truth) // 4) :]
    # The prediction's own error bar, and a step of rounding.
    assert told["predicted"]["rest_m"] == pytest.approx(
        np.mean(quarter), abs=told["model_error_m"] + STEP
    )
    assert told["predicted"]["settled"] is True


def test_a_drop_that_mostly_rests_is_identified_from_its_motion(
    buzz: tuple[Path, Path],
) -> None:
    """Windows at rest fit to the bit; moving ones must not count as spoilt."""
    found = identify(read(buzz[0]))
    assert found.dropped == 0
    for estimate, truth in (
        (found.mass, 0.1),
        (found.damping, 1.0),
        (found.friction, 0.06),
        (found.load, -0.981),
    ):
        _, low, high = estimate.known()
        assert low <= truth <= high
        assert high > low


def undisturbed(folder: Path, *words: str) -> Path:
    """Record a real-time run without late answers, whose history cannot be replayed.

    The fall takes 45 ms, and what matters follows soon after it: half a second is enough, and may
    well be undisturbed.
    """
    for _ in range(16):
        told = launch_json(folder, *words)
        if not told["missed"] and not told["overruns"]:
            break
    return folder / str(told["recording"])


@pytest.mark.slow
def test_a_real_time_recording_is_replayed_on_its_own_delays(tmp_path: Path) -> None:
    told = figures(
        undisturbed(tmp_path, "floor_drop", "duration:=0.5"), "stiffness:=500"
    )
    assert told["lockstep"] is False
    # The fall is 10 mm.
    assert told["self_error_m"] < 1e-3
    assert told["law"]["stiffness"] == 500.0


@pytest.mark.parametrize("delay", [0.0, 1.3])
@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
def test_forces_that_arrive_as_in_lockstep_give_its_run_guard_and_limits_included(
    apply: str, delay: float
) -> None:
    """Each tick's force arrives at once, so only rounding differs."""
    launch = launch_file.read("floor_guarded", {"apply": apply, "pace": "lockstep"})
    played = from_launch(launch)
    device = msgspec.structs.replace(played.scene.device, delay=delay)
    scene = dataclasses.replace(played.scene, device=device, slew=2.0)
    ticks = 1000
    one = run(scene, played.law, ticks, interpreted=True)
    when = np.arange(ticks, dtype=np.float64)
    arrivals = when, np.arange(ticks), np.zeros(ticks)
    other = run(
        scene, played.law, ticks, interpreted=True, given=Given(arrivals=arrivals)
    )
    assert np.max(np.abs(one.force)) > 1.0
    # Rounding of the split grows with the bounces of a hard contact.
    assert np.max(np.abs(one.position - other.position)) < 1e-9
    # A force that never comes: the one before goes on.
    silent = Given(arrivals=(when[:1], np.arange(1), np.zeros(1)))
    held = run(scene, played.law, ticks, interpreted=True, given=silent)
    assert set(held.force) == {held.force[0]}


@pytest.mark.slow
def test_a_guarded_run_in_real_time_comes_back(tmp_path: Path) -> None:
    scene = rebuild(
        undisturbed(tmp_path, "floor_guarded", "apply:=next_tick", "duration:=0.5")
    )
    assert np.max(np.abs(replay(scene).measured - scene.position)) < 1e-3


def test_a_device_at_the_end_of_its_workspace_comes_back(tmp_path: Path) -> None:
    """A floor of 2 N/m lets it reach its end."""
    recording = recorded(tmp_path, "floor_drop", "stiffness:=2", "duration:=1.2")
    scene = rebuild(recording)
    assert scene.left_out == ()
    same = replay(scene)
    assert np.min(same.measured) == same.measured[-1]
    assert same.measured.tolist() == positions(recording)


def test_swaps_are_replayed_from_their_receipts(tmp_path: Path) -> None:
    words = ("floor_swap", "first:=1", "second:=2", "duration:=3")
    recording = recorded(tmp_path, *words)
    scene = rebuild(recording)
    assert len(scene.scene.swaps) == 2
    assert replay(scene).measured.tolist() == positions(recording)


@pytest.mark.slow
def test_the_hand_that_moved_the_device_is_estimated(tmp_path: Path) -> None:
    """The model lacks the hand of wall_press; the missing force is the hand's."""
    recording = (
        tmp_path
        / launch_json(tmp_path, "wall_press", "pace:=lockstep", "duration:=2")[
            "recording"
        ]
    )
    hand = Hand(
        mass=0.1,
        damping=3.0,
        stiffness=300.0,
        path=[(0.2, 0.0), (0.7, 0.03), (2.0, 0.03), (2.5, 0.0)],
    )
    bare = DeviceModel(mass=0.145, damping=3.1)
    scene = rebuild(recording, bare)
    external = missing_force(scene, 1e-7)
    times = np.arange(len(external)) * 0.002
    pull = np.array(
        [hand.stiffness * path_position(hand.path, t) for t in times.tolist()]
    )
    expected = pull - hand.stiffness * scene.position
    middle = slice(50, -50)
    # Its spring pulls with up to 3 N; a smoothed random walk follows corners within a few per cent
    # of that.
    assert np.sqrt(np.mean((external - expected)[middle] ** 2)) < 0.1
    nudged = nudges(scene, external)
    same = replay(scene, None, external, nudged)
    assert np.max(np.abs(same.measured - scene.position)) <= 1e-7
    # A hand whose spring is known gives way to another law as the true one does: what a launch of
    # that law would record.
    law, _ = another_law(scene, {"law": "pd", "stiffness": 400.0})
    spring = rebuild(
        recording,
        DeviceModel(
            mass=0.145, damping=3.1, hand=Hand(stiffness=300.0, path=[(0.0, 0.0)])
        ),
    )
    pulled = missing_force(spring, 1e-7)
    predicted = replay(spring, law, pulled, nudges(spring, pulled))
    truth = replay(rebuild(recording), law)
    assert np.max(np.abs(predicted.measured - truth.measured)) < 1e-5


@pytest.mark.parametrize(
    ("words", "message"),
    [(("law:=nothing",), "nothing"), (("stifness:=3",), "stifness")],
)
def test_what_cannot_be_replayed_is_refused(
    buzz: tuple[Path, Path], words: tuple[str, ...], message: str
) -> None:
    done = typed_in(buzz[0].parent, "bag", "replay", str(buzz[0]), *words, code=2)
    assert message in done.stderr


def test_a_law_that_is_none_is_refused_before_the_scene_is_rebuilt(
    buzz: tuple[Path, Path], tmp_path: Path
) -> None:
    part = tmp_path / "part.mcap"
    typed_in(
        tmp_path,
        "bag",
        "cut",
        str(buzz[0]),
        "--from",
        "0.1",
        "--out",
        str(part),
        code=0,
    )
    # Without its first ticks it cannot be rebuilt at all: who hears of the law has not tried.
    assert (
        "'nope' is not an installed law"
        in typed_in(tmp_path, "bag", "replay", str(part), "law:=nope", code=2).stderr
    )


@pytest.mark.parametrize("missing", [7, 8])
def test_ticks_before_the_driver_slept_are_replayed_where_they_are_enough(
    buzz: tuple[Path, Path], tmp_path: Path, missing: int
) -> None:
    """With five ticks, the drop criterion's error named no recording."""
    slept = rewritten(
        buzz[0], lambda topic, seq: topic != DEVICE_STATE or seq != missing
    )
    if missing >= 8:
        assert len(replay(rebuild(slept)).measured) == missing
        return
    refused = typed_in(tmp_path, "bag", "replay", str(slept), code=1).stderr
    assert (
        f"{slept}: 7 ticks from tick 0 on before one that the driver slept through; a replay"
        " needs 8" in refused
    )


def test_of_two_answers_in_one_tick_both_are_replayed(
    buzz: tuple[Path, Path], tmp_path: Path
) -> None:
    """A late answer, which held until its tick's own came, was ignored."""
    whole, late = Recording(buzz[0]), tmp_path / "late.mcap"
    text, parameters = (
        whole.metadata["launch_file"]["yaml"],
        whole.metadata["parameters"],
    )
    with RecordWriter(
        late, whole.manifest, launch_file=text, parameters=parameters
    ) as writer:
        for entry in whole.entries():
            message = entry.message
            if isinstance(message, DeviceState) and message.seq == 299:
                # Tick 298 had no answer in its own time.
                held = message.force
                message = msgspec.structs.replace(
                    message, force_seq=297, age=1, mean_force=held
                )
            elif isinstance(message, DeviceState) and message.seq == 300:
                # Of tick 299 a quarter as before, half of it 5 N, and the rest its own.
                mean = (0.0, 0.0, 0.25 * held[2] + 0.5 * 5.0 + 0.25 * message.force[2])
                message = msgspec.structs.replace(
                    message, changed_at=0.25, delay=0.75, mean_force=mean
                )
            writer.write(entry.topic, message, entry.log_time)
    scene = rebuild(late)
    first = scene.answers.tolist().index(298)
    assert scene.answers[first + 1] == 299
    assert scene.took[first : first + 2] == pytest.approx([299.25, 299.75])
    # Two roundings of a mean of 5 N.
    assert scene.given[first] == pytest.approx(5.0, abs=1e-14)


def test_nothing_read_from_a_recording_names_a_file(
    buzz: tuple[Path, Path], tmp_path: Path
) -> None:
    """Its scenario was used as a path; a watched file in its launch file was read."""
    precious = tmp_path / "precious.yaml"
    precious.write_text("mine", encoding="utf-8")
    whole = Recording(buzz[0])
    text = whole.metadata["launch_file"]["yaml"]
    watching = text.replace(
        "    kind: coupling\n",
        "    kind: coupling\n    watch: /nonexistent/secret.yaml\n",
    )
    assert watching != text
    manifest = {**whole.manifest, "scenario": str(precious.with_suffix(""))}
    parameters = whole.metadata["parameters"]
    forged = tmp_path / "forged.mcap"
    with RecordWriter(
        forged, manifest, launch_file=watching, parameters=parameters
    ) as writer:
        for entry in whole.entries():
            writer.write(entry.topic, entry.message, entry.log_time)
    assert replay(rebuild(forged)).measured.tolist() == positions(buzz[0])
    assert precious.read_text(encoding="utf-8") == "mine"
    assert set(tmp_path.iterdir()) == {precious, forged}


def test_the_smoother_is_the_conditional_mean_of_the_joint_normal_distribution() -> (
    None
):
    """Its likelihood and its force are those of one large normal distribution, solved densely."""
    ticks, noise, walk = 9, 0.3, 0.2
    step = (1.0, 0.5, 0.0, 0.9, 0.1, 0.4)
    rng = np.random.default_rng(1)
    y, known = rng.normal(size=ticks), rng.normal(size=(ticks, 2))
    a = np.array(
        [[step[0], step[1], step[4]], [step[2], step[3], step[5]], [0.0, 0.0, 1.0]]
    )
    # Mean and covariance of all states, from the first on.
    mean, covariance = [np.array([y[0], 0.0, 0.0])], np.zeros((3 * ticks, 3 * ticks))
    covariance[:3, :3] = np.diag([noise**2, 1.0, 1.0])
    for k in range(1, ticks):
        mean.append(a @ mean[-1] + [*known[k - 1], 0.0])
        now, before = slice(3 * k, 3 * k + 3), slice(3 * k - 3, 3 * k)
        covariance[now, : 3 * k] = a @ covariance[before, : 3 * k]
        covariance[: 3 * k, now] = covariance[now, : 3 * k].T
        covariance[now, now] = a @ covariance[before, before] @ a.T
        covariance[3 * k + 2, 3 * k + 2] += walk**2
    seen = slice(0, None, 3)
    spread = covariance[seen, seen] + noise**2 * np.eye(ticks)
    off = y - np.array(mean)[:, 0]
    likelihood, force = counterfactual._smooth(y, known, step, noise, walk)
    expected = -0.5 * (
        np.linalg.slogdet(spread)[1] + off @ np.linalg.solve(spread, off)
    )
    # Two orders of elimination of a 9 × 9 system of condition below 1e3.
    assert likelihood == pytest.approx(expected, rel=1e-10)
    means = np.array(mean)[:, 2] + covariance[2::3, seen] @ np.linalg.solve(spread, off)
    assert force == pytest.approx(means, rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("walk", [0.03, 1.0])
def test_the_missing_force_is_the_mean_of_all_that_explain_the_positions(
    walk: float,
) -> None:
    """Smoothing tick by tick is conditioning of one Gaussian of all ticks at once."""
    ticks, noise = 25, 3e-4
    step = coefficients(0.1, 2.0, 50.0, 0.02)
    rng = np.random.default_rng(1)
    y, known = 1e-2 * rng.normal(size=ticks), 1e-3 * rng.normal(size=(ticks, 2))
    likelihood, force = _smooth(y, known, step, noise, walk)
    # What is unknown: first position, speed and force, and the steps of the force.
    a11, a12, a21, a22, b1, b2 = step
    unknowns = np.eye(ticks + 2)
    spread = np.diag([noise, 1.0, 1.0, *[walk] * (ticks - 1)]) ** 2
    state, offset = unknowns[:3].copy(), np.array([y[0], 0.0])
    positions, offsets, forces = [], [], []
    for k in range(ticks):
        if k:
            x, v, f = state
            state = np.array(
                [
                    a11 * x + a12 * v + b1 * f,
                    a21 * x + a22 * v + b2 * f,
                    f + unknowns[2 + k],
                ]
            )
            offset = np.array([[a11, a12], [a21, a22]]) @ offset + known[k - 1]
        positions.append(state[0])
        offsets.append(offset[0])
        forces.append(state[2])
    place, pushed = np.array(positions), np.array(forces)
    covariance = place @ spread @ place.T + noise**2 * np.eye(ticks)
    surprise = y - np.array(offsets)
    solved = np.linalg.solve(covariance, surprise)
    # 25 ticks of matrices whose entries lie six decades apart.
    assert force == pytest.approx(pushed @ spread @ place.T @ solved, rel=1e-6)
    density = -0.5 * (surprise @ solved + np.linalg.slogdet(covariance)[1])
    assert likelihood == pytest.approx(density, rel=1e-6)
