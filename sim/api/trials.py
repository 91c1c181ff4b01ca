"""Trials of an experiment: conditions in a seeded order, one outcome each.

A condition is a name and what differs in it: a law, parameters, a scenario. What a trial does with
it is the experimenter's function, on a launch or in one process. An adaptive threshold is a
`Staircase`.
"""

from __future__ import annotations

import csv
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.errors import UsageError
from sim.api.laws import plain
from sim.studies.notebook_results import Result, figure_of, new_figure, pandas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PLAN = ("trial", "block", "condition")  # columns that the plan decides


@dataclass(frozen=True)
class PlannedTrial:
    """One trial: its place in the order, and its condition."""

    number: int  # from 1
    block: int  # from 1
    condition: str  # name of the condition
    # what differs in this condition, e.g. arguments of a launch
    arguments: Mapping[str, Any]

    def row(self) -> dict[str, Any]:
        """Return the columns that the plan decides, and the scalars of the condition.

        Those of ``params`` too, by their path: ``coupling.field.gain``; not those of a law.
        """
        plan = dict(zip(_PLAN, (self.number, self.block, self.condition), strict=True))
        given = dict(plain(self.arguments))
        params = given.pop("params", None)
        inner = dict(_scalars(params, "")) if isinstance(params, Mapping) else {}
        return {**plan, **{k: v for k, v in given.items() if _is_scalar(v)}, **inner}


def _is_scalar(value: Any) -> bool:
    return isinstance(value, bool | int | float | str)


