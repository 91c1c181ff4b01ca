"""The virtual device: closed forms, a 50-digit matrix exponential, another integrator."""

from __future__ import annotations

import itertools
import math
from typing import Any

import mpmath
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sim.device.friction import halt_time, move, slide
from sim.device.hand import Hand, path_position
from sim.device.model import (
    Coefficients,
    DeviceModel,
    advance,
    coefficients,
    quantise,
    saturate,
    split_delay,
)
from sim.device.state import VirtualDevice, device_part, device_tick

MASSES = (0.01, 0.1, 5.0)
DAMPINGS = (0.0, 1e-9, 1e-3, 0.5, 3.0, 40.0)
STIFFNESSES = (0.0, 1e-9, 1.0, 300.0, 1e5)
DURATIONS = (1e-6, 2.5e-4, 2e-3, 1e-2)

mass_values = st.floats(0.01, 5.0)
damping_values = st.one_of(st.just(0.0), st.floats(1e-12, 40.0))
stiffness_values = st.one_of(st.just(0.0), st.floats(1e-9, 1e5))
durations = st.floats(1e-7, 1e-2)
# Below 1e-9 of each unit lies nothing physical, only underflow.
counts = st.integers(-(10**9), 10**9)
states = st.tuples(
    counts.map(lambda i: i * 1e-10),
    counts.map(lambda i: i * 1e-9),
    counts.map(lambda i: i * 1e-8),
)


