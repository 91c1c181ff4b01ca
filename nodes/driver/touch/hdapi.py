"""HDAPI (OpenHaptics, libHD) as the Touch's driver needs it: constants, shared structures, axes, the servo loop's library.

From public headers and bindings; HDAPI counts in millimetres with +x right, +y up, +z towards the user.
"""

from __future__ import annotations

import contextlib
import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, ClassVar

from messages.types import Vector
from nodes.compiled import cache

FORCE_OUTPUT = 0x4000
CALIBRATION_OK, CALIBRATION_NEEDS_UPDATE, CALIBRATION_NEEDS_MANUAL = 0x5000, 0x5001, 0x5002
MAX_WORKSPACE, UPDATE_RATE, MAX_FORCE, MAX_CONTINUOUS_FORCE = 0x2550, 0x2600, 0x2603, 0x2604
CALIBRATION_STYLE = 0x2555
"""Which ways of calibrating the device has, one bit each."""

AUTOMATIC, INKWELL, ENCODER_RESET = 2, 4, 1
"""The ways, the best first, as the vendor's examples prefer them."""

FAULT, STALLED, UNREAD = 1, 2, 3
"""What ``device_read`` of servo.c fails with, as negative numbers."""

INVALID_HANDLE = 0xFFFFFFFF
ERRORS = {
    0x0100: "invalid enum", 0x0101: "invalid value", 0x0102: "invalid operation", 0x0103: "invalid input type",
    0x0104: "bad handle", 0x0200: "warm motors", 0x0201: "exceeded maximum force", 0x0202: "exceeded maximum force impulse",
    0x0203: "exceeded maximum velocity", 0x0204: "force error", 0x0300: "device fault", 0x0302: "communication error",
    0x0304: "timer error", 0x0402: "frame error", 0x0501: "scheduler full",
}  # fmt: skip


class ErrorInfo(ctypes.Structure):
    """What ``hdGetError`` returns, by value."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("error", ctypes.c_uint),
        ("internal", ctypes.c_int),
        ("device", ctypes.c_uint),
    ]


class Servo(ctypes.Structure):
    """What driver and servo loop share, as in nodes/driver/touch/servo.c."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *((name, ctypes.c_void_p) for name in ("begin_frame", "end_frame", "get_double", "set_double", "get_error")),
        ("device", ctypes.c_uint),
        ("deadline", ctypes.c_uint),
        ("commands", ctypes.c_uint),
        ("force", ctypes.c_double * 3),
        ("stop", ctypes.c_uint),
        ("seen", ctypes.c_uint),
        ("seen_at", ctypes.c_double),
        ("patience", ctypes.c_double),
        ("samples", ctypes.c_uint),
        ("position", ctypes.c_double * 3),
        *((name, ctypes.c_uint) for name in ("ticks", "let_go", "errors", "fault", "last_command", "silent")),
        ("held", ctypes.c_double * 3),
    ]


def to_ours(vector: tuple[float, float, float]) -> Vector:
    """Turn a position of HDAPI into ours."""
    x, y, z = vector
    return (-z * 1e-3, -x * 1e-3, y * 1e-3)


def servo_library() -> Any:
    """Load the servo loop, which is compiled once per version of its source."""
    source = Path(__file__).with_name("servo.c")
    sources = {str(source.relative_to(cache.ROOT)): cache.digest_of(source)}
    name = "servo.so"
    try:
        found = cache.read(name)
    except cache.CacheRefusedError:
        found = None
    if found is None:
        found = cache.CacheEntry(kind="so", content=_compiled_servo(source))
        # Where nothing can be kept it is compiled at each start.
        with contextlib.suppress(cache.CacheRefusedError):
            cache.write(name, found, sources)
    return cache.load(found.content)


def _compiled_servo(source: Path) -> bytes:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise OSError("no C compiler: the servo loop of the Touch is compiled once at first use; install gcc or clang")
    with tempfile.TemporaryDirectory(prefix="haptic-servo-") as folder:
        library = Path(folder) / "servo.so"
        done = subprocess.run(
            [compiler, "-O2", "-shared", "-fPIC", "-o", library, source], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise OSError(f"{compiler} cannot compile {source}: {done.stderr[-1000:]}")
        return library.read_bytes()


def load_library(name: str) -> Any:
    """Load the vendor's library and declare what is used of it."""
    try:
        library: Any = ctypes.CDLL(name)
    except OSError as error:
        raise OSError(
            f"{name} cannot be loaded ({error}): install OpenHaptics and the Touch device driver of 3D Systems, or give "
            "the library's path as touch.library; without a device, use kind sim_driver"
        ) from error
    uint, void = ctypes.c_uint, None
    doubles = ctypes.POINTER(ctypes.c_double)
    for function_name, result, arguments in (
        ("hdInitDevice", uint, [ctypes.c_char_p]),
        ("hdDisableDevice", void, [uint]),
        ("hdEnable", void, [uint]),
        ("hdDisable", void, [uint]),
        ("hdGetDoublev", void, [uint, doubles]),
        ("hdGetIntegerv", void, [uint, ctypes.POINTER(ctypes.c_int)]),
        ("hdGetError", ErrorInfo, []),
        ("hdSetSchedulerRate", void, [ctypes.c_ulong]),
        ("hdScheduleAsynchronous", ctypes.c_ulong, [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ushort]),
        ("hdStartScheduler", void, []),
        ("hdStopScheduler", void, []),
        ("hdUnschedule", void, [ctypes.c_ulong]),
        ("hdCheckCalibration", uint, []),
        ("hdUpdateCalibration", void, [uint]),
    ):
        try:
            function = getattr(library, function_name)
        except AttributeError as error:
            raise OSError(f"{name} has no {function_name}: it is not HDAPI's library (libHD)") from error
        function.restype, function.argtypes = result, arguments
    return library
