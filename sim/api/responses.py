"""What a law renders, for notebooks: its response, its Bode plot and its K–B plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from nodes.stability.plant import Plant
from sim.api.laws import LawLike, compiled
from sim.api.laws import law as made
from sim.arrays import Array
from sim.experiments.rendered import LOWEST, POINTS, ZWidth, frequencies, rendered
from sim.experiments.rendered import z_width as plane
from sim.studies.notebook_results import Result, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

USUAL = Plant(period=0.002, mass=0.1, damping=1.0)  # the device where none is given: the paper's


@dataclass(frozen=True, repr=False)
class Response(Result):
    """Stiffness and damping that a law renders, one value a frequency."""

    name: str  # the law
    rate_hz: float  # of the loop [Hz]
    delay_ticks: float  # until its force acts [ticks]
    frequency_hz: Array
    stiffness_n_per_m: Array  # felt at the port, with hold and delay
    damping_n_s_per_m: Array
    law_stiffness_n_per_m: Array  # of the law alone
    law_damping_n_s_per_m: Array
    magnitude_n_per_m: Array
    phase_deg: Array

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Draw stiffness and damping against frequency; `ax`: two axes to draw in."""
        top, below = _axes(ax)
        for axes, key, unit in (
            (top, "stiffness_n_per_m", "N/m"),
            (below, "damping_n_s_per_m", "N s/m"),
        ):
            line = axes.semilogx(self.frequency_hz, getattr(self, key), label=f"{self.name}, felt")
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
        return _figure(top)


@dataclass(frozen=True, repr=False)
class ZWidthResult(Result):
    """How stiff laws may be over the gain of their damper."""

    names: tuple[str, ...]  # the laws
    plant: Plant  # the device and the loop's period
    _planes: tuple[ZWidth, ...]

    def columns(self) -> dict[str, Array]:
        """List gains and stiffnesses, those of each law after the other's."""
        names = [field.name for field in fields(ZWidth) if field.name != "kind"]
        return {
            name: np.concatenate([getattr(one, name) for one in self._planes]) for name in names
        }

    def of(self, name: str) -> ZWidth:
        """Return the plane of one law; KeyError names those there are."""
        if name not in self.names:
            raise KeyError(f"{name!r}: no such law here; there are {', '.join(self.names)}")
        return self._planes[self.names.index(name)]

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the K–B plane: stable below a line in known hands, passive below the dashed one in any; `ax`: where to draw."""
        axes = new_figure(height=4.0)[1][0] if ax is None else ax
        for name, one in zip(self.names, self._planes, strict=True):
            line = axes.plot(one.gain, one.h1_max_n_per_m, label=f"{name}, stable")
            axes.plot(
                one.gain,
                one.passive_n_per_m,
                ls="--",
                color=line[0].get_color(),
                label=f"{name}, passive",
            )
        axes.set(xlabel="gain B of the damper", ylabel="stiffness [N/m]", title="Z-width")
        axes.legend(frameon=False)
        return _figure(axes)


def _axes(ax: Sequence[Axes] | None) -> tuple[Axes, Axes]:
    if ax is None:
        top, below = new_figure(2, height=2.4)[1]
        return top, below
    if len(ax) != 2:
        raise ValueError(f"ax: {len(ax)} axes, expected two, one under the other")
    return ax[0], ax[1]


def _figure(axes: Axes) -> Figure:
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("ax: belongs to no figure")
    return figure


def response(
    law: LawLike,
    plant: Plant | None = None,
    frequency_hz: Array | Sequence[float] | None = None,
    lowest: float = LOWEST,
) -> Response:
    """Work out the stiffness and damping that a law renders against frequency, with the hold and the delay of the loop.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        Gives period [s] and delay [ticks]; 2 ms without a delay where there is none.
    frequency_hz : array_like, shape (n,), optional
        Above 0 and up to half the rate [Hz]; by default spread over the decades.
    lowest : float
        Where that begins [Hz].

    Returns
    -------
    Response
        Re G and Im G/ω at the port, and those of the law alone; ``.plot(ax=)`` draws them.

    Raises
    ------
    ValueError
        For a law with code of its own, and a frequency out of range.

    Examples
    --------
    >>> found = response({"kind": "pd", "stiffness": 1000, "damping": 3}, frequency_hz=[1.0])
    >>> round(float(found.stiffness_n_per_m[0]), 2), round(float(found.damping_n_s_per_m[0]), 3)
    (1000.08, 2.0)
    """
    device = plant or USUAL
    at = (
        frequencies(device.period, lowest, POINTS)
        if frequency_hz is None
        else np.asarray(frequency_hz, dtype=np.float64)
    )
    found = rendered(compiled(law, device.period), device.period, device.delay, at)
    columns = [getattr(found, field.name) for field in fields(found)]
    return Response(_name(law), 1.0 / device.period, device.delay, *columns)


def bode(
    law: LawLike, plant: Plant | None = None, ax: Sequence[Axes] | None = None, **options: Any
) -> Figure:
    """Draw magnitude and phase of what a law renders, with the hold and the delay of the loop.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        Gives period [s] and delay [ticks]; 2 ms without a delay where there is none.
    ax : sequence of two matplotlib.axes.Axes, optional
        Where to draw magnitude and phase; a figure of its own where none is given.
    **options : object
        Of `response`.

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
    top, below = _axes(ax)
    top.loglog(found.frequency_hz, found.magnitude_n_per_m, label=found.name)
    below.semilogx(found.frequency_hz, found.phase_deg, label=found.name)
    top.set_ylabel("magnitude [N/m]")
    below.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    top.legend(frameon=False)
    return _figure(top)


def z_width(
    laws: LawLike | Sequence[LawLike],
    plant: Plant | None = None,
    gains: Sequence[float] | Array | None = None,
) -> ZWidthResult:
    """Work out the K–B plane of one law or several: how stiff each may be at each gain of its damper.

    Parameters
    ----------
    laws : str, mapping, Law, or a list of them
        Their own stiffness and damping do not matter.
    plant : Plant, optional
        The device; 0.1 kg and 1 N s/m at 500 Hz where there is none.
    gains : array_like, shape (n,), optional
        Gains B; by default up to where PD on this device is stable with no stiffness, 2 m/T.

    Returns
    -------
    ZWidthResult
        K_max, H(1) there and the passive K over the gain; ``.plot(ax=)`` draws them.

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
    several = list(cast("Sequence[LawLike]", laws)) if _several(laws) else [cast("LawLike", laws)]
    chosen = [made(one, **_missing(one)) for one in several]
    top = 2.0 * device.mass / device.period / (1.0 + 2.0 * device.delay)
    at = np.linspace(0.0, top, 41) if gains is None else np.asarray(gains, dtype=np.float64)
    planes = tuple(plane(one, device, at.tolist()) for one in chosen)
    return ZWidthResult(tuple(_name(one) for one in several), device, planes)


def _several(laws: object) -> bool:
    """Whether a list names laws; one of numbers is the taps of one law."""
    return isinstance(laws, list | tuple) and not all(isinstance(one, int | float) for one in laws)


def _missing(law: LawLike) -> dict[str, float]:
    """Return a stiffness and a gain for a law given by its name alone: both are looked over."""
    return {"stiffness": 1.0, "damping": 1.0} if isinstance(law, str) else {}


def _name(law: Any) -> str:
    if isinstance(law, str):
        return law
    if isinstance(law, dict) and "kind" in law:
        return str(law["kind"])
    return str(getattr(law, "kind", "")) or "taps"
