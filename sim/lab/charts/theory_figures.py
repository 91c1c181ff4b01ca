"""The figure of THEORY.md §3: boundary curve of a law, regions of hands and worlds.

Lines differ by their dashes, so that the figure is readable in grey. Create it in Python with::

    from sim.lab.charts.theory_figures import draw

    draw("sim/figures/theory_boundary.png")
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nodes.laws.parse import parse_law
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.loop_region import known_answer
from nodes.stability.plant import Plant
from nodes.stability.worlds import AnyWorld, world_k_max

PERIOD = 0.002
MASS, DAMPING = 0.1, 1.0
WIDTH_IN = 7.0  # column width of a page [inch]


def draw(path: str | Path) -> None:
    """Write the figure as a PNG file.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    ValueError
        If the law of the right panel has no certified stiffness.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, 3.1), layout="constrained")
    left, right = figure.subplots(1, 2)
    _curve(left)
    _regions(right)
    figure.savefig(path, dpi=150, metadata={"Software": None})


def _curve(axes: Any) -> None:
    """Plot K(θ) of (3.4) for PD with B = 3 N s/m, without delay and at one tick."""
    law = without_spring(
        parse_law({"kind": "pd", "stiffness": 1.0, "damping": 3.0}), PERIOD
    )
    theta = np.linspace(0.02, np.pi - 1e-3, 4000)
    z = np.exp(1j * theta)
    for delay, dashes, offset in ((0.0, "-", (2, -14)), (1.0, "--", (14, 2))):
        plant = Plant(PERIOD, MASS, DAMPING, delay)
        stiffness = -(1.0 - 1.0 / z) / known_answer(plant, theta) - law.response(z)
        near = np.abs(stiffness) < 6000.0
        axes.plot(
            stiffness.real[near],
            stiffness.imag[near],
            dashes,
            color="black",
            lw=1.2,
            label=f"d = {delay:.0f}",
        )
        edge = k_max(law, plant).k_max_n_per_m
        axes.plot(edge, 0.0, "o", color="black", ms=4)
        axes.annotate(
            f"K_max {edge:.0f}",
            (edge, 0.0),
            offset,
            textcoords="offset points",
            fontsize=8,
        )
    axes.axhline(0.0, color="0.6", lw=0.7)
    axes.set(xlabel="Re K [N/m]", ylabel="Im K [N/m]", ylim=(-800.0, 3000.0))
    axes.set_title("Boundary curve (3.4), PD, B = 3", fontsize=10)
    axes.legend(fontsize=8, loc="upper left")


def _regions(axes: Any) -> None:
    """Plot the disc of hands and the half plane of worlds where (18.4) is tightest."""
    law = without_spring(
        parse_law({"kind": "pd", "stiffness": 1.0, "damping": 0.2}), PERIOD
    )
    edge = world_k_max(
        law, Plant(PERIOD, MASS, DAMPING, 1.0), AnyWorld(), True
    ).k_max_n_per_m
    if edge is None:
        raise ValueError(
            "no stiffness of this law is certified for any hand and any world (THEORY.md §18)"
        )
    theta = np.linspace(0.02, np.pi, 4000)
    w = np.exp(-1j * theta)
    line = -((1.0 - w) / PERIOD / with_spring(law, edge).response(1.0 / w)).real
    room = ((w**2).real - 1.0) / (2.0 * DAMPING) - line
    at = int(np.argmin(room))
    middle, radius = w[at] ** 2 / (2.0 * DAMPING), 1.0 / (2.0 * DAMPING)
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
    disc = middle + radius * turn
    axes.fill(disc.real, disc.imag, color="0.85")
    axes.plot(disc.real, disc.imag, "-", color="black", lw=1.2)
    axes.plot(middle.real, middle.imag, "+", color="black")
    axes.axvline(line[at], color="black", ls="--", lw=1.2)
    axes.axvspan(-2.0, line[at], facecolor="none", edgecolor="0.5", hatch="//", lw=0.0)
    axes.annotate(
        "V P_d of\nany hand",
        (middle.real, middle.imag),
        (-18, 6),
        textcoords="offset points",
        fontsize=8,
    )
    axes.annotate(
        "−V/H − Y of\nany world", (-1.75, -1.1), fontsize=8, backgroundcolor="white"
    )
    axes.set(
        xlabel="Re [m/(N s)]", ylabel="Im [m/(N s)]", xlim=(-2.0, 1.0), ylim=(-1.5, 1.5)
    )
    axes.set_aspect("equal")
    axes.set_title(f"Any hand, any world: d = 1, K = {edge:.0f}", fontsize=10)
