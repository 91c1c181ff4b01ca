"""Check limits of methods by two methods each, and reproduce the theory's traps."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from nodes.parameters.options import FileOptions
from nodes.recording.figure_style import COLOURS, GREY, new_figure, styled, threshold
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim.lab.paper.claims import PaperFigure
    from sim.lab.paper.failures import FailureEdge


@dataclass(frozen=True, kw_only=True)
class FailuresOptions(SpreadOptions, FileOptions):
    """Options of `failures`."""


def failures(options: FailuresOptions) -> PaperFigure:
    """Check all boundaries and reproduce all traps."""
    from sim.lab.paper.claims import save, table
    from sim.lab.paper.failures import MARGIN, both_sides, boundaries, euler_bias, traps
    from sim.lab.paper.failures_beyond import BEYOND, BeyondEdge

    cases, steps = boundaries(), (2, 3, 4, 5, 7, 10, 20, 50)
    jobs: list[partial[Any]] = [partial(both_sides, case) for case in cases]
    jobs += [
        partial(traps),
        *(partial(euler_bias, n) for n in steps),
        *(partial(find) for find in BEYOND),
    ]
    done = spread(options, jobs)
    beyond: list[BeyondEdge] = done[-len(BEYOND) :]
    found: list[FailureEdge] = [edge for edge in done[: len(cases)] if edge is not None]
    claims = done[len(cases)]
    bias = dict(zip(steps, done[len(cases) + 1 : -len(BEYOND)], strict=True))
    figures = {
        "margin": MARGIN,
        "edges": [asdict(edge) | {"agreed": edge.agreed} for edge in found],
        "beyond": [asdict(edge) | {"agreed": edge.agreed} for edge in beyond],
        "euler_bias": [
            {"substeps": n, "found": a, "predicted": b} for n, (a, b) in bias.items()
        ],
    }
    lines = [
        f"{'boundary':64} {'K [N/m]':>9}  pole radius − 1 at K ∓ {100.0 * MARGIN:g} %  simulated"
    ]
    for edge in found:
        simulated = " / ".join(
            "settled" if s else "not"
            for s in (edge.settled_inside, edge.settled_outside)
        )
        lines.append(
            f"{edge.name:64.64} {edge.stiffness:9.1f}  {edge.inside - 1.0:+.1e} /"
            f" {edge.outside - 1.0:+.1e}        {simulated}{'' if edge.agreed else '   DISAGREE'}"
        )
    lines += [
        "",
        (
            f"{'beyond a rigid device at one rate':48} {'boundary':>26}  from both sides, by a"
            " second method"
        ),
    ]
    for one in beyond:
        sides = " / ".join("settled" if s else "not" for s in (one.inside, one.outside))
        at = (
            f"{one.quantity.partition(' [')[0]} {one.value:.5g}"
            f" {one.quantity.partition('[')[2].rstrip(']')}"
        )
        lines.append(
            f"{one.name:48.48} {at:>26}  ∓ {100.0 * abs(one.margin):g} %: {sides} ({one.methods})"
            f"{'' if one.agreed else '   DISAGREE'}"
        )
    held = all(edge.agreed for edge in found) and all(edge.agreed for edge in beyond)
    picture, lines = _draw(found, bias), [*lines, "", table(claims)]
    return replace(
        save("failures", lines, figures, claims, picture, options.out), held=held
    )


@styled
def _draw(edges: list[FailureEdge], bias: dict[int, tuple[float, float]]) -> Figure:
    from sim.axes import legend_below

    figure = new_figure(11.5, 5.0)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for row, edge in enumerate(edges):
        for radius, settled in (
            (edge.inside, edge.settled_inside),
            (edge.outside, edge.settled_outside),
        ):
            left.plot(
                radius - 1.0,
                row,
                "o" if settled else "x",
                color=COLOURS[0] if settled else COLOURS[1],
            )
    threshold(left, 0.0, "pole radius 1", vertical=True)
    left.set_xscale("symlog", linthresh=1e-5)
    left.set_yticks(range(len(edges)), [edge.name for edge in edges], fontsize=7)
    left.grid(visible=False, axis="y")
    left.invert_yaxis()
    left.margins(x=0.1)
    left.set_xlabel("pole radius − 1 [1]")
    left.set_title("just inside and outside: ● simulation settled, × it did not")
    counts = sorted(bias)
    right.plot(
        counts,
        [bias[n][1] for n in counts],
        color=GREY,
        label=r"$1/(1-1/n_\mathrm{sub})$",
    )
    right.plot(
        counts,
        [bias[n][0] for n in counts],
        "o",
        color=COLOURS[1],
        label="semi-implicit Euler, heavy device",
    )
    right.set(
        xscale="log",
        xlabel="sub-steps per tick  [1]",
        ylabel=r"$K_\mathrm{max}$ over the exact one  [1]",
    )
    right.set_xticks(counts, [str(n) for n in counts])
    right.minorticks_off()
    right.set_title("what an integrator adds to $K_\\mathrm{max}$")
    legend_below(figure, [right])
    return figure
