"""Rendered response, Bode plot and K–B plane of a law, for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from nodes.stability.plant import Plant
from sim.api.laws import LawLike, compiled, law_name
from sim.api.laws import law as made
from sim.arrays import Array
from sim.experiments.rendered import LOWEST, POINTS, ZWidth, frequencies, rendered
from sim.experiments.rendered import z_width as plane
from sim.studies.law_looks import law_looks
from sim.studies.notebook_results import Result, figure_of, new_figure, two_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

USUAL = Plant(period=0.002, mass=0.1, damping=1.0)  # default device: that of the paper


@dataclass(frozen=True, repr=False)
class Response(Result):
    """Rendered stiffness and damping of a law, one value per frequency."""

    name: str  # name of the law
    rate_hz: float  # tick rate of the loop [Hz]
    delay_ticks: float  # delay of the force [ticks]
    frequency_hz: Array
    stiffness_n_per_m: Array  # at the port, with hold and delay
    damping_n_s_per_m: Array
    law_stiffness_n_per_m: Array  # of the law alone
    law_damping_n_s_per_m: Array
    magnitude_n_per_m: Array
    phase_deg: Array

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Plot stiffness and damping over frequency, in the two axes `ax` if given."""
        top, below = two_axes(ax)
        for axes, key, unit in (
            (top, "stiffness_n_per_m", "N/m"),
            (below, "damping_n_s_per_m", "N s/m"),
        ):
            line = axes.semilogx(
                self.frequency_hz, getattr(self, key), label=f"{self.name}, felt"
            )
            axes.semilogx(
                self.frequency_hz,
                getattr(self, f"law_{key}"),
                ls="--",
                color=line[0].get_color(),
                label="law alone",
            )
            axes.set_ylabel(f"{key.partition('_')[0]} [{unit}]")
        top.legend(frameon=False)
        below.set_xlabel("frequency [Hz]")
        return figure_of(top)


@dataclass(frozen=True, repr=False)
class ZWidthResult(Result):
    """Largest stiffness of laws over their damping gain."""

    names: tuple[str, ...]  # names of the laws
    plant: Plant  # the device and the loop's period
    _planes: tuple[ZWidth, ...]

    def columns(self) -> dict[str, Array]:
        """Return gains and stiffnesses, law after law."""
        names = [field.name for field in fields(ZWidth) if field.name != "kind"]
        return {
            name: np.concatenate([getattr(one, name) for one in self._planes])
            for name in names
        }

    def of(self, name: str) -> ZWidth:
        """Return the plane of one law; KeyError lists the names."""
        if name not in self.names:
            raise KeyError(
                f"{name!r}: no such law here; there are {', '.join(self.names)}"
            )
        return self._planes[self.names.index(name)]

    def plot(self, ax: Axes | None = None) -> Figure:
        """Plot the K–B plane, in the axes `ax` if given.

        Stable below the heavy line in known hands; passive below the thin one in any hand.
        """
        axes = new_figure(height=4.0)[1][0] if ax is None else ax
        looks = law_looks(self.names)
        for name, look, one in zip(self.names, looks, self._planes, strict=True):
            axes.plot(
                one.gain, one.h1_max_n_per_m, **look.curve(), label=f"{name}, stable"
            )
            passive: dict[str, Any] = look.curve() | {"lw": 0.7}
            axes.plot(
                one.gain, one.passive_n_per_m, **passive, label=f"{name}, passive"
            )
        axes.set(
            xlabel="gain B of the damper", ylabel="stiffness [N/m]", title="Z-width"
        )
        axes.legend(frameon=False)
        return figure_of(axes)


