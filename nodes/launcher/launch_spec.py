"""Structure of a launch file: run, nodes, arguments, includes and the scene's purpose.

The fields are those of the YAML; nodes/launcher/launch_file.py reads, substitutes and checks the
files.
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

# Limit of included files, counted with repetition: thirty files that each include the next twice
# would be a billion.
MAX_FILES = 256


class Argument(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One argument of a launch file."""

    # Default value; its type is the argument's type.
    default: bool | int | float | str | list[Any]
    help: str = ""  # help text; like the unit, for display only
    unit: str = ""
    min: float | None = None  # limits of a number
    max: float | None = None
    choices: list[str] = []  # allowed texts; empty for any


# Rate from which idle processors must not sleep between ticks [Hz].
AWAKE_RATE = 1000.0


class RunSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of the loop: rate, pace, duration, axes, scheduling."""

    # sampling rate [Hz]
    rate: Annotated[float, msgspec.Meta(ge=1.0, le=100_000.0)] = 500.0
    pace: Pace = "realtime"  # pace and apply: see nodes/base/setup.py
    apply: Apply = "on_arrival"
    # Duration [s]; 0 runs until stopped.
    duration: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] = 0.0
    # Axes that the scene computes; by default those along which its surface pushes, or z if
    # unknown.
    axes: Annotated[list[Axis], msgspec.Meta(max_length=3)] = []
    # Core of the chain; ``auto``: the one with fewest device interrupts, ``any``: not pinned.
    cpu: int | Literal["auto", "any"] = "auto"
    # SCHED_FIFO priority of the chain; ``auto``: 50 in real time; 0: none.
    fifo: Annotated[int, msgspec.Meta(ge=0, le=90)] | Literal["auto"] = "auto"
    # How environment, coupling and driver run their ticks (nodes/compiled): ``compiled``,
    # ``plain`` (interpreted), or ``auto``: compiled if already built.
    tick: WantedTick = "auto"
    # Whether idle processors are kept out of sleep states (`nodes.base.realtime.awake`); ``auto``:
    # in real time from 1 kHz.
    awake: bool | Literal["auto"] = "auto"
    # Address of this machine for other machines; needed if nodes run elsewhere.
    host: str = ""
    # first tcp port of the run
    port: Annotated[int, msgspec.Meta(ge=1, le=65000)] = 5600

    @property
    def period(self) -> float:
        """Return the sampling period T [s]."""
        return 1.0 / self.rate

    @property
    def stays_awake(self) -> bool:
        """Whether idle processors are kept out of sleep states."""
        return (
            (self.pace == "realtime" and self.rate >= AWAKE_RATE)
            if self.awake == "auto"
            else self.awake
        )

    @property
    def ticks(self) -> int:
        """Return the number of ticks to run; 0 until stopped."""
        return round(self.duration * self.rate)


class NodeSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One node of a launch file."""

    kind: str  # registered kind of node
    parameters: dict[str, Any] = {}
    required: bool = True  # whether the launch ends when the node does
    respawn: bool = False  # whether it is restarted when it dies
    # delay before a restart [s]
    respawn_delay: Annotated[float, msgspec.Meta(ge=0.0)] = 0.5
    # limit of restarts; -1 for none
    respawn_max: Annotated[int, msgspec.Meta(ge=-1)] = 5
    # Topic name inside the node's chain to the full name of the topic it receives instead.
    remap: dict[str, str] = {}
    # YAML file of parameters: read at the start, and again whenever it is saved. Empty for none.
    watch: str = ""
    # Whether the node is started by hand: ``haptic node start``, a debugger, or a program in
    # another language.
    by_hand: bool = False
    # Address of the machine that runs it, where it is started by hand; empty for this machine.
    host: str = ""
    # tcp port for publishing, the next one for requests; 0: the run's port plus two per node
    # before it.
    port: Annotated[int, msgspec.Meta(ge=0, le=65534)] = 0
    # Name under which that machine's key is allowed here; empty: its address, or on loopback this
    # machine's own.
    key: str = ""
    # tcp port on loopback where every user of this machine may subscribe to the node, unencrypted:
    # for a display without ipc and CURVE. 0 for none.
    open_port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 0


Figure = Literal[
    "settling",
    "peak_force",
    "rest_force",
    "travel",
    "limit_cycle",
    "k_max",
    "force",
    "proxy",
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
    """Purpose of a scene and its intended omissions; ``haptic study needs`` checks the rest."""

    # Figures that matter.
    outcome: Annotated[list[Figure], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [
            "settling",
            "peak_force",
            "rest_force",
            "limit_cycle",
            "k_max",
        ]
    )
    # terms of a real device that the scene omits on purpose
    leaves_out: list[ModelTerm] = []
    # Terms present to be identified, whether or not they affect the motion.
    sought: list[ModelTerm] = []
    # Relative change of a figure that does not matter.
    tolerance: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.02


class Include(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another launch file whose nodes are added to this one."""

    launch: str  # scenario or path of a file
    namespace: str = ""  # prefix of its nodes and topics; empty for none
    arguments: dict[str, Any] = {}  # its arguments that differ from their defaults
    # node to parameters that override its own
    parameters: dict[str, dict[str, Any]] = {}
    without: list[str] = []  # nodes to omit


class Including:
    """Stack of including launch files, outermost first, and a count of all files read."""

    def __init__(
        self, files: Sequence[Path] = (), count: Iterator[int] | None = None
    ) -> None:
        self.files = tuple(files)
        self.count = count or itertools.count()

    def another(self, path: Path, name: str) -> Including:
        """Return the stack with one more file; refuse cycles and too many files."""
        if path.resolve() in self.files:
            raise ParameterError("includes itself", path=name)
        if next(self.count) >= MAX_FILES:
            raise ParameterError(
                f"more than {MAX_FILES} included launch files, counted with repetition",
                path=name,
            )
        return Including((*self.files, path.resolve()), self.count)


class LaunchText(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A launch file as written, before arguments are substituted."""

    summary: str  # one line about what it shows
    nodes: dict[str, Any] = {}  # unchecked: may contain arguments anywhere
    include: list[dict[str, Any]] = []  # other launch files (`Include`), unchecked too
    arguments: dict[str, Argument] = {}  # by name
    run: dict[str, Any] = {}
    model: Model = Model()  # purpose of the scene


class Launch(msgspec.Struct, frozen=True, kw_only=True):
    """A launch file with its arguments substituted."""

    scenario: str  # name of the file
    summary: str  # one line about what it shows
    path: str  # path of the file
    text: str  # file as written
    arguments: dict[str, Any]  # values of all arguments
    run: RunSpec  # settings of the loop
    nodes: dict[str, NodeSpec]  # nodes by name
    # axes by namespace, if they differ from those of ``run``
    axes: dict[str, list[Axis]] = {}
    model: Model = Model()  # purpose of the scene
    models: dict[str, Model] = {}  # purpose of each included chain, by namespace
    origins: Any = None  # file and line of each value; see nodes/launcher/origins.py


def unusual(spec: RunSpec | NodeSpec) -> dict[str, Any]:
    """Return the fields that differ from their defaults."""
    usual = RunSpec() if isinstance(spec, RunSpec) else NodeSpec(kind="")
    return {
        name: value
        for name, value in msgspec.to_builtins(spec).items()
        if value != getattr(usual, name)
    }
