"""One style of figures: PNG, PDF and SVG, no overlapping names, distinct colours."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from nodes.recording.figure_style import (
    COLOURS,
    LINES,
    MARKERS,
    OMEGA,
    label_ends,
    new_figure,
    plain_factor,
    plain_power,
    save_figure,
    styled,
    threshold,
    typeset,
)
from tests.support.overlap import checked_figures


@styled
def drawn() -> Figure:
    figure = Figure(figsize=(4.0, 3.0), layout="constrained")
    axes = figure.add_subplot(
        xlabel=OMEGA, ylabel="force  [N]", xlim=(0.0, 1.0), ylim=(0.0, 1.0)
    )
    x = np.linspace(0.0, 1.0, 5)
    for k in range(4):
        axes.plot(x, 0.5 * x + 0.001 * k, label=f"law {k}")
    threshold(axes, 0.98, "a limit")
    label_ends(axes)
    return figure


def test_a_picture_comes_in_three_formats_and_its_names_can_be_read(
    tmp_path: Path,
) -> None:
    before = mpl.rcParams["axes.grid"]
    figure = drawn()
    assert mpl.rcParams["axes.grid"] is before, "nobody else's pictures change"
    path = save_figure(figure, tmp_path / "deep" / "picture.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    # Letters stay letters.
    written = path.with_suffix(".svg").read_text(encoding="utf-8")
    assert ">law 3<" in written
    assert ">a limit<" in written
    figure.draw_without_rendering()
    notes = [text for text in figure.axes[0].texts if text.get_text().startswith("law")]
    boxes = [text.get_window_extent() for text in notes]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


def test_each_curve_has_a_colour_a_line_and_a_marker_of_its_own() -> None:
    assert len(set(COLOURS)) == len(set(map(str, LINES))) == len(set(MARKERS)) == 7

    def seen_by_a_deuteranope(colour: str) -> np.ndarray:
        """Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB."""
        rgb = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        matrix = [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
        return np.asarray(np.array(matrix) @ linear)

    seen = [seen_by_a_deuteranope(colour) for colour in COLOURS]
    # Red and green of matplotlib's own cycle (#2ca02c, #d62728) are 0.1 apart, of which no more
    # than a shade is seen.
    assert (
        min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(seen, 2))
        > 0.1
    )


def test_symbols_are_set_as_mathematics_and_words_are_left_alone() -> None:
    assert (
        typeset("D^0.5: time to K_max, 5 K_maxima")
        == r"$D^{0.5}$: time to $K_\mathrm{max}$, 5 K_maxima"
    )


@pytest.mark.parametrize(
    ("mathematics", "plain"),
    [
        (r"$\mathdefault{10^{-9}}$", "10⁻⁹"),
        (r"$\mathdefault{2\times10^{-1}}$", "2×10⁻¹"),
        (r"$\mathdefault{-10^{12}}$", "−10¹²"),
        (r"$\mathdefault{0}$", "0"),
        ("run-1", "run-1"),
        ("1e-05", "1e-05"),
    ],
)
def test_powers_are_written_as_text(mathematics: str, plain: str) -> None:
    assert plain_power(mathematics) == plain


@pytest.mark.parametrize(
    ("told", "plain"),
    [
        ("1e−9", "×10⁻⁹"),
        ("1e7", "×10⁷"),
        ("+1e+7", "+1×10⁷"),
        ("1e−5+1.2e3", "×10⁻⁵+1.2×10³"),
        ("", ""),
    ],
)
def test_factors_are_written_as_text(told: str, plain: str) -> None:
    assert plain_factor(told) == plain


def test_a_saved_picture_has_the_numbers_that_matplotlib_would_have(
    tmp_path: Path,
) -> None:
    figure = new_figure(4.0, 3.0)
    left, right = figure.subplots(1, 2)
    left.loglog([1e-4, 1e3], [1.0, 1e6])
    right.plot([0.0, 3e-9], [0.0, 4e8])
    svg = (
        save_figure(figure, tmp_path / "a.png")
        .with_suffix(".svg")
        .read_text(encoding="utf-8")
    )
    powers = {
        int(text.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
        for text in re.findall(r">10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)<", svg)
    }
    # Powers within both axes' limits, the least and the largest among them.
    assert {-4, 0, 6} <= powers <= set(range(-4, 7))
    assert ">×10⁻⁹<" in svg
    assert ">×10⁸<" in svg


def test_a_full_disk_is_told_as_one(tmp_path: Path) -> None:
    """Matplotlib's PDF writer hid the reason behind an AttributeError."""
    for suffix in (".pdf", ".svg", ".png"):
        (tmp_path / "full").with_suffix(suffix).symlink_to("/dev/full")
    figure = new_figure(3.0, 2.0)
    figure.add_subplot().plot([0.0, 1.0])
    with pytest.raises(OSError, match="No space left on device"):
        save_figure(figure, tmp_path / "full.png")


@pytest.mark.parametrize("high", [15.0, 60.0, 500.0, 1e5])
def test_numbers_of_a_logarithmic_axis_never_lie_over_each_other(
    tmp_path: Path, high: float
) -> None:
    """However narrow the panel, and however little of a decade it shows."""
    figure = new_figure(2.0, 1.6)
    axes = figure.add_subplot()
    axes.plot([8.0, high], [0.0, 1.0])
    axes.set(xscale="log", xlabel="time of a call  [µs]")
    with checked_figures() as overlaps:
        save_figure(figure, tmp_path / "log.png")
    assert overlaps == []
