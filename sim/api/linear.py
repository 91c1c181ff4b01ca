"""A law and its loop as linear systems: scipy, python-control, margins and their plots.

The loop is broken at the force: L(z) = H(z)·P(z), with H the law and P the device, held and
delayed, from force to position (`nodes.stability.plant.held_plant`). The closed loop is stable when
all zeros of 1 + L lie inside the unit circle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius, state_matrix
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.pair import as_one
from nodes.stability.plant import Plant, held_plant
from sim.api.laws import LawLike, law_name
from sim.api.laws import law as made
from sim.api.linear_systems import as_control, linear_law

# The entry points of haptic.results name these two here.
from sim.api.linear_systems import to_control as to_control
from sim.api.linear_systems import to_scipy as to_scipy
from sim.api.responses import USUAL
from sim.arrays import Array
from sim.studies.notebook_results import Result, figure_of, new_figure, two_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 2000  # frequencies of a plot of the loop
# factors on the law among which a margin is searched
_FACTORS = np.geomspace(1e-3, 1e3, 241)
_LOCUS = 160  # stiffnesses of a root locus


@dataclass(frozen=True, repr=False)
class OpenLoop(Result):
    """The loop of a law and a device, broken at the force.

    Its methods return L as a system of scipy or python-control, and plot it.
    """

    name: str  # name of the law
    stable: bool  # whether the closed loop is stable
    radius: float  # largest pole radius of the closed loop
    # factors on the whole law between which the closed loop stays stable; None: no such edge
    gain_margin: float | None
    least_gain: float | None
    # at the last frequency where |L| = 1; None if it never is
    phase_margin_deg: float | None
    crossover_hz: float | None  # that frequency
    plant: Plant
    frequency_hz: Array
    magnitude: Array  # |L|
    phase_deg: Array
    _law: CompiledLaw
    _nominal: Any  # the law without its spring, and its own nominal stiffness [N/m]

    def device_to_scipy(self) -> Any:
        """Return the device, held and delayed, from force [N] to position [m].

        Returns
        -------
        scipy.signal.dlti
            A transfer function in z.
        """
        from scipy import signal

        numerator, denominator = _device(self.plant)
        return signal.TransferFunction(numerator, denominator, dt=self.plant.period)

    def to_scipy(self) -> Any:
        """Return L(z) as a system of scipy.

        Returns
        -------
        scipy.signal.dlti
            A transfer function in z.

        Raises
        ------
        ValueError
            For a law with recursive sections.
        """
        from scipy import signal

        if self._law.sections:
            raise ValueError(
                "law: recursive sections make an ill-conditioned product; use to_scipy of law and"
                " device, or to_control"
            )
        numerator, denominator = _device(self.plant)
        taps = np.array(self._law.taps)
        num = np.convolve(taps, numerator)
        den = np.concatenate([denominator, np.zeros(len(taps) - 1)])
        return signal.TransferFunction(num, den, dt=self.plant.period)

    def to_control(self) -> Any:
        """Return L(z) as a system of python-control.

        Returns
        -------
        control.TransferFunction or control.StateSpace
            The open loop; ``control.feedback(…, 1)`` closes it.

        Raises
        ------
        ModuleNotFoundError
            If python-control is not installed.
        """
        law = self._law.sections and as_control(to_scipy(self._law, self.plant))
        return (
            law * as_control(self.device_to_scipy())
            if law
            else as_control(self.to_scipy())
        )

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Plot magnitude and phase of L over frequency.

        Parameters
        ----------
        ax : sequence of two matplotlib.axes.Axes, optional
            Axes to draw in; by default those of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        top, below = two_axes(ax)
        top.loglog(self.frequency_hz, self.magnitude, label=self.name)
        below.semilogx(self.frequency_hz, self.phase_deg, label=self.name)
        top.axhline(1.0, color="0.6", lw=0.8, ls="-")
        top.set_ylabel("|L|")
        below.set(xlabel="frequency [Hz]", ylabel="phase of L [deg]")
        top.legend(frameon=False)
        return figure_of(top)

    def nyquist(self, ax: Axes | None = None) -> Figure:
        """Plot L in the complex plane, with −1.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw in; by default those of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        axes = new_figure(width=4.6, height=4.2)[1][0] if ax is None else ax
        values = self.magnitude * np.exp(1j * np.radians(self.phase_deg))
        near = np.abs(values) <= 5.0  # a device that is free goes to infinity at rest
        line = axes.plot(values.real[near], values.imag[near], label=self.name)
        axes.plot(
            values.real[near], -values.imag[near], color=line[0].get_color(), ls=":"
        )
        axes.plot([-1.0], [0.0], "k+", ls="none")
        axes.set(xlabel="Re L", ylabel="Im L", aspect="equal", title="Nyquist plot")
        axes.legend(frameon=False)
        return figure_of(axes)

    def root_locus(self, ax: Axes | None = None, most: float | None = None) -> Figure:
        """Plot the closed loop's poles while the nominal stiffness grows.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw in; by default those of a new figure.
        most : float, optional
            Largest stiffness [N/m]; by default one and a half K_max.

        Returns
        -------
        matplotlib.figure.Figure
            The figure; a cross marks each pole of the law as it is.
        """
        axes = new_figure(width=4.6, height=4.2)[1][0] if ax is None else ax
        derivative, nominal = self._nominal
        edge = k_max(derivative, self.plant).k_max_n_per_m
        top = most or 1.5 * (
            edge if edge and np.isfinite(edge) else 2.0 * max(nominal, 1.0)
        )
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        axes.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8, ls="-")
        poles = self.locus(np.linspace(top / _LOCUS, top, _LOCUS))
        axes.plot(
            poles.real.ravel(),
            poles.imag.ravel(),
            ".",
            ms=2.0,
            ls="none",
            label=self.name,
        )
        here = np.linalg.eigvals(state_matrix(self._law, self.plant))
        axes.plot(here.real, here.imag, "kx", ls="none")
        title = f"K from 0 to {top:.4g} N/m" + (f", K_max {edge:.4g}" if edge else "")
        axes.set(xlabel="Re z", ylabel="Im z", aspect="equal", title=title)
        return figure_of(axes)

    def locus(self, stiffness: Array) -> NDArray[np.complex128]:
        """Return the closed loop's poles at several nominal stiffnesses.

        Parameters
        ----------
        stiffness : array_like, shape (n,)
            Nominal stiffnesses [N/m].

        Returns
        -------
        ndarray of complex, shape (n, poles)
            Poles in the z plane.
        """
        derivative, _ = self._nominal
        rows = [
            np.linalg.eigvals(state_matrix(with_spring(derivative, value), self.plant))
            for value in np.asarray(stiffness, dtype=np.float64).tolist()
        ]
        return np.array(rows, dtype=np.complex128)


