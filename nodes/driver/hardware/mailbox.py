"""A device behind a mailbox: a servo loop samples it and applies forces.

Base of all drivers of real devices. mailbox.h is the mailbox itself. It also contains the driver's
two calls, so that compiled ticks need no interpreter, and the deadline after which a force that is
not renewed becomes zero.
"""

from __future__ import annotations

import ctypes
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, NamedTuple

import msgspec
import numpy as np

from messages.types import ZERO, Vector
from nodes.driver.calls import JUMPED, Calls
from nodes.driver.device import DeviceLimits, Workspace
from nodes.driver.hardware.compile import servo_library
from nodes.driver.hardware.libraries import Search, find
from nodes.driver.hardware.mapping import Mapping, limits_in_scene, matrix
from nodes.driver.limits import SafetyParameters, recovery_ramp
from nodes.driver.parameters import DriverParameters

# errors of ``device_read`` in mailbox.h, as negative numbers
FAULT, STALLED, UNREAD = 1, 2, 3

# time without a sample after which a device counts as lost [s]; until then there is no force
LOST: Final = 0.8
SAMPLE: Final = 12
# longest watchdog that a launch file may set for these devices [s]
SILENCE: Final = 0.1

# mailboxes of servo loops that may hang, which must not write into freed memory
_kept: Final[list[Any]] = []


def _named(kind: Any, *names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names]


class Mailbox(ctypes.Structure):
    """Memory shared by driver and servo loop, as in nodes/driver/hardware/mailbox.h."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("turn", ctypes.c_double * 9),
        ("unit", ctypes.c_double),
        ("origin", ctypes.c_double * 3),
        *_named(
            ctypes.c_double, "deadline", "patience", "peak", "reach", "back", "recovery"
        ),
        *(("clutch", ctypes.c_int64), ("commands", ctypes.c_uint)),
        ("force", ctypes.c_double * 4),
        *_named(ctypes.c_uint, "stop", "jumps", "told"),
        *(("decided_at", ctypes.c_double), ("seen", ctypes.c_uint)),
        *(("seen_at", ctypes.c_double), ("held", ctypes.c_int64)),
        *_named(ctypes.c_double * 3, "frozen", "shift"),
        *(("share_from", ctypes.c_double), ("samples", ctypes.c_uint)),
        ("sample", ctypes.c_double * SAMPLE),
        *_named(ctypes.c_uint, "ticks", "let_go", "errors"),
        *_named(ctypes.c_int, "error", "fault", "condition"),
        *_named(ctypes.c_uint, "last_command", "silent"),
        *_named(ctypes.c_double, "silent_at", "commanded_at"),
        ("acting", ctypes.c_double * 3),
        *_named(ctypes.c_double, "looked_at", "owed"),
    ]


class HardwareParameters(
    DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of every driver of a real device.

    mapping: From the device into the scene; see nodes/driver/hardware/mapping.py.
    """

    mapping: Mapping = Mapping()


class ServoParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of a servo loop.

    servo_rate: Its rate [Hz]; a device that refuses it uses its own.
    deadline: Time for which it applies a force without a new one [s].
    """

    servo_rate: Annotated[int, msgspec.Meta(ge=100, le=10_000)] = 1000
    deadline: Annotated[float, msgspec.Meta(ge=0.005, le=0.1)] = 0.05


class HandleSample(NamedTuple):
    """Data of a device besides its position, in the scene's axes."""

    # quaternion x, y, z, w, shape (4,); (0, 0, 0, 1) for a device without orientation
    orientation: tuple[float, float, float, float]
    gripper: float  # opening [m]; 0 without one
    buttons: int  # one bit each
    velocity: Vector  # as the vendor computes it [m/s]: recorded, not used, shape (3,)


