"""Shapes of suspects against closed forms: a dragged bristle, a mass loose in its gap."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from sim.arrays import Array
from sim.identify.experiment import lockstep
from sim.identify.identified_motion import MOBILITY, NAMES
from sim.identify.output_error import Fit
from sim.identify.suspects import Shapes, describe

T = 0.002


def shapes(position: Array, force: Array | None = None) -> Shapes:
    """Return the shapes of one window in which the model, 1 kg, follows the recording."""
    nothing = np.zeros((1, 0))
    found = Fit(
        np.eye(len(NAMES))[MOBILITY],
        np.zeros(0, dtype=np.int64),
        np.zeros((1, 4)),
        np.zeros(1),
        nothing,
        nothing,
        np.zeros(1, dtype=np.int64),
        len(position),
    )
    pushed = np.zeros(len(position)) if force is None else force
    return Shapes(lockstep(T, position, pushed), found, position[None])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bristle_slips_at_its_reach_and_bends_back_by_the_way(sign: float) -> None:
    """After a turn it is at its reach less the way back, down to its reach on the other side."""
    way, reach = 2.0**-16, 10 * 2.0**-16
    there = np.arange(40) * way
    back = there[-1] - np.arange(1, 41) * way
    (out,) = shapes(sign * np.concatenate([there, back]))._bristle(reach)
    assert list(sign * out[:40]) == [reach] * 40
    assert list(sign * out[40:]) == [max(reach - k * way, -reach) for k in range(1, 41)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_loose_mass_coasts_through_its_gap_and_then_rests(sign: float) -> None:
    """The first mass stops; the second goes on at its speed until it hits the other side."""
    way = 2.0**-16
    gap = 20 * way
    moving = np.arange(40) * way
    (out,) = shapes(sign * np.concatenate([moving, np.full(40, moving[-1])]))._loose(
        gap
    )
    # The speed is a central difference, so half of the last step counts as a stop already.
    assert list(sign * out[:40]) == [0.5 * gap] * 40
    coasting = [0.5 * gap - (k - 0.5) * way for k in range(1, 41)]
    assert list(sign * out[40:]) == [max(one, -0.5 * gap) for one in coasting]


def test_a_free_mass_moves_by_half_the_square_of_time() -> None:
    """Under 1 m/s² from rest; under nothing, not at all."""
    ticks = np.arange(50)
    some = shapes(np.zeros(50))
    (moved,) = some._moved_by(np.ones((1, 50)))
    assert moved == pytest.approx(0.5 * (ticks * T) ** 2, abs=1e-15)
    assert not some._moved_by(np.zeros((1, 50))).any()


def test_joints_are_looked_for_from_8_hz_to_nine_tenths_of_the_nyquist_frequency() -> (
    None
):
    """By steps of 3 %, each with two damping ratios."""
    modes = [
        one
        for one in shapes(np.zeros(50), np.sin(np.arange(50.0))).all()
        if one.term == "flexible mode"
    ]
    frequencies = sorted({one.size for one in modes})
    assert frequencies[0] == pytest.approx(8.0)
    assert frequencies[-1] == pytest.approx(0.9 * 0.5 / T)
    steps = np.diff(np.log(frequencies))
    assert steps.max() == pytest.approx(steps.min())
    assert 0.03 <= steps.max() < 0.031
    assert len(modes) == 2 * len(frequencies)
    assert {one.start for one in modes} == {
        (0.3, frequency, loss) for frequency in frequencies for loss in (0.02, 0.08)
    }


def test_a_joint_under_a_steady_push_stretches_by_its_compliance() -> None:
    """1 m/s² over ω², after its swing has died: 4 s of a damping ratio of 2 % at 8 Hz."""
    ticks = 2000
    slowest = next(shapes(np.zeros(ticks), np.ones(ticks))._modes())
    ((stretched,),) = slowest.shapes
    pulse = 2.0 * np.pi * 8.0
    # e^(−0.02 ω t) is 2 % there.
    assert stretched[-1] == pytest.approx(1.0 / pulse**2, rel=0.03)
    assert stretched.max() == pytest.approx(
        (1.0 + np.exp(-0.02 * np.pi)) / pulse**2, rel=2e-3
    )


def test_a_lag_takes_its_time_off_a_steady_slope() -> None:
    """A force that grows by 1 N a tick is behind by the lag in ticks, and moves 1 kg by it."""
    lags = list(shapes(np.zeros(400), np.arange(400.0))._lags())
    assert [one.start for one in lags] == [(0.25,), (0.5,), (1.0,), (2.0,), (4.0,)]
    for lag in lags:
        ((moved,),) = lag.shapes
        assert lag.size == pytest.approx(1e3 * T * lag.start[0])
        # After 100 ticks the longest has settled to e⁻²⁵.
        assert np.diff(moved, 2)[100:] == pytest.approx(-lag.start[0] * T**2, rel=1e-6)


def test_a_filtered_sensor_reads_a_part_of_the_sample_before() -> None:
    """A parabola is continued exactly to the sample before the first."""
    at = np.arange(30.0)
    position = 1e-6 * (3.0 + 2.0 * at + 0.5 * at**2)
    before = 1e-6 * (3.0 + 2.0 * (at - 1.0) + 0.5 * (at - 1.0) ** 2)
    filters = list(shapes(position)._read())
    assert [one.size for one in filters] == [0.15, 0.5]
    for one in filters:
        ((read,),) = one.shapes
        assert read == pytest.approx(one.size * (before - position), abs=1e-18)


@pytest.mark.parametrize(("largest", "steps"), [(0.02, 4), (0.0201, 5), (1.0, 7)])
def test_a_force_has_no_steps_larger_than_itself(largest: float, steps: int) -> None:
    force = largest * np.sin(np.arange(50.0))
    force[7] = largest
    found = [
        one.size
        for one in shapes(np.zeros(50), force).all()
        if one.term == "force steps"
    ]
    assert found == [1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1][:steps]


def test_sizes_are_tried_over_what_a_device_may_have() -> None:
    """From the smallest to the largest, and so densely that one of them is near."""
    ticks = np.arange(400)
    some = shapes(0.01 * np.sin(ticks / 20.0), 2.0 * np.sin(ticks / 20.0))
    found: dict[str, list[float]] = {}
    for one in some.all():
        found.setdefault(one.term, []).append(one.size)
    ranges = {
        "presliding": (20e-6, 500e-6, 2.5, 5),
        "backlash": (50e-6, 800e-6, 2.0, 5),
        "stribeck": (0.01, 0.03, 3.0, 2),
        "encoder ripple": (0.4e-3, 30e-3, 75.0 ** (1.0 / 39.0), 40),
        "cogging": (0.4e-3 * 75.0 ** (9.0 / 39.0), 30e-3, 75.0 ** (1.0 / 39.0), 31),
    }
    for term, (smallest, largest, factor, count) in ranges.items():
        sizes = found[term]
        assert len(sizes) == count, term
        assert sizes[0] == pytest.approx(smallest, rel=1e-3), term
        assert sizes[-1] == pytest.approx(largest), term
        assert max(b / a for a, b in pairwise(sizes)) == pytest.approx(factor), term


@pytest.mark.parametrize(
    ("term", "size", "words"),
    [
        ("flexible mode", 37.4, "at 37 Hz"),
        ("actuator lag", 4.0, "about 4.0 ms"),
        ("presliding", 2e-4, "over 200 µm"),
        ("backlash", 4e-4, "about 0.4 mm"),
        ("cogging", 0.03, "every 30 mm"),
        ("encoder ripple", 4e-4, "every 0.4 mm"),
        ("sensor filter", 0.15, "15 % of the sample before"),
        ("force steps", 2e-3, "steps of 2 mN"),
        ("spring", 0.0, "a spring of the device"),
    ],
)
def test_a_suspect_is_described_by_its_size(term: str, size: float, words: str) -> None:
    assert words in describe(term, size)


def test_a_spring_pulls_with_powers_of_the_way_from_the_middle() -> None:
    """A free mass of 1 kg under a held force: second differences are T²/2 of the two forces."""
    way = np.tile([0.25, -0.5, 0.0, 0.5, -0.25], 20)
    (spring,) = shapes(3.0 + way)._springs()
    for power, (moved,) in enumerate(spring.shapes, 1):
        force = -(way**power)
        expected = 0.5 * T * T * (force[1:-1] + force[:-2])
        # rounding of positions of some 0.01 m
        assert np.diff(moved, 2) == pytest.approx(expected, abs=1e-16)
