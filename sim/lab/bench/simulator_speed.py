"""Speed of the one-process simulator: against a plain C loop, and over the cores.

The C loop of the same recurrence is compiled here from the source below, without contraction of
multiply and add and without fast math, so it must give the same bits; this is checked before
timing.
"""

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nodes.base.realtime import off
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha
from nodes.stability.k_max import with_spring
from sim.arrays import Array
from sim.device.model import DeviceModel, coefficients
from sim.experiments.drop import drop_scene
from sim.experiments.settling import Criterion, settles
from sim.measure.haptic_commands import MeasurementError
from sim.measure.stopwatch import Timing, interleaved
from sim.play.one_axis_inputs import Scene, contact_of, motion_of
from sim.play.one_axis_loop import play_compiled
from sim.play.one_axis_tables import LawTables, Records

SOURCE = """
void play(long ticks, double x, double v, const double *c, double load, double surface, \
double normal,
          const double *taps, long count, double *history, long length, double *positions)
{
    long head = 0;
    for (long k = 0; k < ticks; k++) {
        double distance = (x - surface) * normal;
        int contact = distance < 0.0;
        double proxy = contact ? surface : x;
        head = head > 0 ? head - 1 : length - 1;
        history[head] = history[head + length] = proxy - x;
        double force = 0.0;
        for (long m = 0; m < count; m++)
            force += taps[m] * history[head + m];
        if (force * normal < 0.0)
            force = 0.0;
        positions[k] = x;
        double u = force + load;
        double next = c[0] * x + c[1] * v + c[4] * u;
        v = c[2] * x + c[3] * v + c[5] * u;
        x = next;
    }
}
"""
FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC")

PERIOD = 0.002


class NoCompilerError(MeasurementError):
    """There is no C compiler to compare with; the text names the compilers tried."""


@dataclass(frozen=True)
class Speed:
    """Results of the benchmark."""

    # Seconds per tick on one core, by number of taps; C is empty without a compiler.
    simulator: dict[int, Timing]
    plain_c: dict[int, Timing]
    # Seconds per tick of many runs in parallel.
    one_core: Timing
    all_cores: Timing
    cores: int  # number of cores used
    reason: str  # reason why there is no C result; empty if there is one


def scene() -> Scene:
    """Return the scene that is timed."""
    return drop_scene(DeviceModel(mass=0.1, damping=1.0), PERIOD, False, True)


def laws() -> dict[int, CompiledLaw]:
    """Return the laws that are timed."""
    paper = parse_law({"kind": "paper_optimum", "stiffness": 1000.0}).compile(PERIOD)
    long = PDAlpha(
        stiffness=1000.0, damping=2.0, order=0.9, taps=64, gains="paper"
    ).compile(PERIOD)
    return {2: PD(stiffness=1000.0, damping=2.0).compile(PERIOD), 4: paper, 64: long}


def ours(law: CompiledLaw, ticks: int) -> Callable[[], Array]:
    """Prepare one run of the simulator."""
    here = scene()
    motion, contact = motion_of(here, ticks), contact_of(here)
    none, positions = np.empty(0, dtype=np.int64), np.empty(ticks)
    taps = np.array(law.taps)
    rendered = LawTables(
        taps, np.array([0, len(taps)]), None, np.zeros(2, dtype=np.int64), none, none
    )
    records = Records(positions, None, None, None, None, None)

    def play() -> Array:
        history, commands = np.zeros(2 * len(taps)), np.zeros(motion.waiting)
        play_compiled(
            ticks, motion, contact, rendered, np.zeros(0), history, commands, records
        )
        return positions

    return play


def compile_c(folder: Path) -> Any:
    """Compile the C loop."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise NoCompilerError(
            "neither cc nor gcc is in the PATH: install one to compare with C"
        )
    source, library = folder / "play.c", folder / "play.so"
    source.write_text(SOURCE)
    done = subprocess.run(
        [compiler, *FLAGS, "-o", library, source],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise NoCompilerError(
            f"{compiler} {' '.join(FLAGS)} failed: {done.stderr.strip().splitlines()[-1:]}"
        )
    play = ctypes.CDLL(str(library)).play
    number, whole, array = (
        ctypes.c_double,
        ctypes.c_long,
        ctypes.POINTER(ctypes.c_double),
    )
    play.argtypes = [
        whole,
        number,
        number,
        array,
        number,
        number,
        number,
        array,
        whole,
        array,
        whole,
        array,
    ]
    play.restype = None
    return play


def in_c(play: Any, law: CompiledLaw, ticks: int) -> Callable[[], Array]:
    """Prepare one run of the C loop."""
    device = scene().device
    step = np.array(coefficients(device.mass, device.damping, 0.0, PERIOD))
    taps, positions, load = np.array(law.taps), np.empty(ticks), device.load(0, PERIOD)

    def pointer(array: Array) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def run() -> Array:
        n, history = len(taps), np.zeros(2 * len(taps))
        fallen = (device.position, 0.0, pointer(step), load, 0.0, 1.0)
        play(ticks, *fallen, pointer(taps), n, pointer(history), n, pointer(positions))
        return positions

    return run


def measure(
    ticks: int, rounds: int, step: Callable[[str], None] = lambda _: None
) -> Speed:
    """Time the simulator against C, and one core against all, interleaved."""
    jobs: dict[str, tuple[Callable[[], object], int]] = {}
    reason = ""
    with tempfile.TemporaryDirectory() as folder:
        try:
            play = compile_c(Path(folder))
        except NoCompilerError as error:
            play, reason = None, str(error)
        for n, law in laws().items():
            jobs[f"ours|{n}"] = ours(law, ticks), ticks
            if play is not None:
                jobs[f"c|{n}"] = in_c(play, law, ticks), ticks
                if ours(law, ticks)().tobytes() != in_c(play, law, ticks)().tobytes():
                    raise RuntimeError(
                        f"C and the simulator give different bits with {n} taps; the timing would"
                        " mean nothing"
                    )
        cores = len(os.sched_getaffinity(0))
        found = interleaved(jobs, rounds, step)
        # As in a search for K_max: many drops of the usual horizon in parallel.
        horizon = min(ticks, Criterion().ticks)
        many = [with_spring(laws()[4], 10.0 * k) for k in range(16 * cores)]
        work = horizon * len(many)
        spread = interleaved(
            {
                "one": (_spread(many, horizon, 1), work),
                "all": (_spread(many, horizon, cores), work),
            },
            rounds,
            step,
        )
    simulator = {n: found[f"ours|{n}"] for n in laws()}
    plain_c = {} if play is None else {n: found[f"c|{n}"] for n in laws()}
    return Speed(simulator, plain_c, spread["one"], spread["all"], cores, reason)


def _spread(many: list[CompiledLaw], ticks: int, cores: int) -> Callable[[], object]:
    here, criterion = scene(), Criterion(ticks)

    def play() -> object:
        with off(sorted(os.sched_getaffinity(0))[cores:]):
            return settles(here, many, criterion)

    return play
