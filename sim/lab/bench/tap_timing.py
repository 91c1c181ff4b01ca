"""Time per tick of n taps: plain loop, unrolled sum, numpy's running sum, compiled loop.

All four add from the newest to the oldest and so give the same bits; numpy's dot product does not,
and is timed only to show the cost of that. `nodes.coupling.law_on_axis.UNROLLED_TAPS` is chosen
from this. Also timed: the cost of a history that turns with the surface in three axes, by the
kernel's own function.
"""

import math
import subprocess
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nodes.arithmetic import fir
from nodes.compiled.kernels.machine import record_at
from nodes.compiled.kernels.sources import record_of
from nodes.compiled.layout import address_of
from nodes.coupling.kernel import _render as render
from nodes.coupling.law_on_axis import UNROLLED_TAPS, History, LawOnAxis, unrolled
from nodes.coupling.render import begin_turning
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.coupling.state import CouplingState
from nodes.launcher.child import PYTHON
from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives import realise
from nodes.laws.pd import PD
from nodes.laws.pd_filtered import PDFiltered
from nodes.laws.pd_windowed import PDWindowed
from sim.measure.stopwatch import Timing, interleaved
from sim.play.compiled import compiled

LENGTHS = (4, 8, 16, 24, 32, 48, 64, 128, 256, 500, 1000, 2000)
WAYS = ("plain", "unrolled", "numpy", "numba", "numpy_dot")
_CALLS = 200


@dataclass(frozen=True)
class TapTimings:
    """Time per tick of each method at each length."""

    timings: dict[int, dict[str, Timing]]  # number of taps, then method (see `WAYS`)
    same_bits: bool  # whether all but ``numpy_dot`` gave the same bits at all lengths

    def crossover(self, before: str, after: str) -> float | None:
        """Return the number of taps from which one method stays faster than another."""
        lengths = sorted(self.timings)
        ratio = [
            math.log(self.timings[n][after].median / self.timings[n][before].median)
            for n in lengths
        ]
        if ratio[-1] >= 0.0:
            return None
        for i in range(len(lengths) - 1, 0, -1):
            if ratio[i - 1] >= 0.0:
                part = ratio[i - 1] / (ratio[i - 1] - ratio[i])
                return float(lengths[i - 1] * (lengths[i] / lengths[i - 1]) ** part)
        return float(lengths[0])

    def fastest(self, taps: int) -> str:
        """Return the fastest method that gives the kernel's bits."""
        return min(WAYS[:-1], key=lambda way: self.timings[taps][way].median)


_fir_compiled = compiled()(fir)


def evaluators(
    law: CompiledLaw, history: Sequence[float], ring: Any
) -> dict[str, Callable[[int], float]]:
    """Return the methods of summing the taps of one law over one history."""
    taps, n = law.taps, len(law.taps)
    weights: Any = np.array(taps)
    products = np.empty(n)
    multiply, running_sum = np.multiply, np.add.accumulate

    def with_numpy(head: int) -> float:
        multiply(weights, ring[head : head + n], products)
        return float(running_sum(products, out=products)[-1]) + 0.0

    return {
        "plain": lambda head: fir(taps, history, head),
        "unrolled": unrolled(taps, history),
        "numpy": with_numpy,
        "numba": lambda head: _fir_compiled(weights, ring, head),
        "numpy_dot": lambda head: float(weights.dot(ring[head : head + n])),
    }


