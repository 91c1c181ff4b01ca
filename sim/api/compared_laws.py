"""Laws side by side on one device: what each renders, bears and needs."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError
from nodes.stability.closed_loop import pole_radius
from sim.api.laws import LawLike, compiled, law_name
from sim.api.laws import law as made
from sim.api.loops import k_max
from sim.api.played import drop
from sim.api.responses import USUAL, Response, response
from sim.arrays import Array
from sim.stability.rest import rest
from sim.studies.notebook_results import Result, overlay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nodes.stability.plant import Plant

RESOLUTION = 2.3e-5  # step of the encoder by default, that of a Touch [m]
DROPPED = 1500  # ticks of the drop
_GRID = 2001  # frequencies at which the largest gain of noise is searched


@dataclass(frozen=True, repr=False)
class LawTable(Result):
    """Laws on one device, a row each; NaN where a law with code of its own has no figure."""

    law: NDArray[np.str_]  # name
    k_max_wall_n_per_m: Array  # largest stable nominal stiffness at a wall
    # the same before any world that answers in the same tick
    k_max_any_world_n_per_m: Array
    h1_n_per_m: Array  # stiffness felt at rest, H(1)
    # largest |H| up to half the rate: force per error of the encoder
    noise_gain_n_per_m: Array
    pole_radius: Array  # of the loop as given; stable below 1
    # whether a mass dropped from 10 mm comes to rest, with the clamp
    lands: NDArray[np.bool_]
    peak_force_n: Array  # largest force of that drop
    rest_friction_n: Array  # friction with which no limit cycle persists: (Δ/2) Σ|h_m|
    plant: Plant
    resolution_m: float  # step Δ of the encoder, for `rest_friction_n`
    _responses: Mapping[str, Response]

    def __len__(self) -> int:
        return len(self.law)

    def rows(self) -> list[dict[str, Any]]:
        """Return the table as one mapping per law.

        Returns
        -------
        list of dict
            Column to value, as Python numbers.
        """
        columns = {name: values.tolist() for name, values in self.columns().items()}
        return [
            dict(zip(columns, values, strict=True))
            for values in zip(*columns.values(), strict=True)
        ]

    def figures(self) -> dict[str, Any]:
        """Return each figure with its values, in the order of the laws."""
        return {name: tuple(values.tolist()) for name, values in self.columns().items()}

    def __str__(self) -> str:
        table = [
            [name, *map(_shown, values)] for name, values in self.figures().items()
        ]
        first = max(len(row[0]) for row in table)
        wide = max(len(cell) for row in table for cell in row[1:])
        lines = [
            "  ".join([f"  {name:{first}}", *(f"{cell:>{wide}}" for cell in cells)])
            for name, *cells in table
        ]
        return "\n".join([type(self).__name__, *lines])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{name}</th>"
            + "".join(f"<td>{html.escape(_shown(value))}</td>" for value in values)
            + "</tr>"
            for name, values in self.figures().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Plot rendered stiffness and damping of all laws over frequency.

        Parameters
        ----------
        ax : sequence of two matplotlib.axes.Axes, optional
            Axes to draw in; by default those of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        return overlay(self._responses, ax)


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value:.5g}"
    return str(value)


def compare(
    laws: LawLike | Sequence[LawLike] | Mapping[str, LawLike],
    plant: Plant | None = None,
    resolution: float = RESOLUTION,
) -> LawTable:
    """Compare laws on one device: stability, stiffness, noise, landing and rest.

    Parameters
    ----------
    laws : sequence of laws, or mapping of str to law
        Laws as `haptic.law` takes them; a mapping names them.
    plant : Plant, optional
        The device; by default 0.1 kg and 1 N s/m at 500 Hz. A hand of it holds no dropped mass.
    resolution : float
        Step of the encoder, for the friction that keeps the device at rest [m].

    Returns
    -------
    LawTable
        A row per law; ``.plot()`` draws what they render over frequency, ``.to_pandas()`` is the
        table.

    Raises
    ------
    nodes.laws.parse.LawRefusedError
        If a law is invalid at this period.
    ValueError
        If there is no law, or the resolution is negative.

    Examples
    --------
    >>> found = compare([{"kind": "pd", "stiffness": 1500, "damping": 3}, "designed_d0"])
    >>> found.k_max_wall_n_per_m.round(), found.h1_n_per_m.round()
    (array([ 3782., 13976.]), array([1500., 3736.]))
    """
    device = plant or USUAL
    named = _named(laws)
    if not named:
        raise ValueError("laws: none to compare")
    if not 0.0 <= resolution < np.inf:
        raise ValueError(f"resolution = {resolution!r}: must be finite and at least 0")
    rows = {}
    for name, one in named.items():
        try:
            rows[name] = _row(one, device, resolution)
        except ParameterError as error:
            raise type(error)(error.text, f"{name}: {error.path}") from None
    figures = list(rows.values())

    def column(key: str) -> Any:
        return np.array([row[key] for row in figures])

    return LawTable(
        law=np.array(list(named)),
        **{key: column(key) for key in figures[0]},
        plant=device,
        resolution_m=resolution,
        _responses={
            name: response(one, device)
            for name, one in named.items()
            if _is_linear(one, device)
        },
    )


def _named(laws: Any) -> dict[str, LawLike]:
    """Return the laws by name; equal names are numbered."""
    if isinstance(laws, Mapping) and "kind" not in laws:
        return dict(laws)
    single = not isinstance(laws, list | tuple) or all(
        isinstance(one, int | float) for one in laws
    )
    found: dict[str, LawLike] = {}
    for one in cast("Sequence[LawLike]", [laws] if single and laws else laws):
        name, number = law_name(one), 1
        while name in found:
            number += 1
            name = f"{law_name(one)} {number}"
        found[name] = one
    return found


def _is_linear(law: LawLike, plant: Plant) -> bool:
    return compiled(law, plant.period).evaluate is None


def _row(law: LawLike, plant: Plant, resolution: float) -> dict[str, Any]:
    """Return the figures of one law."""
    found = compiled(law, plant.period)
    fallen = drop(found, replace(plant, stiffness=0.0, partner=None), ticks=DROPPED)
    landed = {"lands": bool(fallen.settled), "peak_force_n": fallen.peak_force_n}
    if found.evaluate is not None:
        return {**dict.fromkeys(_LINEAR, np.nan), **landed, "rest_friction_n": np.nan}
    described = found if isinstance(law, CompiledLaw) else made(law)
    edges = [k_max(described, plant, world).k_max_n_per_m for world in ("wall", "any")]
    circle = np.exp(1j * np.linspace(0.0, np.pi, _GRID))
    figures = (
        *(np.nan if edge is None else edge for edge in edges),
        found.h1,
        float(np.abs(found.response(circle)).max()),
        pole_radius(found, plant),
    )
    friction = rest(found, plant, resolution).friction_bound_n
    return {
        **dict(zip(_LINEAR, figures, strict=True)),
        **landed,
        "rest_friction_n": friction,
    }


_LINEAR = (
    "k_max_wall_n_per_m",
    "k_max_any_world_n_per_m",
    "h1_n_per_m",
    "noise_gain_n_per_m",
    "pole_radius",
)
