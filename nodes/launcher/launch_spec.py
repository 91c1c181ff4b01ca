"""What may stand in a launch file: how the loop runs, its nodes, the arguments, and what the scene is for.

The fields are the YAML's own; nodes/launcher/launch_file.py finds the files, fills them in and checks them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from nodes.base.setup import Apply, Axis, Pace
from nodes.compiled.choose_tick import Wanted
from nodes.parameters.store import ParameterError

MAX_FILES = 256
"""Most launch files of one launch, each as often as it is included: thirty that include the next twice are a billion."""


class Argument(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One argument of a launch file.

    Attributes
    ----------
    default : object
        Value when none is given; its type is the argument's type.
    help, unit : str
        For people.
    min, max : float or None
        Limits of a number.
    choices : list
        What a text may be; empty for anything.
    """

    default: bool | int | float | str | list[Any]
    help: str = ""
    unit: str = ""
    min: float | None = None
    max: float | None = None
    choices: list[str] = []


AWAKE_RATE = 1000.0
"""From this rate on a tick is too short for processors that sleep between ticks [Hz]."""


class RunSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How the loop runs.

    Attributes
    ----------
    rate : float
        Sampling rate [Hz].
    pace, apply : str
        See nodes/base/setup.py.
    duration : float
        How long [s]; 0 runs until stopped.
    axes : list of str
        Axes that the scene computes; when left out, those along which its surface pushes, or z where that is not known.
    cpu : int or str
        Core of the chain driver-environment-coupling; ``auto`` takes the one that devices interrupt least where there are
        several, ``any`` does not pin.
    fifo : int or str
        SCHED_FIFO priority of the chain; ``auto`` takes 50 in real time, 0 none.
    tick : str
        How environment, coupling and driver take their ticks (nodes/compiled): ``compiled``, ``plain`` (by the interpreter)
        or ``auto``: compiled where that is there already, for it was asked for before.
    awake : bool or str
        Whether idle processors are kept from going to sleep (`nodes.base.realtime.awake`); ``auto``: in real
        time from 1 kHz up.
    host : str
        Address under which other machines reach this one; needed when nodes run elsewhere.
    port : int
        First tcp port of the run.
    """

    rate: Annotated[float, msgspec.Meta(ge=1.0, le=100_000.0)] = 500.0
    pace: Pace = "realtime"
    apply: Apply = "on_arrival"
    duration: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    axes: Annotated[list[Axis], msgspec.Meta(max_length=3)] = []
    cpu: int | Literal["auto", "any"] = "auto"
    fifo: Annotated[int, msgspec.Meta(ge=0, le=90)] | Literal["auto"] = "auto"
    tick: Wanted = "auto"
    awake: bool | Literal["auto"] = "auto"
    host: str = ""
    port: Annotated[int, msgspec.Meta(ge=1, le=65000)] = 5600

    @property
    def period(self) -> float:
        """Sampling period T [s]."""
        return 1.0 / self.rate

    @property
    def stays_awake(self) -> bool:
        """Whether idle processors are kept from going to sleep."""
        if self.awake == "auto":
            return self.pace == "realtime" and self.rate >= AWAKE_RATE
        return self.awake

    @property
    def ticks(self) -> int:
        """Ticks to run, 0 until stopped."""
        return round(self.duration * self.rate)


class NodeSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One node of a launch file.

    Attributes
    ----------
    kind : str
        A registered kind of node.
    parameters : dict
        Its parameters.
    required : bool
        Whether the launch ends when the node does.
    respawn : bool
        Whether it is started again when it dies.
    respawn_delay : float
        Wait before that [s].
    respawn_max : int
        How often at most; -1 for ever.
    remap : dict of str to str
        Topic that the node listens to, as its chain calls it, to the full name of the one that it takes in its place.
    watch : str
        YAML file of parameters: read at the start, and again whenever it is saved. Empty for none.
    by_hand : bool
        Whether somebody else starts it: ``haptic node start``, a debugger, or a program in another language.
    host : str
        Address of the machine that runs it; empty for this one. It is started there by hand.
    port : int
        tcp port that it publishes at, its control requests at the next one; 0 for the run's port and two for every node
        before it.
    key : str
        Name under which that machine's key is allowed here; empty for the address, on loopback for this machine's own.
    open_port : int
        tcp port on loopback at which every user of this machine may listen to the node, unencrypted, and do no more: for
        a display that knows neither ipc nor CURVE. 0 for none.
    """

    kind: str
    parameters: dict[str, Any] = {}
    required: bool = True
    respawn: bool = False
    respawn_delay: Annotated[float, msgspec.Meta(ge=0.0)] = 0.5
    respawn_max: Annotated[int, msgspec.Meta(ge=-1)] = 5
    remap: dict[str, str] = {}
    watch: str = ""
    by_hand: bool = False
    host: str = ""
    port: Annotated[int, msgspec.Meta(ge=0, le=65534)] = 0
    key: str = ""
    open_port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 0


