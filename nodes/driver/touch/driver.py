"""3D Systems Touch and Touch X as a driver node, through HDAPI and a servo loop in C.

Written from the facts in public headers and bindings, and not yet run on hardware; what can be
checked without is checked against a stand-in library (sim/emulators).

HDAPI (libHD of OpenHaptics) counts in millimetres with +x right, +y up, +z towards the user; here
+x is forward, +y left, +z up, in metres.
"""

from __future__ import annotations

import ctypes
import time
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec

from nodes.driver.device import Workspace
from nodes.driver.hardware.driver import HardwareDriver
from nodes.driver.hardware.mailbox import (
    HardwareParameters,
    MailboxDevice,
    ServoParameters,
)
from nodes.driver.touch import hdapi
from nodes.parameters.paths import LocalPath

PRIORITY = 65535


class TouchParameters(
    ServoParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the device.

    name: Name of the device in the vendor's setup; empty for the default one.
    serial: Serial number that the device must have; empty for any.
    library: HDAPI's library: a name that the dynamic linker finds, or a path.
    calibration_time: Longest wait for the calibration [s].
    """

    name: str = ""
    serial: str = ""
    library: LocalPath = "libHD.so"
    calibration_time: Annotated[float, msgspec.Meta(ge=0.0, le=120.0)] = 20.0


class TouchDriverParameters(
    HardwareParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the driver node.

    touch: The device.
    """

    touch: TouchParameters = TouchParameters()


class TouchDevice(MailboxDevice):
    """One device: `connect` opens it with forces off; `open` calibrates it and enables forces."""

    TITLE: ClassVar[str] = "Touch"
    SECTION: ClassVar[str] = "touch"
    FOLDERS: ClassVar[tuple[str, ...]] = hdapi.FOLDERS
    AXES: ClassVar[tuple[str, ...]] = ("-z", "-x", "+y")
    UNIT: ClassVar[float] = 1e-3
    SERVO: ClassVar[Path] = Path(__file__).with_name("servo.c")
    Shared: ClassVar[type[Any]] = hdapi.TouchServo
    held: ClassVar[bool] = False

    def __init__(self, parameters: TouchDriverParameters) -> None:
        super().__init__(parameters)
        self._device: int | None = None
        self._scheduled: int | None = None

    def connect(self) -> None:
        """Load the vendor's library, open the device and read its limits; no force yet."""
        if TouchDevice.held:
            raise OSError(
                "Touch: this process has one already, and HDAPI has one scheduler a process: give"
                " each a launch of its own"
            )
        self._hd: Any = hdapi.load_library(self._wants.library)
        name = self._wants.name or "(default)"
        device = self._hd.hdInitDevice(self._wants.name.encode() or None)
        self._check(f"device {name} cannot be opened", "is it plugged in and set up?")
        if device == hdapi.INVALID_HANDLE:
            raise OSError(
                f"device {name}: hdInitDevice gave no handle; is it plugged in?"
            )
        self._device = device
        TouchDevice.held = True
        try:
            self._hd.hdDisable(hdapi.FORCE_OUTPUT)
            self._check("forces cannot be switched off")
            known = {
                "model": hdapi.MODEL_TYPE,
                "serial": hdapi.SERIAL_NUMBER,
                "driver": hdapi.DRIVER_VERSION,
            }
            self.facts = {name: self._text(which) for name, which in known.items()}
            if self._wants.serial not in ("", self.facts["serial"]):
                raise OSError(
                    f"Touch: device {name} has serial number {self.facts['serial']}, not"
                    f" {self._wants.serial}; give the name that the vendor's setup has for that one"
                    " as touch.name"
                )
            self._prepare()
        except OSError:
            self.close()
            raise

    def _errors(self) -> list[str]:
        found: list[str] = []
        while len(found) < 16 and (code := self._hd.hdGetError().error):
            found.append(hdapi.error_text(code))
        return found

    def _check(self, what: str, remedy: str = "") -> None:
        errors = self._errors()
        if errors:
            raise OSError(
                f"Touch: {what}: {', '.join(errors)}{f'; {remedy}' if remedy else ''}"
            )

    def _text(self, name: int) -> str:
        text = self._hd.hdGetString(name)
        # A library of an older version may not know it; the facts are for people only.
        return "" if self._errors() or not text else str(text.decode(errors="replace"))

    def _doubles(self, name: int, count: int) -> list[float]:
        values = (ctypes.c_double * count)()
        self._hd.hdGetDoublev(name, values)
        self._check(f"0x{name:04X} cannot be read")
        return list(values)

    def _prepare(self) -> None:
        """Create the mailbox with the device's own limits."""
        ends = [end * self.UNIT for end in self._doubles(hdapi.MAX_WORKSPACE, 6)]
        workspace: Workspace = (
            (ends[0], ends[3]),
            (ends[1], ends[4]),
            (ends[2], ends[5]),
        )
        (peak,) = self._doubles(hdapi.MAX_FORCE, 1)
        (continuous,) = self._doubles(hdapi.MAX_CONTINUOUS_FORCE, 1)
        if not (peak > 0.0 and continuous > 0.0):
            raise OSError(
                f"Touch: the device reports a peak force of {peak:g} N and {continuous:g} N"
                " continuously"
            )
        self.prepare(peak, continuous, workspace)

    def open(self) -> None:
        """Start the servo loop, calibrate with forces off, then enable forces, at zero."""
        hd = self._hd
        hd.hdSetSchedulerRate(self._wants.servo_rate)
        # If refused, the device's own rate applies; the driver uses the newest sample at each tick.
        self._errors()
        servo = self._shared
        for field, name in hdapi.SERVO_CALLS.items():
            setattr(servo, field, ctypes.cast(getattr(hd, name), ctypes.c_void_p).value)
        servo.device = self._device
        tick = ctypes.cast(self._code.servo_tick, ctypes.c_void_p)
        self._scheduled = hd.hdScheduleAsynchronous(tick, ctypes.byref(servo), PRIORITY)
        self._check("the servo loop cannot be scheduled")
        hd.hdStartScheduler()
        self._check("the scheduler cannot be started")
        self._calibrate()
        self.await_samples()
        hd.hdEnable(hdapi.FORCE_OUTPUT)
        self._check("forces cannot be switched on")
        if error := self._code.servo_watch(ctypes.byref(servo)):
            raise OSError(error, "Touch: the servo loop cannot be watched")

    def _calibrate(self) -> None:
        until = time.monotonic() + self._wants.calibration_time
        while (state := self._hd.hdCheckCalibration()) != hdapi.CALIBRATION_OK:
            self._check("the calibration cannot be checked")
            if state == hdapi.CALIBRATION_NEEDS_UPDATE:
                # the position may jump: forces are still off
                styles = (ctypes.c_int * 1)()
                self._hd.hdGetIntegerv(hdapi.CALIBRATION_STYLE, styles)
                self._check("the way of calibrating cannot be read")
                ways = [
                    way
                    for way in (hdapi.AUTOMATIC, hdapi.INKWELL, hdapi.ENCODER_RESET)
                    if styles[0] & way
                ]
                if not ways:
                    raise OSError(
                        "Touch: the device knows no way of calibrating that this driver does"
                        f" (0x{styles[0]:X})"
                    )
                self._hd.hdUpdateCalibration(ways[0])
                self._check("the calibration failed")
            by_hand = state == hdapi.CALIBRATION_NEEDS_MANUAL
            remedy = (
                "put the stylus into its inkwell"
                if by_hand
                else "move the stylus through its whole range"
            )
            if time.monotonic() > until:
                raise OSError(
                    f"Touch: not calibrated within {self._wants.calibration_time:g} s"
                    f" (0x{state:04X}): {remedy}"
                )
            # an update completes some calibrations without help
            if by_hand:
                self.wait_for(
                    f"waits up to {self._wants.calibration_time:g} s for its calibration: {remedy}"
                )
            time.sleep(0.01)
        self._check("the calibration cannot be checked")

    def error_text(self, code: int) -> str:
        """Return an error of HDAPI as text."""
        return hdapi.error_text(code)

    def close(self) -> None:
        """Switch forces off, stop the servo loop, close the device; also after a failure."""
        if self._device is None:
            return
        hd = self._hd
        if self._scheduled is not None:
            self._box.stop = 1
            if self._code.servo_end(ctypes.byref(self._shared)):
                raise OSError(
                    "Touch: a call of the device does not return; switch the device off"
                )
        hd.hdDisable(hdapi.FORCE_OUTPUT)
        if self._scheduled is not None:
            hd.hdStopScheduler()
            hd.hdUnschedule(self._scheduled)
            self._scheduled = None
        hd.hdDisableDevice(self._device)
        self._device, TouchDevice.held = None, False
        self._errors()


class TouchDriver(HardwareDriver):
    """A driver node with a Touch or Touch X."""

    Parameters: ClassVar[type[msgspec.Struct]] = TouchDriverParameters
    hardware: ClassVar[type[MailboxDevice]] = TouchDevice
    checked: ClassVar[str] = "a stand-in library; not on hardware"
