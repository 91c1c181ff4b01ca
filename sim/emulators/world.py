"""The arm behind an emulator: physics, commands it received, and faults on demand.

It is stored in a file (world.h) that is mapped both by the emulator in a node's process and by the
program that watches or disturbs it. An emulated library is compiled into a folder, with its world
beside it; two copies are two devices.
"""

import ctypes
import math
import mmap
import os
import subprocess
import time
from pathlib import Path
from typing import Any, ClassVar, Final

from nodes.driver.hardware.compile import compiler, shared_library

HERE: Final = Path(__file__).parent


class WorldState(ctypes.Structure):
    """Layout of world.h."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(
            (name, ctypes.c_double)
            for name in ("mass", "damping", "gravity", "resolution")
        ),
        *(
            (name, ctypes.c_double * 3)
            for name in ("position", "velocity", "force", "seen")
        ),
        *(
            (name, ctypes.c_double)
            for name in ("advanced_at", "free_from", "watchdog", "commanded_at")
        ),
        *((name, ctypes.c_double) for name in ("peak", "continuous", "gripper")),
        ("turn", ctypes.c_double * 9),
        *((name, ctypes.c_int32) for name in ("buttons", "serial", "devices", "rate")),
        *(
            (name, ctypes.c_int32)
            for name in (
                "open",
                "forces",
                "calibrations",
                "broken",
                "commands",
                "style",
            )
        ),
        ("largest", ctypes.c_double),
        *(
            (name, ctypes.c_int32)
            for name in (
                *(
                    "unplugged",
                    "nan",
                    "positive",
                    "block_ms",
                    "manual",
                    "cause",
                    "error",
                    "refuse_rate",
                    "frozen",
                ),
                *("slow_ms", "stuck", "fails"),
            )
        ),
        ("other", ctypes.c_double * 3),
        ("late", ctypes.c_double),
        ("due", ctypes.c_double * (4 * 256)),
        *((name, ctypes.c_int32) for name in ("due_first", "due_count")),
        ("tool_mass", ctypes.c_double),
        ("base", ctypes.c_double * 2),
        *((name, ctypes.c_int32) for name in ("carries", "spare")),
        ("fail", ctypes.c_char * 32),
        ("lock", ctypes.c_int32),
    ]


class World:
    """One arm in its file; a new one has 0.1 kg and is held at the origin."""

    def __init__(self, path: Path) -> None:
        made = not path.exists()
        if made:
            path.write_bytes(bytes(ctypes.sizeof(WorldState)))
        with path.open("r+b") as file:
            self._mapped = mmap.mmap(file.fileno(), ctypes.sizeof(WorldState))
        self.path = path
        # Present state. Faults: ``unplugged`` fails every call; ``nan`` returns NaN positions;
        # ``positive`` makes calls return warnings; ``block_ms`` delays the next read;
        # ``manual`` requires a manual calibration; ``cause`` disables forces; ``error`` reports
        # an error once; ``refuse_rate`` refuses the servo rate; ``frozen`` stops the vendor's
        # thread; ``slow_ms`` delays each read; ``stuck`` freezes the encoders; ``fails`` makes
        # the call named ``fail`` fail; ``other`` is another session's force [N]; ``late`` is the
        # device's own delay [s].
        self.state = WorldState.from_buffer(self._mapped)
        code = shared_library(
            "stand-in-world.so",
            [HERE / "world.c", HERE / "world.h"],
            [HERE / "world.c", "-lm"],
            "an arm",
        )
        code.stand_in_size.restype = ctypes.c_size_t
        if code.stand_in_size() != ctypes.sizeof(WorldState):
            raise OSError(f"{path}: world.h and world.py disagree")
        self._code = code
        if made:
            s = self.state
            s.mass = 0.1
            s.damping = 1.0
            s.free_from = math.inf
            s.peak, s.continuous = 7.9, 1.75
            s.turn[0] = s.turn[4] = s.turn[8] = 1.0
            s.serial, s.devices, s.rate = 1234, 1, 1000

    def fail(self, call: str) -> None:
        """Make a call of the vendor's library fail from now on; an empty name ends this."""
        self.state.fail, self.state.fails = call.encode(), bool(call)

    def force(self) -> tuple[float, float, float]:
        """Return the force that acts on the arm now [N]."""
        self._code.stand_in_advance(ctypes.byref(self.state))
        x, y, z = self.state.force
        return x, y, z

    def read(
        self,
    ) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
        """Read position [m] and velocity [m/s]; None if that fails."""
        position = (ctypes.c_double * 3)()
        velocity = (ctypes.c_double * 3)()
        if not self._code.stand_in_read(ctypes.byref(self.state), position, velocity):
            return None
        return (position[0], position[1], position[2]), (
            velocity[0],
            velocity[1],
            velocity[2],
        )

    def push(self, force: tuple[float, float, float]) -> None:
        """Apply a force [N]."""
        self._code.stand_in_push(
            ctypes.byref(self.state), (ctypes.c_double * 3)(*force)
        )

    def drop(
        self, height: float, gravity: float = 9.81, at: float | None = None
    ) -> None:
        """Drop the arm from a height [m], now or at a time of the monotonic clock [s]."""
        s = self.state
        s.position[:] = (0.0, 0.0, height)
        s.velocity[:] = (0.0, 0.0, 0.0)
        s.gravity = gravity
        s.free_from = time.monotonic() if at is None else at


def library(name: str, folder: Path, *options: str) -> tuple[Path, World]:
    """Compile an emulated library into a folder; return its path and world."""
    # A unique name, because the name of its library identifies who uses a device.
    path = folder / f"lib{name}-{os.urandom(4).hex()}.so"
    subprocess.run(
        _command(name, "-shared", "-fPIC", *options, "-o", str(path)), check=True
    )
    return path, world_beside(path)


def world_beside(path: Path) -> World:
    """Return the world of an emulated library."""
    return World(path.with_name(path.name + ".world"))


def archive(name: str, folder: Path, *options: str) -> Path:
    """Compile the emulator as a static library, as some vendors ship it."""
    compiled = folder / f"{name}.o"
    path = folder / f"lib{name}.a"
    subprocess.run(
        _command(name, "-fPIC", "-c", *options, "-o", str(compiled)), check=True
    )
    subprocess.run(["ar", "rcs", str(path), str(compiled)], check=True)
    return path


def _command(name: str, *options: str) -> list[str]:
    return [
        compiler(),
        "-O1",
        "-pthread",
        *options,
        str(HERE / f"{name}.c"),
        "-ldl",
        "-lm",
    ]
