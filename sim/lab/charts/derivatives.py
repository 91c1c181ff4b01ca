"""Realisations of D^α on the chart: cost per tick against error and against stiffness.

Cost is the time of the coupling's own rendering, tick by tick, and the multiplies of the compiled
kernels. Error is against (jω)^α with the best pure delay removed. Stiffness is the H(1) at which
the loop with a known device, at one tick of delay, becomes unstable, with the same normalised gain
for all.
"""

from collections.abc import Callable, Iterator, MutableSequence, Sequence
from functools import partial
from typing import Any

import numpy as np

from nodes.arithmetic import push
from nodes.coupling.render import evaluate
from nodes.laws import CompiledLaw
from nodes.laws.derivatives import derivative_kinds, realise
from nodes.laws.pd_alpha import combine
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant
from sim.lab.bench.tap_timing import in_node
from sim.lab.charts.derivative_errors import analyse
from sim.lab.charts.points import Extra, Group, Point
from sim.measure.jobs import Runner
from sim.measure.stopwatch import interleaved
from sim.play.compiled import compiled

ORDERS = (0.5, 1.5)
PERIOD = 0.002
MASS, DAMPING, DELAY = 0.1, 1.0, 1.0
GAIN, STIFFNESS = 3.0, 200.0
_TICKS = 200
_ROUNDS, _QUICK_ROUNDS, _QUICK_TAPS = 15, 3, 64
_FINITE = (4, 16, 64, 256, 1000)
_RECURSIVE = (4, 6, 9, 13)
_LENGTHS: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(
        (
            "al_alaoui_cfe",
            "tustin_cfe",
            "least_squares",
            "oustaloup_matched",
            "oustaloup_tustin",
        ),
        _RECURSIVE,
    ),
    "exponentials": (32, 256, 2000, 20000),
    "log_binned": (64, 256, 1000),
}


def _render(
    taps: Sequence[float],
    recursive: Sequence[float] | None,
    state: MutableSequence[float],
    history: MutableSequence[float],
    samples: Sequence[float],
) -> float:
    length = len(history) // 2
    head = 0
    total = 0.0
    for k in range(len(samples)):
        head = push(history, head, length, samples[k])
        total += evaluate(taps, recursive, state, history, head)
    return total


_render_compiled = compiled()(_render)


def candidates(
    order: float, quick: bool = False
) -> Iterator[tuple[str, int, CompiledLaw]]:
    """Yield all installed realisations at the lengths they accept."""
    for kind in derivative_kinds():
        lengths = _LENGTHS.get(kind, _FINITE)
        for taps in lengths:
            if quick and taps > max(_QUICK_TAPS, lengths[0]):
                continue
            try:
                yield kind, taps, realise(kind, order, taps, PERIOD)
            except ValueError:
                continue


def with_stiffness(
    unit: CompiledLaw, stiffness: float, gain: float, order: float, period: float
) -> CompiledLaw:
    """Return a law with a given H(1) and derivative, whatever the derivative leaks."""
    physical = gain * (0.5 * period) ** (order - 1.0)
    return combine(stiffness - physical * unit.h1, [(physical, unit)])


def largest_stable(
    radius: Callable[[float], float], low: float, high: float, precision: float = 0.005
) -> float:
    """Return the parameter value at which a loop becomes unstable."""
    before = 0.0
    for value in np.geomspace(low, high, 20).tolist():
        stable = radius(value) < 1.0
        if before and not stable:
            while value > before * (1.0 + precision):
                middle = float(np.sqrt(before * value))
                if radius(middle) < 1.0:
                    before = middle
                else:
                    value = middle
            return before
        if stable:
            before = value
    return before


def derivative_groups(
    step: Callable[[str], None], quick: bool, spread: Runner
) -> list[Group]:
    """Measure all realisations: times on this machine, the rest wherever the study runs."""
    groups = []
    rounds = _QUICK_ROUNDS if quick else _ROUNDS
    for order in ORDERS:
        found = list(candidates(order, quick))
        jobs: dict[str, tuple[Callable[[], object], int]] = {}
        for kind, taps, law in found:
            jobs[f"{kind} {taps}|node"] = (in_node(law, _samples(_TICKS)), _TICKS)
            jobs[f"{kind} {taps}|compiled"] = (_when_compiled(law), 20 * _TICKS)
        timings = interleaved(jobs, rounds, step)
        details: dict[str, tuple[str, dict[str, Extra]]] = {}
        jobs_beside: list[Callable[[], Any]] = [
            partial(_figures, kind, taps, order) for kind, taps, _ in found
        ]

        def told(done: str, _: int, order: float = order) -> None:
            step(f"D^{order:g} {done}")

        figures = spread(jobs_beside, told)
        for (kind, taps, _), measured in zip(found, figures, strict=True):
            name = f"{kind} {taps}"
            node, fast = timings[f"{name}|node"], timings[f"{name}|compiled"]
            times = {
                "node_us": 1e6 * node.median,
                "node_us_low": 1e6 * node.low,
                "node_us_high": 1e6 * node.high,
            }
            details[name] = kind, measured | times | {"compiled_ns": 1e9 * fast.median}
        groups += _groups(order, details, rounds)
    return groups


