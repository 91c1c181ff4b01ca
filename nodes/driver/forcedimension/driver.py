"""Force Dimension devices as a driver node, through DHD and a servo loop in C (servo.c).

Checked against the header and the static library of SDK 3.17.5 without a device, and against a
stand-in (sim/emulators); not yet on hardware. Positions are in metres; the axes of a device on a
table are +x to the operator, +y right, +z up.
"""

from __future__ import annotations

import ctypes
import math
import time
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from nodes.driver.device import Workspace
from nodes.driver.forcedimension import dhd as sdk
from nodes.driver.hardware.driver import HardwareDriver
from nodes.driver.hardware.inertia import Inertia
from nodes.driver.hardware.mailbox import (
    HardwareParameters,
    MailboxDevice,
    ServoParameters,
)
from nodes.parameters.paths import LocalPath


class ForceDimensionParameters(
    ServoParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the device.

    serial: Its serial number; None for the first one found.
    library: DHD's library: a name that the dynamic linker finds, or a path; a static one (``.a``)
        is linked once.
    watchdog: Time without a force command after which the firmware itself cuts the forces and
        brakes [s], even if the whole process is gone. 0 for a device without one, which must then
        be allowed by ``safety.without: [hold]``.
    peak_force: Largest force of the model along each axis [N], which the device does not report. An
        omega.3 has 12, a delta.3 and a sigma.7 20, a Falcon 8.
    continuous_force: Largest lasting force [N]; None for the peak force.
    workspace: Workspace of the model, along its own axes [m]; a device outside of it gets no force.
    gravity_compensation: Whether the library carries the device's own weight, in addition to the
        forces of the scene.
    tool_mass: Mass mounted on the device, for gravity compensation [kg]; None for the device's own
        value.
    base_angles: Rotation of the base about its own x and z axes, for gravity compensation
        [degrees].
    ready_time: Longest wait for a device that must be moved to calibrate itself [s].
    """

    serial: int | None = None
    library: LocalPath = "libdhd.so"
    deadline: Annotated[float, msgspec.Meta(ge=0.005, le=0.1)] = 0.03
    watchdog: Annotated[float, msgspec.Meta(ge=0.0, le=0.0319)] = 0.03
    peak_force: Annotated[float, msgspec.Meta(gt=0.0)] = 8.0
    continuous_force: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    workspace: Workspace = ((-0.2, 0.2), (-0.2, 0.2), (-0.2, 0.2))
    gravity_compensation: bool = True
    tool_mass: Annotated[float, msgspec.Meta(ge=0.0)] | None = None
    base_angles: tuple[float, float] = (0.0, 0.0)
    ready_time: Annotated[float, msgspec.Meta(ge=0.0, le=120.0)] = 20.0


class ForceDimensionDriverParameters(
    HardwareParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the driver node.

    force_dimension: The device.
    """

    force_dimension: ForceDimensionParameters = ForceDimensionParameters()


class ForceDimensionDevice(MailboxDevice):
    """One device: `connect` opens it with forces off; `open` waits for its calibration."""

    TITLE: ClassVar[str] = "Force Dimension"
    SECTION: ClassVar[str] = "force_dimension"
    FOLDERS: ClassVar[tuple[str, ...]] = sdk.FOLDERS
    AXES: ClassVar[tuple[str, ...]] = ("-x", "-y", "+z")
    SERVO: ClassVar[Path] = Path(__file__).with_name("servo.c")
    Shared: ClassVar[type[Any]] = sdk.DhdServo

    def __init__(self, parameters: ForceDimensionDriverParameters) -> None:
        super().__init__(parameters)
        self._id: bytes | None = None

    def connect(self) -> None:
        """Load the vendor's library, open the wanted device, read its properties; no force yet."""
        self._dhd: Any = sdk.load_library(self._wants.library)
        count = self._dhd.dhdGetDeviceCount()
        if count <= 0:
            raise OSError(
                f"Force Dimension: no device found (of {self._sdk()}): is it plugged in and"
                " switched on? Without a rule of udev for vendor 1451 (a Falcon: 0403:cb48) only"
                " root sees it"
            )
        seen: list[str] = []
        refused = ""
        for number in range(count):
            if self._dhd.dhdOpenID(sdk.identity(number)) < 0:
                refused = self._last()
                seen.append(f"number {number}: {refused}")
                continue
            self._id = sdk.identity(number)
            try:
                serial = self._serial()
                if self._wants.serial in (None, serial):
                    self._connected(serial)
                    return
                seen.append(f"serial number {serial}")
            except OSError:
                self.close()
                raise
            self.close()
        if self._wants.serial is None:
            raise OSError(
                f"Force Dimension: the device cannot be opened: {refused}; does another program"
                " have it?"
            )
        raise OSError(
            f"Force Dimension: no device with serial number {self._wants.serial}; available:"
            f" {', '.join(seen)}"
        )

    def _connected(self, serial: int) -> None:
        wants, dhd = self._wants, self._dhd
        self._call("dhdEnableForce", 0)
        version = ctypes.create_string_buffer(64)
        has_version = dhd.dhdGetVersionStr(version, 64, self._id) >= 0
        name = dhd.dhdGetSystemName(self._id)
        self.facts = {
            "model": name.decode(errors="replace") if name else "unknown",
            "serial": str(serial),
            "firmware": version.value.decode(errors="replace")
            if has_version
            else "unknown",
            "sdk": self._sdk(),
            # A limit set in the library, not a property of the device; −1: none, or no answer.
            "force_limit_n": float(dhd.dhdGetMaxForce(self._id)),
        }
        has_watchdog = False
        if wants.watchdog > 0.0:
            units = min(255, int(wants.watchdog / sdk.WATCHDOG_UNIT))
            has_watchdog = (
                dhd.dhdEnableExpertMode() >= 0
                and dhd.dhdSetWatchdog(units, self._id) >= 0
            )
        self.facts["watchdog"] = (
            f"{wants.watchdog:g} s" if has_watchdog else f"none ({self._last()})"
        )
        limit = self.facts["force_limit_n"]
        peak = min(wants.peak_force, limit) if limit > 0.0 else wants.peak_force
        # The thread's deadline acts while the process lives; the firmware's, when it does not.
        hold = max(wants.deadline, wants.watchdog) if has_watchdog else math.inf
        continuous = min(peak, wants.continuous_force or peak)
        self.prepare(
            peak,
            continuous,
            wants.workspace,
            hold=hold,
            opening=wants.ready_time + 10.0,
        )

    def _serial(self) -> int:
        number = ctypes.c_ushort()
        self._call("dhdGetSerialNumber", ctypes.byref(number))
        return int(number.value)

    def _sdk(self) -> str:
        text = self._dhd.dhdGetSDKVersionStr()
        return (
            f"SDK {text.decode(errors='replace')}"
            if text
            else "an SDK without a version"
        )

    def _last(self) -> str:
        return sdk.error_text(self._dhd.dhdErrorGetLast())

    def _call(self, name: str, *arguments: Any) -> int:
        """Call DHD and return the result; negative results are errors."""
        result: int = getattr(self._dhd, name)(*arguments, self._id)
        if result < 0:
            raise OSError(f"Force Dimension: {name}: {self._last()}")
        return result

    def open(self) -> None:
        """Wait for the calibration, start the servo loop, then enable forces, at zero."""
        wants, dhd = self._wants, self._dhd
        assert self._id is not None  # noqa: S101  # it is connected
        self._await_ready()
        self._call("dhdSetBaseAngleXDeg", wants.base_angles[0])
        self._call("dhdSetBaseAngleZDeg", wants.base_angles[1])
        if wants.tool_mass is not None:
            self._call("dhdSetEffectorMass", wants.tool_mass)
        self._call("dhdSetGravityCompensation", int(wants.gravity_compensation))
        servo = self._shared
        has_wrist = dhd.dhdHasWrist(self._id)
        has_gripper = dhd.dhdHasGripper(self._id)
        self.facts |= {"wrist": has_wrist, "gripper": has_gripper}
        there = {"get_orientation": has_wrist, "get_gripper": has_gripper}
        for field, name in sdk.SERVO_CALLS.items():
            if there.get(field, True):
                setattr(
                    servo, field, ctypes.cast(getattr(dhd, name), ctypes.c_void_p).value
                )
        servo.device = self._id[0]
        servo.period = 1.0 / wants.servo_rate
        if error := self._code.servo_start(ctypes.byref(servo)):
            raise OSError(error, "Force Dimension: the servo loop cannot be started")
        self.await_samples()
        self._call("dhdEnableForce", 1)
        self._box.condition = 0  # the old status said that forces were off

    def _await_ready(self) -> None:
        until = time.monotonic() + self._wants.ready_time
        status = (ctypes.c_int * sdk.STATUS)()
        while self._call("dhdGetStatus", status) >= 0 and status[sdk.RESET]:
            if time.monotonic() > until:
                raise OSError(
                    f"Force Dimension: not calibrated within {self._wants.ready_time:g} s: move the"
                    " handle through its whole range once, or into its cradle, and launch again"
                )
            self.wait_for(
                f"waits up to {self._wants.ready_time:g} s for its calibration: move the handle"
                " through its whole range, or into its cradle"
            )
            time.sleep(0.02)

    def close(self) -> None:
        """End the servo loop, set forces off and close the device; also after a partial failure."""
        if self._id is None:
            return
        if self._shared is not None and self._code.servo_end(
            ctypes.byref(self._shared)
        ):
            raise OSError(
                "Force Dimension: a call of the device does not return; its watchdog cuts the"
                " forces"
            )
        # Forces off first; a device that is gone refuses both, which does not matter here.
        self._dhd.dhdStop(self._id)
        self._dhd.dhdClose(self._id)
        self._id = None

    def error_text(self, code: int) -> str:
        """Return an error of DHD as text."""
        return sdk.error_text(code)

    def condition(self) -> str:
        """Return why the device gives no force."""
        cause = int(self._box.condition)
        return (
            sdk.CONDITIONS.get(
                cause, f"the device says that forces are off (cause {cause})"
            )
            if cause
            else ""
        )

    def inertia(self) -> Inertia | None:
        """Return the inertia that forces of the scene move at the present position [kg]."""
        if self._id is None:
            return None
        joints = (ctypes.c_double * 8)()
        matrix = (ctypes.c_double * 36)()
        # While the servo loop runs, only it reads the device; the rest is computed.
        if self._shared.running:
            known = bool(self._code.servo_joints(ctypes.byref(self._shared), joints))
        else:
            known = self._dhd.dhdGetJointAngles(joints, self._id) >= 0
        if (
            not known
            or self._dhd.dhdJointAnglesToInertiaMatrix(joints, matrix, self._id) < 0
        ):
            return None
        return inertia_in_scene(np.reshape(matrix, (6, 6))[:3, :3], self.turn)


def inertia_in_scene(theirs: ArrayLike, turn: Inertia) -> Inertia:
    """Return a device's inertia m in the scene's axes, T⁻ᵀ m T⁻¹ [kg].

    The energy is the same for v = T u, with T a rotation times the scale.
    """
    rows = np.array(turn)
    ours: Inertia = msgspec.convert(
        (rows @ theirs @ rows.T / (rows[0] @ rows[0]) ** 2).tolist(), Inertia
    )
    return ours


class ForceDimensionDriver(HardwareDriver):
    """A driver node with a Force Dimension device."""

    Parameters: ClassVar[type[msgspec.Struct]] = ForceDimensionDriverParameters
    hardware: ClassVar[type[MailboxDevice]] = ForceDimensionDevice
    checked: ClassVar[str] = (
        "the library of SDK 3.17.5 without a device, and a stand-in of it; not on hardware"
    )
