"""``import haptic``, a launch in lockstep, and the same bits in one process; for any Python."""

import sys
import tempfile

import haptic

with (
    tempfile.TemporaryDirectory() as folder,
    haptic.launch("floor_drop", stiffness=1500, pace="lockstep", out_dir=folder) as run,
):
    summary = run.wait()
    launched = run.recording["position"][:-1, 2]
played = haptic.play("floor_drop", stiffness=1500).measured_m
same = summary.ticks == len(played) == 1500 and bool((launched == played).all())
print(f"Python {sys.version.split()[0]}: {summary.ticks} ticks, the same bits: {same}")
sys.exit(not same)