def _figures(kind: str, taps: int, order: float) -> dict[str, Extra]:
    """Return all values of one realisation except its times."""
    stiffness, gain = _limits(realise(kind, order, taps, PERIOD), order)
    return {
        **analyse(kind, order, taps, PERIOD),
        "h1_max_n_per_m": stiffness,
        "gain_max_n_s_per_m": gain,
    }


def _groups(
    order: float, details: dict[str, tuple[str, dict[str, Extra]]], rounds: int
) -> list[Group]:
    """Compare the realisations of one order: time, multiplies, stiffness."""

    def points(
        cost: str, error: Callable[[dict[str, Any]], float]
    ) -> tuple[Point, ...]:
        return tuple(
            Point(name, float(measured[cost] or 0.0), error(measured), kind, measured)
            for name, (kind, measured) in details.items()
        )

    def aligned(measured: dict[str, Any]) -> float:
        return float(measured["error_aligned"])

    def lost(measured: dict[str, Any]) -> float:
        return 1.0 - float(measured["h1_max_n_per_m"]) / best

    best = max(
        float(measured["h1_max_n_per_m"] or 0.0) for _, measured in details.values()
    )
    error, time, each = (
        "relative error, best delay removed (rms) [1]",
        "time per tick in the node [µs]",
        "multiplies per tick",
    )
    note = (
        f"Error against (jω)^α, 0.001 to 0.5 of Nyquist. T = {1e3 * PERIOD:g} ms; times by the "
        f"coupling's own rendering, median of {rounds} interleaved rounds."
    )
    return [
        Group(
            f"derivative_time_{order:g}",
            f"D^{order:g}: time",
            time,
            error,
            points("node_us", aligned),
            note,
        ),
        Group(
            f"derivative_multiplies_{order:g}",
            f"D^{order:g}: multiplies",
            each,
            error,
            points("multiplies", aligned),
            note,
        ),
        Group(
            f"derivative_stiffness_{order:g}",
            f"D^{order:g}: stiffness left",
            time,
            f"stiffness lost against the best, {best:.0f} N/m [1]",
            points("node_us", lost),
            f"H(1) at which the pole radius reaches 1: m = {MASS} kg, b = {DAMPING} N s/m,"
            f" {DELAY:g} tick of delay, normalised gain {GAIN:g} N s/m for all.",
            linear=True,
        ),
    ]


def derivative_steps(quick: bool = False) -> int:
    """Return the number of steps of `derivative_groups`."""
    rounds = _QUICK_ROUNDS if quick else _ROUNDS
    return sum(rounds + sum(1 for _ in candidates(order, quick)) for order in ORDERS)


def _limits(law: CompiledLaw, order: float) -> tuple[float, float]:
    """Return the limits at pole radius 1: stiffness at the common gain, and vice versa."""

    def radius(stiffness: float, gain: float) -> float:
        whole = with_stiffness(law, stiffness, gain, order, PERIOD)
        return pole_radius(whole, Plant(PERIOD, MASS, DAMPING, DELAY))

    return (
        largest_stable(lambda k: radius(k, GAIN), 30.0, 20000.0),
        largest_stable(lambda g: radius(STIFFNESS, g), 0.1, 1000.0),
    )


def _samples(count: int) -> list[float]:
    return [1e-3 * float(s) for s in np.sin(0.05 * np.arange(count))]


def _when_compiled(law: CompiledLaw) -> Callable[[], object]:
    taps: Any = np.array(law.taps)
    recursive: Any = (
        np.array([c for s in law.sections for c in s]) if law.sections else None
    )
    state: Any = np.zeros(2 * len(law.sections))
    history: Any = np.zeros(2 * max(2, len(taps)))
    samples: Any = np.array(_samples(20 * _TICKS))
    return lambda: _render_compiled(taps, recursive, state, history, samples)
