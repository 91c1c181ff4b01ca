"""Cost of the parts of a tick.

Compare with ``--benchmark-enable --benchmark-compare``, never by absolute times.
"""

from __future__ import annotations

import math
from array import array

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from nodes.arithmetic import fir, push, sections
from nodes.coupling.law_on_axis import History, LawOnAxis
from nodes.laws.derivatives import realise
from nodes.laws.pd import PD
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel, advance, coefficients
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface

T = 0.002


@pytest.mark.parametrize("taps", [4, 24, 100])
def test_fir(benchmark: BenchmarkFixture, taps: int) -> None:
    law = realise("gl", 0.5, taps, T)
    history = array("d", [1e-3] * (2 * taps))
    force = benchmark(fir, law.taps, history, 0)
    # The sum of taps times a constant, rounded once per tap.
    assert force == pytest.approx(1e-3 * math.fsum(law.taps), rel=1e-12)


@pytest.mark.parametrize("length", [4, 2000])
def test_push(benchmark: BenchmarkFixture, length: int) -> None:
    history = array("d", [0.0]) * (2 * length)
    assert benchmark(push, history, 0, length, 1.0) == length - 1


def test_sections(benchmark: BenchmarkFixture) -> None:
    law = realise("oustaloup_tustin", 0.5, 9, T)
    flat = tuple(c for section in law.sections for c in section)
    state = [0.0] * (2 * len(law.sections))
    assert math.isfinite(benchmark(sections, flat, state, 1e-3, 1e-3))


@pytest.mark.parametrize("kind", ["gl", "exponentials"])
@pytest.mark.parametrize("memory", [32, 2000])
def test_law_on_axis(benchmark: BenchmarkFixture, kind: str, memory: int) -> None:
    law = realise(kind, 0.5, memory, T)
    history = History(max(2, len(law.taps)))
    axis = LawOnAxis(law, history)

    def tick() -> float:
        history.push(1e-3)
        return axis.force(history.head)

    assert benchmark(tick) > 0.0


def test_exact_map(benchmark: BenchmarkFixture) -> None:
    x, v = benchmark(advance, 0.0, 1.0, 0.0, coefficients(0.1, 1.0, 0.0, T))
    # e^{−bT/m} of the velocity is left.
    assert v == pytest.approx(math.exp(-0.02), rel=1e-14)
    assert 0.0 < x < T


def test_ten_thousand_ticks_compiled(benchmark: BenchmarkFixture) -> None:
    scene = Scene(
        device=DeviceModel(mass=0.1, damping=1.0, gravity=9.81, position=0.01),
        surface=SceneSurface("plane"),
        period=T,
        raw=False,
        clamp=True,
    )
    trace = benchmark(run, scene, PD(stiffness=500.0, damping=1.0).compile(T), 10_000)
    # At rest the floor carries the weight: x = −m g / K, to the decay of 20 s.
    assert trace.position[-1] == pytest.approx(-0.1 * 9.81 / 500.0, rel=1e-9)


@pytest.mark.parametrize("taps", [4, 64, 500])
def test_pole_radius(benchmark: BenchmarkFixture, taps: int) -> None:
    law = realise("gl", 0.5, taps, T)
    assert benchmark(pole_radius, law, Plant(T, 0.1, 1.0, 1.0)) > 0.0
