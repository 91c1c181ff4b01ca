"""Map of the limit-cycle-free stiffness over friction and encoder step (THEORY.md §5)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.recording.figure_style import COLOURS, new_figure, save_figure, styled
from nodes.stability.k_max import k_max, with_spring
from nodes.stability.plant import Plant
from sim.axes import plain_log
from sim.results import fresh
from sim.stability.rest import ComesToRest, Rest, rest, stiffest_at_rest

DECADES = 1.5  # range of the map on either side of the device [decades]
_SHOWN, _TOLD = 121, 13


@dataclass(frozen=True)
class RestMap:
    """Stiffest K at rest over friction and encoder step."""

    friction_n: Any
    resolution_m: Any
    k_rest_n_per_m: Any  # shape (resolutions, frictions); NaN: none
    k_max_n_per_m: float | None
    plot: Path


@dataclass(frozen=True)
class RestFound:
    """What a law needs to come to rest, and what a friction is enough for."""

    rest: Rest
    map: RestMap
    # with the given friction; None: none was given
    limit_cycle_free: ComesToRest | None = None
    # stiffest at rest with it; None: none, or none given
    k_rest_n_per_m: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the figures, the frictions at the top level, with the text."""
        figures = vars(self) | vars(self.rest) | {"text": self.rest.text()}
        return {name: one for name, one in figures.items() if name != "rest"}


def rest_map(
    law: CompiledLaw,
    stiffness: float,
    device: Plant,
    resolution: float,
    friction: float,
    path: Path,
) -> RestMap:
    """Plot the lesser of K_rest and K_max over friction and encoder step; return the data."""
    derivative = with_spring(law, -stiffness)
    limit = k_max(derivative, device).k_max_n_per_m
    # Where no stiffness is stable, none is free of limit cycles.
    top = 0.0 if limit is None else limit

    def over(count: int) -> tuple[Any, Any, Any]:
        factors = np.logspace(-DECADES, DECADES, count)
        frictions = friction * factors
        steps = resolution * factors
        k = np.array(
            [
                [stiffest_at_rest(derivative, step, force) for force in frictions]
                for step in steps.tolist()
            ]
        )
        return frictions, steps, np.minimum(k, top)

    frictions, steps, k = over(_TOLD)
    found = rest(law, device, resolution)
    _draw(
        path,
        over(_SHOWN),
        (resolution, friction),
        (found.friction_bound_n, found.friction_estimated_n),
        stiffness,
    )
    bounded = limit if limit is not None and math.isfinite(limit) else None
    return RestMap(frictions, steps, np.where(k > 0.0, k, math.nan), bounded, path)


@styled
def _draw(
    path: Path,
    grid: tuple[Any, Any, Any],
    here: tuple[float, float],
    needed: tuple[float, float | None],
    stiffness: float,
) -> None:
    from matplotlib.colors import LogNorm

    frictions, steps, k = grid
    resolution, friction = here
    figure = new_figure(6.6, 4.6)
    axes = figure.add_subplot(
        xlabel="dry friction [N]",
        ylabel="encoder step [µm]",
        xscale="log",
        yscale="log",
    )
    axes.set_title("largest K whose every motion stops")
    axes.grid(visible=False)
    shown = np.ma.masked_less_equal(k, 0.0)
    if shown.count():
        norm = LogNorm(
            max(float(shown.min()), 1e-2 * float(shown.max())),
            float(shown.max()) * (1.0 + 1e-9),
        )
        # Rasterised: thousands of cells would show seams in SVG.
        image = axes.pcolormesh(
            frictions,
            1e6 * steps,
            shown,
            norm=norm,
            cmap="cividis",
            shading="nearest",
            rasterized=True,
        )
        figure.colorbar(image, ax=axes, label="K [N/m]; blank: none")
    for force, style, label in zip(
        needed, ("-", "--"), ("bound", "estimate"), strict=True
    ):
        if force:
            axes.plot(
                force / resolution * steps,
                1e6 * steps,
                "k" + style,
                lw=1.2,
                label=f"K = {stiffness:.4g} N/m, {label}",
            )
    axes.plot(
        friction,
        1e6 * resolution,
        "o",
        color=COLOURS[1],
        mec="white",
        ms=7,
        label="this device",
    )
    axes.set(xlim=(frictions[0], frictions[-1]), ylim=(1e6 * steps[0], 1e6 * steps[-1]))
    plain_log(axes.xaxis, float(frictions[0]), float(frictions[-1]))
    plain_log(axes.yaxis, 1e6 * float(steps[0]), 1e6 * float(steps[-1]))
    axes.legend(loc="lower right", frameon=True)
    save_figure(figure, path, fresh)