class MailboxDevice(ABC):
    """One device; subclasses define how it is found, opened and closed, and its error texts."""

    TITLE: ClassVar[str] = ""  # name in errors
    SECTION: ClassVar[str] = ""  # section of the node's parameters
    # folders of its vendor's library, besides the dynamic linker's
    FOLDERS: ClassVar[Sequence[str]] = ()
    # its axes that point forward, left and up if it stands upright
    AXES: ClassVar[Sequence[str]] = ("+x", "+y", "+z")
    UNIT: ClassVar[float] = 1.0  # its unit of length [m]
    SERVO: ClassVar[Path] = Path(__file__).with_name("mailbox.c")
    Shared: ClassVar[type[Any]] = Mailbox

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters
        self._wants: Any = getattr(parameters, self.SECTION)
        # properties known once it is connected: model, serial number, versions
        self.facts: dict[str, Any] = {}
        self.servo_rate, self.deadline = self._wants.servo_rate, self._wants.deadline
        # called with what is waited for while opening, which may take long; set by the owner
        self.say: Callable[[str], Any] = str
        self._waits = ""
        # limits in the scene, known after `connect`
        self.limits = DeviceLimits()
        # from the device's axes into the scene's
        self.turn = matrix(parameters.mapping, self.AXES)
        self._code: Any = None
        self._shared: Any = None
        self._box: Any = None

    @property
    def let_go(self) -> int:
        """How often the servo loop set the force to zero because none came."""
        return int(self._box.let_go)

    @property
    def jumps(self) -> int:
        """Count of position jumps at the last reading."""
        return int(self._box.told)

    @classmethod
    def find(cls, parameters: Any) -> Search:
        """Search this machine for what it needs, usually its vendor's library."""
        return find(getattr(parameters, cls.SECTION).library, cls.FOLDERS)

    @property
    def ticks(self) -> int:
        """Number of servo ticks that have read a position."""
        return int(self._box.ticks)

    def wait_for(self, what: str) -> None:
        """Report what is waited for, once per change."""
        if what != self._waits:
            self._waits = what
            self.say(f"{self.TITLE}: {what}")

    @abstractmethod
    def connect(self) -> None:
        """Open the device with forces off and read its limits; OSError with a remedy on failure."""

    def identify(self) -> None:  # noqa: B027  # most kinds know all by then
        """Read what is unknown after `connect`, for a remote device."""

    @abstractmethod
    def open(self) -> None:
        """Start the servo loop, calibrate with forces off, then enable forces, at zero.

        Raises OSError, as `connect` does.
        """

    @abstractmethod
    def close(self) -> None:
        """Switch forces off, end the servo loop, close the device; also after a failure."""

    @abstractmethod
    def error_text(self, code: int) -> str:
        """Return an error of the device as text."""

    def condition(self) -> str:
        """Return why the device gives no force although requested, or ""."""
        fault = self._box.fault
        return (
            f"the device reported {self.error_text(fault)}: forces are off until the node is"
            " started again"
            if fault
            else ""
        )

    def prepare(
        self,
        peak: float,
        continuous: float,
        workspace: Workspace,
        hold: float | None = None,
        opening: float | None = None,
    ) -> None:
        """Create the mailbox, with the device's limits along its axes [N, m] and hold time [s]."""
        mapping: Mapping = self.parameters.mapping
        safety: SafetyParameters = self.parameters.safety
        theirs = self._theirs = DeviceLimits(
            peak_force=peak,
            continuous_force=continuous,
            silence=SILENCE,
            hold=self.deadline if hold is None else hold,
            lets_go=self.deadline,
            opening=DeviceLimits().opening if opening is None else opening,
            workspace=workspace,
        )
        self._code = servo_library(self.SERVO)
        self._code.mailbox_size.restype = ctypes.c_size_t
        sizes = [(self._code.mailbox_size, Mailbox)]
        if self.Shared is not Mailbox:
            self._code.servo_size.restype = ctypes.c_size_t
            sizes.append((self._code.servo_size, self.Shared))
        if any(size() != ctypes.sizeof(struct) for size, struct in sizes):
            raise OSError(
                f"{self.TITLE}: servo loop and driver disagree about what they share; reinstall"
                " haptic-nodes"
            )
        doubles = ctypes.POINTER(ctypes.c_double)
        whole = ctypes.c_int64
        self._code.device_read.argtypes = [whole, whole, doubles]
        self._code.device_write.argtypes = [whole, doubles, whole, ctypes.c_double]
        self._code.mailbox_sample.argtypes = [whole, doubles]
        self._shared = self.Shared()
        _kept.append(self._shared)
        box = self._box = self._shared if self.Shared is Mailbox else self._shared.box
        box.turn[:] = [number for row in self.turn for number in row]
        box.unit, box.origin[:] = self.UNIT, mapping.centre
        box.deadline = box.patience = self.deadline
        box.peak = peak
        box.clutch = 0 if mapping.clutch is None else 1 << mapping.clutch
        box.reach, box.back = mapping.reach, mapping.clutch_ramp
        self.come_back_within(safety)
        self.limits = limits_in_scene(theirs, mapping, self.turn)

    def come_back_within(self, safety: SafetyParameters) -> None:
        """Set the ramp of a force that was lost for a moment."""
        self._box.recovery = recovery_ramp(safety)

    def await_samples(self) -> None:
        """Wait until the servo loop runs, set its force to zero, and re-centre if requested."""
        until = time.monotonic() + 2.0
        while self._box.ticks < 2:
            if self._box.fault or time.monotonic() > until:
                error = self._box.fault or self._box.error
                why = f": {self.error_text(error)}" if error else "; restart it"
                raise OSError(
                    f"{self.TITLE}: no sample from the device within 2 s{why}"
                )
            time.sleep(0.001)
        if self.parameters.mapping.recentre:
            self.recentre()
        self.write_force(ZERO, 0, 0.0)

    def recentre(self) -> Vector:
        """Move the device's origin and workspace so that it is at the scene's centre.

        Return the change [m].
        """
        mapping: Mapping = self.parameters.mapping
        here = self.read_position(0)
        centre = mapping.centre
        x, y, z = (c - at for c, at in zip(centre, here, strict=True))
        if not math.isfinite(x + y + z):
            raise OSError(
                f"{self.TITLE}: the device gives no position; it cannot be re-centred"
            )
        for i, step in enumerate((x, y, z)):
            self._box.origin[i] += step
        self._box.jumps += 1
        # the position of the device is known now
        a, b, c = self._box.origin
        self.limits = limits_in_scene(
            self._theirs,
            msgspec.structs.replace(mapping, centre=(a, b, c), recentre=False),
            self.turn,
        )
        return x, y, z

    @property
    def _at(self) -> int:
        return ctypes.addressof(self._box)

    def read_position(self, seq: int) -> Vector:
        """Return the newest sample; NaN if it is too old, OSError if the device is lost."""
        position = (ctypes.c_double * 3)()
        status = -self._code.device_read(self._at, seq, position)
        box = self._box
        if status == -JUMPED:
            status = 0
        if status == FAULT:
            raise OSError(
                f"{self.TITLE}: {self.error_text(box.fault)}; forces are off until the node is"
                " started again"
            )
        if status == STALLED and (silent := time.monotonic() - box.seen_at) > LOST:
            error = f"{self.error_text(box.error)}; " if box.error else ""
            raise OSError(
                f"{self.TITLE}: no sample for {silent:.3f} s: {error}look at cable and power"
            )
        if status:
            return (math.nan, math.nan, math.nan)
        return position[0], position[1], position[2]

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand a force to the servo loop."""
        self._code.device_write(self._at, (ctypes.c_double * 3)(*force), seq, offset)

    def calls(self) -> Calls:
        """Return the calls of the mailbox in C."""
        both = self._code.device_read, self._code.device_write
        read, write = (
            ctypes.cast(function, ctypes.c_void_p).value or 0 for function in both
        )
        return Calls(read, write, self._at)

    def handle(self) -> HandleSample | None:
        """Return the data besides the position, or None."""
        sample = (ctypes.c_double * SAMPLE)()
        if self._code.mailbox_sample(self._at, sample):
            return None
        rows = np.array(self.turn)
        x, y, z = (self.UNIT * rows @ sample[3:6]).tolist()
        # The axis of a rotation transforms like a position.
        a, b, c = (rows @ sample[6:9] / self.parameters.mapping.scale).tolist()
        return HandleSample(
            (a, b, c, sample[9]), sample[10], int(sample[11]), (x, y, z)
        )

    def inertia(self) -> tuple[Vector, Vector, Vector] | None:
        """Return the inertia that forces of the scene move at this position [kg], or None."""
        return None
