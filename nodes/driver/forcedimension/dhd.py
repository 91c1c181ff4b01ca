"""DHD (Force Dimension SDK): functions, constants, texts; a static library is linked once.

Checked against the header and the library of SDK 3.17.5 (dhdc.h, libdrd.a for Linux).
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from ctypes import (
    POINTER,
    c_bool,
    c_char,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_ubyte,
    c_uint,
    c_ushort,
    c_void_p,
)
from pathlib import Path
from typing import Any, ClassVar, Final

from nodes.driver.hardware.compile import compiler, shared_library
from nodes.driver.hardware.libraries import Functions, declared, find, load
from nodes.driver.hardware.mailbox import Mailbox

FOLDERS: Final = (
    "/usr/lib",
    "/usr/lib64",
    "/usr/lib/x86_64-linux-gnu",
    "/usr/local/lib",
    "/opt/force-dimension/lib",
)
REMEDY: Final = (
    "install the Force Dimension SDK and give the path of its libdhd.so or, where it has only"
    " static libraries, of lib/release/lin-x86_64-gcc/libdhd.a (or libdrd.a) as"
    " force_dimension.library"
)
WHAT: Final = "Force Dimension's library (libdhd, libdrd)"

ERRORS: Final = (  # indexed by number, as in dhdc.h
    *(
        "no error",
        "error",
        "communication error",
        "device controller busy",
        "no driver found",
        "no device found",
    ),
    *(
        "operation not available",
        "operation timed out",
        "geometry error",
        "expert mode disabled",
        "not implemented",
    ),
    *(
        "out of memory",
        "device not ready",
        "file not found",
        "configuration error",
        "invalid index",
        "deprecated",
    ),
    *(
        "null argument",
        "redundant encoder integrity test failed",
        "feature is not enabled",
        "device is in use",
    ),
    *("invalid value", "robotic regulation is not running"),
)

CONDITIONS: Final = {  # causes of missing forces in the device's status (DHD_FORCE_OFF_*)
    1: "the device's FORCE button is off: press it",
    2: (
        "the handle moved faster than the device allows and it braked: let it rest, then press its"
        " FORCE button"
    ),
    3: "its watchdog cut the forces, because none came in time: press its FORCE button",
    4: "forces are not enabled",
    5: "the USB connection was cut",
    6: "nobody holds its dead-man's switch",
}

STATUS: Final = 17
RESET: Final = 3  # index in the status: whether the device must be calibrated
WATCHDOG_UNIT: Final = 125e-6  # unit of the firmware's watchdog [s]; at most 255 units

_ID: Final = c_char
_D: Final = POINTER(c_double)

FUNCTIONS: Final[Functions] = {  # the functions used
    **dict.fromkeys(
        ("dhdErrorGetLast", "dhdGetDeviceCount", "dhdEnableExpertMode"), (c_int, [])
    ),
    **dict.fromkeys(("dhdOpenID", "dhdClose", "dhdStop"), (c_int, [_ID])),
    **dict.fromkeys(("dhdEnableForce", "dhdSetWatchdog"), (c_int, [c_ubyte, _ID])),
    **dict.fromkeys(
        ("dhdSetEffectorMass", "dhdSetBaseAngleXDeg", "dhdSetBaseAngleZDeg"),
        (c_int, [c_double, _ID]),
    ),
    **dict.fromkeys(
        ("dhdGetPosition", "dhdGetLinearVelocity"), (c_int, [_D, _D, _D, _ID])
    ),
    **dict.fromkeys(("dhdHasWrist", "dhdHasGripper"), (c_bool, [_ID])),
    **dict.fromkeys(("dhdGetGripperGap", "dhdGetJointAngles"), (c_int, [_D, _ID])),
    "dhdGetSDKVersionStr": (c_char_p, []),
    "dhdGetSerialNumber": (c_int, [POINTER(c_ushort), _ID]),
    "dhdGetSystemName": (c_char_p, [_ID]),
    "dhdGetVersionStr": (c_int, [c_char_p, c_size_t, _ID]),
    "dhdGetStatus": (c_int, [POINTER(c_int), _ID]),
    "dhdSetGravityCompensation": (c_int, [c_int, _ID]),
    "dhdGetMaxForce": (c_double, [_ID]),
    "dhdGetOrientationFrame": (c_int, [c_void_p, _ID]),
    "dhdGetButtonMask": (c_uint, [_ID]),
    "dhdSetForce": (c_int, [c_double, c_double, c_double, _ID]),
    "dhdJointAnglesToInertiaMatrix": (c_int, [_D, _D, _ID]),
}


SERVO_CALLS: Final = {  # functions called by the servo loop, by its own names
    "get_position": "dhdGetPosition",
    "get_velocity": "dhdGetLinearVelocity",
    "get_orientation": "dhdGetOrientationFrame",
    "get_gripper": "dhdGetGripperGap",
    "get_buttons": "dhdGetButtonMask",
    "get_status": "dhdGetStatus",
    "set_force": "dhdSetForce",
    "last_error": "dhdErrorGetLast",
    "get_joints": "dhdGetJointAngles",
}


class DhdServo(ctypes.Structure):
    """Memory shared by driver and servo loop, as in nodes/driver/forcedimension/servo.c."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("box", Mailbox),
        *((name, c_void_p) for name in SERVO_CALLS),
        ("period", c_double),
        *((name, c_int) for name in ("device", "running", "saturated")),
        ("poses", c_uint),
        ("joints", c_double * 8),
        ("thread", ctypes.c_ulong),
    ]


