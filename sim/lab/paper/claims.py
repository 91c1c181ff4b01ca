"""Claims about the loop with our verdict: holds, holds only if, does not hold."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.recording.figure_style import save_figure
from sim.results import fresh

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


def save(
    name: str, figures: Mapping[str, Any], claims: Sequence[Claim], picture: Figure, folder: Path
) -> dict[str, Any]:
    """Write a study's data and picture."""
    plot, data = folder / f"{name}.png", fresh(folder / f"{name}.json")
    save_figure(picture, plot, fresh)
    whole = {**figures, "claims": [asdict(claim) for claim in claims]}
    data.write_text(json.dumps(whole, indent=1, allow_nan=False) + "\n")
    return {**whole, "plot": str(plot), "data": str(data)}
