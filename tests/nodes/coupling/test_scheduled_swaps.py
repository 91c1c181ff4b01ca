"""Scheduled law changes: recorded, and bit-equal to one process."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import pytest

from messages.types import Force
from nodes.launcher.launch_file import read
from sim.play.launched import from_launch
from sim.play.player import play
from tests.support import slowly
from tests.support.held import HELD, receipts, recorded
from tests.support.launching import launch_json, running

# -- schedules
# --------------------------------------------------------------------------------------------------


def leak() -> float:
    """Return D(1) of the paper's two terms with B = 3 N s/m at 500 Hz, four taps each [N/m].

    Each term's D(−1) is 2/T times its gain: f(ω_N) = 1 (paper, figure 3).
    """
    total = 0.0
    for gain, order in ((1.69, 1.50), (1.32, 3.47)):
        choose = [math.prod((order - i) / (i + 1) for i in range(m)) for m in range(4)]
        total += (
            gain * sum((-1) ** m * one for m, one in enumerate(choose)) / sum(choose)
        )
    return abs(2.0 * 3.0 / 0.002 * total)


@pytest.mark.process
@pytest.mark.parametrize("ramp", slowly([0, 100], but=[100]))
def test_scheduled_swaps_are_recorded_and_have_the_bits_of_one_process(
    tmp_path: Path, ramp: int
) -> None:
    figures = launch_json(tmp_path, "floor_swap", "pace:=lockstep", f"ramp:={ramp}")
    recording = recorded(tmp_path, figures)
    found = receipts(recording)
    assert [
        (receipt.seq, receipt.action, receipt.reason, receipt.ramp) for receipt in found
    ] == [(1000, "switch", "schedule", 0), (2000, "switch", "schedule", ramp)]
    # PDα is leak-corrected: the same H(1) as PD, at rest no step but rounding of 1 N. Multi-term is
    # softer by its leak.
    assert found[0].force_step < 1e-13
    assert found[1].force_step == pytest.approx(leak() * 0.000981, rel=1e-4)
    forces: list[Force] = recording.messages("/coupling/force")
    trace = play(read("floor_swap", {"pace": "lockstep", "ramp": ramp})).along()
    assert [force.force[2].hex() for force in forces[: len(trace.force)]] == [
        value.hex() for value in trace.force.tolist()
    ]
    if ramp:
        # Faded, the force never changes by more per tick than it would within a law: no jump to be
        # felt.
        steps = [
            abs(b.force[2] - a.force[2])
            for a, b in itertools.pairwise(forces[1900:2300])
        ]
        assert max(steps) < 0.02


SCHEDULED = (
    HELD.replace("fifo: 0", "fifo: 0, duration: 3.0")
    .replace(
        "      fallback:",
        """        recursive:
          {kind: pd_alpha, stiffness: 500.0, damping: 1.0, order: 0.8, taps: 6, gains: physical,
      derivative: oustaloup_matched}
      schedule: [{at: 2.0, law: recursive}]
      fallback:""",
    )
    .replace("stability: refuse", "stability: 'off'")
)


@pytest.mark.process
@pytest.mark.parametrize("ramp", [0, 40])
def test_a_scheduled_recursive_law_has_the_bits_of_one_process(
    tmp_path: Path, ramp: int
) -> None:
    # Long before the history is full, and when the swap replays less than all: memory is shorter
    # than the run.
    text = SCHEDULED.replace("fifo: 0", "fifo: 0, pace: lockstep").replace(
        "law: recursive}", f"law: recursive, ramp: {ramp}}}"
    )
    (tmp_path / "recursive.yaml").write_text(
        text.replace("      fallback:", "      memory: 300\n      fallback:")
    )
    figures = launch_json(tmp_path, "./recursive.yaml")
    forces = {
        force.seq: force.force[2]
        for force in recorded(tmp_path, figures).messages("/coupling/force")
    }
    launch = read(str(tmp_path / "recursive.yaml"), {})
    scene = from_launch(launch)
    assert scene.swaps[0].law.sections
    expected = play(launch).along().force.tolist()
    assert [forces[seq].hex() for seq in range(len(expected))] == [
        value.hex() for value in expected
    ]


@pytest.mark.slow
def test_a_scheduled_law_runs_along_and_follows_a_change_before_its_time(
    tmp_path: Path,
) -> None:
    (tmp_path / "scheduled.yaml").write_text(SCHEDULED)
    with running(tmp_path, "./scheduled.yaml") as launch:
        launch.call("coupling", "param.set", values={"laws.recursive.damping": 2.0})
        figures = launch.finish()
    recording = recorded(tmp_path, figures)
    found = receipts(recording)
    assert [receipt.action for receipt in found] == ["set", "switch"]
    # Tick 1000, or on a busy machine the first one after it that reached the coupling.
    ticks = [force.seq for force in recording.messages("/coupling/force")]
    assert found[-1].seq == min(seq for seq in ticks if seq >= 1000)
    assert json.loads(found[-1].after)["damping"] == 2.0
    # D^0.8 of 1 mm that have been held for 2 s is near zero however it is realised: well below the
    # 0.56 N of the spring.
    assert found[-1].force_step < 0.3