def error_text(code: int) -> str:
    """Return an error as text."""
    return f"{ERRORS[code] if 0 <= code < len(ERRORS) else 'error'} ({code})"


def identity(device: int) -> bytes:
    """Return the number of a device as DHD expects it: a char."""
    return bytes([device & 0xFF])


def load_library(name: str) -> Any:
    """Load the vendor's library and declare its functions; a static one is linked first, once."""
    if name.endswith(".a"):
        path = Path(name).absolute()
        if not path.exists():
            raise OSError(
                f"{name} cannot be loaded: no such file; {REMEDY}; without a device, use kind"
                " sim_driver"
            )
        return declared(_linked(path), name, WHAT, FUNCTIONS)
    return load(name, FOLDERS, REMEDY, WHAT, FUNCTIONS)


def _linked(archive: Path) -> Any:
    """Return a static library linked into a shared one."""
    usb = find(
        "libusb-1.0.so.0",
        ("/usr/lib", "/usr/lib/x86_64-linux-gnu", "/lib/x86_64-linux-gnu"),
    )
    if usb.library is not None:
        # the archive needs its functions
        ctypes.CDLL(usb.library, mode=ctypes.RTLD_GLOBAL)
    with tempfile.TemporaryDirectory(prefix="haptic-dhd-") as folder:
        stubs = Path(folder) / "stubs.c"
        stubs.write_text(_stubs(archive), encoding="ascii")
        whole: list[str | Path] = [
            "-Wl,--whole-archive",
            archive,
            "-Wl,--no-whole-archive",
            stubs,
        ]
        options = [*whole, "-lstdc++", "-lpthread", "-lm"]
        try:
            return shared_library(
                f"linked-{archive.stem}.so",
                [archive],
                options,
                f"a library of {archive}",
            )
        except OSError as error:
            name = _missing_symbol(error)
            if not name:
                raise
            missing = (
                f"libusb-1.0.so.0 is not found (looked in {', '.join(usb.searched)}): install"
                " libusb-1.0-0"
                if name.startswith("libusb") and usb.library is None
                else f"it is not {WHAT}, or not all of it; {REMEDY}"
            )
            raise OSError(
                f"{archive} cannot be used: it needs {name}, which nothing here has; {missing}"
            ) from error


def _missing_symbol(error: OSError) -> str:
    """Return the symbol that a library needs and nothing provides, or "" for another error.

    The loader reports it in a sentence only (dlerror); a test fails if its words change.
    """
    _, found, name = str(error).rpartition("undefined symbol: ")
    return name if found else ""


def _stubs(archive: Path) -> str:
    """Return C source of no-op functions for the vendor's logger, which its archive lacks."""
    done = subprocess.run(["nm", archive], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(
            f"nm cannot read {archive}: {done.stderr[-300:]}; is it a static library of"
            f" {compiler()}?"
        )
    return stub_source(done.stdout)


def stub_source(listing: str) -> str:
    """Return the source of the functions that an archive's listing by ``nm`` lacks."""
    names: dict[str, set[str]] = {"U": set(), "T": set()}
    for line in listing.splitlines():
        *_, kind, name = line.split() if len(line.split()) >= 2 else ("", "", "")
        if kind in ("U", "T", "D", "B", "R", "W"):
            names["U" if kind == "U" else "T"].add(name)
    missing = sorted(
        name for name in names["U"] - names["T"] if "forcedimension6logger" in name
    )
    # weak, and sufficient for a number as for a function without a result
    return (
        "".join(
            f"__attribute__((weak)) long {name}(void) {{ return 0; }}\n"
            for name in missing
        )
        or "int unused;\n"
    )
