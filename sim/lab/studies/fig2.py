"""Plot the paper's figure 2, f(ω) of single fractional terms, and judge its claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, quantity
from nodes.recording.figure_style import (
    COLOURS,
    GREY,
    LINES,
    MARKERS,
    OMEGA,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from sim.lab.paper.claims import PaperFigure


@dataclass(frozen=True, kw_only=True)
class Fig2Options(FileOptions):
    """Options of `fig2`."""

    taps: int = quantity("taps", 4)


@styled
def fig2(options: Fig2Options) -> PaperFigure:
    """Plot the figure and check the claims."""
    from sim.lab.paper.claims import save, table
    from sim.lab.paper.fig2_claims import claims_2, figure_2

    if options.taps < 2:
        raise UsageError(f"--taps {options.taps}: a derivative needs at least 2")
    theta, low, high = figure_2(options.taps)
    claims = claims_2(options.taps)
    figure = new_figure(10.0, 4.2)
    share = theta / theta[-1]
    for axes, name, terms in zip(figure.subplots(1, 2), "ab", (low, high), strict=True):
        axes.set(
            xlabel=OMEGA,
            ylabel=r"$f(\omega)$ over $f(\omega_\mathrm{N})$  [1]",
            ylim=(-2.5, 1.2),
        )
        for i, term in enumerate(terms):
            axes.plot(
                share,
                term.curve,
                color=COLOURS[i],
                ls=LINES[i],
                label=f"α = {term.order:g}",
            )
            axes.plot(
                share, term.unlimited, color=COLOURS[i], ls="-", lw=0.6, alpha=0.7
            )
            axes.plot(term.zero, 0.0, color=COLOURS[i], marker=MARKERS[i])
        axes.axhline(0.0, color=GREY, lw=0.8)
        axes.set_title(
            f"({name}) f of one term, {options.taps} taps (thick), unlimited memory (thin)"
        )
        axes.legend()
    curves = [
        {
            "figure": name,
            "order": t.order,
            "zero": t.zero,
            "f": t.curve,
            "f_unlimited": t.unlimited,
        }
        for name, terms in (("a", low), ("b", high))
        for t in terms
    ]
    figures = {"taps": options.taps, "frequency_nyquist": share, "curves": curves}
    head = (
        f"figure 2: f of one term, f(ω_N) = 1; {options.taps} taps (the paper prints no n), and"
        " unlimited memory"
    )
    return save("fig2", [head, table(claims)], figures, claims, figure, options.out)
