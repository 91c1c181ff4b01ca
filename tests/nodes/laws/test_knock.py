"""The step test as a law: its force in each tick, and what ends it."""

from __future__ import annotations

import pytest

from nodes.laws import CompiledLaw
from nodes.laws.knock import Knock

T = 0.002


def rendered(law: Knock, deflections: list[float], length: int = 16) -> list[float]:
    """Return forces as the coupling renders them, over a double ring buffer."""
    compiled: CompiledLaw = law.compile(T)
    own = compiled.own_code()
    assert own is not None
    ring, head, forces = [0.0] * (2 * length), 0, []
    for k, x in enumerate(deflections):
        head = head - 1 if head > 0 else length - 1
        ring[head] = ring[head + length] = x
        if k > 0:
            forces.append(
                sum(tap * ring[head + m] for m, tap in enumerate(compiled.taps))
                + own(ring, head)
            )
    return forces


TAPS = (5000.0, -3000.0, 500.0)


def test_a_trial_is_the_law_felt_from_nothing_and_then_the_soft_spring() -> None:
    law = Knock(taps=TAPS, step=1e-4, ticks=40, stiffness=20.0, damping=0.5)
    held = 2e-3
    forces = rendered(law, [held] * 60)
    # A step of the deflection over nothing: the sum of the first taps; beside it the force that was
    # there before.
    steps = [sum(TAPS[: k + 1]) * 1e-4 for k in range(40)]
    assert forces[:40] == pytest.approx([20.0 * held + s for s in steps], abs=1e-12)
    assert forces[40:] == pytest.approx([20.0 * held] * 19, abs=1e-12)


def test_a_trial_that_goes_far_is_over_for_good() -> None:
    law = Knock(taps=TAPS, step=1e-4, ticks=40, far=3.0)
    for end, over in ((1.9e-4, False), (2.1e-4, True)):
        # Its deflection is the step, and what the device adds.
        forces = rendered(law, [0.0, 0.0, end, 0.0, 0.0, 0.0])
        soft = rendered(
            Knock(taps=(0.0,), step=1e-12, ticks=1), [0.0, 0.0, end, 0.0, 0.0, 0.0]
        )
        assert (forces[1:] == pytest.approx(soft[1:], abs=1e-12)) is over


def test_a_load_is_carried_before_during_and_after_on_the_first_axis() -> None:
    law = Knock(taps=TAPS, step=1e-4, ticks=5, load=0.98)
    forces = rendered(law, [0.0] * 10)
    assert forces[0] == pytest.approx(0.98 + TAPS[0] * 1e-4, rel=1e-12)
    assert forces[-1] == 0.98
    second = law.compile(T).own_code(1)
    assert second is not None
    assert second([0.0] * 32, 0) == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_trial_ends_beyond_its_reach_and_not_at_it(sign: float) -> None:
    """Powers of two, so that the deflection at the reach is exact."""
    step = sign * 2.0**-13
    law = Knock(
        taps=(4096.0,), step=step, ticks=9, far=3.0, stiffness=16.0, damping=0.0
    )
    start = 2.0**-8
    # The trial adds the step to what the device moved since the tick before.
    for moved in (2.0, -4.0):
        inside = start + moved * step
        felt = 4096.0 * (moved + 1.0) * step
        assert rendered(law, [start, inside]) == [16.0 * start + felt]
        outside = start + moved * (1.0 + 2.0**-20) * step
        assert rendered(law, [start, outside]) == [16.0 * outside]


def test_lost_ticks_of_a_trial_count() -> None:
    """Five ticks, of which two are lost: the trial gives three forces."""
    law = Knock(taps=(4096.0,), step=2.0**-13, ticks=5)
    own = law.compile(T).own_code()
    assert own is not None
    ring = [0.0] * 32
    # The head moves down by one a tick, from its lowest place to its highest.
    forces = [own(ring, head) for head in (1, 0, 13, 12)]
    assert forces == [0.5, 0.5, 0.5, 0.0]
