"""What may stand in a launch file: how the loop runs, its nodes, the arguments, and what the scene is for.

The fields are the YAML's own; nodes/launcher/launch_file.py finds the files, fills them in and
checks them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from nodes.base.setup import Apply, Axis, Pace
from nodes.compiled.choose_tick import WantedTick
from nodes.parameters.store import ParameterError

# most launch files of one launch, each as often as included: thirty that include the next twice are
# a billion
MAX_FILES = 256


class Argument(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One argument of a launch file."""

    # value when none is given; its type is the argument's type
    default: bool | int | float | str | list[Any]
    help: str = ""  # for people, as is the unit
    unit: str = ""
    min: float | None = None  # limits of a number
    max: float | None = None
    choices: list[str] = []  # what a text may be; empty for anything


# from this rate on a tick is too short for processors that sleep between ticks [Hz]
AWAKE_RATE = 1000.0


class RunSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How the loop runs."""

    rate: Annotated[float, msgspec.Meta(ge=1.0, le=100_000.0)] = 500.0  # sampling rate [Hz]
    pace: Pace = "realtime"  # this and the next: see nodes/base/setup.py
    apply: Apply = "on_arrival"
    # how long [s]; 0 runs until stopped
    duration: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] = 0.0
    # Axes that the scene computes; when left out, those along which its surface pushes, or z where
    # that is not known.
    axes: Annotated[list[Axis], msgspec.Meta(max_length=3)] = []
    # Core of the chain; ``auto`` takes the one that devices interrupt least where there are
    # several, ``any`` does not pin.
    cpu: int | Literal["auto", "any"] = "auto"
    # SCHED_FIFO priority of the chain; ``auto`` takes 50 in real time, 0 none.
    fifo: Annotated[int, msgspec.Meta(ge=0, le=90)] | Literal["auto"] = "auto"
    # How environment, coupling and driver take their ticks (nodes/compiled): ``compiled``,
    # ``plain`` (by the interpreter) or ``auto``: compiled where that is there already, for it was
    # asked for before.
    tick: WantedTick = "auto"
    # Whether idle processors are kept from going to sleep (`nodes.base.realtime.awake`); ``auto``:
    # in real time from 1 kHz up.
    awake: bool | Literal["auto"] = "auto"
    # address under which other machines reach this one; needed when nodes run elsewhere
    host: str = ""
    port: Annotated[int, msgspec.Meta(ge=1, le=65000)] = 5600  # first tcp port of the run

    @property
    def period(self) -> float:
        """Sampling period T [s]."""
        return 1.0 / self.rate

    @property
    def stays_awake(self) -> bool:
        """Whether idle processors are kept from going to sleep."""
        return (
            (self.pace == "realtime" and self.rate >= AWAKE_RATE)
            if self.awake == "auto"
            else self.awake
        )

    @property
    def ticks(self) -> int:
        """Ticks to run, 0 until stopped."""
        return round(self.duration * self.rate)


class NodeSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One node of a launch file."""

    kind: str  # a registered kind of node
    parameters: dict[str, Any] = {}  # its parameters
    required: bool = True  # whether the launch ends when the node does
    respawn: bool = False  # whether it is started again when it dies
    respawn_delay: Annotated[float, msgspec.Meta(ge=0.0)] = 0.5  # wait before that [s]
    respawn_max: Annotated[int, msgspec.Meta(ge=-1)] = 5  # how often at most; -1 for ever
    # Topic that the node listens to, as its chain calls it, to the full name of the one that it
    # takes in its place.
    remap: dict[str, str] = {}
    # YAML file of parameters: read at the start, and again whenever it is saved. Empty for none.
    watch: str = ""
    # Whether somebody else starts it: ``haptic node start``, a debugger, or a program in another
    # language.
    by_hand: bool = False
    # Address of the machine that runs it; empty for this one. It is started there by hand.
    host: str = ""
    # tcp port that it publishes at, its requests at the next one; 0 for the run's port and two for
    # every node before it.
    port: Annotated[int, msgspec.Meta(ge=0, le=65534)] = 0
    # Name under which that machine's key is allowed here; empty for the address, on loopback for
    # this machine's own.
    key: str = ""
    # tcp port on loopback at which every user of this machine may listen to the node, unencrypted,
    # and do no more: for a display that knows neither ipc nor CURVE. 0 for none.
    open_port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 0


Figure = Literal[
    "settling", "peak_force", "rest_force", "travel", "limit_cycle", "k_max", "force", "proxy"
]
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
    """What a scene is for, and what it leaves out on purpose: the rest is checked by ``haptic study needs``."""

    # Figures that count.
    outcome: Annotated[list[Figure], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: ["settling", "peak_force", "rest_force", "limit_cycle", "k_max"]
    )
    leaves_out: list[ModelTerm] = []  # terms of a real device that the scene idealises away
    # terms that are there to be identified, whether the motion feels them or not
    sought: list[ModelTerm] = []
    # Relative movement of a figure that does not matter.
    tolerance: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.02


class Include(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another launch file whose nodes belong to this one."""

    launch: str  # a scenario, or the path of a file
    namespace: str = ""  # what stands before its nodes and topics; empty for nothing
    arguments: dict[str, Any] = {}  # its arguments that differ from their defaults
    parameters: dict[str, dict[str, Any]] = {}  # node to parameters that are laid over its own
    without: list[str] = []  # nodes of it that are left out


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
                f"{name}: more than {MAX_FILES} launch files are included, each as often as it is"
                " named"
            )
        return Including((*self.files, path.resolve()), self.count)


class LaunchText(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A launch file as it is written, before its arguments are filled in."""

    summary: str  # what it shows, in a line
    nodes: dict[str, Any] = {}  # not yet checked: arguments may stand anywhere in them
    include: list[dict[str, Any]] = []  # other launch files (`Include`), neither checked yet
    arguments: dict[str, Argument] = {}  # by name
    run: dict[str, Any] = {}
    model: Model = Model()  # what the scene is for


class Launch(msgspec.Struct, frozen=True, kw_only=True):
    """A launch file with its arguments filled in."""

    scenario: str  # name of the file
    summary: str  # what it shows
    path: str  # where it is
    text: str  # the file as written
    arguments: dict[str, Any]  # values of all arguments
    run: RunSpec  # how the loop runs
    nodes: dict[str, NodeSpec]  # the nodes by name
    axes: dict[str, list[Axis]] = {}  # axes by namespace, where they are not those of ``run``
    model: Model = Model()  # what the scene is for
    origins: Any = None  # where its values were written; see nodes/launcher/origins.py


def unusual(spec: RunSpec | NodeSpec) -> dict[str, Any]:
    """Give the fields that are not as they are when they are left out."""
    usual = RunSpec() if isinstance(spec, RunSpec) else NodeSpec(kind="")
    return {
        name: value
        for name, value in msgspec.to_builtins(spec).items()
        if value != getattr(usual, name)
    }
