"""Each real device at its own rate, on its stand-in, beside the virtual device in turns: ticks missed, and response times.

``pytest -s -n 0 tests/sim/test_device_rates.py`` prints the table of nodes/driver/DEVICES.md.
"""

from __future__ import annotations

from statistics import median
from typing import Any, TypeAlias

import pytest

from sim.drill.devices import KINDS, DrilledKind, StandIn
from sim.drill.drill import scene
from sim.measure.rig import Rig

OWN_RATE = 1000.0
"""Samples that the drivers ask their devices for, where nothing else is said [Hz]; here the loop goes as fast."""

SECONDS, ROUNDS = 1.5, 3
"""Of a turn [s]: 1500 ticks, of which `MORE` are 15; and how many turns each device has."""

MORE = 0.01
"""What a real device may miss more than the virtual one [share of ticks]: two turns of one device differ by so much."""


Found: TypeAlias = dict[str, list[tuple[float, float]]]
"""Of each device, and of each turn: ticks missed [share], and the 99th percentile of its response [us]."""


def _run(stand: StandIn | None) -> dict[str, Any]:
    """Let a loop run for a while; what its summary says."""
    content = scene()
    content["run"]["rate"] = OWN_RATE
    try:
        if stand is not None:
            stand.prepare()
            stand.change(content)
        with Rig(content) as rig:
            rig.let_pass(SECONDS)
            rig.end()
            return rig.summary
    finally:
        if stand is not None:
            stand.tidy()


@pytest.fixture(scope="module")
def found() -> Found:
    """Run all devices in turns, each beside the same virtual one."""
    runs: Found = {name: [] for name in (*(kind.kind for kind in KINDS), "sim_driver")}
    for _ in range(ROUNDS):
        for name, stand in (*((kind.kind, StandIn(kind)) for kind in KINDS), ("sim_driver", None)):
            told = _run(stand)
            missed = (told["missed"] + told["overruns"]) / (told["ticks"] + told["overruns"])
            runs[name].append((missed, told["response_us"]["p99"]))
    for name, rounds in runs.items():
        shares = ", ".join(f"{share:.2%}" for share, _ in rounds)
        print(f"| `{name}` | {OWN_RATE:.0f} | {shares} | {median(p99 for _, p99 in rounds):.0f} |")
    return runs


@pytest.mark.realtime
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: str(kind.kind))
def test_a_real_device_misses_no_more_ticks_than_the_virtual_one(kind: DrilledKind, found: Found) -> None:
    assert median(share for share, _ in found[kind.kind]) <= median(share for share, _ in found["sim_driver"]) + MORE