Figure = Literal["settling", "peak_force", "rest_force", "travel", "limit_cycle", "k_max", "force", "proxy"]
ModelTerm = Literal[
    "gravity",
    "damping",
    "friction",
    "resolution",
    "peak_force",
    "delay",
    "hand",
    "contact",
    "limit",
    "slew",
    "workspace",
    "guard",
    "memory",
    "axes",
    "shape",
    "triangles",
    "surface_friction",
    "tool_radius",
    "bodies",
]


class Model(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a scene is for, and what it leaves out on purpose: the rest is checked by ``haptic study needs``.

    Attributes
    ----------
    outcome : list of str
        Figures that count.
    leaves_out : list of str
        Terms of a real device that the scene idealises away.
    sought : list of str
        Terms that are there to be identified, whether the motion feels them or not.
    tolerance : float
        Relative movement of a figure that does not matter.
    """

    outcome: Annotated[list[Figure], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: ["settling", "peak_force", "rest_force", "limit_cycle", "k_max"]
    )
    leaves_out: list[ModelTerm] = []
    sought: list[ModelTerm] = []
    tolerance: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.02


class Include(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another launch file whose nodes belong to this one.

    Attributes
    ----------
    launch : str
        A scenario, or the path of a file.
    namespace : str
        What stands before its nodes and topics; empty for nothing.
    arguments : dict
        Its arguments that differ from their defaults.
    parameters : dict of str to dict
        Node to parameters that are laid over its own.
    without : list of str
        Nodes of it that are left out.
    """

    launch: str
    namespace: str = ""
    arguments: dict[str, Any] = {}
    parameters: dict[str, dict[str, Any]] = {}
    without: list[str] = []


class Including:
    """Which launch files include the one that is read, the outermost first, and how many one launch has read so far."""

    def __init__(self, files: Sequence[Path] = (), count: Iterator[int] | None = None) -> None:
        self.files = tuple(files)
        self.count = count or itertools.count()

    def another(self, path: Path, name: str) -> Including:
        """Go on in one more file."""
        if path.resolve() in self.files:
            raise ParameterError(f"{name}: includes itself")
        if next(self.count) >= MAX_FILES:
            raise ParameterError(
                f"{name}: more than {MAX_FILES} launch files are included, each as often as it is named"
            )
        return Including((*self.files, path.resolve()), self.count)


class LaunchText(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A launch file as it is written, before its arguments are filled in.

    Attributes
    ----------
    summary : str
        What it shows, in a line.
    nodes, run : dict
        Not yet checked: arguments may stand anywhere in them.
    include : list
        Other launch files (`Include`), neither checked yet.
    arguments : dict of str to Argument
        By name.
    model : Model
        What the scene is for.
    """

    summary: str
    nodes: dict[str, Any] = {}
    include: list[dict[str, Any]] = []
    arguments: dict[str, Argument] = {}
    run: dict[str, Any] = {}
    model: Model = Model()


class Launch(msgspec.Struct, frozen=True, kw_only=True):
    """A launch file with its arguments filled in.

    Attributes
    ----------
    scenario, summary : str
        Name of the file and what it shows.
    path : str
        Where it is.
    text : str
        The file as written.
    arguments : dict
        Values of all arguments.
    run : RunSpec
        How the loop runs.
    nodes : dict of str to NodeSpec
        The nodes by name.
    axes : dict of str to list of str
        Axes by namespace, where they are not those of ``run``.
    model : Model
        What the scene is for.
    origins : Origins or None
        Where its values were written; see nodes/launcher/origins.py.
    """

    scenario: str
    summary: str
    path: str
    text: str
    arguments: dict[str, Any]
    run: RunSpec
    nodes: dict[str, NodeSpec]
    axes: dict[str, list[Axis]] = {}
    model: Model = Model()
    origins: Any = None
