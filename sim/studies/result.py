"""The result of a study: figures by name, text and verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.studies.notebook_results import Result, bars, new_figure, pandas

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Names of the tables of studies.
_TABLES = ("rows", "points", "drops", "edges", "curves", "cases", "terms", "parameters")


class StudyResult(Result):
    """Base of the results of studies; ``result["name"]`` reads a figure of the answer."""

    interrupted: int = 0  # signal that ended the study early, leaving a partial result; 0: none

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
        rows = next((value for name, value in answer.items() if name in _TABLES and value), None)
        return pandas().DataFrame([answer] if rows is None else rows)

    def plot(self) -> Figure:
        """Show the study's own picture; without one, plot its figures as bars."""
        picture = self.answer.get("plot")
        if not isinstance(picture, str) or not Path(picture).exists():
            return bars(_flat(self.answer), "as their names say", type(self).__name__)
        from matplotlib.image import imread

        drawn = imread(picture)
        figure, (axes,) = new_figure(width=drawn.shape[1] / 150.0, height=drawn.shape[0] / 150.0)
        axes.imshow(drawn)
        axes.set_axis_off()
        return figure

    def __getitem__(self, name: str) -> Any:
        """Return one figure."""
        answer = self.answer
        if name not in answer:
            raise KeyError(f"{name!r} is no figure of this study; there are {', '.join(answer)}")
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


@dataclass(frozen=True, repr=False)
class Answer(StudyResult):
    """Figures and text of a study without a type of its own."""

    answer: dict[str, Any]
    text: str
    held: bool = True
    interrupted: int = 0


def answered(
    figures: Mapping[str, Any],
    lines: str | Sequence[str],
    *,
    ledger: Path | None = None,
    plot: Path | None = None,
    held: bool = True,
) -> Answer:
    """Return an answer of figures and lines; the paths of files come last."""
    files = {
        name: str(path) for name, path in (("ledger", ledger), ("plot", plot)) if path is not None
    }
    text = [lines] if isinstance(lines, str) else lines
    return Answer({**figures, **files}, "\n".join([*text, *files.values()]), held)
