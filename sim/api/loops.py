"""Largest stable stiffness and poles of a law on a device, without starting a process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from nodes.stability import k_max as stability
from nodes.stability.closed_loop import pole_radius, state_matrix
from nodes.stability.plant import Plant
from nodes.stability.worlds import hand_text, world_k_max
from sim.api.laws import LawLike, compiled
from sim.api.laws import law as made
from sim.api.named_worlds import read_world
from sim.arrays import Array
from sim.studies.notebook_results import Result, figure_of, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SHOWN = 41


@dataclass(frozen=True, repr=False)
class KMaxResult(Result):
    """Largest stable stiffness of a law on a device."""

    # largest stable nominal stiffness [N/m]; None: none is stable
    k_max_n_per_m: float | None
    h1_max_n_per_m: float | None  # DC stiffness there, H(1) [N/m]
    method: str  # ``closed_form``, ``pole_radius``, or ``certificate`` for worlds other than a wall
    # stable intervals of the nominal stiffness [N/m]
    stable: tuple[tuple[float, float], ...]
    plant: Plant  # the device and the loop's period
    about: str  # the worlds and hands for which it holds
    _derivative: Any

    def plot(self, ax: Axes | None = None) -> Figure:
        """Plot the pole radius over the nominal stiffness, in the axes `ax` if given.

        The loop is stable below 1.
        """
        axes = new_figure()[1][0] if ax is None else ax
        top = 1.3 * (self.k_max_n_per_m or 1000.0)
        if not np.isfinite(top):
            top = 1e5
        stiffness = np.linspace(top / _SHOWN, top, _SHOWN)
        radius = [
            pole_radius(stability.with_spring(self._derivative, value), self.plant)
            for value in stiffness.tolist()
        ]
        axes.plot(stiffness, radius, label="pole radius")
        axes.axhline(1.0, color="0.5", lw=0.8, label="edge of stability")
        if self.k_max_n_per_m is not None and np.isfinite(self.k_max_n_per_m):
            axes.axvline(
                self.k_max_n_per_m,
                color="0.5",
                ls="--",
                lw=0.8,
                label=f"K_max {self.k_max_n_per_m:.4g} N/m",
            )
        axes.set(xlabel="nominal stiffness K [N/m]", ylabel="pole radius")
        axes.legend(frameon=False)
        return figure_of(axes)


@dataclass(frozen=True, repr=False)
class Poles(Result):
    """Poles of a law on a device."""

    radius: float  # largest pole radius; the loop decays by this factor per tick
    stable: bool  # whether the radius is below 1
    real: Array  # real parts of all poles, the largest pole first
    imaginary: Array

    def plot(self, ax: Axes | None = None) -> Figure:
        """Plot the poles in the z plane, with the unit circle, in the axes `ax` if given."""
        axes = new_figure(width=4.2, height=4.2)[1][0] if ax is None else ax
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        axes.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8)
        axes.plot(self.real, self.imaginary, "x", ls="none")
        axes.set(
            xlabel="Re z",
            ylabel="Im z",
            aspect="equal",
            title=f"pole radius {self.radius:.5g}",
        )
        return figure_of(axes)


def k_max(
    law: LawLike, plant: Plant, world: str = "wall", **options: Any
) -> KMaxResult:
    """Compute the largest stable stiffness of a law, everything else fixed.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law; its own stiffness is ignored.
    plant : Plant
        Period [s], mass [kg], damping [N s/m], delay [ticks] and a hand's stiffness [N/m].
    world : str
        The world that the device is coupled to (THEORY.md §18). ``wall``; ``spring``, any stiffness
        within a range; ``any``, every passive world that answers in the same tick; ``any_hand``,
        the same in every passive hand; ``any_hand_wall``; ``tool`` and ``any_hand_tool``, a stepped
        tool that carries any passive load; ``euler_tool``, a tool of known mass, moved by
        semi-implicit Euler, with implicit bodies behind it; ``two_hands``, a second device in any
        hand.
    **options : object
        Options of the world: ``springs`` (softest, stiffest) [N/m], ``tool_damping`` [N s/m],
        ``tool_mass`` [kg], ``other``, the second device (Plant).

    Returns
    -------
    KMaxResult
        K_max of a wall, or the largest certified stiffness of another world; ``.plot()`` plots the
        pole radius up to it.

    Raises
    ------
    ValueError
        For a law with code of its own, which has no poles, for an unknown world, or for options
        that the world does not have.

    Examples
    --------
    >>> pd = made("pd", stiffness=1, damping=3)
    >>> plant = Plant(period=0.002, mass=0.1, damping=1.0)
    >>> k_max(pd, plant).k_max_n_per_m
    3781.8664...
    >>> k_max(pd, plant, world="any").k_max_n_per_m
    2244.217...
    """
    from nodes.laws import CompiledLaw

    if isinstance(law, CompiledLaw):
        derivative = stability.with_spring(law, -law.h1)
    else:
        derivative = stability.without_spring(made(law), plant.period)
    kind, any_hand = read_world(world, options)
    if world == "wall":
        found = stability.k_max(derivative, plant)
        about = f"{kind.about}; {hand_text(plant, any_hand)}"
        return KMaxResult(
            found.k_max_n_per_m,
            found.h1_max_n_per_m,
            found.method,
            found.stable,
            plant,
            about,
            derivative,
        )
    edge = world_k_max(derivative, plant, kind, any_hand)
    top, low = edge.k_max_n_per_m, edge.low_n_per_m
    if top is None or low is None:
        return KMaxResult(None, None, "certificate", (), plant, edge.about, derivative)
    return KMaxResult(
        top,
        top + derivative.h1,
        "certificate",
        ((low, top),),
        plant,
        edge.about,
        derivative,
    )


def poles(law: LawLike, plant: Plant) -> Poles:
    """Compute the poles of a law on a device, exactly, with zero-order hold and delay.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant
        Period [s], mass [kg], damping [N s/m], delay [ticks] and a hand's stiffness [N/m].

    Returns
    -------
    Poles
        Stable when the radius is below 1.

    Raises
    ------
    ValueError
        For a law with code of its own, which has no poles.

    Examples
    --------
    >>> poles({"kind": "pd", "stiffness": 1500, "damping": 3}, Plant(0.002, 0.1, 1.0)).stable
    True
    """
    taps = compiled(law, plant.period)
    if taps.evaluate is not None:
        raise ValueError("law: has code of its own and no poles; play it instead")
    matrix = state_matrix(taps, plant)
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    found = found[np.argsort(-np.abs(found))]
    radius = pole_radius(taps, plant)
    return Poles(radius, radius < 1.0, found.real.copy(), found.imag.copy())
