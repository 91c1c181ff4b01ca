"""One colour, line and marker a law, the same in every figure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from nodes.recording.figure_style import COLOURS, GREY, LINES, MARKERS

# Places in the style's cycle, by the first word of a law's name; others get a free place.
_PLACES = {
    "pd": 0,
    "pd_filtered": 1,
    "pd_windowed": 2,
    "paper_optimum": 3,
    "designed": 4,
    "designed_drop": 5,
    "pd_alpha": 6,
}


_MORE = ("d", "<", ">", "p", "h")  # markers of further laws of one kind


@dataclass(frozen=True)
class LawLook:
    """How the curve of one law is drawn."""

    color: str
    line: Any
    marker: str

    def curve(self) -> dict[str, Any]:
        """Return a plot's keywords of a line without markers."""
        return {"color": self.color, "ls": self.line}

    def points(self) -> dict[str, Any]:
        """Return a plot's keywords of markers without a line."""
        return {"color": self.color, "ls": "none", "marker": self.marker}

    def marked(self) -> dict[str, Any]:
        """Return a plot's keywords of a line with markers."""
        return self.points() | {"ls": self.line}


def law_looks(names: Iterable[str]) -> list[LawLook]:
    """Return the looks of laws by their names.

    The names may continue: "pd_alpha 0.5", "designed, H(1) = 900 N/m".
    """
    listed = list(names)
    kinds = [name.replace(",", " ").split()[0].lower() for name in listed]
    free = [
        place for place in range(len(COLOURS)) if place not in map(_PLACES.get, kinds)
    ]
    places: dict[str, int | None] = {}
    for kind in kinds:
        if kind not in places:
            places[kind] = (
                _PLACES[kind] if kind in _PLACES else free.pop(0) if free else None
            )
    looks: list[LawLook] = []
    for k, kind in enumerate(kinds):
        place, before = places[kind], kinds[:k].count(kind)
        if place is None:
            grey = sum(look.color == GREY for look in looks)
            looks.append(
                LawLook(GREY, LINES[grey % len(LINES)], _MORE[grey % len(_MORE)])
            )
            continue
        line = LINES[(place + 3 * before) % len(LINES)]
        marker = MARKERS[place] if before == 0 else _MORE[(before - 1) % len(_MORE)]
        looks.append(LawLook(COLOURS[place], line, marker))
    return looks
