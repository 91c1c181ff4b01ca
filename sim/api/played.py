"""Play launch files and drops in this process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from nodes.parameters.store import ParameterError
from nodes.stability.plant import Plant
from sim.api.launch_arguments import launch_arguments, left_out
from sim.api.laws import LawLike, compiled
from sim.api.python_words import speaking_python
from sim.arrays import Array
from sim.studies.notebook_results import Result, figure_of, two_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nodes.launcher.launch_spec import Launch
    from sim.play.trace import BodyTrace, ChainTrace


@dataclass(frozen=True, repr=False)
class Played(Result):
    """One-process run, one row per tick; arrays of several axes have a column per axis."""

    name: str  # scenario or experiment
    rate_hz: float  # tick rate of the loop [Hz]
    axes: str  # computed axes, e.g. ``z`` or ``xyz``
    # Whether a drop came to rest in the wall (sim.experiments.settling.Criterion); None if nothing
    # falls or the run is too short.
    settled: bool | None
    # first tick with the driver stopped; None: never stopped
    stopped_at_tick: int | None
    peak_force_n: float  # largest force [N]
    # Final position [m]: a number for one axis, else one per axis.
    final_position_m: float | tuple[float, ...]
    time_s: Array
    position_m: Array
    velocity_m_per_s: Array
    measured_m: Array  # encoder readings
    deflection_m: Array
    proxy_m: Array  # proxy positions
    normal: Array  # outward normal of the touched surface
    contact: NDArray[np.bool_]  # whether a surface is touched
    force_n: Array
    # Trajectories of other moving things by name: bodies of a MuJoCo scene, devices of a pair.
    # Their table columns are the position [m] and the orientation as a quaternion, w first.
    bodies: Mapping[str, BodyTrace] = field(default_factory=dict)

    def figures(self) -> dict[str, Any]:
        """Return the scalar results, and the names of the bodies."""
        return {**super().figures(), "bodies": ", ".join(self.bodies)}

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the arrays with one row per tick, bodies' positions and orientations included.

        The first columns are those of a recording (nodes/recording/table.py): ``time``,
        ``position_z``, which is what the encoder read, ``proxy_z``, ``force_z``; for each axis.
        The arrays by their names here follow.
        """
        shown = {
            "position": self.measured_m,
            "proxy": self.proxy_m,
            "force": self.force_n,
        }
        found: dict[str, NDArray[Any]] = {"time": self.time_s}
        for name, values in shown.items():
            rows = values.reshape(len(values), -1)
            found |= {f"{name}_{axis}": rows[:, i] for i, axis in enumerate(self.axes)}
        found |= super().columns()
        for name, body in self.bodies.items():
            found[f"{name}_m"] = body.position
            if body.turn is not None:
                found |= {
                    f"{name}_q{part}": body.turn[:, i] for i, part in enumerate("wxyz")
                }
        return found

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Plot position and force over time, one line per axis, in the two axes `ax` if given."""
        top, below = two_axes(ax, height=2.2)
        several = len(self.axes) > 1
        for i, axis in enumerate(self.axes):
            position, force = (
                values[:, i] if several else values
                for values in (self.position_m, self.force_n)
            )
            name = axis if ax is None else f"{self.name} {axis}"
            top.plot(self.time_s, position * 1e3, label=name)
            below.step(self.time_s, force, where="post", label=name)
        top.set(ylabel="position [mm]", title=self.name if ax is None else "")
        below.set(ylabel="force [N]", xlabel="time [s]")
        if several or ax is not None:
            below.legend(frameon=False)
        return figure_of(top)


def drop(
    law: LawLike,
    plant: Plant,
    height: float = 0.01,
    ticks: int = 1500,
    history: Literal["penetration", "position"] = "penetration",
    clamp: bool = True,
) -> Played:
    """Drop a mass on a virtual floor, as a launch and ``haptic study kmax`` do.

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant
        Period [s], mass [kg], damping [N s/m] and delay [ticks]; no hand holds the dropped mass.
    height : float
        Height of the fall [m].
    ticks : int
        Length of the run [ticks].
    history : str
        Input of the law outside contact: ``penetration`` (zero) or ``position`` (the raw distance).
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
        If the plant has a hand, the height is below 0, or the history is neither of the two.

    Examples
    --------
    >>> drop({"kind": "pd", "stiffness": 1000, "damping": 3}, Plant(0.002, 0.1, 1.0)).settled
    True
    """
    from sim.experiments.drop import Convention, dropped, held

    if history not in ("penetration", "position"):
        raise ValueError(
            f"history is {history!r}, expected 'penetration' or 'position'"
        )
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
        raise ValueError(
            f"height is {height:g} m, expected at least 0: the floor is at 0"
        )
    convention = Convention(history == "position", clamp)
    trace, rested = dropped(
        held(plant),
        compiled(law, plant.period),
        plant.period,
        ticks,
        convention,
        height,
    )
    peak = float(np.max(np.abs(trace.force)))
    proxy = np.where(trace.measured < 0.0, 0.0, trace.measured)
    return Played(
        name=f"drop from {height * 1e3:g} mm",
        rate_hz=1.0 / plant.period,
        axes="z",
        settled=rested,
        stopped_at_tick=None,
        peak_force_n=peak,
        final_position_m=trace.final[0],
        time_s=trace.time,
        position_m=trace.position,
        velocity_m_per_s=trace.velocity,
        measured_m=trace.measured,
        deflection_m=trace.deflection,
        proxy_m=proxy,
        normal=np.ones(ticks),
        contact=trace.measured < 0.0,
        force_n=trace.force,
    )


def play(
    scenario: str,
    chain: str | None = None,
    *,
    params: Mapping[str, Any] | None = None,
    without: str | Sequence[str] = (),
    **arguments: Any,
) -> Played:
    """Play a scenario's launch file in this process; bit-identical to its lockstep launch.

    Parameters
    ----------
    scenario : str
        Name or path of a launch file; ``haptic.scenarios()`` lists them.
    chain : str, optional
        Namespace of the chain to play, if the launch file has several.
    params : mapping of str to object, optional
        Parameters of nodes, e.g. ``{"driver.device.mass": 0.2}``.
    without : str or sequence of str
        Nodes to leave out.
    **arguments : object
        Arguments of the launch file, e.g. ``stiffness=1500``; ``law=`` takes any law, e.g.
        ``haptic.PD(stiffness=1500, damping=3)``.

    Returns
    -------
    Played
        The run.

    Raises
    ------
    nodes.parameters.store.ParameterError
        If the launch file refuses an argument, has several chains and none is named, or contains a
        node that cannot run in one process: a real device, or a network between two hands.

    Examples
    --------
    >>> round(play("floor_drop", stiffness=1500).final_position_m, 9)
    -0.000654
    >>> play("two_hands", chain="right").axes
    'x'
    """
    from nodes.launcher import launch_file
    from sim.play.player import play as play_chain

    with speaking_python():
        given = launch_arguments(arguments, params)
        launch = launch_file.without(
            launch_file.read(scenario, given), left_out(without)
        )
        try:
            trace = play_chain(launch, chain)
        except ParameterError as error:
            raise type(error)(launch.origins.located(error)) from error
    name = "/".join(filter(None, (launch.scenario, chain)))
    return _played(name, trace, _settled(launch, chain or "", trace))


def _settled(launch: Launch, chain: str, trace: ChainTrace) -> bool | None:
    """Return whether a drop came to rest; None if it is no drop or too short to decide."""
    from sim.experiments.settling import SHORTEST, Criterion, settled
    from sim.play.launched import NotOneAxisError, from_launch

    try:
        one = from_launch(launch, chain)
    except NotOneAxisError:
        return None
    device = one.scene.device
    falls = (
        bool(device.gravity)
        and device.hand is None
        and one.scene.surface.kind == "plane"
    )
    if not falls or trace.ticks < SHORTEST:
        return None
    along = trace.along()
    return settled(
        one.scene, one.last_law, along.position, along.force, Criterion(trace.ticks)
    )


def _played(name: str, trace: ChainTrace, settled: bool | None) -> Played:
    axes = list(trace.axes)
    several = len(axes) > 1

    def of(values: Array) -> Array:
        return values[:, axes] if several else values[:, axes[0]]

    ends = tuple(trace.final[0, axes].tolist())
    force = trace.force[:, axes]
    return Played(
        name=name,
        rate_hz=1.0 / trace.period,
        axes="".join("xyz"[i] for i in axes),
        settled=settled,
        stopped_at_tick=trace.stopped_at,
        peak_force_n=float(np.linalg.norm(force, axis=1).max()),
        final_position_m=ends if several else ends[0],
        time_s=trace.time,
        position_m=of(trace.position),
        velocity_m_per_s=of(trace.velocity),
        measured_m=of(trace.measured),
        deflection_m=of(trace.deflection),
        proxy_m=of(trace.proxy),
        normal=of(trace.normal),
        contact=trace.contact,
        force_n=of(trace.force),
        bodies=trace.bodies,
    )
