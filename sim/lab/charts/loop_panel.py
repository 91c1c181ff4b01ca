"""The loop on the chart: time of a tick against the error of the rendered impedance.

A loop renders K + B s^α late and sampled, and the law approximates s^α; both are errors of the
impedance at the port. A higher rate reduces the first and leaves less time per tick; a longer law
reduces the second and takes more time. Time is that of an interpreted tick through surface,
coupling and device; error is over the band of hand motion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha
from nodes.laws.pd_filtered import PDFiltered
from sim.arrays import Array
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.experiments.rendered import error_of
from sim.lab.charts.points import Extra, Group, Point
from sim.measure.stopwatch import interleaved
from sim.play.one_axis import run

RATES = (500.0, 1000.0, 2000.0, 4000.0)  # of the loop [Hz]
BAND = (1.0, 50.0)  # in which impedances are compared [Hz]
DELAY = 1.0  # of every loop [ticks]
STIFFNESS, DAMPING = 500.0, 2.0  # of the ideal impedance [N/m], [N s^α/m]
_TICKS = 400
_ROUNDS, _QUICK_ROUNDS = 7, 2

LawAt = Callable[[float], CompiledLaw]


def realisations(order: float) -> dict[str, LawAt]:
    """Return laws that render K + B s^α, as functions of the period."""
    if order == 1.0:
        filtered = PDFiltered(stiffness=STIFFNESS, damping=DAMPING, cutoff=100.0)
        return {
            "PD": PD(stiffness=STIFFNESS, damping=DAMPING).compile,
            "PD, velocity behind 100 Hz": filtered.compile,
        }

    def alpha(derivative: str, taps: int) -> LawAt:
        law = PDAlpha(
            stiffness=STIFFNESS,
            damping=DAMPING,
            order=order,
            taps=taps,
            gains="physical",
            derivative=derivative,
        )
        return law.compile

    kinds = [
        ("gl", 4),
        ("gl", 16),
        ("gl", 64),
        ("gl", 256),
        ("oustaloup_matched", 9),
        ("exponentials", 256),
    ]
    return {f"{kind} {taps}": alpha(kind, taps) for kind, taps in kinds}


def wanted(order: float, frequency_hz: Array) -> NDArray[np.complex128]:
    """Return the ideal impedance, K + B (jω)^α [N/m]."""
    return np.asarray(STIFFNESS + DAMPING * (2j * np.pi * frequency_hz) ** order)


def loop_groups(step: Callable[[str], None], quick: bool = False) -> list[Group]:
    """Measure every law at every rate, for a viscous and a fractional damper."""
    band = np.geomspace(*BAND, 60)
    return [_group(order, band, step, quick) for order in (1.0, 0.5)]


def _group(
    order: float, band: Array, step: Callable[[str], None], quick: bool
) -> Group:
    laws = realisations(order)
    rates = RATES[::2] if quick else RATES
    scenes = {
        rate: drop_scene(DeviceModel(mass=0.1, damping=1.0, delay=DELAY), 1.0 / rate)
        for rate in rates
    }

    def tick(law: CompiledLaw, rate: float) -> Callable[[], object]:
        return lambda: run(scenes[rate], law, _TICKS, interpreted=True)

    # The time of a tick depends on the law, not on the rate.
    jobs: dict[str, tuple[Callable[[], object], int]] = {
        name: (tick(law(1.0 / rates[0]), rates[0]), _TICKS)
        for name, law in laws.items()
    }
    timings = interleaved(jobs, _QUICK_ROUNDS if quick else _ROUNDS, step)
    points = []
    for name, law in laws.items():
        for rate in rates:
            compiled, cost = law(1.0 / rate), 1e6 * timings[name].median
            off = error_of(compiled, 1.0 / rate, DELAY, wanted(order, band), band)
            detail: dict[str, Extra] = {
                "rate_hz": rate,
                "tick_us": cost,
                "impedance_error": off,
                "h1_n_per_m": compiled.h1,
            }
            # Twice the rate needs twice as many ticks per second.
            detail["load"] = 1e-6 * cost * rate
            points.append(
                Point(f"{name}, {rate:g} Hz", cost * rate / rates[0], off, name, detail)
            )
    what = "K + B s" if order == 1.0 else f"K + B s^{order:g}"
    return Group(
        f"loop_impedance_{order:g}".replace(".", "_"),
        f"The loop: rendering {what}",
        f"time of ticks, a tick at {rates[0]:g} Hz, in Python [µs]",
        "error of the impedance at the port, of itself",
        tuple(points),
        f"K = {STIFFNESS:g} N/m, B = {DAMPING:g}, {DELAY:g} tick of delay and the hold; root mean"
        f" square over {BAND[0]:g} to {BAND[1]:g} Hz.",
    )


def loop_steps(quick: bool) -> int:
    """Return the number of progress steps."""
    rounds = _QUICK_ROUNDS if quick else _ROUNDS
    return 2 * rounds
