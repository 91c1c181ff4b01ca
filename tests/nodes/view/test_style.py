"""Colours of the page: text of each colour is readable on each background it stands on."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import nodes.view

_STYLE = (Path(nodes.view.__file__).parent / "web" / "style.css").read_text(
    encoding="utf-8"
)
TEXT = [
    "ink",
    "soft",
    "device",
    "proxy",
    "force",
    "target",
    "beside-ink",
    "good",
    "warn",
    "bad",
]
ON_THE_WALL = (
    "soft",
    "force",
    "target",
    "beside-ink",
)  # names, arrows and figures of the scene
LEAST = 4.5  # WCAG 2.2, 1.4.3 (AA), of normal text


def luminance(colour: str) -> float:
    """Return the relative luminance of #rrggbb (WCAG 2.2)."""
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    dark, bright = sorted((luminance(one), luminance(other)))
    return (bright + 0.05) / (dark + 0.05)


def colours(theme: str) -> dict[str, str]:
    block = _STYLE.split(theme, 1)[1].split("}", 1)[0]
    return dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})\b", block))


def test_contrast_is_that_of_the_standard() -> None:
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)
    # the grey that the standard's notes give as just enough on white
    assert 4.5 < contrast("#767676", "#ffffff") < 4.6


@pytest.mark.parametrize("theme", [":root {", ':root[data-theme="dark"] {'])
def test_all_text_is_readable_in_both_themes(theme: str) -> None:
    given = colours(theme)
    pairs = [(name, ground) for name in TEXT for ground in ("card", "paper")]
    pairs += [(name, "wall") for name in ON_THE_WALL]
    short = {
        pair: round(contrast(given[pair[0]], given[pair[1]]), 2)
        for pair in pairs
        if contrast(given[pair[0]], given[pair[1]]) < LEAST
    }
    assert not short


def test_the_focus_of_what_fills_a_clipped_card_is_drawn_inside() -> None:
    """An outline outside of the scene is cut off, but for a corner."""
    page = (Path(nodes.view.__file__).parent / "web" / "index.html").read_text(
        encoding="utf-8"
    )
    scene = page.partition('<section class="card scene"')[2].partition("</section>")[0]
    assert re.search(r"\.scene \{[^}]*overflow: hidden", _STYLE)
    inset = r"([^{}\n]*):focus-visible \{[^}]*outline-offset: -"
    inside = re.findall(inset, _STYLE)
    for canvas in re.findall(r'<canvas id="(\w+)" tabindex', scene):
        assert any(re.search(rf"#{canvas}\b", each) for each in inside), canvas