def time_taps(
    lengths: Sequence[int], rounds: int, step: Callable[[str], None]
) -> TapTimings:
    """Time all methods at all lengths, interleaved."""
    jobs: dict[str, tuple[Callable[[], object], int]] = {}
    same = True
    for n in lengths:
        history = array(
            "d", np.random.default_rng(n).normal(scale=1e-3, size=2 * n).tolist()
        )
        ways = evaluators(realise("gl", 0.5, n, 0.002), history, np.frombuffer(history))
        results = {way: evaluate(0) for way, evaluate in ways.items()}
        same = same and len({results[way] for way in WAYS[:-1]}) == 1
        for way, evaluate in ways.items():
            calls = max(4, _CALLS * 32 // max(n, 32))
            jobs[f"{way}|{n}"] = (_repeat(evaluate, n, calls), calls)
    timed = interleaved(jobs, rounds, step)
    return TapTimings(
        {n: {way: timed[f"{way}|{n}"] for way in WAYS} for n in lengths}, same
    )


def time_laws(rounds: int, step: Callable[[str], None]) -> dict[str, Timing]:
    """Time the coupling's rendering of PD: plain, and with filtered or windowed velocity."""
    period, step_m, ticks = 0.002, 2.3e-5, 500
    laws: dict[str, Law] = {
        "pd": PD(stiffness=1000.0, damping=3.0),
        "pd_filtered": PDFiltered(stiffness=1000.0, damping=3.0, cutoff=100.0),
        "pd_windowed": PDWindowed(stiffness=1000.0, damping=3.0, resolution=step_m),
    }
    # A slow swing through an encoder, so that windows open and close.
    samples = (
        np.rint(1e-3 * np.sin(0.02 * np.arange(ticks)) / step_m) * step_m
    ).tolist()

    return interleaved(
        {
            name: (in_node(law.compile(period), samples), ticks)
            for name, law in laws.items()
        },
        rounds,
        step,
    )


def in_node(law: CompiledLaw, samples: Sequence[float]) -> Callable[[], object]:
    """Return a function that runs the coupling's own rendering over given deflections."""
    history = History(max(2, len(law.taps)))
    axis = LawOnAxis(law, history)

    def run() -> None:
        for sample in samples:
            history.push(sample)
            axis.force(history.head)

    return run


def _repeat(
    evaluate: Callable[[int], float], length: int, calls: int
) -> Callable[[], object]:
    heads = [k % length for k in range(calls)]

    def run() -> None:
        for head in heads:
            evaluate(head)

    return run


def import_seconds(module: str) -> float:
    """Time the import of a module in its own process: a start-up cost of a node [s]."""
    code = f"import time; t = time.perf_counter(); import {module}; print(time.perf_counter() - t)"
    return min(
        float(
            subprocess.run(
                [*PYTHON, "-c", code], capture_output=True, text=True, check=True
            ).stdout
        )
        for _ in range(3)
    )


def as_json(found: TapTimings, machine: dict[str, Any]) -> dict[str, Any]:
    """Return the timings as one JSON object."""
    points = []
    for n, ways in sorted(found.timings.items()):
        point: dict[str, Any] = {"taps": n}
        for way, timing in ways.items():
            point |= {
                f"{way}_us": 1e6 * timing.median,
                f"{way}_us_low": 1e6 * timing.low,
                f"{way}_us_high": 1e6 * timing.high,
            }
        points.append(point)
    return {
        "points": points,
        "crossover_taps": {
            "unrolled_to_numpy": found.crossover("unrolled", "numpy"),
            "unrolled_to_numba": found.crossover("unrolled", "numba"),
            "numpy_to_numba": found.crossover("numpy", "numba"),
        },
        "fastest": {str(n): found.fastest(n) for n in sorted(found.timings)},
        "same_bits": found.same_bits,
        "unrolled_taps": UNROLLED_TAPS,
        "import_s": {module: import_seconds(module) for module in ("numpy", "numba")},
        "machine": machine,
    }


FRAMES = ("world", "surface")

_TICKS = 20_000
_RADIUS, _DEEP, _STEP = 0.035, 2e-3, 4e-4
_look = record_at(record_of(CouplingState))


def _play(address: int, normals: Any, position: Any, proxy: Any, force: Any) -> float:
    """Render along a path from the normals alone, so that little besides the tick is timed."""
    s = _look(address)
    felt = 0.0
    for k in range(len(normals)):
        normal = normals[k]
        for i in range(3):
            proxy[i] = _RADIUS * normal[i]
            position[i] = (_RADIUS - _DEEP) * normal[i]
        due = s.pushes[s.axes - 1] + 1
        render(s, position, proxy, normal, -_DEEP, True, (0.0, 1.0, 1.0), force, due)
        felt += force[2]
    return felt


_played: Any = compiled()(_play)


def time_turning(rounds: int, step: Callable[[str], None]) -> dict[str, Timing]:
    """Time a tick of the compiled rendering on three axes, with the history in each frame."""
    angle = _STEP / _RADIUS * np.arange(_TICKS)
    normals = np.stack(
        [np.cos(angle), 0.6 * np.sin(angle), 0.8 * np.sin(angle)], axis=1
    )
    law = PD(stiffness=800.0, damping=2.0).compile(0.002)
    kept = []

    def job(frame: str) -> Callable[[], object]:
        renderer = Renderer([0, 1, 2], 64, CouplingState())
        begin_turning(renderer.state, frame)
        renderer.law = ActiveLaw("pd", "", law, renderer.histories)
        kept.append(renderer)
        at, rooms = address_of(renderer.state), [np.zeros(3) for _ in range(3)]
        return lambda: _played(at, normals, *rooms)

    return interleaved({frame: (job(frame), _TICKS) for frame in FRAMES}, rounds, step)
