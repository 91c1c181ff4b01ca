"""Plot the paper's figure 3, f(ω) of its two-term law beside PD, and judge its claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, quantity
from nodes.recording.figure_style import GREY, OMEGA, label_ends, new_figure, styled
from sim.studies.law_looks import law_looks

if TYPE_CHECKING:
    from sim.lab.paper.claims import PaperFigure


@dataclass(frozen=True, kw_only=True)
class Fig3Options(FileOptions):
    """Options of `fig3`."""

    taps: int = quantity("taps", 4)
    rate: float = quantity("rate", 500.0)


@styled
def fig3(options: Fig3Options) -> PaperFigure:
    """Plot the figure and check the claims."""
    from sim.lab.paper.claims import save, table
    from sim.lab.paper.fig3_claims import claims_3, figure_3

    if options.taps < 2:
        raise UsageError(f"--taps {options.taps}: a derivative needs at least 2")
    curves = figure_3(options.taps)
    claims = claims_3(options.taps, 1.0 / options.rate)
    share = curves["theta"] / curves["theta"][-1]
    figure = new_figure(6.4, 4.2)
    axes = figure.add_subplot(
        xlabel=OMEGA, ylabel=r"$f(\omega)$, each term 1 at $\omega_\mathrm{N}$  [1]"
    )
    optimum, pd = law_looks(("paper_optimum", "pd"))
    axes.plot(
        share, curves["optimum"], color=optimum.color, ls="-", label="paper's optimum"
    )
    axes.plot(share, curves["pd"], color=pd.color, ls="--", label="PD")
    for i, label in enumerate((r"$1.69\,D^{1.50}$", r"$1.32\,D^{3.47}$")):
        axes.plot(
            share,
            curves["terms"][i],
            color=optimum.color,
            ls=("-.", ":")[i],
            lw=0.8,
            label=label,
        )
    for level in (-1.0, 0.0):
        axes.axhline(level, color=GREY, lw=0.8)
    axes.set_title(f"f of the paper's optimum, {options.taps} taps per term")
    axes.set_xlim(0.0, 1.0)
    label_ends(axes)
    figures = {"taps": options.taps, "frequency_nyquist": share}
    figures |= {f"f_{name}": curves[name] for name in ("optimum", "pd", "terms")}
    head = (
        f"figure 3: f of the paper's optimum beside PD, {options.taps} taps per term; seconds as"
        f" at {options.rate:g} Hz"
    )
    return save("fig3", [head, table(claims)], figures, claims, figure, options.out)
