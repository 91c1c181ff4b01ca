"""Running the yardsticks: the bare loop in Python, and in C where there is a compiler."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from nodes.compiled.library import library_of_pyzmq
from nodes.compiled.message_fields import NotCompilableError
from nodes.launcher.child import PYTHON
from sim.measure.measured_launch import MeasurementError

BARE = (*PYTHON, "-m", "sim.measure.bare_loop")
"""The yardstick: bare pyzmq and msgpack."""


@cache
def c_loop() -> tuple[str, ...] | None:
    """Compile the yardstick in C."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    try:
        libzmq = library_of_pyzmq()
    except NotCompilableError:
        return None
    if compiler is None:
        return None
    program = Path(tempfile.mkdtemp(prefix="haptic-bare-c-")) / "bare_loop"
    atexit.register(shutil.rmtree, program.parent, ignore_errors=True)
    source = Path(__file__).with_name("bare_loop.c")
    done = subprocess.run([compiler, "-O2", "-o", program, source, "-ldl"], capture_output=True, check=False)
    return (str(program), libzmq) if done.returncode == 0 else None


def bare_loop(
    ticks: int, core: str, fifo: int = 0, rate: float = 0.0, logger: bool = False, program: Sequence[str] = BARE
) -> dict[str, Any]:
    """Run a yardstick."""
    from sim.measure.bare_loop import ROLES

    with tempfile.TemporaryDirectory(prefix="haptic-bare-") as folder:
        tail = [str(rate), str(int(logger))]
        others = sorted(os.sched_getaffinity(0) - ({int(core)} if core.isdecimal() else set()))
        commands = [[*program, role, folder, str(ticks), core, str(fifo), *tail] for role in ROLES]
        if logger:
            commands.insert(0, [*program, "logger", folder, str(ticks), str(others[0]) if others else core, "0", *tail])
        started = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for command in commands]
        try:
            out, _ = started[-1].communicate(timeout=60.0 + 4.0 * ticks / (rate or 1000.0))
            codes = [process.wait(timeout=10.0) for process in started]
        finally:
            for process in started:
                process.kill()
                if process.stdout is not None:
                    process.stdout.close()
        if any(codes):
            raise MeasurementError(f"the bare loop failed with exit codes {codes}")
        figures: dict[str, Any] = json.loads(out)
        return figures
