"""HDAPI (OpenHaptics, libHD): constants, structures, and loading of the library.

From public headers and bindings; HDAPI counts in millimetres with +x right, +y up, +z towards the
user.
"""

from __future__ import annotations

import ctypes
from typing import Any, ClassVar

from nodes.driver.hardware.libraries import Functions, load
from nodes.driver.hardware.mailbox import Mailbox

FORCE_OUTPUT = 0x4000
CALIBRATION_OK, CALIBRATION_NEEDS_UPDATE, CALIBRATION_NEEDS_MANUAL = (
    0x5000,
    0x5001,
    0x5002,
)
MODEL_TYPE, DRIVER_VERSION, SERIAL_NUMBER = 0x2501, 0x2502, 0x2504
MAX_WORKSPACE, MAX_FORCE, MAX_CONTINUOUS_FORCE = 0x2550, 0x2603, 0x2604
CALIBRATION_STYLE = 0x2555  # calibration methods of the device, one bit each
# the methods, the best first, as the vendor's examples prefer them
AUTOMATIC, INKWELL, ENCODER_RESET = 2, 4, 1

INVALID_HANDLE = 0xFFFFFFFF
ERRORS = {
    0x0100: "invalid enum",
    0x0101: "invalid value",
    0x0102: "invalid operation",
    0x0103: "invalid input type",
    0x0104: "bad handle",
    0x0200: "warm motors",
    0x0201: "exceeded maximum force",
    0x0202: "exceeded maximum force impulse",
    0x0203: "exceeded maximum velocity",
    0x0204: "force error",
    0x0300: "device fault",
    0x0301: "device already initiated",
    0x0302: "communication error",
    0x0303: "communication configuration error",
    0x0304: "timer error",
    0x0400: "illegal begin",
    0x0401: "illegal end",
    0x0402: "frame error",
    0x0500: "invalid priority",
    0x0501: "scheduler full",
    0x0600: "invalid licence",
}


class ErrorInfo(ctypes.Structure):
    """Result of ``hdGetError``, by value."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("error", ctypes.c_uint),
        ("internal", ctypes.c_int),
        ("device", ctypes.c_uint),
    ]


SERVO_CALLS = {  # functions called by the servo loop, by its own names
    "begin_frame": "hdBeginFrame",
    "end_frame": "hdEndFrame",
    "make_current": "hdMakeCurrentDevice",
    "get_double": "hdGetDoublev",
    "get_integer": "hdGetIntegerv",
    "set_double": "hdSetDoublev",
    "get_error": "hdGetError",
    "enable": "hdEnable",
    "disable": "hdDisable",
}


class TouchServo(ctypes.Structure):
    """Memory shared by driver and servo loop, as in nodes/driver/touch/servo.c."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("box", Mailbox),
        *((name, ctypes.c_void_p) for name in SERVO_CALLS),
        *((name, ctypes.c_uint) for name in ("device", "turns")),
        *((name, ctypes.c_int) for name in ("cut", "watched")),
        ("watch", ctypes.c_ulong),
    ]


def error_text(code: int) -> str:
    """Return an error as text."""
    return f"{ERRORS.get(code, 'error')} (0x{code:04X})"


FOLDERS = (
    "/usr/lib",
    "/usr/lib64",
    "/usr/lib/x86_64-linux-gnu",
    "/usr/local/lib",
    "/opt/OpenHaptics",
)
"""Folders of 3D Systems' packages, besides those of the dynamic linker."""

REMEDY = (
    "install OpenHaptics and the Touch device driver of 3D Systems, or give the library's path as"
    " touch.library"
)


def load_library(name: str) -> Any:
    """Load the vendor's library and declare its functions."""
    uint = ctypes.c_uint
    void = None
    doubles = ctypes.POINTER(ctypes.c_double)
    whole = ctypes.POINTER(ctypes.c_int)
    functions: Functions = {
        "hdInitDevice": (uint, [ctypes.c_char_p]),
        **dict.fromkeys(
            ("hdDisableDevice", "hdEnable", "hdDisable", "hdMakeCurrentDevice"),
            (void, [uint]),
        ),
        **dict.fromkeys(
            ("hdBeginFrame", "hdEndFrame", "hdUpdateCalibration"), (void, [uint])
        ),
        **dict.fromkeys(("hdGetDoublev", "hdSetDoublev"), (void, [uint, doubles])),
        "hdGetIntegerv": (void, [uint, whole]),
        "hdGetString": (ctypes.c_char_p, [uint]),
        "hdGetError": (ErrorInfo, []),
        **dict.fromkeys(
            ("hdSetSchedulerRate", "hdUnschedule"), (void, [ctypes.c_ulong])
        ),
        "hdScheduleAsynchronous": (
            ctypes.c_ulong,
            [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ushort],
        ),
        **dict.fromkeys(("hdStartScheduler", "hdStopScheduler"), (void, [])),
        "hdCheckCalibration": (uint, []),
    }
    return load(name, FOLDERS, REMEDY, "HDAPI's library (libHD)", functions)
