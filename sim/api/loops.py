"""Laws on a device, without starting a process: stability, the drop, and launch files played in one process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from nodes.stability import k_max as stability
from nodes.stability.closed_loop import pole_radius, state_matrix
from nodes.stability.plant import Plant
from nodes.stability.worlds import hand_text, world_k_max
from sim.api.laws import LawLike, compiled, plain
from sim.api.laws import law as made
from sim.api.named_worlds import read_world
from sim.arrays import Array
from sim.studies.notebook_results import Result, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim.play.one_axis import Trace


_SHOWN = 41


@dataclass(frozen=True, repr=False)
class KMaxResult(Result):
    """How stiff a law may get on a device."""

    k_max_n_per_m: float | None  # largest stable nominal stiffness [N/m]; None when none is stable
    h1_max_n_per_m: float | None  # stiffness that is felt there, H(1) [N/m]
    method: str  # ``closed_form``, ``pole_radius``, or ``certificate`` for worlds other than a wall
    stable: tuple[tuple[float, float], ...]  # stable intervals of the nominal stiffness [N/m]
    plant: Plant  # the device and the loop's period
    about: str  # which worlds and hands it is about
    _derivative: Any

    def plot(self) -> Figure:
        """Draw the pole radius over the nominal stiffness: stable where the line is below 1."""
        figure, (axes,) = new_figure()
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
        return figure


@dataclass(frozen=True, repr=False)
class Poles(Result):
    """Poles of a law on a device."""

    radius: float  # the largest; the loop decays by this factor per tick
    stable: bool  # whether it is below 1
    real: Array  # of all poles, the largest first
    imaginary: Array

    def plot(self) -> Figure:
        """Draw the poles in the z plane, with the unit circle."""
        figure, (axes,) = new_figure(width=4.2, height=4.2)
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        axes.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8)
        axes.plot(self.real, self.imaginary, "x")
        axes.set(
            xlabel="Re z", ylabel="Im z", aspect="equal", title=f"pole radius {self.radius:.5g}"
        )
        return figure


@dataclass(frozen=True, repr=False)
class Played(Result):
    """A run in one process, one value per tick."""

    name: str  # what was played
    rate_hz: float  # of the loop [Hz]
    # Whether a drop came to rest in the wall (sim.experiments.drop.Criterion); None where nothing
    # falls, or not for long.
    settled: bool | None
    peak_force_n: float  # largest force [N]
    final_position_m: float  # where the device ended [m]
    time_s: Array
    position_m: Array
    velocity_m_per_s: Array
    measured_m: Array  # what the encoder read
    deflection_m: Array
    force_n: Array

    def plot(self) -> Figure:
        """Draw position and force over time."""
        figure, (top, below) = new_figure(2, height=2.2)
        top.plot(self.time_s, self.position_m * 1e3)
        top.set(ylabel="position [mm]", title=self.name)
        below.step(self.time_s, self.force_n, where="post")
        below.set(ylabel="force [N]", xlabel="time [s]")
        return figure


def k_max(law: LawLike, plant: Plant, world: str = "wall", **options: Any) -> KMaxResult:
    """Find the largest stable stiffness of a law, everything else fixed.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        Its own stiffness does not matter.
    plant : Plant
        Period [s], mass [kg], damping [N s/m], delay [ticks] and a hand's stiffness [N/m].
    world : str
        What the device is coupled to (THEORY.md §18). ``wall``; ``spring``, of any stiffness of a
        range; ``any``, every passive world that answers in the same tick; ``any_hand``, the same in
        every passive hand; ``any_hand_wall``; ``tool`` and ``any_hand_tool``, a stepped tool with
        anything passive hung on it; ``euler_tool``, one of known mass that semi-implicit Euler
        moves, implicit bodies behind it; ``two_hands``, a second device in any hand.
    **options : object
        What a world needs: ``springs`` (softest, stiffest) [N/m], ``tool_damping`` [N s/m],
        ``tool_mass`` [kg], ``other``, the second device (Plant).

    Returns
    -------
    KMaxResult
        The edge; ``.plot()`` draws the way to it. For other worlds than a wall the edge of what is
        certified.

    Raises
    ------
    ValueError
        For a law with code of its own, which has no poles; for an unknown world or options that it
        does not have.

    Examples
    --------
    >>> k_max(made("pd", stiffness=1, damping=3), Plant(period=0.002, mass=0.1, damping=1.0)).k_max_n_per_m
    3781.8664...
    >>> k_max(made("pd", stiffness=1, damping=3), Plant(period=0.002, mass=0.1, damping=1.0), world="any").k_max_n_per_m
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
        top, top + derivative.h1, "certificate", ((low, top),), plant, edge.about, derivative
    )


