"""Integrators on the chart: time per tick against the error of a drop and of K_max.

The force is held between ticks, so the device has an exact map, which costs no more than an Euler
step. Every other integrator approximates it, and its error appears as stability of the coupling.
The reference is scipy's matrix exponential, which is independent of the closed forms of
`sim.device.model`.
"""

import itertools
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from nodes.laws.pd import PD
from sim.device.model import advance, coefficients
from sim.experiments.drop import GRAVITY, fall
from sim.lab.charts.derivatives import largest_stable
from sim.lab.charts.points import Extra, Group, Point
from sim.measure.stopwatch import interleaved

PERIOD, MASS, DAMPING = 0.002, 0.1, 1.0
_LAW = PD(stiffness=400.0, damping=1.0)
_HEIGHT = 0.005
_TICKS = 250
_ROUNDS, _QUICK_ROUNDS = 9, 2

Step = Callable[[float, float, float], tuple[float, float]]


def integrators() -> dict[str, Step]:
    """Return the integrators of one tick."""
    exact = coefficients(MASS, DAMPING, 0.0, PERIOD)
    found: dict[str, Step] = {"exact map": lambda x, v, u: advance(x, v, u, exact)}
    found |= {
        f"semi-implicit Euler {count}": euler(count, implicit=True)
        for count in (1, 2, 4, 10, 40, 100)
    }
    found |= {
        f"explicit Euler {count}": euler(count, implicit=False) for count in (1, 10)
    }
    found |= {f"RK4 {count}": _rk4(count) for count in (1, 2, 4)}
    found |= {
        f"solve_ivp {tolerance:g}": _solve_ivp(tolerance)
        for tolerance in (1e-3, 1e-6, 1e-9)
    }
    if find_spec("mujoco") is not None:
        ways = itertools.product((1, 2, 10), ("Euler", "implicitfast", "RK4"))
        found |= {
            f"MuJoCo {integrator} {count}": _mujoco(integrator, count)
            for count, integrator in ways
        }
    return found


def reference() -> Step:
    """Return the exact map from scipy's matrix exponential."""
    from scipy.linalg import expm

    generator = np.array(
        [[0.0, 1.0, 0.0], [0.0, -DAMPING / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]]
    )
    a = np.asarray(expm(generator * PERIOD), dtype=np.float64)

    def step(x: float, v: float, u: float) -> tuple[float, float]:
        return float(a[0, 0] * x + a[0, 1] * v + a[0, 2] * u), float(
            a[1, 0] * x + a[1, 1] * v + a[1, 2] * u
        )

    return step


def drop(step: Step, ticks: int = _TICKS) -> NDArray[np.float64]:
    """Drop the device on a floor of spring and damper, with forces held between ticks."""
    x, v = _HEIGHT, 0.0

    def move(force: float) -> float:
        nonlocal x, v
        x, v = step(x, v, force - MASS * GRAVITY)
        return x

    return fall(move, _LAW.compile(PERIOD), _HEIGHT, ticks)[0]


def spring_limit(step: Step) -> float:
    """Return the largest spring stiffness that is stable with a linear integrator."""
    columns = [
        np.array(step(*unit))
        for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ]
    state, force = np.stack(columns[:2], axis=1), columns[2]

    def radius(stiffness: float) -> float:
        closed = state.copy()
        closed[:, 0] -= stiffness * force
        return float(np.abs(np.linalg.eigvals(closed)).max())

    # Relative precision 1e-9; the upper limit is high because some integrators wrongly stay
    # stable.
    return largest_stable(radius, 1.0, 2e5, precision=1e-9)


