"""Claims about the loop with our verdict: holds, holds only if, does not hold."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.recording.figure_style import save_figure
from sim.results import fresh
from sim.studies.result import Findings, at_top, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HOLDS, ONLY_IF, FAILS = "holds", "holds only if", "does not hold"


@dataclass(frozen=True)
class Claim:
    """One claim and its verdict."""

    source: str  # source: a section of the theory, an equation or figure of the paper
    claim: str  # the statement
    verdict: str  # ``holds``, ``holds only if`` or ``does not hold``
    number: str  # the computed value, and the condition of ``holds only if``


def verdict(true: bool, condition: bool | None = None) -> str:
    """Return the verdict."""
    return HOLDS if true else ONLY_IF if condition else FAILS


def table(claims: Sequence[Claim]) -> str:
    """Return the claims as text."""
    width = max(len(HOLDS), len(ONLY_IF), len(FAILS))
    return "\n".join(
        f"{claim.verdict:{width}}  {claim.claim}  [{claim.source}]\n{'':{width}}  {claim.number}"
        for claim in claims
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class PaperFigure(Findings):
    """A figure of the paper with its claims, and the files of both."""

    # as they stand in the file of data
    curves: Mapping[str, Any] = at_top()
    claims: Sequence[Claim]
    data: Path

    @property
    def text(self) -> str:
        """Text for the terminal."""
        return "\n".join([*self.lines, str(self.picture), str(self.data)])


def save(
    name: str,
    lines: Sequence[str],
    figures: Mapping[str, Any],
    claims: Sequence[Claim],
    picture: Figure,
    folder: Path,
) -> PaperFigure:
    """Write a study's data and picture."""
    plot, data = folder / f"{name}.png", fresh(folder / f"{name}.json")
    save_figure(picture, plot, fresh)
    whole = plain({**figures, "claims": claims})
    data.write_text(json.dumps(whole, indent=1, allow_nan=False) + "\n")
    return PaperFigure(
        lines=tuple(lines), curves=figures, claims=claims, data=data, picture=plot
    )