def _device(plant: Plant) -> tuple[Array, Array]:
    """Return numerator and denominator of the held, delayed device [m/N], highest power first."""
    one = as_one(plant)
    if one.partner is not None:
        raise ValueError(
            "plant: a pair has no transfer function of low order; use haptic.poles"
        )
    held = held_plant(one)
    numerator = np.array(held.numerator)
    denominator = np.concatenate([held.denominator, np.zeros(held.whole + 1)])
    while numerator[-1] == 0.0 and denominator[-1] == 0.0 and len(numerator) > 1:
        numerator, denominator = numerator[:-1], denominator[:-1]  # a common factor z
    return numerator, denominator


def loop(law: LawLike, plant: Plant | None = None) -> OpenLoop:
    """Return the loop of a law and a device, broken at the force: margins and plots.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        The device; by default 0.1 kg and 1 N s/m at 500 Hz.

    Returns
    -------
    OpenLoop
        ``.plot(ax=)`` is its Bode plot, ``.nyquist(ax=)`` and ``.root_locus(ax=)`` the others;
        ``.to_scipy()`` and ``.to_control()`` return L.

    Raises
    ------
    ValueError
        For a law with code of its own, or a plant with a partner that moves.

    Examples
    --------
    >>> pd = {"kind": "pd", "stiffness": 1500, "damping": 3}
    >>> round(loop(pd, Plant(rate=500, mass=0.1, damping=1.0)).gain_margin, 3)
    11.704
    """
    device = plant or USUAL
    found = linear_law(law, device.period)
    numerator, denominator = _device(device)
    frequency = np.geomspace(1e-4 / device.period, 0.5 / device.period, POINTS)
    z = np.exp(2j * np.pi * frequency * device.period)
    values = found.response(z) * np.polyval(numerator, z) / np.polyval(denominator, z)
    magnitude, phase = np.abs(values), np.degrees(np.unwrap(np.angle(values)))
    radius = pole_radius(found, device)
    low, high = _gain_edges(found, device) if radius < 1.0 else (None, None)
    crossing = np.flatnonzero((magnitude[:-1] >= 1.0) & (magnitude[1:] < 1.0))
    crossover, margin = None, None
    if len(crossing):
        i = int(crossing[-1])
        share = np.log(magnitude[i]) / (np.log(magnitude[i]) - np.log(magnitude[i + 1]))
        crossover = float(frequency[i] * (frequency[i + 1] / frequency[i]) ** share)
        at = phase[i] + share * (phase[i + 1] - phase[i])
        margin = float((at + 180.0 + 180.0) % 360.0 - 180.0)
    if isinstance(law, CompiledLaw):
        nominal = (with_spring(found, -found.h1), found.h1)
    else:
        nominal = (without_spring(made(law), device.period), _spring(made(law), found))
    return OpenLoop(
        law_name(law),
        radius < 1.0,
        radius,
        high,
        low,
        margin,
        crossover,
        device,
        frequency,
        magnitude,
        phase,
        found,
        nominal,
    )


def _spring(law: Any, found: CompiledLaw) -> float:
    return float(getattr(law, "stiffness", found.h1))


def _gain_edges(law: CompiledLaw, plant: Plant) -> tuple[float | None, float | None]:
    """Return the factors on a stable loop's law at its edges: below 1 and above."""

    def radius(factor: float) -> float:
        return pole_radius(scaled(law, factor), plant)

    def edge(factors: Array) -> float | None:
        inside = 1.0
        for outside in factors.tolist():
            if radius(outside) >= 1.0:
                while abs(outside - inside) > 1e-9 * inside:
                    middle = 0.5 * (inside + outside)
                    inside, outside = (
                        (middle, outside) if radius(middle) < 1.0 else (inside, middle)
                    )
                return inside
            inside = outside
        return None

    return edge(_FACTORS[_FACTORS < 1.0][::-1]), edge(_FACTORS[_FACTORS > 1.0])


def scaled(law: CompiledLaw, factor: float) -> CompiledLaw:
    """Return a linear law with all forces multiplied by a factor."""
    sections = tuple(
        (factor * b0, factor * b1, a1, a2) for b0, b1, a1, a2 in law.sections
    )
    return replace(law, taps=tuple(factor * tap for tap in law.taps), sections=sections)
