"""Check whether texts of a figure overlap, by drawing it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock
from weakref import WeakSet

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

SLACK = 1.0
"""Allowed overlap of two boxes, which include unused space for descenders [pixel]."""


def drawn_texts(figure: Figure) -> list[Text]:
    """Draw a figure and return the texts really drawn, without tick labels out of view.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.

    Returns
    -------
    list of Text
        Visible, not blank.
    """
    FigureCanvasAgg(figure)
    # Once for the layout, once for the places that it gives; nothing is painted.
    figure.draw_without_rendering()
    found: dict[int, Text] = {}
    draw = Text.draw

    def note(self: Text, *args: Any, **kwargs: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            found[id(self)] = self
        draw(self, *args, **kwargs)

    with mock.patch.object(Text, "draw", note):
        figure.draw_without_rendering()
    return list(found.values())


def overlaps(figure: Figure) -> list[str]:
    """Return the texts of a figure that overlap each other, or extend beyond it.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.

    Returns
    -------
    list of str
        The two texts of each pair, with the size of what they share [pixel].
    """
    texts = drawn_texts(figure)
    boxes = [(text.get_text(), Text.get_window_extent(text)) for text in texts]
    found = []
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        width, height = (
            min(a.x1, b.x1) - max(a.x0, b.x0),
            min(a.y1, b.y1) - max(a.y0, b.y0),
        )
        if width > SLACK and height > SLACK:
            found.append(f"{one!r} over {other!r}: {width:.0f} x {height:.0f}")
    return found


@contextmanager
def checked_figures() -> Iterator[list[str]]:
    """Check every figure saved within a with block, once for all formats.

    Yields
    ------
    list of str
        What `overlaps` found, figure by figure, each line with the name of its file.
    """
    found: list[str] = []
    looked_at: WeakSet[Figure] = WeakSet()
    save = Figure.savefig

    def check(self: Figure, fname: Any, **kwargs: Any) -> None:
        save(self, fname, **kwargs)
        if self not in looked_at:
            found.extend(f"{fname}: {line}" for line in overlaps(self))
            looked_at.add(self)

    with mock.patch.object(Figure, "savefig", check):
        yield found
