"""3D Systems Touch and Touch X as a driver node, through OpenHaptics' HDAPI (libHD) and a servo loop in C (servo.c).

Written from the facts in public headers and bindings, and not yet run on hardware; what can be checked without is checked
against a stand-in library (tests/nodes/driver/test_touch.py).

HDAPI counts in millimetres with +x right, +y up, +z towards the user; here +x is forward, +y left, +z up, in metres.
"""

from __future__ import annotations

import ctypes
import math
import time
from typing import Annotated, Any, ClassVar

import msgspec

from messages.types import Vector
from nodes.driver.calls import Calls
from nodes.driver.device import Device, DeviceLimits, Workspace
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters
from nodes.driver.touch.hdapi import (
    AUTOMATIC,
    CALIBRATION_NEEDS_MANUAL,
    CALIBRATION_NEEDS_UPDATE,
    CALIBRATION_OK,
    CALIBRATION_STYLE,
    ENCODER_RESET,
    ERRORS,
    FAULT,
    FORCE_OUTPUT,
    INKWELL,
    INVALID_HANDLE,
    MAX_CONTINUOUS_FORCE,
    MAX_FORCE,
    MAX_WORKSPACE,
    STALLED,
    UNREAD,
    UPDATE_RATE,
    Servo,
    load_library,
    servo_library,
    to_ours,
)
from nodes.parameters.paths import LocalPath

PRIORITY = 65535
SILENCE = 0.1
"""Longest watchdog that a launch file may ask for on this device [s]."""


class TouchParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the device.

    Attributes
    ----------
    name : str
        Name of the device in the vendor's setup; empty for the default one.
    library : str
        HDAPI's library: a name that the dynamic linker finds, or a path.
    servo_rate : int
        Rate asked for the servo thread [Hz]; where it is refused, the device's own holds.
    deadline : float
        How long the servo thread holds a force without a new one [s].
    calibration_time : float
        Longest wait for the calibration [s].
    """

    name: str = ""
    library: LocalPath = "libHD.so"
    servo_rate: Annotated[int, msgspec.Meta(ge=100, le=10_000)] = 1000
    deadline: Annotated[float, msgspec.Meta(ge=0.005, le=0.1)] = 0.05
    calibration_time: Annotated[float, msgspec.Meta(ge=0.0, le=120.0)] = 20.0


class TouchDriverParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the driver node.

    Attributes
    ----------
    touch : TouchParameters
        The device.
    """

    touch: TouchParameters = TouchParameters()


