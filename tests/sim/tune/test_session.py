"""A tuning's record: what a refusal leaves, its text, and when a command succeeds."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from messages.errors import RefusedError, UsageError
from sim.drill.given_design import given_design, given_prediction
from sim.stability.rest import ComesToRest
from sim.studies.result import plain
from sim.tune.knocking import (
    LOWEST,
    STEP,
    KnockedEdge,
    KnockVerdict,
    Plan,
    climb,
    factor_of,
)
from sim.tune.live_trial import STOPPED, Cut, Trials
from sim.tune.outcome import headline, verified
from sim.tune.record import AppliedStep, ForceLimits, PlannedKnocks, TuneRecord
from sim.tune.session import Tuning
from sim.tune.tune_options import TuneOptions

DESIGNED = given_design([900.0, -800.0], 0.002, lands=True)
PREDICTED = given_prediction(100.0, 1.3)
PLANNED = PlannedKnocks((), "", Plan(0, 0, 1))
HELD = verified(
    PREDICTED, climb(Plan(LOWEST, 20, 25), lambda n: KnockVerdict(STEP**n, 0.0, True))
)

WHOLE = TuneRecord(
    designed=DESIGNED, predicted=PREDICTED, predicted_steps=PLANNED, verified=HELD
)


def refuse() -> Any:
    raise RefusedError("let go first")


def tuning(
    folder: Path, running: Callable[[], Any] = refuse, fresh: bool = False
) -> Tuning:
    return Tuning(TuneOptions(out=folder), running, refuse, fresh)


def resting(step: int) -> KnockVerdict:
    return KnockVerdict(factor_of(step), 0.0, True)


@pytest.mark.parametrize(("step", "fresh"), [("identify", True), ("verify", False)])
def test_a_tuning_that_is_refused_at_its_first_step_leaves_an_earlier_one_as_it_was(
    step: str, fresh: bool, tmp_path: Path
) -> None:
    """The refusal overwrote its result and deleted its law."""
    known = TuneRecord(
        designed=DESIGNED, predicted=PREDICTED, predicted_steps=PLANNED, verified=HELD
    )
    names = {
        "tune.json": json.dumps(plain(known)),
        "tuned.yaml": "a law",
        "tune.html": "a page",
    }
    for name, text in names.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    again = tuning(tmp_path, fresh=fresh)
    with pytest.raises(RefusedError, match="let go first"):
        again.do(step)
    again.record.refused = "let go first"
    again.keep()
    again.write()
    assert {
        path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()
    } == names
    assert (
        again.record.headline
        == f"Nothing new: let go first. {tmp_path / 'tune.json'} is as it was."
    )
    assert again.files == {}


@pytest.mark.parametrize("step", ["verify", "apply"])
def test_a_launch_of_another_rate_gets_no_law(step: str, tmp_path: Path) -> None:
    TuneRecord(
        designed=DESIGNED, predicted=PREDICTED, predicted_steps=PLANNED, verified=HELD
    ).write(tmp_path / "tune.json")
    loop = SimpleNamespace(
        period=0.001, run=SimpleNamespace(run="fast"), read_limits=lambda: None
    )
    with pytest.raises(
        RefusedError, match="fast: runs at 1000 Hz, and the law was designed for 500 Hz"
    ):
        tuning(tmp_path, lambda: loop).do(step)


@pytest.mark.parametrize(
    ("active", "name"),
    [("pd", "tuned"), ("tuned", "tuned_again"), ("tuned_again", "tuned")],
)
def test_a_law_that_renders_is_faded_from_and_stays(
    active: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second tuning's law replaced the active first one within a tick."""
    TuneRecord(designed=DESIGNED, verified=HELD).write(tmp_path / "tune.json")
    asked: list[tuple[str, dict[str, Any]]] = []

    def ask(_: Any, __: Any, operation: str, **given: Any) -> dict[str, Any]:
        asked.append((operation, given))
        return {"active": active, "seq": 7, "force_step_n": 0.0}

    monkeypatch.setattr("sim.tune.session.ask", ask)
    loop = SimpleNamespace(
        period=0.002,
        run=None,
        coupling="coupling",
        read_limits=lambda: None,
        ready=lambda: None,
    )
    done = tuning(tmp_path, lambda: loop)
    done.do("apply")
    (_, put), (switched, to) = asked[-2:]
    assert list(put["values"]) == [f"laws.{name}"]
    assert (switched, to["law"], to["ramp"]) == ("law.switch", name, 250)
    assert done.record.applied is not None
    assert (done.record.applied.law, done.record.applied.before) == (name, active)


