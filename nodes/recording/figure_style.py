"""One style for every figure: colour-blind safe, readable in print; PNG, PDF and SVG.

The colours are those of Okabe and Ito (2008). Each has a line style and a marker of its own, so
that a black and white print stays readable. Decorate a function that draws with `styled`;
`save_figure` writes all formats.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import math
import re
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Blue, vermilion, green, purple, orange, sky blue and black, in this order."""

LINES: tuple[Any, ...] = (
    "-",
    "--",
    "-.",
    ":",
    (0, (6, 1.5, 1, 1.5, 1, 1.5)),
    (0, (3, 1)),
    (0, (8, 2)),
)
"""Line styles in the same order."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X")  # markers in the same order
# text width of a paper [inch]: letters are as large in print as they are here
PAGE_WIDTH = 7.2
BAD, GREY, INK = "#B22222", "#8A8F98", "#1D252C"

# label of an axis of frequency in units of the Nyquist frequency
OMEGA = r"$\omega/\omega_\mathrm{N}$  [1]"
_RAISED = str.maketrans("0123456789-−", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")

_SYMBOLS = (
    (re.compile(r"\bD\^([\d.]+)"), r"$D^{\1}$"),
    (re.compile(r"\bK_max\b"), r"$K_\\mathrm{max}$"),
)

_P = ParamSpec("_P")
_T = TypeVar("_T")


def _rc() -> Any:
    from cycler import cycler

    return {
        "axes.prop_cycle": cycler(color=COLOURS, linestyle=LINES),
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "axes.labelsize": 9.0,
        "axes.titlesize": 9.5,
        "axes.titlelocation": "left",
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": "#E3E5E8",
        "grid.linewidth": 0.7,
        "lines.linewidth": 1.4,
        "lines.markersize": 4.0,
        "font.size": 9.0,
        "legend.fontsize": 8.0,
        "legend.frameon": False,
        "xtick.labelsize": 8.0,
        "ytick.labelsize": 8.0,
        # Shorter ticks, and the same line of numbers.
        "xtick.minor.pad": 5.0,
        "ytick.minor.pad": 5.0,
        "mathtext.fontset": "dejavusans",
        # Letters stay letters: a paper's own font can take their place.
        "svg.fonttype": "none",
        "pdf.fonttype": 42,
    }


def styled(draw: Callable[_P, _T]) -> Callable[_P, _T]:
    """Decorate a drawing function to use the project's style; global settings stay unchanged."""

    @functools.wraps(draw)
    def drawn(*words: _P.args, **named: _P.kwargs) -> _T:
        import matplotlib as mpl

        with mpl.rc_context(_rc()), warnings.catch_warnings():
            # A slow machine triggers this warning; the user cannot do anything about it.
            warnings.filterwarnings(
                "ignore", message="Creating legend with loc", category=UserWarning
            )
            return draw(*words, **named)

    return drawn


def new_figure(width: float, height: float) -> Figure:
    """Create an empty figure without a window; size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


@styled
def save_figure(
    figure: Figure, path: Path, room: Callable[[Path], Path] = lambda path: path
) -> Path:
    """Write a figure as PNG, PDF and SVG; `room` frees a file name, see `sim.results.fresh`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _write_numbers_plainly(figure)
    figure.set_dpi(150)
    settle_layout(figure)
    _thin_out_numbers(figure)
    for suffix in (".pdf", ".svg", path.suffix):
        # Render to memory first: on a full disk matplotlib's PDF writer hides the reason behind an
        # error of its own.
        drawn = io.BytesIO()
        with _letters_alone():
            figure.savefig(drawn, dpi=150, format=suffix.removeprefix("."))
        room(path.with_suffix(suffix)).write_bytes(drawn.getbuffer())
    return path


def _thin_out_numbers(figure: Figure) -> None:
    """Remove the numbers between powers of ten where they lie over each other."""
    from matplotlib.ticker import NullFormatter

    for axes in figure.axes:
        for axis, along in ((axes.xaxis, 0), (axes.yaxis, 1)):
            if axis.get_scale() != "log":
                continue
            axis.get_tightbbox()  # places the numbers
            ends = sorted(
                tuple(label.get_window_extent().get_points()[:, along])
                for label in axis.get_ticklabels(which="both")
                if label.get_text()
            )
            if any(end > begin for (_, end), (begin, _) in itertools.pairwise(ends)):
                axis.set_minor_formatter(NullFormatter())


