"""Trials in a seeded order, one tidy table; staircases that find a known threshold."""

from __future__ import annotations

import csv
import math
import random
from collections import Counter
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from messages.errors import UsageError
from sim.api.trials import PlannedTrial


def plan(**options: Any) -> haptic.TrialTable:
    conditions = {name: {"stiffness": 10.0 * i} for i, name in enumerate("abc", 1)}
    return haptic.trials(conditions, **{"blocks": 4, "repeats": 2, "seed": 7} | options)


@given(st.integers(1, 5), st.integers(1, 6), st.integers(1, 3), st.integers())
def test_every_block_has_every_condition_as_often(
    count: int, blocks: int, repeats: int, seed: int
) -> None:
    names = [f"c{i}" for i in range(count)]
    made = haptic.trials(names, blocks, repeats, seed)
    assert [trial.number for trial in made.plan] == list(
        range(1, count * blocks * repeats + 1)
    )
    for block in range(1, blocks + 1):
        found = Counter(trial.condition for trial in made.plan if trial.block == block)
        assert found == dict.fromkeys(names, repeats)
    again = haptic.trials(names, blocks, repeats, seed)
    assert [trial.condition for trial in again.plan] == [
        trial.condition for trial in made.plan
    ]


def test_another_seed_is_another_order_and_blocks_differ() -> None:
    orders = {
        tuple(trial.condition for trial in plan(seed=seed).plan) for seed in range(20)
    }
    assert len(orders) == 20  # of 90^4
    one = [trial.condition for trial in plan().plan]
    assert len({tuple(one[i : i + 6]) for i in range(0, 24, 6)}) > 1


def test_outcomes_make_one_tidy_table() -> None:
    made = plan().run(
        lambda trial: {"force_n": trial.arguments["stiffness"] * 2, "felt": True}
    )
    table = made.to_pandas()
    names = ["trial", "block", "condition", "stiffness", "force_n", "felt"]
    assert list(table.columns) == names
    assert len(table) == len(made) == 24
    assert (table.force_n == 2 * table.stiffness).all()
    assert made.figures()["done"] == 24
    assert "force_n" in made.plot().axes[0].get_ylabel()
    assert made.plot("felt").axes[0].get_ylabel() == "felt"


def test_a_law_of_a_condition_is_an_argument_and_no_column() -> None:
    law = haptic.PD(stiffness=800, damping=3)
    made = haptic.trials({"law": {"law": law, "duration": 0.1}}).run(
        lambda trial: haptic.play("floor_drop", **trial.arguments).peak_force_n
    )
    assert list(made.rows[0]) == ["trial", "block", "condition", "duration", "outcome"]


def test_an_experiment_that_broke_off_goes_on_where_it_was(tmp_path: Path) -> None:
    out = tmp_path / "subject.csv"
    done: list[int] = []

    def breaks(trial: PlannedTrial) -> float:
        if trial.number == 9:
            raise KeyboardInterrupt
        done.append(trial.number)
        return 0.1 * trial.number

    with pytest.raises(KeyboardInterrupt):
        plan(out=out).run(breaks)
    made = plan(out=out)
    assert next(iter(made)).number == 9
    made.run(lambda trial: done.append(trial.number) or 0.1 * trial.number)  # type: ignore[func-returns-value]
    assert done == list(range(1, 25))
    with out.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["outcome"]) for row in rows] == [0.1 * n for n in range(1, 25)]
    whole = plan(out=out)
    assert list(whole) == []
    # What is read back is what was written, to the bit: repr of a float.
    assert whole.columns()["outcome"].tolist() == made.columns()["outcome"].tolist()
    assert whole.rows == made.rows


def test_a_file_of_another_plan_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "subject.csv"
    plan(out=out).run(lambda trial: trial.number)
    with pytest.raises(UsageError, match=r"another plan or seed"):
        plan(out=out, seed=8)
    with pytest.raises(UsageError, match=r"24 rows, this plan has"):
        plan(out=out, blocks=1)


@pytest.mark.parametrize(
    ("outcomes", "text"),
    [
        ([{"block": 1}], r"'block' is already a column"),
        ([{"a": 1}, {"b": 2}], r"outcomes b, but those before have a"),
        ([{"a": 1}, {"a": 1, "b": 2}], r"those before have a"),
    ],
)
def test_an_outcome_that_fits_no_table_is_refused(
    outcomes: list[Any], text: str
) -> None:
    made = plan()
    *fitting, last = outcomes
    for trial, outcome in zip(made, fitting, strict=False):
        made.record(trial, outcome)
    with pytest.raises(UsageError, match=text):
        made.record(next(iter(made)), last)
    assert len(made.rows) == len(outcomes) - 1
    with pytest.raises(UsageError, match=r"trial 5 is not the next one"):
        made.record(made.plan[4], 1)
    with pytest.raises(UsageError, match="at least one"):
        haptic.trials({}, blocks=1)
    with pytest.raises(UsageError, match="'trial' is the name of a column"):
        haptic.trials({"a": {"trial": 1}})