def response(
    law: LawLike,
    plant: Plant | None = None,
    frequency_hz: Array | Sequence[float] | None = None,
    lowest: float = LOWEST,
) -> Response:
    """Compute the rendered stiffness and damping over frequency, with hold and delay.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        Period [s] and delay [ticks]; by default 2 ms without a delay.
    frequency_hz : array_like, shape (n,), optional
        Frequencies above 0 and up to half the rate [Hz]; by default spaced logarithmically.
    lowest : float
        Lowest of the default frequencies [Hz].

    Returns
    -------
    Response
        Re G and Im G/ω at the port, and those of the law alone; ``.plot(ax=)`` plots them.

    Raises
    ------
    ValueError
        For a law with code of its own, and for a frequency out of range.

    Examples
    --------
    >>> found = response({"kind": "pd", "stiffness": 1000, "damping": 3}, frequency_hz=[1.0])
    >>> round(float(found.stiffness_n_per_m[0]), 2), round(float(found.damping_n_s_per_m[0]), 3)
    (1000.21, 2.0)
    """
    device = plant or USUAL
    at = (
        frequencies(device.period, lowest, POINTS)
        if frequency_hz is None
        else np.asarray(frequency_hz, dtype=np.float64)
    )
    found = rendered(compiled(law, device.period), device.period, device.delay, at)
    columns = [getattr(found, field.name) for field in fields(found)]
    return Response(law_name(law), 1.0 / device.period, device.delay, *columns)


def bode(
    law: LawLike,
    plant: Plant | None = None,
    ax: Sequence[Axes] | None = None,
    **options: Any,
) -> Figure:
    """Plot magnitude and phase of a law's response, with hold and delay.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        Period [s] and delay [ticks]; by default 2 ms without a delay.
    ax : sequence of two matplotlib.axes.Axes, optional
        Axes of magnitude and phase; by default those of a new figure.
    **options : object
        Options of `response`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ValueError
        As `response` does.

    Examples
    --------
    >>> len(bode({"kind": "pd", "stiffness": 1000, "damping": 3}).axes)
    2
    """
    found = response(law, plant, **options)
    top, below = two_axes(ax)
    top.loglog(found.frequency_hz, found.magnitude_n_per_m, label=found.name)
    below.semilogx(found.frequency_hz, found.phase_deg, label=found.name)
    top.set_ylabel("magnitude [N/m]")
    below.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    top.legend(frameon=False)
    return figure_of(top)


def z_width(
    laws: LawLike | Sequence[LawLike],
    plant: Plant | None = None,
    gains: Sequence[float] | Array | None = None,
) -> ZWidthResult:
    """Compute the K–B plane of laws: K_max of each over the gain of its damper.

    Parameters
    ----------
    laws : str, mapping, Law, or a list of them
        The laws; their own stiffness and damping are ignored.
    plant : Plant, optional
        The device; by default 0.1 kg and 1 N s/m at 500 Hz.
    gains : array_like, shape (n,), optional
        Gains B [N s/m]; by default up to 2 m/T, where PD is stable only with no stiffness.

    Returns
    -------
    ZWidthResult
        K_max, its H(1) and the passive K over the gain; ``.plot(ax=)`` plots them.

    Raises
    ------
    ValueError
        For a law without the parameters ``stiffness`` and ``damping``, or with code of its own.

    Examples
    --------
    >>> found = z_width({"kind": "pd", "stiffness": 1, "damping": 1}, gains=[0.0, 3.0])
    >>> found.of("pd").k_max_n_per_m.round()
    array([1003., 3782.])
    """
    device = plant or USUAL
    several = (
        list(cast("Sequence[LawLike]", laws))
        if _several(laws)
        else [cast("LawLike", laws)]
    )
    chosen = [made(one, **_missing(one)) for one in several]
    top = 2.0 * device.mass / device.period / (1.0 + 2.0 * device.delay)
    at = (
        np.linspace(0.0, top, 41)
        if gains is None
        else np.asarray(gains, dtype=np.float64)
    )
    planes = tuple(plane(one, device, at.tolist()) for one in chosen)
    return ZWidthResult(tuple(law_name(one) for one in several), device, planes)


def _several(laws: object) -> bool:
    """Return whether a list contains laws; a list of numbers is one law's taps."""
    return isinstance(laws, list | tuple) and not all(
        isinstance(one, int | float) for one in laws
    )


def _missing(law: LawLike) -> dict[str, float]:
    """Return stiffness and damping for a law given by name alone; the search replaces both."""
    return {"stiffness": 1.0, "damping": 1.0} if isinstance(law, str) else {}