def settle_layout(figure: Figure) -> None:
    """Compute a figure's layout once, so that writing each file does not repeat it."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


_fonts = threading.Lock()


@contextlib.contextmanager
def _letters_alone() -> Iterator[None]:
    """Omit OpenType layout tables from PDF fonts: unused, and a third of the time."""
    from fontTools.subset import Options

    name = "_drop_tables_default"
    # The default is global, so one thread at a time.
    with _fonts:
        before = getattr(Options, name, [])
        setattr(Options, name, [*before, "GDEF", "GPOS", "GSUB", "kern"])
        try:
            yield
        finally:
            setattr(Options, name, before)


def plain_power(text: str) -> str:
    r"""Convert ``$\mathdefault{2\times10^{-3}}$`` to 2×10⁻³; return other text unchanged."""
    found = re.fullmatch(r"\$\\mathdefault\{(.*?)(?:\^\{(.*)\})?\}\$", text)
    if found is None:
        return text
    return found[1].replace(r"\times", "×").replace("-", "−") + (
        found[2] or ""
    ).translate(_RAISED)


def plain_factor(text: str) -> str:
    """Convert an axis' factor and offset, ``1e−3+2e7``, to ×10⁻³+2×10⁷."""
    text = re.sub(
        r"e\+?([−-]?\d+)", lambda power: "×10" + power[1].translate(_RAISED), text
    )
    return re.sub(r"^1×", "×", text)


def _write_numbers_plainly(figure: Figure) -> None:
    """Write axis numbers as plain text; as mathematics they take half of the drawing time."""
    from matplotlib.ticker import Formatter, LogFormatter, ScalarFormatter

    class Plain(Formatter):
        def __init__(self, of: Formatter) -> None:
            self._of = of

        def set_locs(self, locs: Any) -> None:
            self._of.set_locs(locs)

        def __call__(self, x: float, pos: int | None = None) -> str:
            return plain_power(self._of(x, pos))

        def get_offset(self) -> str:
            return plain_factor(self._of.get_offset())

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(
                of := axis.get_major_formatter(), LogFormatter | ScalarFormatter
            ):
                axis.set_major_formatter(Plain(of))
            if isinstance(
                of := axis.get_minor_formatter(), LogFormatter | ScalarFormatter
            ):
                axis.set_minor_formatter(Plain(of))


def typeset(text: str) -> str:
    """Typeset plain symbols such as K_max and D^1.5 as mathematics."""
    for plain, mathematics in _SYMBOLS:
        text = plain.sub(mathematics, text)
    return text


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Label a panel's rows, the first on top, with space above for a threshold's name."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -1.0)
    axes.grid(visible=False, axis="x")