def exponential(
    mass: float, damping: float, stiffness: float, duration: float
) -> Coefficients:
    """Return the same map as the exponential of an augmented matrix, with 50 digits."""
    with mpmath.workdps(50):
        m, b, k, h = map(mpmath.mpf, (mass, damping, stiffness, duration))
        power = mpmath.expm(
            mpmath.matrix([[0, 1, 0], [-k / m, -b / m, 1 / m], [0, 0, 0]]) * h,
            method="taylor",
        )
        cells = ((0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (1, 2))
        a11, a12, a21, a22, b1, b2 = (float(power[cell]) for cell in cells)
    return a11, a12, a21, a22, b1, b2


@pytest.mark.parametrize("mass", MASSES)
def test_map_is_the_matrix_exponential(mass: float) -> None:
    for damping, stiffness, duration in itertools.product(
        DAMPINGS, STIFFNESSES, DURATIONS
    ):
        ours = coefficients(mass, damping, stiffness, duration)
        # Oscillating terms pass through zero: there a rounding of the phase (up to ω h ≈ 32 rad
        # here) counts absolutely, against the amplitude. 1e-13 is 450 roundings; the worst seen is
        # 1.3e-13 relative, on a b1 of an overdamped map.
        assert ours == pytest.approx(
            exponential(mass, damping, stiffness, duration), rel=3e-13, abs=1e-18
        )


def test_near_critical_damping() -> None:
    mass, stiffness, duration = 0.1, 3e4, 5e-3
    critical = 2.0 * math.sqrt(mass * stiffness)
    for damping in (
        critical,
        math.nextafter(critical, 0.0),
        math.nextafter(critical, 1e9),
        critical * (1 + 1e-7),
    ):
        expected = exponential(mass, damping, stiffness, duration)
        # b²/4m² and k/m cancel: what is left carries one rounding of ω² h² ≈ 7, some 1e-15, into
        # every term.
        assert coefficients(mass, damping, stiffness, duration) == pytest.approx(
            expected, rel=1e-13
        )


@pytest.mark.parametrize("damping", [1e-3, 0.5, 3.0, 400.0])
def test_free_device_is_the_plant_of_the_theory(damping: float) -> None:
    # THEORY.md §3: e = exp(−bT/m), q = (1−e)m/b; x⁺ = x + q v − (T − q) F/b, v⁺ = e v − (1−e) F/b.
    mass, period = 0.1, 0.002
    decay = math.exp(-damping * period / mass)
    q = (1.0 - decay) * mass / damping
    expected = (1.0, q, 0.0, decay, (period - q) / damping, (1.0 - decay) / damping)
    # The printed form loses m/(bT) digits in T − q: at b = 1e-3 that is 5e4 roundings twice over.
    lost = 2.3e-16 * (1.0 + mass / (damping * period)) ** 2
    assert coefficients(mass, damping, 0.0, period) == pytest.approx(
        expected, rel=max(1e-14, lost)
    )


def test_frictionless_undamped_free_device_is_a_parabola() -> None:
    assert coefficients(0.1, 0.0, 0.0, 0.002) == pytest.approx(
        (1.0, 0.002, 0.0, 1.0, 2e-5, 0.02), rel=4e-16
    )


@given(mass_values, damping_values, stiffness_values, durations, durations, states)
@settings(max_examples=300)
def test_two_steps_are_one(
    m: float,
    b: float,
    k: float,
    h1: float,
    h2: float,
    state: tuple[float, float, float],
) -> None:
    x, v, u = state
    once = advance(x, v, u, coefficients(m, b, k, h1 + h2))
    twice = advance(
        *advance(x, v, u, coefficients(m, b, k, h1)), u, coefficients(m, b, k, h2)
    )
    # Rounding is relative to the largest term that enters, not to the result, which may be a small
    # difference.
    rate = math.sqrt(k / m) + b / m
    reach = abs(x) + (abs(v) + abs(u) / m * (h1 + h2)) * (h1 + h2)
    assert twice[0] == pytest.approx(
        once[0], abs=2e-13 * reach * (1.0 + rate * (h1 + h2))
    )
    assert twice[1] == pytest.approx(
        once[1], abs=2e-13 * (abs(v) + abs(u) / m * (h1 + h2) + rate * reach) * 4.0
    )


@given(
    mass_values, stiffness_values, durations, st.floats(-0.1, 0.1), st.floats(-1.0, 1.0)
)
@settings(max_examples=200)
def test_energy_is_kept_without_damping(
    m: float, k: float, h: float, x: float, v: float
) -> None:
    def energy(x: float, v: float) -> float:
        return 0.5 * m * v * v + 0.5 * k * x * x

    after = energy(*advance(x, v, 0.0, coefficients(m, 0.0, k, h)))
    # 1e-13: sin² + cos² of a phase of up to 30 rad, twice a rounding of it each.
    assert after == pytest.approx(energy(x, v), rel=1e-13, abs=1e-30)


@given(
    mass_values,
    damping_values,
    stiffness_values,
    durations,
    states,
    st.floats(0.0, 5.0),
)
@settings(max_examples=300)
def test_nothing_but_the_force_adds_energy(
    m: float,
    b: float,
    k: float,
    h: float,
    state: tuple[float, float, float],
    friction: float,
) -> None:
    x, v, u = state
    x1, v1 = move(x, v, u, h, coefficients(m, b, k, h), m, b, k, friction)
    before = 0.5 * m * v * v + 0.5 * k * x * x
    gained = 0.5 * m * v1 * v1 + 0.5 * k * x1 * x1 - before - u * (x1 - x)
    # Rounding of the terms of the balance themselves.
    assert gained <= 1e-12 * (
        before + abs(u) * (abs(x) + abs(v) * h + abs(u) / m * h * h)
    )


# Coulomb friction


def test_sticks_up_to_friction_and_not_beyond() -> None:
    step = coefficients(0.1, 1.0, 0.0, 0.002)
    for sign in (1.0, -1.0):
        assert slide(0.003, 0.0, sign * 0.06, 0.002, step, 0.1, 1.0, 0.0, 0.06) == (
            0.003,
            0.0,
        )
        x, v = slide(
            0.0, 0.0, sign * math.nextafter(0.06, 1.0), 0.002, step, 0.1, 1.0, 0.0, 0.06
        )
        assert x * sign > 0.0
        assert v * sign > 0.0


def test_stops_where_the_closed_form_says() -> None:
    # Without damping: Δx = m v²/(2 f_c), Δt = m v/f_c; the step is longer than that, and it must
    # stay.
    mass, friction, v = 0.1, 0.06, 0.0009
    step = coefficients(mass, 0.0, 0.0, 0.002)
    assert halt_time(0.0, v, -friction, 1.0, mass, 0.0, 0.0) == pytest.approx(
        mass * v / friction, rel=1e-15
    )
    x, after = slide(0.0, v, 0.0, 0.002, step, mass, 0.0, 0.0, friction)
    assert after == 0.0
    assert x == pytest.approx(mass * v * v / (2.0 * friction), rel=1e-14)


def test_halt_time_of_a_damped_device() -> None:
    # v(t) = v e^{−bt/m} + (u/b)(1 − e^{−bt/m}) = 0 at t = (m/b) ln(1 − b v/u).
    mass, damping, v, u = 0.1, 3.0, 0.5, -0.2
    expected = mass / damping * math.log1p(-damping * v / u)
    assert halt_time(0.0, v, u, 1.0, mass, damping, 0.0) == pytest.approx(
        expected, rel=1e-14
    )
    assert halt_time(0.0, -v, -u, -1.0, mass, damping, 0.0) == pytest.approx(
        expected, rel=1e-14
    )
    assert halt_time(0.0, v, 0.1, 1.0, mass, damping, 0.0) == math.inf


@pytest.mark.parametrize("damping", [0.0, 0.4, 60.0])
@pytest.mark.parametrize("stiffness", [0.0, 2000.0])
def test_sliding_against_an_integrator(damping: float, stiffness: float) -> None:
    """50 ms with friction, hand, reversals and stops, the force changing every 5 ms."""
    mass, friction, piece = 0.05, 0.3, 0.005
    forces = np.random.default_rng(7).uniform(-1.5, 1.5, 10)
    step = coefficients(mass, damping, stiffness, piece)
    x, v = 0.002, 0.3
    p, q = x, v
    for u in forces:
        x, v = slide(x, v, float(u), piece, step, mass, damping, stiffness, friction)
        p, q = _integrate(p, q, float(u), piece, mass, damping, stiffness, friction)
        # rtol of the integrator 1e-12, events located to 4 roundings of time: 1e-9 of the scales 1
        # mm and 1 m/s.
        assert x == pytest.approx(p, abs=1e-12)
        assert v == pytest.approx(q, abs=1e-9)


def _integrate(
    x: float,
    v: float,
    u: float,
    duration: float,
    mass: float,
    damping: float,
    stiffness: float,
    friction: float,
) -> tuple[float, float]:
    """Integrate sliding by DOP853 with event location, an independent method."""
    time = 0.0
    while time < duration:
        net = u - stiffness * x
        if v == 0.0 and abs(net) <= friction:
            return x, 0.0
        direction = math.copysign(1.0, v if v != 0.0 else net)

        def rate(_: float, y: Any, s: float = direction) -> Any:
            return [y[1], (u - s * friction - damping * y[1] - stiffness * y[0]) / mass]

        def stop(_: float, y: Any, s: float = direction) -> Any:
            return y[1] * s

        stop.terminal = True  # type: ignore[attr-defined]
        stop.direction = -1.0  # type: ignore[attr-defined]
        answer: Any = solve_ivp(
            rate,
            (time, duration),
            [x, v],
            method="DOP853",
            events=stop,
            rtol=1e-12,
            atol=1e-15,
        )
        x, v, time = float(answer.y[0, -1]), float(answer.y[1, -1]), float(answer.t[-1])
        if answer.status == 1:
            v = 0.0
    return x, v


@given(
    mass_values,
    damping_values,
    stiffness_values,
    durations,
    durations,
    states,
    st.floats(0.0, 5.0),
)
@settings(max_examples=300)
def test_two_sliding_steps_are_one(
    m: float,
    b: float,
    k: float,
    h1: float,
    h2: float,
    state: tuple[float, float, float],
    friction: float,
) -> None:
    x, v, u = state
    once = slide(x, v, u, h1 + h2, coefficients(m, b, k, h1 + h2), m, b, k, friction)
    half = slide(x, v, u, h1, coefficients(m, b, k, h1), m, b, k, friction)
    twice = slide(*half, u, h2, coefficients(m, b, k, h2), m, b, k, friction)
    rate = math.sqrt(k / m) + b / m
    pull = abs(u) + friction
    reach = abs(x) + (abs(v) + pull / m * (h1 + h2)) * (h1 + h2)
    # A stop is found to a rounding of time, and then moved by at most that much velocity: a few
    # more roundings than above.
    assert twice[0] == pytest.approx(
        once[0], abs=1e-12 * reach * (1.0 + rate * (h1 + h2))
    )
    assert twice[1] == pytest.approx(
        once[1], abs=1e-12 * (abs(v) + pull / m * (h1 + h2) + rate * reach) * 4.0
    )


# Sensor, motor, delay


@given(st.floats(-0.2, 0.2), st.floats(1e-6, 1e-3))
def test_quantiser_reads_the_nearest_count(x: float, resolution: float) -> None:
    read = quantise(x, resolution)
    assert read == round(x / resolution) * resolution
    # Half a count, and a rounding of the quotient.
    assert abs(read - x) <= 0.5 * resolution * (1.0 + 1e-9)
    assert quantise(read, resolution) == read


def test_quantiser_at_its_edges() -> None:
    assert quantise(0.1234, None) == 0.1234
    assert quantise(0.5, 1.0) == 0.0
    assert quantise(math.nextafter(0.5, 1.0), 1.0) == 1.0
    assert quantise(1.5, 1.0) == 2.0
    assert math.isinf(quantise(math.inf, 1e-5))
    assert math.isnan(quantise(math.nan, 1e-5))


def test_motor_saturates_at_its_peak() -> None:
    assert saturate(7.9, 7.9) == 7.9
    assert saturate(8.0, 7.9) == 7.9
    assert saturate(-8.0, 7.9) == -7.9
    assert saturate(-8.0, None) == -8.0


@pytest.mark.parametrize(
    ("delay", "whole", "part"),
    [(0.0, 0, 0.0), (1.0, 1, 0.0), (2.25, 2, 0.25), (0.999, 0, 0.999)],
)
def test_delay_splits(delay: float, whole: int, part: float) -> None:
    found = split_delay(delay)
    assert found[0] == whole
    assert found[1] == pytest.approx(part)


def test_force_acts_when_its_delay_is_over() -> None:
    # An undamped mass under one force of 1 N for one tick: it moves by F/m·h²/2 of the time it has
    # acted.
    period, mass = 0.002, 0.1
    for delay in (0.0, 0.25, 1.0, 1.25, 3.5):
        device = VirtualDevice(DeviceModel(mass=mass, delay=delay), period)
        for k in range(6):
            device_tick(device.state, 1.0 if k == 0 else 0.0)
            acted = min(max((k + 1 - delay) * period, 0.0), period)
            coasted = max((k - delay) * period, 0.0)
            expected = acted**2 / (2.0 * mass) + acted / mass * coasted
            assert device.state.x == pytest.approx(expected, rel=1e-12)


def test_next_tick_is_one_tick_of_delay() -> None:
    one = VirtualDevice(DeviceModel(mass=0.1, delay=1.25), 0.002)
    other = VirtualDevice(DeviceModel(mass=0.1, delay=0.25), 0.002, next_tick=True)
    for k in range(20):
        device_tick(one.state, math.sin(k))
        device_tick(other.state, math.sin(k))
    assert one.state.x == other.state.x


def test_a_tick_in_parts_is_a_tick() -> None:
    model = DeviceModel(
        mass=0.1, damping=0.5, gravity=9.81, friction=0.06, peak_force=0.8, delay=0.25
    )
    whole, parts = VirtualDevice(model, 0.002), VirtualDevice(model, 0.002)
    previous = 0.0
    for k in range(50):
        force = 1.2 * math.sin(0.3 * k)
        device_tick(whole.state, force)
        device_part(parts.state, previous, 0.25 * 0.002)
        device_part(parts.state, force, 0.002 - 0.25 * 0.002)
        previous = force
        assert (parts.state.x, parts.state.v) == (whole.state.x, whole.state.v)


# Parameters


def test_hand_holds_along_its_path() -> None:
    model = msgspec.convert(
        {
            "mass": 0.045,
            "hand": {
                "mass": 0.1,
                "damping": 4.0,
                "stiffness": 400.0,
                "path": [[0.0, 0.0], [0.1, 0.02]],
            },
        },
        DeviceModel,
    )
    assert (model.moving_mass, model.moving_damping, model.grip) == (
        0.045 + 0.1,
        4.0,
        400.0,
    )
    device = VirtualDevice(model, 0.001)
    for _ in range(2000):
        device_tick(device.state, 0.0)
    # Two seconds of decay at b/2m ≈ 14 /s leave e^{−26}.
    assert device.state.x == pytest.approx(0.02, rel=1e-9)


def test_path_is_linear_between_and_held_beyond() -> None:
    path = [(0.0, 1.0), (2.0, 3.0), (3.0, 3.0)]
    assert [path_position(path, t) for t in (-1.0, 0.0, 1.0, 2.0, 2.5, 9.0)] == [
        1.0,
        1.0,
        2.0,
        3.0,
        3.0,
        3.0,
    ]


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"mass": 0.0}, r"> 0.0.*\$\.mass"),
        ({"mass": -0.1}, r"> 0.0.*\$\.mass"),
        ({"mass": math.inf}, "mass: inf"),
        ({"mass": 0.1, "damping": -1.0}, r">= 0.0.*\$\.damping"),
        ({"mass": 0.1, "delay": math.nan}, "delay|nan"),
        ({"mass": 0.1, "colour": 1}, "unknown field `colour`"),
        (
            {"mass": 0.1, "hand": {"stiffness": 1.0, "path": []}},
            r"path or file: neither is given.*hand",
        ),
        (
            {"mass": 0.1, "hand": {"stiffness": 1.0, "path": [[1.0, 0.0], [1.0, 1.0]]}},
            r"times must increase.*\$\.hand",
        ),
    ],
)
def test_wrong_parameters_are_refused_by_path(
    fields: dict[str, object], text: str
) -> None:
    with pytest.raises(msgspec.ValidationError, match=text):
        msgspec.convert(fields, DeviceModel)


def test_a_hand_may_repeat_its_path() -> None:
    once = Hand(stiffness=1.0, path=[(0.0, 0.0), (1.0, 2.0), (2.0, 0.0)])
    again = msgspec.structs.replace(once, repeat=2.5)
    for time in (0.0, 0.5, 1.0, 2.25):
        # 2.5 s and these times are exact
        assert again.point(time) == again.point(time + 2.5) == once.point(time)
    assert once.point(3.5) == 0.0
    assert again.point(3.5) == 2.0
    with pytest.raises(
        ValueError, match=r"repeat is 1\.5 s, but the path ends at 2\.0 s"
    ):
        Hand(stiffness=1.0, path=once.path, repeat=1.5)
