"""Cases of ``haptic bench loop``: each launch does what its name says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nodes.recording.reader import Recording
from sim.lab.bench.bare import CASES, LONGEST_FADE, SERVO_RATE, launches
from tests.support.held import receipts, recorded
from tests.support.launching import launch_json

TICKS = 100


@pytest.mark.slow
def test_the_guard_is_on_and_a_fade_goes_on_to_the_end(tmp_path: Path) -> None:
    words = ("pace:=lockstep", f"duration:={TICKS / 500.0}", "--tick", "plain")
    with launches(["guard", "fade"]) as cases:
        guarded = launch_json(tmp_path, *cases["guard"], *words)
        assert guarded["guard"] == {
            "lowered": 0,
            "raised": 0,
            "highest_j": pytest.approx(0.0, abs=0.01),
        }
        faded = launch_json(tmp_path, *cases["fade"], *words)
    assert faded["guard"] is None
    (swap,) = receipts(Recording(tmp_path / faded["recording"]))
    assert (swap.seq, swap.ramp) == (0, LONGEST_FADE)
    assert LONGEST_FADE > TICKS


@pytest.mark.slow
@pytest.mark.realtime
def test_the_stand_in_is_driven_by_its_own_driver(tmp_path: Path) -> None:
    with launches(list(CASES)) as cases:
        run = launch_json(
            tmp_path,
            *cases["stand_in"],
            f"rate:={SERVO_RATE}",
            "duration:=0.5",
            "stiffness:=500",
        )
    # Held 1 mm deep in a wall of 500 N/m. At 4 kHz a busy machine's pause of 3 ms takes the force
    # away, and its ramp begins anew: so it is looked for in all ticks, not in the last one.
    assert run["final"]["position_m"] == pytest.approx(-0.001, abs=1e-9)
    forces = recorded(tmp_path, run).arrays("/device/state")["force"][:, 2]
    assert np.isclose(forces, 0.5, rtol=0.0, atol=1e-6).any()