def _scalars(tree: Mapping[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    """Yield the scalars of a tree of parameters by path."""
    for name, value in tree.items():
        place = f"{path}.{name}" if path else str(name)
        if isinstance(value, Mapping):
            yield from _scalars(value, place)
        elif _is_scalar(value):
            yield place, value


@dataclass(repr=False)
class TrialTable(Result):
    """A plan of trials and the rows that are done; iterating yields what is left to do."""

    conditions: Mapping[str, Mapping[str, Any]]
    blocks: int
    seed: int
    plan: Sequence[PlannedTrial]
    # a tidy row per trial that is done
    rows: list[dict[str, Any]] = field(default_factory=list)
    out: Path | None = None  # CSV file to which each row is appended

    def __len__(self) -> int:
        return len(self.plan)

    def __iter__(self) -> Iterator[PlannedTrial]:
        yield from self.plan[len(self.rows) :]

    def record(self, trial: PlannedTrial, outcome: Any) -> dict[str, Any]:
        """Append the outcome of a trial to the table, and to the file if there is one.

        Parameters
        ----------
        trial : PlannedTrial
            The next trial of the plan.
        outcome : mapping, number, bool or str
            Its outcome; a mapping makes a column of each entry, else the column is ``outcome``.

        Returns
        -------
        dict
            The row.

        Raises
        ------
        UsageError
            If it is not the next trial, or if an outcome has the name of a column of the plan or
            other names than the outcomes before it.
        """
        number = len(self.rows) + 1
        if trial.number != number:
            raise UsageError(
                f"trial {trial.number} is not the next one, which is {number}"
            )
        found = plain(outcome if isinstance(outcome, Mapping) else {"outcome": outcome})
        row = trial.row()
        if taken := sorted(set(found) & set(row)):
            raise UsageError(
                f"trial {number}: outcome {taken[0]!r} is already a column"
            )
        names = [name for name in self.columns_of_outcome() if name not in found]
        if self.rows and (names or set(found) - set(self.columns_of_outcome())):
            raise UsageError(
                f"trial {number}: outcomes {', '.join(found)}, but those before have"
                f" {', '.join(self.columns_of_outcome())}"
            )
        row = {**{name: row.get(name) for name in self.factors()}, **found}
        self.rows.append(row)
        if self.out is not None:
            _append(self.out, row)
        return row

    def factors(self) -> list[str]:
        """Return the columns that the plan decides.

        Returns
        -------
        list of str
            ``trial``, ``block``, ``condition``, and each scalar that differs in a condition.
        """
        return list(dict.fromkeys(name for trial in self.plan for name in trial.row()))

    def columns_of_outcome(self) -> list[str]:
        """Return the names of the outcomes so far; none before the first.

        Returns
        -------
        list of str
            Names.
        """
        known = set(self.factors())
        return [
            name for name in (self.rows[0] if self.rows else {}) if name not in known
        ]

    def run(self, function: Callable[[PlannedTrial], Any]) -> TrialTable:
        """Do all trials that are left; return this table.

        Parameters
        ----------
        function : callable
            From a trial to its outcome. What it raises ends the run; the rows so far remain, and
            another call goes on with the same trial.

        Returns
        -------
        TrialTable
            Itself.
        """
        for trial in self:
            self.record(trial, function(trial))
        return self

    def figures(self) -> dict[str, Any]:
        """Return what the plan is and how much is done."""
        return {
            "conditions": ", ".join(self.conditions),
            "blocks": self.blocks,
            "seed": self.seed,
            "trials": len(self.plan),
            "done": len(self.rows),
        }

    def columns(self) -> dict[str, Any]:
        """Return the table's columns as arrays, a value per trial that is done."""
        names = self.rows[0] if self.rows else {}
        return {name: np.array([row[name] for row in self.rows]) for name in names}

    def to_pandas(self) -> Any:
        """Return the tidy table: one row per trial that is done. Needs pandas."""
        return pandas().DataFrame(self.rows)

    def plot(self, outcome: str | None = None, ax: Axes | None = None) -> Figure:
        """Plot an outcome of each trial over its condition, with the means.

        Parameters
        ----------
        outcome : str, optional
            Column; by default the first outcome that is a number.
        ax : matplotlib.axes.Axes, optional
            Axes to draw in; by default those of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        UsageError
            If no outcome is a number.
        """
        columns = self.columns()
        numbers = [
            name
            for name in self.columns_of_outcome()
            if columns[name].dtype.kind in "bif"
        ]
        name = outcome or next(iter(numbers), None)
        if name is None or name not in columns:
            raise UsageError(
                f"outcome {outcome!r}: expected one of {', '.join(numbers) or 'none'}"
            )
        axes = new_figure()[1][0] if ax is None else ax
        values, conditions = columns[name].astype(float), columns["condition"]
        spread = random.Random(self.seed)  # noqa: S311  # of dots beside each other
        for i, condition in enumerate(self.conditions):
            mine = values[conditions == condition]
            at = [i + spread.uniform(-0.1, 0.1) for _ in mine]
            axes.plot(at, mine, "o", ls="none", ms=3.0)
            if len(mine):
                axes.plot([i - 0.25, i + 0.25], [mine.mean()] * 2, "k-")
        axes.set_xticks(range(len(self.conditions)), list(self.conditions))
        axes.set_ylabel(name)
        return figure_of(axes)


def trials(
    conditions: Mapping[str, Mapping[str, Any]] | Sequence[str],
    blocks: int = 1,
    repeats: int = 1,
    seed: int = 0,
    out: str | Path | None = None,
) -> TrialTable:
    """Plan trials: each block has each condition `repeats` times, in an order of its own.

    Parameters
    ----------
    conditions : mapping of str to mapping, or sequence of str
        Conditions by name, each with what differs in it, e.g. ``{"soft": {"stiffness": 500}}``.
    blocks : int
        Number of blocks.
    repeats : int
        Trials of each condition in a block.
    seed : int
        Seed of the order: the same seed gives the same order on every machine.
    out : str or Path, optional
        CSV file; each row is appended as soon as it is there. If the file exists, the plan goes on
        behind its last row.

    Returns
    -------
    TrialTable
        The plan: iterate over it and `TrialTable.record` each outcome, or `TrialTable.run` a
        function.

    Raises
    ------
    UsageError
        If there is nothing to do, or the file belongs to another plan.

    Examples
    --------
    >>> plan = trials({"soft": {"stiffness": 500}, "hard": {"stiffness": 1500}}, blocks=2, seed=3)
    >>> table = plan.run(lambda trial: 2 * trial.arguments["stiffness"])
    >>> sorted(table.columns()["outcome"].tolist())
    [1000, 1000, 3000, 3000]
    """
    named = _by_name(conditions)
    for what, number in (("blocks", blocks), ("repeats", repeats)):
        if not isinstance(number, int | np.integer):
            raise UsageError(f"trials: {what} {number!r}: expected a whole number")
    if not named or blocks < 1 or repeats < 1:
        raise UsageError(
            f"trials: {len(named)} conditions, {blocks} blocks, {repeats} repeats; expected at"
            " least one of each"
        )
    for name, arguments in named.items():
        if taken := sorted(set(arguments) & set(_PLAN)):
            raise UsageError(
                f"condition {name!r}: {taken[0]!r} is the name of a column; rename it"
            )
    order = random.Random(seed)  # noqa: S311  # a reproducible order, not a secret
    plan: list[PlannedTrial] = []
    for block in range(1, blocks + 1):
        drawn = [name for name in named for _ in range(repeats)]
        order.shuffle(drawn)
        plan += [
            PlannedTrial(len(plan) + i, block, name, named[name])
            for i, name in enumerate(drawn, 1)
        ]
    made = TrialTable(named, blocks, seed, plan, out=None if out is None else Path(out))
    if made.out is not None:
        # Before the first trial, not behind it.
        try:
            made.out.parent.mkdir(parents=True, exist_ok=True)
            with made.out.open("a"):
                pass
        except OSError as error:
            raise UsageError(f"trials: out: {error}; choose another file") from error
        made.rows += _read(made.out, made)
    return made


def _by_name(
    conditions: Mapping[str, Mapping[str, Any]] | Sequence[str],
) -> dict[str, Mapping[str, Any]]:
    """Return the conditions by name; refuse what is no list of names and no mapping."""
    if isinstance(conditions, str):
        raise UsageError(
            f"trials: {conditions!r}: expected names of conditions, [{conditions!r}]"
        )
    if isinstance(conditions, Mapping):
        for name, arguments in conditions.items():
            if not isinstance(arguments, Mapping):
                raise UsageError(
                    f"condition {name!r}: expected a mapping of what differs, e.g."
                    f" {{'stiffness': 500}}, got {arguments!r:.80}"
                )
        return dict(conditions)
    names = list(conditions)
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise UsageError(
            f"condition {twice[0]!r} is named twice; repeats= repeats conditions"
        )
    return {name: {} for name in names}


def _append(path: Path, row: Mapping[str, Any]) -> None:
    begins = not path.exists() or not path.stat().st_size
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(row))
        if begins:
            writer.writeheader()
        writer.writerow(row)


def _read(path: Path, made: TrialTable) -> list[dict[str, Any]]:
    """Return the rows of a file that an earlier run of the same plan wrote.

    What the plan decides is taken from the plan: a condition ``007`` is no number.
    """
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        lines = list(reader)
    if len(lines) > len(made.plan):
        raise UsageError(
            f"{path}: {len(lines)} rows, this plan has {len(made.plan)} trials"
        )
    rows = []
    for line, trial in zip(lines, made.plan, strict=False):
        if None in line or None in line.values():
            raise UsageError(
                f"{path}: row {trial.number} has other columns than the first line; if it was cut"
                " off while it was written, delete it, and its trial is done again"
            )
        wanted = trial.row()
        if any(line.get(name) != str(wanted[name]) for name in _PLAN):
            raise UsageError(
                f"{path}: row {trial.number} is {line.get('condition')!r} in block"
                f" {line.get('block')}, this plan has {trial.condition!r} in {trial.block}: another"
                " plan or seed; choose another file"
            )
        planned = {name: wanted.get(name) for name in made.factors()}
        for name, value in planned.items():
            there = line.get(name)
            if there != ("" if value is None else str(value)):
                raise UsageError(
                    f"{path}: row {trial.number} has {name} {there}, this plan {value}: the"
                    " condition has changed; choose another file"
                )
        outcome = {
            name: _value(text) for name, text in line.items() if name not in planned
        }
        rows.append({**planned, **outcome})
    return rows


def _value(text: str) -> Any:
    """Return a cell of a CSV file as the number or text that was written."""
    if text in ("True", "False"):
        return text == "True"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