@pytest.mark.parametrize(
    ("down", "probability"), [(1, 0.5), (2, 0.5**0.5), (3, 0.5 ** (1 / 3))]
)
def test_a_staircase_settles_where_levitt_says(down: int, probability: float) -> None:
    # A virtual observer: right with probability Φ(log(value/10)/0.5), so the threshold is known.
    normal = random.Random(1)  # noqa: S311  # a virtual observer

    def right(value: float) -> bool:
        return normal.gauss(math.log(value / 10.0), 0.5) > 0.0

    found = []
    for _ in range(200):
        stairs = haptic.Staircase(80.0, down=down, reversals=24)
        while not stairs.done:
            stairs.answer(right(stairs.value))
        found.append(math.log(stairs.threshold))
    # Quantile of the normal distribution, by bisection of erf.
    low, high = -3.0, 3.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        below = 0.5 * (1.0 + math.erf(middle / math.sqrt(2.0))) < probability
        low, high = (middle, high) if below else (low, middle)
    # 200 staircases of 20 reversals: a standard error of about 0.5/√200 = 0.035 in the logarithm;
    # the mean of reversals is biased by a part of the last step, log(2)/4 = 0.17.
    assert np.mean(found) == pytest.approx(math.log(10.0) + 0.5 * low, abs=0.1)


def test_a_staircase_refuses_what_it_cannot_do() -> None:
    for bad in (
        {"value": 0.0},
        {"value": 1.0, "factor": 1.0},
        {"value": 1.0, "down": 0},
    ):
        with pytest.raises(UsageError, match="staircase: value"):
            haptic.Staircase(**bad)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="a threshold needs two"):
        _ = haptic.Staircase(1.0).threshold


def test_names_that_look_like_numbers_are_read_again_as_names(tmp_path: Path) -> None:
    names, out = ["007", "1e3", "True", "nan", "1_0"], tmp_path / "deep" / "trials.csv"
    first = haptic.trials(names, out=out)
    for trial in list(first)[:3]:
        first.record(trial, 1.5)
    again = haptic.trials(names, out=out)
    assert again.rows == first.rows
    assert len(list(again)) == 2


@pytest.mark.parametrize(
    ("kept", "text"),
    [
        ("trial,block,condition,stiffness,outcome\n1,1", "row 1 has other columns"),
        (
            "trial,block,condition,stiffness,outcome\n1,1,a,500,2,3\n",
            "row 1 has other columns",
        ),
        (
            "trial,block,condition,stiffness,outcome\n1,1,a,600,2\n",
            "stiffness 600, this plan 500",
        ),
    ],
)
def test_a_cut_file_and_that_of_a_changed_condition_are_refused(
    kept: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / "trials.csv").write_text(kept, encoding="utf-8")
    with pytest.raises(UsageError, match=text):
        haptic.trials({"a": {"stiffness": 500}}, out=tmp_path / "trials.csv")


def test_an_empty_file_gets_its_first_line(tmp_path: Path) -> None:
    out = tmp_path / "trials.csv"
    out.touch()
    haptic.trials(["a"], out=out).run(lambda _: 1)
    assert len(haptic.trials(["a"], out=out).rows) == 1


def test_a_place_that_cannot_be_written_is_refused_before_the_first_trial(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path, tmp_path / "file" / "trials.csv"):
        with pytest.raises(UsageError, match="choose another file"):
            haptic.trials(["a"], out=out)


@pytest.mark.parametrize(
    ("conditions", "options", "text"),
    [
        ("soft", {}, "expected names of conditions"),
        (["a", "a"], {}, "'a' is named twice"),
        ({"a": 5}, {}, "expected a mapping of what differs"),
        (["a"], {"blocks": 2.5}, "blocks 2.5: expected a whole number"),
        (["a"], {"repeats": "2"}, "repeats '2': expected a whole number"),
    ],
)
def test_what_is_no_plan_is_refused(conditions: Any, options: Any, text: str) -> None:
    with pytest.raises(UsageError, match=text):
        haptic.trials(conditions, **options)


@pytest.mark.parametrize(
    "bad",
    [
        {"value": "100"},
        {"value": math.inf},
        {"down": 1.5},
        {"reversals": 2.5},
        {"factor": math.inf},
    ],
)
def test_a_staircase_that_could_not_end_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(
        UsageError, match=f"{next(iter(bad))} {next(iter(bad.values()))!r}"
    ):
        haptic.Staircase(**{"value": 100.0} | bad)


def test_a_field_is_a_condition_and_a_column() -> None:
    """The hand's error across the reach is that of its field; none without one."""
    conditions = {
        "null": {"field": "none", "gain": 0.0},
        "curl": {"field": "curl", "gain": 13.0},
        "other": {"field": "curl", "gain": -13.0},
    }
    made = haptic.trials(conditions).run(
        lambda trial: (
            np.abs(haptic.play("reach", **trial.arguments).position_m[:, 1])
            .max()
            .item()
        )
    )
    rows = {row["condition"]: row for row in made.rows}
    assert rows["curl"]["field"] == "curl"
    assert rows["null"]["outcome"] == 0.0
    assert rows["curl"]["outcome"] > 0.01
    # mirrored to the bit: F(−B) = −F(B) across, and along by the square
    assert rows["other"]["outcome"] == rows["curl"]["outcome"]


def test_each_parameter_that_differs_is_a_column_too(tmp_path: Path) -> None:
    conditions: dict[str, dict[str, Any]] = {
        "curl": {"params": {"coupling.field": {"kind": "curl", "gain": 13.0}}},
        "soft": {"params": {"coupling": {"laws": {"pd": {"stiffness": 500}}}}},
    }
    out = tmp_path / "t.csv"
    made = haptic.trials(conditions, out=out).run(lambda trial: trial.number)
    rows = {row["condition"]: row for row in made.rows}
    assert rows["curl"]["coupling.field.kind"] == "curl"
    assert rows["curl"]["coupling.field.gain"] == 13.0
    assert rows["soft"]["coupling.laws.pd.stiffness"] == 500
    assert rows["soft"]["coupling.field.gain"] is None
    assert haptic.trials(conditions, out=out).rows == made.rows  # as it is read again