def test_a_climb_that_was_cut_short_verifies_nothing() -> None:
    """Without a limit in the model either, everything tried so far counted as verified."""
    whole = climb(Plan(LOWEST, 20, 25), resting)
    assert verified(PREDICTED, whole).holds
    # From before the law itself, at it, and after all of it: a refusal may come at the very end.
    for steps in (
        whole.steps[:5],
        [step for step in whole.steps if step.factor <= 1.0],
        whole.steps,
    ):
        told = verified(PREDICTED, KnockedEdge(steps, "the machine stalled"))
        assert not told.holds
        record = TuneRecord(
            designed=DESIGNED, verified=told, refused="the machine stalled"
        )
        assert headline(record).startswith("Not verified: ")


def test_a_law_that_holds_ends_the_command_with_0_whether_or_not_an_edge_was_found(
    tmp_path: Path,
) -> None:
    record = tuning(tmp_path).record
    assert record.came_through()
    for holds in (True, False):
        record.verified = replace(HELD, holds=holds)
        assert record.came_through() is holds


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    whole = TuneRecord(
        limits=ForceLimits(3.3, None),
        designed=DESIGNED,
        predicted=replace(PREDICTED, limit_cycle_free=ComesToRest.ESTIMATED),
        predicted_steps=PLANNED,
        verified=HELD,
        applied=AppliedStep(7, 250, 0.0, "tuned", "pd"),
        date="now",
    )
    whole.write(tmp_path / "tune.json")
    assert TuneRecord.read(tmp_path / "tune.json") == whole
    for damaged in ("[]", "{", '{"designed": {}}', '{"verified": {"holds": 3}}'):
        (tmp_path / "tune.json").write_text(damaged, encoding="utf-8")
        with pytest.raises(UsageError, match="is not what haptic tune wrote"):
            TuneRecord.read(tmp_path / "tune.json")


def stand_in(ready: Callable[[], Any], safety: list[str]) -> Any:
    """Return a launch that only knows of a stopped driver; `safety` is its state."""
    stopped = SimpleNamespace(
        safety="stopped", seq=1, energy=0.0, overruns=0, age=0, position=(0.0, 0.0, 0.0)
    )
    return SimpleNamespace(
        run=None,
        driver="driver",
        coupling="coupling",
        environment="environment",
        peak=3.0,
        axes=(2,),
        ready=ready,
        change=lambda *_, **__: {"from": "trial", "seq": 0},
        states=lambda: iter([stopped]),
        why_stopped=lambda: "swings",
        soften=lambda _: None,
        anchor=lambda _: None,
        wait=lambda _: None,
        progress=lambda: {"position_m": (0.0, 0.0, 0.0), "safety": safety[0]},
        rearm=lambda _: refuse(),
    )


def trials(loop: Any, monkeypatch: pytest.MonkeyPatch) -> Trials:
    monkeypatch.setattr("sim.tune.live_trial.ask", lambda *_, **__: None)
    held: Any = SimpleNamespace(
        check=lambda: None, borrow=lambda *_, **__: None, not_put_back=""
    )
    return Trials(loop, held, [900.0, -800.0], 1e-3, 0.0, lambda _: None)


def test_a_driver_that_takes_no_more_forces_gives_no_verdict(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Stopped by a large step and not rearmed, it failed every smaller one too."""
    steps = KnockedEdge()
    with pytest.raises(RefusedError, match="let go first"):
        trials(stand_in(refuse, ["stopped"]), monkeypatch).climb(Plan(0, 20, 25), steps)
    assert steps.steps == []
    assert not steps.complete


def test_a_driver_that_stops_right_after_a_knock_judges_that_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The stop was attributed to the next step, which never reached the device."""
    safety = ["stopped"]
    trial = trials(stand_in(lambda: None, safety), monkeypatch)
    rests = KnockVerdict(1.0, 0.0, True)
    monkeypatch.setattr(
        trial, "_window", lambda _: (np.linspace(0.0, 1e-3, 100), Cut(), "")
    )
    monkeypatch.setattr("sim.tune.live_trial.judge", lambda *_: rests)
    assert trial._try(1.0) == (
        KnockVerdict(1.0, 0.0, False, f"{STOPPED}: swings", "stop"),
        "",
    )
    safety[0] = "active"
    assert trial._try(1.0) == (rests, "")
