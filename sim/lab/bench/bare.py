"""Reference loops for launches, bare Python and C, and launches with optional tick work.

Each case (guard, cross-fade, device behind its servo loop) is the ordinary launch with one extra
parameter file, or with an emulated device instead of the virtual one, so that only this differs.
"""

import atexit
import contextlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from nodes.compiled.library import library_of_pyzmq
from nodes.compiled.message_fields import NotCompilableError
from nodes.launcher import scenario_files
from nodes.launcher.child import PYTHON
from nodes.parameters.yaml_io import read_yaml
from sim.emulators.world import library
from sim.measure.haptic_commands import MeasurementError

BARE = (
    *PYTHON,
    "-m",
    "sim.lab.bench.bare_loop",
)  # reference loop: bare pyzmq and msgpack


@cache
def c_loop() -> tuple[str, ...] | None:
    """Compile the reference loop in C; None without a compiler."""
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
    done = subprocess.run(
        [compiler, "-O2", "-o", program, source, "-ldl"],
        capture_output=True,
        check=False,
    )
    return (str(program), libzmq) if done.returncode == 0 else None


def bare_loop(
    ticks: int,
    core: str,
    fifo: int = 0,
    rate: float = 0.0,
    logger: bool = False,
    program: Sequence[str] = BARE,
) -> dict[str, Any]:
    """Run a reference loop."""
    from sim.lab.bench.bare_loop import ROLES

    with tempfile.TemporaryDirectory(prefix="haptic-bare-") as folder:
        tail = [str(rate), str(int(logger))]
        others = sorted(
            os.sched_getaffinity(0) - ({int(core)} if core.isdecimal() else set())
        )
        commands = [
            [*program, role, folder, str(ticks), core, str(fifo), *tail]
            for role in ROLES
        ]
        if logger:
            commands.insert(
                0,
                [
                    *program,
                    "logger",
                    folder,
                    str(ticks),
                    str(others[0]) if others else core,
                    "0",
                    *tail,
                ],
            )
        started = [
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            for command in commands
        ]
        try:
            out, _ = started[-1].communicate(
                timeout=60.0 + 4.0 * ticks / (rate or 1000.0)
            )
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


SCENARIO: Final = "floor_drop"

# maximum number of ticks of a ramp; a longer round continues with the new law
LONGEST_FADE: Final = 100_000
# Servo rate of the emulator and of the loop compared with the virtual device [Hz]; the servo is
# synchronised with the loop.
SERVO_RATE: Final = 4000
# Driver parameters of the emulated Force Dimension device.
ARM: Final[Mapping[str, Any]] = {
    "serial": 1234,
    "ready_time": 5.0,
    "servo_rate": SERVO_RATE,
}
# Cases and their labels.
CASES: Final = {
    "guard": "guard on",
    "fade": "during a cross-fade",
    "stand_in": "stand-in of a device",
}


def given(case: str) -> dict[str, Any]:
    """Return the parameters that a case adds to the nodes."""
    if case == "guard":
        # An unlimited allowance: no force is reduced, but the work is done.
        return {"driver": {"passivity": {"guard": "on", "allowance": 1e3}}}
    if case == "fade":
        return {
            "coupling": {
                "schedule": [{"at": 0.0, "law": "pd_alpha", "ramp": LONGEST_FADE}]
            }
        }
    return {}


def _with_arm(folder: Path) -> str:
    """Write the launch with an emulated arm, pressed into the wall, as its device."""
    path, world = library("dhd", folder)
    world.state.position[2] = -0.001
    content = read_yaml(scenario_files.find(SCENARIO))
    driver = content["nodes"]["driver"]
    parameters = {
        "safety": driver["parameters"]["safety"],
        "force_dimension": {**ARM, "library": str(path)},
    }
    driver |= {"kind": "force_dimension_driver", "parameters": parameters}
    # Applies to the virtual device only.
    del content["model"]
    for name in ("mass", "height"):
        del content["arguments"][name]
    content["nodes"]["coupling"]["parameters"]["plant"] = {
        "mass": world.state.mass,
        "damping": 1.0,
    }
    written = folder / "stand_in.yaml"
    written.write_text(json.dumps(content), encoding="utf-8")
    return str(written)


@contextlib.contextmanager
def launches(cases: Sequence[str]) -> Iterator[dict[str, tuple[str, ...]]]:
    """Yield the arguments of ``haptic launch`` per case; ``""`` is the ordinary launch."""
    with tempfile.TemporaryDirectory(prefix="haptic-cases-") as place:
        found: dict[str, tuple[str, ...]] = {"": (SCENARIO,)}
        for case in cases:
            if case == "stand_in":
                found[case] = (_with_arm(Path(place)),)
                continue
            path = Path(place) / f"{case}.yaml"
            path.write_text(json.dumps(given(case)), encoding="utf-8")
            found[case] = (SCENARIO, "--params", str(path))
        yield found
