"""THEORY.md §6 on the energy account: exact for force changes at ticks, else even motion."""

from __future__ import annotations

import pytest

from nodes.driver.passivity import line_of, through
from nodes.laws.pd import PD
from sim.device.model import DeviceModel, advance, coefficients
from sim.experiments.drop import drop_scene
from sim.play.one_axis import run

T, M, B = 0.002, 0.1, 1.0


def energies(latency: float) -> tuple[float, float]:
    """Return the energy given out in a drop: by the driver's account, and by forces' work."""
    scene = drop_scene(DeviceModel(mass=M, damping=B, delay=latency), T, False, True)
    trace = run(scene, PD(stiffness=900.0, damping=3.0).compile(T), 1500)
    account = 0.0
    line, share = line_of(latency)
    for k in range(1499):
        mean = through(line, float(trace.force[k]), share)
        account += mean * float(trace.position[k + 1] - trace.position[k])
    work, part, whole = 0.0, latency % 1.0, int(latency)
    weight = -9.81 * M
    for k in range(1499):
        older, newer = (
            float(trace.force[j]) if j >= 0 else 0.0 for j in (k - whole - 1, k - whole)
        )
        start, speed = float(trace.position[k]), float(trace.velocity[k])
        middle, _ = (
            advance(start, speed, weight + older, coefficients(M, B, 0.0, part * T))
            if part
            else (start, 0.0)
        )
        work += older * (middle - start) + newer * (
            float(trace.position[k + 1]) - middle
        )
    return account, work


@pytest.mark.parametrize("latency", [1.0, 2.0])
def test_whole_ticks_are_exact(latency: float) -> None:
    account, work = energies(latency)
    # Rounding of 1500 sums of joules.
    assert account == pytest.approx(work, abs=1e-12)


def test_half_a_tick_is_not() -> None:
    account, work = energies(0.5)
    off = abs(account - work)
    # The motion within a tick bends by a T²/8, which the force's step is multiplied with: above
    # rounding, below the energy.
    assert 1e-6 < off < 0.02 * abs(work)