def integrator_groups(step: Callable[[str], None], quick: bool = False) -> list[Group]:
    """Measure all integrators."""
    found = integrators()
    jobs: dict[str, tuple[Callable[[], object], int]] = {
        name: ((lambda f=f: drop(f)), _TICKS)  # type: ignore[misc]
        for name, f in found.items()
    }
    timings = interleaved(jobs, _QUICK_ROUNDS if quick else _ROUNDS, step)
    exact = reference()
    path, limit = drop(exact), spring_limit(exact)
    depth = -float(path.min())
    moved, stiff = [], []
    for name, f in found.items():
        cost = 1e6 * timings[name].median
        family = name.rsplit(" ", 1)[0] if name != "exact map" else name
        off = float(np.abs(drop(f) - path).max()) / depth
        found_limit = spring_limit(f)
        detail: dict[str, Extra] = {
            "trajectory_error": off,
            "k_max_n_per_m": found_limit,
            "k_max_exact_n_per_m": limit,
        }
        detail |= {
            "tick_us": cost,
            "tick_us_low": 1e6 * timings[name].low,
            "tick_us_high": 1e6 * timings[name].high,
        }
        moved.append(Point(name, cost, off, family, detail))
        stiff.append(Point(name, cost, abs(found_limit / limit - 1.0), family, detail))
        step(f"integrator {name}")
    label = "time per tick, device and law, in Python [µs]"
    return [
        Group(
            "integrator_trajectory",
            "Integrators: a drop",
            label,
            "largest error of the height over the depth of the impact",
            tuple(moved),
            f"{1e3 * MASS:g} g dropped {1e3 * _HEIGHT:g} mm on K = {_LAW.stiffness:g} N/m, B ="
            f" {_LAW.damping:g} N s/m, T = {1e3 * PERIOD:g} ms, {_TICKS} ticks; against"
            " scipy.linalg.expm.",
        ),
        Group(
            "integrator_k_max",
            "Integrators: K_max of a spring",
            label,
            "relative error of K_max [1]",
            tuple(stiff),
            f"Spring alone, m = {MASS} kg, b = {DAMPING} N s/m, no delay: K_max = {limit:.1f} N/m.",
        ),
    ]


def integrator_steps(quick: bool = False) -> int:
    """Return the number of steps of `integrator_groups`."""
    return (_QUICK_ROUNDS if quick else _ROUNDS) + len(integrators())


def euler(
    count: int, implicit: bool, mass: float = MASS, damping: float = DAMPING
) -> Step:
    """Return a tick of Euler steps, semi-implicit or explicit."""
    h = PERIOD / count

    def step(x: float, v: float, u: float) -> tuple[float, float]:
        for _ in range(count):
            old = v
            v += h * (u - damping * v) / mass
            x += h * (v if implicit else old)
        return x, v

    return step


def _rk4(count: int) -> Step:
    h = PERIOD / count

    def slope(v: float, u: float) -> float:
        return (u - DAMPING * v) / MASS

    def step(x: float, v: float, u: float) -> tuple[float, float]:
        for _ in range(count):
            a1 = slope(v, u)
            v2 = v + 0.5 * h * a1
            a2 = slope(v2, u)
            v3 = v + 0.5 * h * a2
            a3 = slope(v3, u)
            v4 = v + h * a3
            a4 = slope(v4, u)
            x += h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
            v += h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        return x, v

    return step


def _solve_ivp(tolerance: float) -> Step:
    from scipy.integrate import solve_ivp

    def step(x: float, v: float, u: float) -> tuple[float, float]:
        result = solve_ivp(
            lambda _, y: (y[1], (u - DAMPING * y[1]) / MASS),
            (0.0, PERIOD),
            (x, v),
            rtol=tolerance,
            atol=1e-3 * tolerance,
        )
        return float(result.y[0, -1]), float(result.y[1, -1])

    return step


def _mujoco(integrator: str, count: int) -> Step:
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>\
<option timestep="{PERIOD / count!r}" integrator="{integrator}" gravity="0 0 0"/>
        <worldbody><body><joint type="slide" axis="0 0 1" damping="{DAMPING!r}"/>
        <inertial pos="0 0 0" mass="{MASS!r}" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)

    def step(x: float, v: float, u: float) -> tuple[float, float]:
        data.qpos[0], data.qvel[0], data.qfrc_applied[0] = x, v, u
        mujoco.mj_step(model, data, count)
        return float(data.qpos[0]), float(data.qvel[0])

    return step
