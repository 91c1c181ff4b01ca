"""K_max from a recorded swing of unknown mass (THEORY.md §9): launches, random devices."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE
from nodes.cli.main import main
from nodes.laws.parse import parse_law
from nodes.recording.reader import Recording
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene, free_scene
from sim.identify.swing import (
    _SHORTEST,
    CannotTellError,
    _law,
    longest,
    recorded_swing,
    ringing,
    swing_of,
    windows,
)
from sim.identify.swing_drops import DroppedSwing, counted, dropped
from sim.play.one_axis import run
from sim.studies.edge import LAWS
from tests.support import one_process
from tests.support.launching import exit_code
from tests.support.recorded import rewritten

T = 0.002


PD_ALPHA = (
    "{laws: {half: {kind: pd_alpha, stiffness: 1800.0, damping: 8.0, order: 0.5, taps: 20, gains:"
    " paper}}, law: half}"
)


def recorded(folder: Path, words: str, law: str = "", device: str = "{}") -> Path:
    (folder / "more.yaml").write_text(
        f"coupling: {law or '{}'}\ndriver: {{device: {device}}}", encoding="utf-8"
    )
    assignments = f"duration:=1 {words}".split()
    return one_process.recorded(
        folder, "floor_drop", *assignments, params=folder / "more.yaml"
    )


def limit_of(path: Path, delay: float = 0.0) -> float:
    limit = k_max(
        without_spring(_law(Recording(path), path), T), Plant(T, 0.1, 1.0, delay)
    ).k_max_n_per_m
    assert limit is not None
    return limit


@pytest.mark.parametrize(
    ("words", "law", "delay"),
    [("law:=pd stiffness:=900 apply:=next_tick", "", 1.0), ("", PD_ALPHA, 0.0)],
)
def test_a_launch_far_inside_tells_where_the_edge_is(
    tmp_path: Path,
    words: str,
    law: str,
    delay: float,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = recorded(tmp_path, words, law)
    limit, found = limit_of(path, delay), recorded_swing(path)
    low, high = found.k_max_n_per_m
    # The margin on each side, and what the windows differ by: nothing is noisy here, but the short
    # memory of PDα creeps.
    assert low < limit < high < 1.06 * low
    assert found.mass_kg == pytest.approx((0.1, 0.1), rel=0.03)
    assert found.stiffness_n_per_m < 0.75 * limit
    assert found.edge.k_exact_n_per_m == pytest.approx(limit, rel=0.03)
    assert main(["study", "edge", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["k_max_n_per_m"] == [
        low,
        high,
    ]
    # A damping that nobody knows leaves a wider interval, not another one.
    wide = _told_without_damping(path)
    assert wide[0] < low < high < 1.02 * wide[1]


def _told_without_damping(path: Path) -> tuple[float, float]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sim.identify.swing.virtual_device", lambda *_: None)
        return recorded_swing(path).k_max_n_per_m


@pytest.mark.parametrize("name", LAWS)
def test_friction_and_encoder_do_not_move_the_edge_out_of_the_interval(
    name: str,
) -> None:
    # Random devices, dropped: dry friction makes the swing die faster, which is not taken for
    # damping.
    rows = [dropped(number, name, LAWS[name], T) for number in range(6)]
    found = counted(rows)
    assert found.told >= 2
    assert found.hold == found.told
    assert (found.median_width or 1.0) < 0.3
    assert all(row.why for row in rows if row.between_n_per_m is None)


def test_drops_are_counted_law_by_law(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "edge", "--drops", "5", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (
        figures["drops"] == sum(one["drops"] for one in figures["laws"].values()) == 5
    )
    missed = DroppedSwing("pd", 0.9, 100.0, (90.0, 98.0))
    held = DroppedSwing("pd", 0.9, 100.0, (98.0, 102.0))
    told = counted([missed, held, DroppedSwing("pd", 0.9, 100.0)])
    assert (told.drops, told.told, told.hold) == (3, 2, 1)
    assert told.worst_miss == pytest.approx(0.02)
    assert exit_code("study", "edge", "--drops", "0") == 2


@pytest.mark.parametrize(
    ("theta", "decay"),
    [(0.2, 0.98), (1.0, 0.999), (0.4, 1.01), (1.5, 0.5), (2.5, 0.35), (0.6, 1.045)],
)
def test_a_swing_is_fitted_exactly(theta: float, decay: float) -> None:
    k = np.arange(120)
    fit = ringing(-1e-3 + 1e-4 * decay**k * np.cos(theta * k + 0.3))
    # The signal obeys the model: what is left is the tolerance of the search.
    assert (fit.theta, fit.decay) == pytest.approx((theta, decay), rel=1e-6)
    assert fit.residual < 1e-6


@pytest.mark.parametrize("size", [1e-6, 1e-4])
def test_the_residual_is_a_share_of_the_swing_whatever_its_size(size: float) -> None:
    """What is left of a swing with noise is the noise."""
    k = np.arange(400)
    noise = 0.02 * np.random.default_rng(1).normal(size=400)
    swing = np.cos(0.4 * k) + noise
    # The fit takes up six of 400 values: 1 %.
    assert ringing(size * swing + 0.05).residual == pytest.approx(
        np.sqrt(np.mean(noise**2)) / np.ptp(swing), rel=0.02
    )


def test_a_swing_has_at_least_forty_ticks_and_a_nanometre() -> None:
    k = np.arange(_SHORTEST)
    swing = np.cos(0.7 * k)
    swing /= np.ptp(swing)
    assert ringing(1.001e-9 * swing).theta == pytest.approx(0.7, rel=1e-6)
    with pytest.raises(CannotTellError, match="nothing swings"):
        ringing(0.999e-9 * swing)
    with pytest.raises(CannotTellError, match="at least 40 are needed"):
        ringing(swing[1:])


def test_what_does_not_swing_is_refused() -> None:
    k = np.arange(200)
    with pytest.raises(CannotTellError, match="nothing swings"):
        ringing(np.zeros(200))
    with pytest.raises(CannotTellError, match="creeps to rest"):
        ringing(1e-3 * 0.9**k + 5e-4 * 0.8**k)


def test_what_grows_is_refused() -> None:
    derivative = without_spring(
        parse_law({"kind": "pd", "stiffness": 1.0, "damping": 3.0}), T
    )
    plant = Plant(T, 0.1, 1.0)
    whole = with_spring(
        derivative, 1.02 * (k_max(derivative, plant).k_max_n_per_m or 0.0)
    )
    trace = run(free_scene(DeviceModel(mass=0.1, damping=1.0), T), whole, 400)
    with pytest.raises(CannotTellError, match="does not decay"):
        windows(trace.measured)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "law", "why"),
    [
        (
            "law:=pd stiffness:=2500",
            "{schedule: [{at: 0.3, law: multi_term}]}",
            "the law changed",
        ),
        (
            "",
            (
                "{laws: {w: {kind: pd_windowed, stiffness: 1500.0, damping: 3.0, resolution:"
                " 2.3e-5}}, law: w}"
            ),
            "own code|code of its own",
        ),
    ],
)
def test_off_the_ringing_pole_it_cannot_tell(
    tmp_path: Path, words: str, law: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(tmp_path, words, law)
    with pytest.raises(CannotTellError, match=why):
        recorded_swing(path)
    assert main(["study", "edge", str(path)]) == 1
    assert capsys.readouterr().out.startswith("unknown: ")


def test_where_nothing_was_touched_nothing_swings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "study",
                "edge",
                str(recorded(tmp_path, "stiffness:=1000 height:=0.3 duration:=0.2")),
            ]
        )
        == 1
    )
    assert capsys.readouterr().out.startswith("unknown: nothing was touched")


@pytest.mark.slow
def test_study_edge_compares_laws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "study",
                "edge",
                "--points",
                "4",
                "--gain",
                "3..25",
                "--out",
                str(tmp_path),
                "--json",
            ]
        )
        == 0
    )
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert figures["exact_error"] < 1e-9
    # The filter's own lag makes the low-frequency reading of PD behind one worse than that of the
    # laws of taps.
    ratios = [
        point["k_simple_n_per_m"] / point["k_exact_n_per_m"]
        for point in figures["points"]
        if "Hz" not in point["law"]
    ]
    assert 0.95 < min(ratios) < max(ratios) < 1.0
    assert 0.85 < figures["ratio_min"] < figures["ratio_max"] < 1.0
    assert (
        len(figures["points"])
        == 4 * len({point["law"] for point in figures["points"]})
        == 20
    )
    assert Path(figures["plot"]).stat().st_size > 10_000
    assert main(["study", "edge", "--gain", "3", "--out", str(tmp_path)]) == 2
    assert main(["study", "edge", str(tmp_path / "none.mcap")]) == 2


def test_a_contact_with_ticks_that_are_missing_is_not_taken_for_a_faster_swing(
    tmp_path: Path,
) -> None:
    """With every tenth tick lost, the interval did not contain K_max."""
    path = recorded(tmp_path, "law:=pd stiffness:=2500 duration:=2")
    limit = limit_of(path)
    later = rewritten(
        path, lambda topic, seq: topic != DEVICE_STATE or seq < 300 or seq % 10 != 0
    )
    low, high = recorded_swing(later).k_max_n_per_m
    assert low < limit < high
    with pytest.raises(CannotTellError, match="ticks of contact before it bounces"):
        recorded_swing(
            rewritten(path, lambda topic, seq: topic != DEVICE_STATE or seq % 10 != 0)
        )


def test_a_law_that_changed_before_the_recording_began_is_not_taken_for_the_launch_file_s(
    tmp_path: Path,
) -> None:
    path = recorded(
        tmp_path, "law:=pd stiffness:=2500", "{schedule: [{at: 0.01, law: pd_alpha}]}"
    )
    late = rewritten(path, lambda _, seq: seq > 10)
    with pytest.raises(CannotTellError, match="the law changed"):
        recorded_swing(late)


def test_without_the_coupling_s_forces_nothing_tells_the_law(tmp_path: Path) -> None:
    path = recorded(tmp_path, "law:=pd stiffness:=2500")
    with pytest.raises(CannotTellError, match="were not recorded"):
        recorded_swing(rewritten(path, lambda topic, _: topic != FORCE))


@pytest.mark.parametrize("stiffness", [300.0, 1500.0])
def test_a_hand_that_holds_the_device_is_in_the_loop(stiffness: float) -> None:
    """Without its spring, the swing seemed that of a lighter device."""
    hand = Hand(mass=0.05, damping=2.0, stiffness=stiffness, path=[(0.0, 0.0)])
    body, law = (
        DeviceModel(mass=0.05, damping=0.5, hand=hand),
        parse_law({"kind": "pd", "stiffness": 1200.0, "damping": 1.0}),
    )
    trace = run(drop_scene(body, T, raw=False, clamp=True), law.compile(T), 500)
    first, last = longest(np.abs(trace.force) > 0.0)
    loop = Plant(T, 1.0, 0.0, 0.0, stiffness)
    limit = k_max(
        without_spring(law, T), replace(loop, mass=0.1, damping=2.5)
    ).k_max_n_per_m
    assert limit is not None
    for damping in (2.5, None):
        low, high = swing_of(
            law, loop, trace.measured[first:last], damping
        ).k_max_n_per_m
        assert low < limit < high
    low, high = swing_of(
        law, replace(loop, stiffness=0.0), trace.measured[first:last], 0.5
    ).k_max_n_per_m
    assert not low < limit < high


def test_the_hand_of_a_recorded_scene_is_taken_into_account(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    device = "{hand: {mass: 0.05, damping: 2.0, stiffness: 1000.0, path: [[0.0, 0.0]]}}"
    path = recorded(
        tmp_path, "law:=pd stiffness:=1500 damping:=1", "{stability: 'off'}", device
    )
    limit = k_max(
        without_spring(_law(Recording(path), path), T), Plant(T, 0.15, 3.0, 0.0, 1000.0)
    ).k_max_n_per_m
    assert limit is not None
    assert main(["study", "edge", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["k_max_n_per_m"][0] < limit < told["k_max_n_per_m"][1]
    assert told["hand_n_per_m"] == 1000.0
    assert main(["study", "edge", str(path)]) == 0
    assert "held by a hand of 1000 N/m" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [("--mass", "0.2"), ("--damping", "2"), ("--drops", "3"), ("--gain", "3..20")],
)
def test_what_a_recording_tells_is_not_asked_for(
    words: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", "edge", "run.mcap", *words]) == 2
    assert f"{words[0]}: no effect here" in capsys.readouterr().err