def poles(law: LawLike, plant: Plant) -> Poles:
    """Find the poles of a law on a device, exactly: force held between ticks, delay included.

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


def drop(
    law: LawLike,
    plant: Plant,
    height: float = 0.01,
    ticks: int = 1500,
    history: Literal["penetration", "position"] = "penetration",
    clamp: bool = True,
) -> Played:
    """Drop a mass on a virtual floor, the experiment of the paper, as a launch and ``haptic study kmax`` drop it.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant
        Period [s], mass [kg], damping [N s/m] and delay [ticks]; nobody holds what is dropped.
    height : float
        Of the fall [m].
    ticks : int
        How long [ticks].
    history : str
        What feeds the law outside contact: ``penetration`` (zero) or ``position`` (the raw
        distance).
    clamp : bool
        Whether a force into the wall is set to zero, as the coupling does. A wall that may pull
        settles at up to 25 % more stiffness (PD, B = 40 N s/m: 18 000 N/m, against 14 400).

    Returns
    -------
    Played
        The run, and whether it settled.

    Raises
    ------
    ValueError
        When the plant has a hand: nobody holds what is dropped; when the height is below 0; when
        the history is neither of the two.

    Examples
    --------
    >>> drop({"kind": "pd", "stiffness": 1000, "damping": 3}, Plant(0.002, 0.1, 1.0)).settled
    True
    """
    from sim.experiments.drop import Convention, dropped, held

    if history not in ("penetration", "position"):
        raise ValueError(f"history is {history!r}, expected 'penetration' or 'position'")
    if plant.stiffness:
        raise ValueError(
            f"plant.stiffness is {plant.stiffness:g} N/m, expected 0: no hand holds a dropped mass"
        )
    if plant.partner is not None:
        raise ValueError(
            "plant.partner: a mass is dropped on a floor, which does not move; leave the"
            " partner out"
        )
    if not 0.0 <= height < np.inf:
        raise ValueError(f"height is {height:g} m, expected at least 0: the floor is at 0")
    convention = Convention(history == "position", clamp)
    trace, rested = dropped(
        held(plant), compiled(law, plant.period), plant.period, ticks, convention, height
    )
    return _played(f"drop from {height * 1e3:g} mm", 1.0 / plant.period, trace, rested)


def _played(name: str, rate: float, trace: Trace, rested: bool | None) -> Played:
    peak, columns = (
        float(np.max(np.abs(trace.force))),
        (trace.time, trace.position, trace.velocity, trace.measured),
    )
    return Played(name, rate, rested, peak, trace.final[0], *columns, trace.deflection, trace.force)


def play(scenario: str, **arguments: Any) -> Played:
    """Play a scenario's launch file in one process: the bits of its lockstep run, thousands of times faster.

    Parameters
    ----------
    scenario : str
        Name or path of a launch file; ``haptic.scenarios()`` lists them.
    **arguments : object
        Arguments of the launch file, e.g. ``stiffness=1500``.

    Returns
    -------
    Played
        The run.

    Raises
    ------
    nodes.parameters.store.ParameterError
        When the launch file refuses an argument, or holds what one process does not play.

    Examples
    --------
    >>> round(play("floor_drop", stiffness=1500).final_position_m, 9)
    -0.000654
    """
    from nodes.launcher import launch_file
    from sim.experiments.drop import SHORTEST, Criterion, settled
    from sim.play.launched import from_launch

    launch = launch_file.read(scenario, plain(arguments))
    launched = from_launch(launch)
    scene, trace = launched.scene, launched.play()
    falls = (
        bool(scene.device.gravity) and scene.device.hand is None and scene.surface.kind == "plane"
    )
    rested = None
    if falls and launched.ticks >= SHORTEST:
        rested = settled(
            scene, launched.last_law, trace.position, trace.force, Criterion(launched.ticks)
        )
    return _played(launch.scenario, launch.run.rate, trace, rested)
