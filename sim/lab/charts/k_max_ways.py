"""Methods for K_max on the chart: formulas, pole radius, and simulations of any horizon.

The reference solves for the pole on the unit circle to twelve digits. A formula is instant and
exact where it applies. A simulation near the limit needs a long run to show whether the loop is
stable, so its result depends on its horizon.
"""

import math
from collections.abc import Callable

import numpy as np

from nodes.laws.pd import PD
from nodes.stability.closed_loop import pole_radius
from nodes.stability.effective_damping import damping_needed
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.lab.charts.derivatives import largest_stable
from sim.lab.charts.points import Extra, Group, Point
from sim.measure.stopwatch import interleaved
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface

PERIOD, MASS, DAMPING, GAIN = 0.002, 0.1, 0.1, 3.0
_ROUNDS, _QUICK_ROUNDS = 5, 2
_HEIGHT = 0.005
_GRAVITY = 9.81
_PRECISION = 1e-3

FindKMax = Callable[[], float]


def poles(delay: float, precision: float) -> float:
    """Return K_max from the pole radius."""
    return largest_stable(
        lambda k: pole_radius(
            PD(stiffness=k, damping=GAIN).compile(PERIOD),
            Plant(PERIOD, MASS, DAMPING, delay),
        ),
        10.0,
        1e5,
        precision,
    )


def solved(delay: float, method: str) -> float:
    """Return K_max without a search (THEORY.md §3).

    By Jury's conditions, linear in K, or the crossings of the boundary curve.
    """
    derivative = without_spring(PD(stiffness=1.0, damping=GAIN), PERIOD)
    return (
        k_max(derivative, Plant(PERIOD, MASS, DAMPING, delay), method).k_max_n_per_m
        or 0.0
    )


def light(_delay: float) -> float:
    """Return the closed form for an undamped device without delay (THEORY.md §3).

    κ = 2β(2−β)/(2+β).
    """
    beta = GAIN * PERIOD / MASS
    return MASS / PERIOD**2 * 2.0 * beta * (2.0 - beta) / (2.0 + beta)


def heavy(delay: float) -> float:
    """Return the closed form for a heavy device, (b + B)/(T(½ + d)) (THEORY.md §3)."""
    return (DAMPING + GAIN) / (PERIOD * (0.5 + delay))


def passive(delay: float) -> float:
    """Return the largest K at which the law is passive on this device (Colgate).

    It is safe for any hand, hence lower.
    """
    low, high = 0.0, 1e4

    def needed(k: float) -> float:
        return damping_needed(
            PD(stiffness=max(k, 1e-9), damping=GAIN).compile(PERIOD), PERIOD, delay
        )

    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) <= DAMPING else (low, middle)
    return low


def simulated(delay: float, horizon: float, dropped: bool) -> float:
    """Search K_max by simulation.

    A run is stable if the swing in its last fifth is below a tenth of the start.
    """
    ticks = math.ceil(horizon / PERIOD)
    device = DeviceModel(
        mass=MASS,
        damping=DAMPING,
        position=_HEIGHT,
        delay=delay,
        gravity=_GRAVITY if dropped else None,
    )
    surface = SceneSurface("plane") if dropped else SceneSurface("anchor")
    scene = Scene(
        device=device, surface=surface, period=PERIOD, raw=False, clamp=dropped
    )
    tail = max(2, ticks // 5)

    def radius(stiffness: float) -> float:
        end = run(
            scene, PD(stiffness=stiffness, damping=GAIN).compile(PERIOD), ticks
        ).position[-tail:]
        swing = float(np.max(end) - np.min(end))
        return 0.0 if math.isfinite(swing) and swing < 0.1 * _HEIGHT else 2.0

    return largest_stable(radius, 50.0, 1e5, _PRECISION)


def ways(delay: float) -> dict[str, FindKMax]:
    """Return the methods that apply at a delay."""
    found: dict[str, FindKMax] = {
        "closed form, heavy device": lambda: heavy(delay),
        "passivity": lambda: passive(delay),
    }
    if delay == 0.0:
        found["closed form, undamped device"] = lambda: light(delay)
        found["Jury conditions"] = lambda: solved(0.0, "closed_form")
    found["boundary curve"] = lambda: solved(delay, "pole_radius")
    for precision in (1e-1, 1e-3, 1e-6, 1e-9):
        found[f"pole radius {precision:g}"] = lambda precision=precision: poles(
            delay, precision
        )  # type: ignore[misc]
    for horizon in (0.1, 0.3, 1.0, 3.0, 10.0, 30.0):
        for dropped in (False, True):
            name = f"{'drop' if dropped else 'release'} {horizon:g} s"
            found[name] = lambda horizon=horizon, dropped=dropped: simulated(
                delay, horizon, dropped
            )  # type: ignore[misc]
    return found


def kmax_groups(step: Callable[[str], None], quick: bool = False) -> list[Group]:
    """Measure all methods for K_max, without delay and with one tick."""
    groups = []
    rounds = _QUICK_ROUNDS if quick else _ROUNDS
    for delay in (0.0, 1.0):
        found = ways(delay)
        timings = interleaved(
            {name: (way, 1) for name, way in found.items()}, rounds, step
        )
        exact = poles(delay, 1e-12)
        points = []
        for name, way in found.items():
            value, timing = way(), timings[name]
            detail: dict[str, Extra] = {
                "k_max_n_per_m": value,
                "k_max_exact_n_per_m": exact,
            }
            detail |= {
                "time_s": timing.median,
                "time_s_low": timing.low,
                "time_s_high": timing.high,
            }
            family = (
                name.split(" ")[0] if name[-1] == "s" else name.rstrip("0123456789.e- ")
            )
            points.append(
                Point(
                    name, 1e3 * timing.median, abs(value / exact - 1.0), family, detail
                )
            )
            step(f"K_max by {name}")
        groups.append(
            Group(
                f"k_max_delay_{delay:g}",
                f"Ways to K_max, {'no delay' if delay == 0.0 else 'one tick of delay'}",
                "time for one K_max [ms]",
                "relative error of K_max [1]",
                tuple(points),
                f"PD with B = {GAIN:g} N s/m on m = {MASS} kg, b = {DAMPING} N s/m, T ="
                f" {1e3 * PERIOD:g} ms: K_max = {exact:.2f} N/m. Simulations search to"
                f" {_PRECISION:g}.",
            )
        )
    return groups


def kmax_steps(quick: bool = False) -> int:
    """Return the number of steps of `kmax_groups`."""
    rounds = _QUICK_ROUNDS if quick else _ROUNDS
    return sum(rounds + len(ways(delay)) for delay in (0.0, 1.0))