class TouchDevice:
    """One device. `connect` takes hold of it with forces off; `open` calibrates it and lets forces through.

    Parameters
    ----------
    parameters : TouchParameters
        Which device, and how.
    """

    def __init__(self, parameters: TouchParameters) -> None:
        self._parameters = parameters
        self._limits = DeviceLimits()
        self._device: int | None = None
        self._scheduled: int | None = None

    @property
    def limits(self) -> DeviceLimits:
        """What the device itself says it bears; known after `connect`."""
        return self._limits

    def connect(self) -> None:
        """Load the vendor's library, take hold of the device, and read its limits; no force yet."""
        self._hd: Any = load_library(self._parameters.library)
        self._code: Any = servo_library()
        self._code.servo_size.restype = ctypes.c_size_t
        doubles, whole = ctypes.POINTER(ctypes.c_double), ctypes.c_int64
        self._code.device_read.argtypes = [whole, whole, doubles]
        self._code.device_write.argtypes = [whole, doubles, whole, ctypes.c_double]
        if self._code.servo_size() != ctypes.sizeof(Servo):
            raise OSError(
                "touch_driver: servo.c and hdapi.py disagree about their shared structure; reinstall haptic-nodes"
            )
        device = self._hd.hdInitDevice(self._parameters.name.encode() or None)
        self._check(f"device {self._parameters.name or '(default)'} cannot be opened", "is it plugged in and set up?")
        if device == INVALID_HANDLE:
            raise OSError(
                f"device {self._parameters.name or '(default)'}: hdInitDevice gave no handle; is it plugged in?"
            )
        self._device = device
        self._hd.hdDisable(FORCE_OUTPUT)
        self._check("forces cannot be switched off")
        self._limits = self._read_limits()

    def _errors(self) -> list[str]:
        found: list[str] = []
        while len(found) < 16 and (code := self._hd.hdGetError().error):
            found.append(f"{ERRORS.get(code, 'error')} (0x{code:04X})")
        return found

    def _check(self, what: str, remedy: str = "") -> None:
        errors = self._errors()
        if errors:
            raise OSError(f"Touch: {what}: {', '.join(errors)}{f'; {remedy}' if remedy else ''}")

    def _doubles(self, name: int, count: int) -> list[float]:
        values = (ctypes.c_double * count)()
        self._hd.hdGetDoublev(name, values)
        self._check(f"0x{name:04X} cannot be read")
        return list(values)

    def _read_limits(self) -> DeviceLimits:
        low_x, low_y, low_z, high_x, high_y, high_z = self._doubles(MAX_WORKSPACE, 6)
        low, high = to_ours((low_x, low_y, low_z)), to_ours((high_x, high_y, high_z))
        x, y, z = ((min(a, b), max(a, b)) for a, b in zip(low, high, strict=True))
        workspace: Workspace = (x, y, z)
        (peak,), (continuous,) = self._doubles(MAX_FORCE, 1), self._doubles(MAX_CONTINUOUS_FORCE, 1)
        return DeviceLimits(
            peak_force=peak,
            continuous_force=continuous,
            silence=SILENCE,
            hold=self._parameters.deadline,
            workspace=workspace,
        )

    def open(self) -> None:
        """Start the servo thread, calibrate with forces off, then let forces through, at zero."""
        hd, parameters = self._hd, self._parameters
        hd.hdSetSchedulerRate(parameters.servo_rate)
        refused = self._errors()
        rate = float(parameters.servo_rate)
        if refused:
            # The loop's rate does not depend on it: the driver takes the newest sample at each of its own ticks.
            rates = (ctypes.c_int * 1)()
            hd.hdGetIntegerv(UPDATE_RATE, rates)
            self._check(f"{parameters.servo_rate} Hz is refused and the device's own rate cannot be read")
            rate = float(rates[0])
        self._servo = Servo()
        servo = self._servo
        for field, name in (
            ("begin_frame", "hdBeginFrame"),
            ("end_frame", "hdEndFrame"),
            ("get_double", "hdGetDoublev"),
            ("set_double", "hdSetDoublev"),
            ("get_error", "hdGetError"),
        ):
            setattr(servo, field, ctypes.cast(getattr(hd, name), ctypes.c_void_p).value)
        servo.device = self._device
        servo.deadline, servo.patience = max(1, round(parameters.deadline * rate)), parameters.deadline
        tick = ctypes.cast(self._code.servo_tick, ctypes.c_void_p)
        self._scheduled = hd.hdScheduleAsynchronous(tick, ctypes.byref(servo), PRIORITY)
        self._check("the servo loop cannot be scheduled")
        hd.hdStartScheduler()
        self._check("the scheduler cannot be started")
        self._calibrate()
        self._await_samples()
        self.write_force((0.0, 0.0, 0.0), 0, 0.0)
        hd.hdEnable(FORCE_OUTPUT)
        self._check("forces cannot be switched on")

    def _calibrate(self) -> None:
        until = time.monotonic() + self._parameters.calibration_time
        while (state := self._hd.hdCheckCalibration()) != CALIBRATION_OK:
            self._check("the calibration cannot be looked at")
            if state == CALIBRATION_NEEDS_UPDATE:
                # The position may jump here; forces are still off.
                styles = (ctypes.c_int * 1)()
                self._hd.hdGetIntegerv(CALIBRATION_STYLE, styles)
                self._check("the way of calibrating cannot be read")
                ways = [way for way in (AUTOMATIC, INKWELL, ENCODER_RESET) if styles[0] & way]
                if not ways:
                    raise OSError(
                        f"Touch: the device knows no way of calibrating that this driver does (0x{styles[0]:X})"
                    )
                self._hd.hdUpdateCalibration(ways[0])
                self._check("the calibration failed")
            if time.monotonic() > until:
                remedy = (
                    "put the stylus into its inkwell"
                    if state == CALIBRATION_NEEDS_MANUAL
                    else "move the stylus through its whole range"
                )
                raise OSError(
                    f"Touch: not calibrated within {self._parameters.calibration_time:g} s (0x{state:04X}): {remedy}"
                )
            time.sleep(0.01)

    def _await_samples(self) -> None:
        until = time.monotonic() + 2.0
        while self._servo.ticks < 2:
            if time.monotonic() > until:
                raise OSError(
                    "Touch: the servo thread does not run: no sample within 2 s; restart the device's service"
                )
            time.sleep(0.001)

    def read_position(self, seq: int) -> Vector:
        """Take the newest sample of the servo thread."""
        servo = self._servo
        position = (ctypes.c_double * 3)()
        status = -self._code.device_read(ctypes.addressof(servo), seq, position)
        if status == FAULT:
            raise OSError(
                f"Touch: {ERRORS.get(servo.fault, 'error')} (0x{servo.fault:04X}); forces are off until the node is "
                "started again"
            )
        if status == STALLED:
            raise OSError(
                f"Touch: the servo thread has given no sample for {time.monotonic() - servo.seen_at:.3f} s, limit "
                f"{self._parameters.deadline:g} s; look at cable and power"
            )
        if status == UNREAD:
            return (math.nan, math.nan, math.nan)
        return position[0], position[1], position[2]

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand a force to the servo thread."""
        self._code.device_write(ctypes.addressof(self._servo), (ctypes.c_double * 3)(*force), seq, offset)

    def calls(self) -> Calls:
        """Give the servo thread's mailbox as it stands in C."""
        read, write = (
            ctypes.cast(function, ctypes.c_void_p).value or 0
            for function in (self._code.device_read, self._code.device_write)
        )
        return Calls(read, write, ctypes.addressof(self._servo))

    @property
    def let_go(self) -> int:
        """How often the servo thread set the force to zero by itself, because none came."""
        return int(self._servo.let_go)

    def close(self) -> None:
        """Switch forces off, stop the servo thread and give the device back; also after a failure half-way."""
        if self._device is None:
            return
        hd = self._hd
        if self._scheduled is not None:
            self._servo.stop = 1
        hd.hdDisable(FORCE_OUTPUT)
        if self._scheduled is not None:
            hd.hdStopScheduler()
            hd.hdUnschedule(self._scheduled)
            self._scheduled = None
        hd.hdDisableDevice(self._device)
        self._device = None
        self._errors()


class TouchDriver(Driver):
    """A driver node with a Touch or Touch X."""

    Parameters: ClassVar[type[msgspec.Struct]] = TouchDriverParameters

    def make_device(self) -> Device:
        """Take hold of the device, forces off."""
        device = TouchDevice(self.store.current.touch)
        device.connect()
        return device