def legend_above(axes: Axes, columns: int = 2) -> None:
    """Place the legend above a panel that has no free space inside."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        borderaxespad=0.2,
        handletextpad=0.3,
    )


def label_ends(axes: Axes, size: float = 8.0) -> None:
    """Label each curve at its right end in its colour; call after setting the limits."""
    import numpy as np

    low, high = axes.get_xlim()
    ends: list[tuple[float, float, str, Any]] = []
    for line in axes.get_lines():
        name = str(line.get_label())
        x = np.asarray(line.get_xdata(), dtype=float)
        y = np.asarray(line.get_ydata(), dtype=float)
        seen = np.flatnonzero((x >= low) & (x <= high) & np.isfinite(y))
        if name.startswith("_") or not seen.size:
            continue
        last = axes.transData.transform((x[seen[-1]], y[seen[-1]]))
        end = axes.transAxes.inverted().transform(last)
        height = float(np.clip(end[1], 0.0, 1.0))
        ends.append((height, float(end[0]), name, line.get_color()))
    ends.sort(key=lambda end: end[0])
    # Height of a line of text, as a fraction of the panel's height.
    dpi = axes.get_figure(root=True).dpi  # type: ignore[union-attr]
    gap = 1.25 * size / 72.0 * dpi / axes.get_window_extent().height
    for (_, at, name, colour), height in zip(
        ends, _apart([end[0] for end in ends], gap), strict=True
    ):
        place: Any = {
            "xycoords": "axes fraction",
            "xytext": (5, 0),
            "textcoords": "offset points",
            "va": "center",
        }
        axes.annotate(
            name,
            (min(at, 1.0), height),
            **place,
            color=colour,
            fontsize=size,
            annotation_clip=False,
        )


def _apart(heights: Sequence[float], gap: float) -> list[float]:
    """Move sorted heights apart by at least `gap`, within 0 to 1."""
    found: list[float] = []
    for height in heights:
        found.append(max(height, found[-1] + gap) if found else height)
    limit = 1.0
    for i in range(len(found) - 1, -1, -1):
        found[i] = min(found[i], limit)
        limit = found[i] - gap
    return found


def threshold(
    axes: Axes, value: float, name: str, vertical: bool = False, before: bool = False
) -> None:
    """Draw a named threshold line; a vertical line's name stands after it unless `before`.

    A horizontal line's name stands where the fewest curves pass, and no other name stands, that
    were drawn before.
    """
    look: Any = {"color": INK, "lw": 0.9, "ls": (0, (1, 1.5))}
    text: Any = {
        "textcoords": "offset points",
        "fontsize": 7.5,
        "color": INK,
        # A background box keeps curves from striking the name through; an outline would turn the
        # letters into shapes.
        "bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6},
        "zorder": 5,
    }
    if vertical:
        axes.axvline(value, **look)
        axes.annotate(
            name,
            (value, 0.99),
            xycoords=("data", "axes fraction"),
            xytext=(-3 if before else 3, -3),
            ha="right" if before else "left",
            va="top",
            **text,
        )
        return
    curves = _pixels(axes)
    inside = axes.get_window_extent()
    names = [each.get_window_extent() for each in axes.texts if each.get_text()]
    axes.axhline(value, **look)
    axes.autoscale_view()  # now: the line may move what is compared

    def write(side: str, over: bool) -> Annotation:
        return axes.annotate(
            name,
            (0.01 if side == "left" else 0.99, value),
            xycoords=("axes fraction", "data"),
            xytext=(0, 3 if over else -3),
            ha=side,
            va="bottom" if over else "top",
            **text,
        )

    def cost(note: Annotation) -> float:
        box = note.get_window_extent()
        if box.y0 < inside.y0 or box.y1 > inside.y1:
            return float(len(curves) + 1)
        taken = len(curves) if box.count_overlaps(names) else 0
        return float(taken + sum(box.contains(x, y) for x, y in curves))

    keep_best((write(*side) for side in _SIDES), cost)


def keep_best(
    notes: Iterable[Annotation], cost: Callable[[Annotation], float]
) -> Annotation | None:
    """Write notes one by one until one costs nothing; remove all but the cheapest.

    A note of infinite cost is removed too.
    """
    best = None
    least = math.inf
    for note in notes:
        if (found := cost(note)) >= least:
            note.remove()
            continue
        if best is not None:
            best.remove()
        best, least = note, found
        if least == 0.0:
            break
    return best


# Places of a horizontal threshold's name, in the order they are tried: side, above the line.
_SIDES = (("left", True), ("right", True), ("left", False), ("right", False))


def _pixels(axes: Axes) -> list[tuple[float, float]]:
    """Return points along the curves of a panel [pixel], about four pixels apart."""
    import numpy as np

    found = [np.empty((0, 2))]
    for line in axes.get_lines():
        at = np.asarray(
            line.get_transform().transform(np.asarray(line.get_xydata(), dtype=float))
        )
        at = at[np.isfinite(at).all(axis=1)]
        found.append(at)
        if line.get_linestyle() != "None":
            for start, end in itertools.pairwise(at):
                steps = min(int(np.abs(end - start).max() / 4.0), 500)
                found.append(np.linspace(start, end, steps, endpoint=False))
    return [(float(x), float(y)) for x, y in np.concatenate(found)]
