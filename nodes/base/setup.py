"""Setup of a node: identity, endpoints, pace and parameters, as the launcher sends them."""

import sys
from typing import Annotated, Any, Literal

import msgspec

from messages import topics
from messages.types import Real

__all__ = [
    "AXIS_INDEX",
    "Apply",
    "Axis",
    "Effect",
    "Pace",
    "Scheduling",
    "Setup",
    "Tick",
    "least_delay",
]

Pace = Literal["realtime", "lockstep"]
Apply = Literal["on_arrival", "next_tick"]
Tick = Literal["plain", "compiled"]
Axis = Literal["x", "y", "z"]
AXIS_INDEX: dict[str, int] = {"x": 0, "y": 1, "z": 2}


def least_delay(apply: Apply) -> float:
    """Return the least delay of a loop [ticks]: under ``next_tick`` a force waits for one.

    Parameters
    ----------
    apply : str
        When a force takes effect: ``on_arrival`` or ``next_tick``.

    Returns
    -------
    float
        0 or 1 [ticks].
    """
    return 1.0 if apply == "next_tick" else 0.0


class Scheduling(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Processors and priority of a process.

    Attributes
    ----------
    cpus : list of int
        Processors it may use; empty for all.
    fifo : int
        SCHED_FIFO priority 1-99; 0 for the normal scheduler.
    aside : list of int
        Processors of its threads outside the loop; empty for the same.
    """

    cpus: list[int] = []
    aside: list[int] = []
    fifo: Annotated[int, msgspec.Meta(ge=0, le=99)] = 0


class Effect(msgspec.Struct, frozen=True, kw_only=True):
    """What a shape or region of an environment does to a law, on which the coupling judges it.

    Attributes
    ----------
    name : str
        Parameter path of the shape or region; of several regions where they overlap.
    stiffness, damping : float
        Factors of the law's force at rest, and of the rest of the law; at most 1, but for lines
        that overlap.
    lag : float
        Time by which the proxy trails behind the device [s]; 0 for one that does not.
    line : bool
        Whether it is a line that attracts, whose pull falls off from half its reach.
    """

    name: str
    stiffness: float = 1.0
    damping: float = 1.0
    lag: float = 0.0
    line: bool = False


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """One node of one run, fully resolved.

    Attributes
    ----------
    run, run_dir : str
        Name of the run and its private directory.
    name, kind, factory : str
        Name in the launch (with the namespace of its chain: ``left/driver``), kind, and
        ``module:Class`` that implements it.
    period : float
        Sampling period T [s].
    pace : str
        ``realtime`` or ``lockstep``.
    apply : str
        When a force takes effect: ``on_arrival`` or ``next_tick``.
    tick : str
        ``compiled`` if the node runs its usual ticks without the interpreter (nodes/compiled), else
        ``plain``.
    axes : list of str
        Axes that the scene computes.
    virtual : bool
        Whether every device of the launch is virtual, so that nothing can break.
    ticks : int
        Ticks to run; 0 runs until stopped.
    publish, control, listen : str
        Endpoints that the node binds: for the next hop of the loop, for requests, for listeners.
    reach, listen_reach : str
        Further endpoints, for hops and listeners on other machines; empty for none.
    allow_paths : list of str or None
        Directories in which its parameters may name files, if the launcher is on another machine;
        None for anywhere.
    by_hand : bool
        Whether the node is started by hand, not by the launcher.
    lease : float
        Time without a control request after which it stops by itself [s]; 0 for never.
    patience : float
        Longest wait for its listeners [s].
    sources : dict of str to str
        Topic inside the chain (or ``<node>``, for all its topics) to the endpoint that publishes
        it.
    remap : dict of str to str
        Topic inside the chain to the full name of the topic that replaces it.
    listeners : int
        Subscriptions of the launch's own nodes to wait for before the first tick.
    scheduling : Scheduling
        Processors and priority.
    parameters : dict
        The node's own parameters, not yet validated.
    plant : dict of str to float
        What the other nodes of the chain know of the device (`nodes.base.node.Node.plant`).
    effects : list of Effect
        What the chain's environment does to a law, for a node that judges laws.
    peak_force : float or None
        Largest force of the chain's driver along an axis by its parameters [N]; None if not
        limited.
    watch : str
        YAML file whose changes are applied while running; empty for none.
    manifest : dict of str to str
        Data for a recording: launch file, parameters, versions, clock offset.
    clock_offset, clock_error : float
        Offset from the monotonic clock of the node's host to that of the launcher's, as measured
        before the start, and its uncertainty [s]; both 0 on the launcher's host.
    """

    run: str
    run_dir: str
    name: str
    kind: str
    factory: str
    period: float
    pace: Pace
    apply: Apply
    axes: list[Axis]
    ticks: int
    publish: str
    control: str
    sources: dict[str, str]
    remap: dict[str, str] = {}
    tick: Tick = "plain"
    virtual: bool = False
    peak_force: float | None = None
    listen: str = ""
    reach: str = ""
    listen_reach: str = ""
    allow_paths: list[str] | None = None
    by_hand: bool = False
    lease: float = 0.0
    patience: float = 10.0
    listeners: int = 0
    scheduling: Scheduling = Scheduling()
    parameters: dict[str, Any] = {}
    plant: dict[str, float] = {}
    effects: list[Effect] = []
    watch: str = ""
    manifest: dict[str, str] = {}
    clock_offset: Real = 0.0
    clock_error: Annotated[float, msgspec.Meta(ge=0.0, le=sys.float_info.max)] = 0.0

    @property
    def namespace(self) -> str:
        """Namespace of the node's chain; empty for none."""
        return self.name.rpartition("/")[0]

    def topic(self, topic: str) -> str:
        """Return the name on the wire of a topic inside the chain.

        Parameters
        ----------
        topic : str
            E.g. ``/device/state``.

        Returns
        -------
        str
            The topic it is remapped to, or the topic in the namespace of the chain.
        """
        return self.remap.get(topic) or topics.within(self.namespace, topic)
