"""The result of a study: figures by name, text and verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.studies.notebook_results import Result, bars, new_figure, pandas

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Names of the tables of studies.
_TABLES = ("rows", "points", "drops", "edges", "curves", "cases", "terms", "parameters")


class StudyResult(Result):
    """Base of the results of studies; ``result["name"]`` reads a figure of the answer."""

    # signal that ended the study early, leaving a partial result; 0: none
    interrupted: int = 0

    if TYPE_CHECKING:  # each result defines a field or a property

        @property
        def held(self) -> bool:
            """Whether the verdict is yes: the exit code is 0."""

        @property
        def answer(self) -> dict[str, Any]:
            """Figures by name, with units at their ends: what ``--json`` prints."""

        @property
        def text(self) -> str:
            """Text for the terminal."""

    def figures(self) -> dict[str, Any]:
        """Return the figures."""
        return self.answer

    def columns(self) -> dict[str, Any]:
        """Return no columns: a table of rows is one figure of the answer."""
        return {}

    def to_pandas(self) -> Any:
        """Return a table: the rows of the study if it has any, else its figures in one row."""
        answer = self.answer
        rows = next(
            (value for name, value in answer.items() if name in _TABLES and value), None
        )
        return pandas().DataFrame([answer] if rows is None else rows)

    def plot(self) -> Figure:
        """Show the study's own picture; without one, plot its figures as bars."""
        picture = self.answer.get("plot")
        if not isinstance(picture, str) or not Path(picture).exists():
            return bars(_flat(self.answer), "as their names say", type(self).__name__)
        from matplotlib.image import imread

        drawn = imread(picture)
        figure, (axes,) = new_figure(
            width=drawn.shape[1] / 150.0, height=drawn.shape[0] / 150.0
        )
        axes.imshow(drawn)
        axes.set_axis_off()
        return figure

    def __getitem__(self, name: str) -> Any:
        """Return one figure."""
        answer = self.answer
        if name not in answer:
            raise KeyError(
                f"{name!r} is no figure of this study; there are {', '.join(answer)}"
            )
        return answer[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.answer)


def _flat(said: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return every number of an answer by its path."""
    found: dict[str, Any] = {}
    for name, value in said.items():
        found |= (
            _flat(value, f"{before}{name}.")
            if isinstance(value, Mapping)
            else {f"{before}{name}": value}
        )
    return found


def at_top() -> Any:
    """Declare a field whose figures stand at the top level of a study's answer."""
    return field(metadata={"figure": ""})


@dataclass(frozen=True, repr=False, kw_only=True)
class Findings(StudyResult):
    """Result whose fields are its figures; those declared here are not, and files come last."""

    # For the terminal. A text alone would be a sequence of its characters.
    lines: list[str] | tuple[str, ...]
    held: bool = True  # whether the verdict is yes
    interrupted: int = 0  # signal that ended the study early; 0: none
    ledger: Path | None = None
    picture: Path | None = None

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, in plain JSON types."""
        found: dict[str, Any] = {}
        for one in fields(self):
            if one.name not in _BESIDE:
                value = plain(getattr(self, one.name))
                found |= (
                    {one.name: value} if one.metadata.get("figure", one.name) else value
                )
        return found | {name: str(path) for name, path in self._files().items()}

    @property
    def text(self) -> str:
        """Text for the terminal."""
        return "\n".join([*self.lines, *map(str, self._files().values())])

    def _files(self) -> dict[str, Path]:
        named = {"ledger": self.ledger, "plot": self.picture}
        return {name: path for name, path in named.items() if path is not None}


# Fields of `Findings` that are no figures, or come last.
_BESIDE = frozenset(one.name for one in fields(Findings))


def plain(value: Any) -> Any:
    """Convert figures to JSON types.

    An object's own `as_json` decides first. What is not finite in an array becomes null, because
    it stands for a missing value there.
    """
    if hasattr(value, "as_json"):
        return plain(value.as_json())
    if is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray):
        shown = value.astype(object)
        shown[~np.isfinite(value)] = None
        return shown.tolist()
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, Path | StrEnum) else value
