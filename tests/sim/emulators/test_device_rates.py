"""Each real device at its own rate on its emulator, against the virtual device: misses.

``pytest -s -n 0 --benchmark-enable tests/sim/emulators/test_device_rates.py`` prints the table of
nodes/driver/DEVICES.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median
from typing import Any

import pytest

from sim.drill.devices import KINDS, StandIn
from sim.drill.drill import scene
from sim.measure.rig import Rig

OWN_RATE = 1000.0
"""Default servo rates of the drivers; the loop runs at the same rate here [Hz]."""

SECONDS, ROUNDS = 1.5, (1, 3, 7)
"""Duration of a turn [s], 1500 ticks, and turns per device if fewer do not decide."""

MORE, TIMES = 0.01, 3
"""Misses allowed beyond the virtual device's: share of ticks, and as a factor.

Two turns of one device differ by `MORE`. If the machine is too slow and the virtual device misses
ticks too, `TIMES` as many are allowed, because the emulator takes its share.
"""


VIRTUAL = "sim_driver"


def _run(stand: StandIn | None) -> dict[str, Any]:
    """Run a loop for a while; return its summary."""
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


class Turns:
    """Turns of each device: ticks missed [share], and 99th percentile of the response [us]."""

    def __init__(self) -> None:
        self._turns: dict[str, list[tuple[float, float]]] = {}

    def take(self, name: str) -> float:
        """Run a turn; return its share of missed ticks."""
        told = _run(
            StandIn(next(kind for kind in KINDS if kind.kind == name))
            if name != VIRTUAL
            else None
        )
        missed = (told["missed"] + told["overruns"]) / (
            told["ticks"] + told["overruns"]
        )
        self._turns.setdefault(name, []).append((missed, told["response_us"]["p99"]))
        return float(missed)

    def show(self) -> None:
        """Print the table's rows."""
        for name, made in self._turns.items():
            shares = ", ".join(f"{share:.2%}" for share, _ in made)
            print(
                f"| `{name}` | {OWN_RATE:.0f} | {shares} | {median(p99 for _, p99 in made):.0f} |"
            )


@pytest.fixture(scope="module")
def turns(request: pytest.FixtureRequest) -> Iterator[Turns]:
    made = Turns()
    if request.config.getoption("benchmark_enable"):
        for name in (*(kind.kind for kind in KINDS), VIRTUAL) * ROUNDS[1]:
            made.take(name)
    yield made
    made.show()


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("kind", [kind.kind for kind in KINDS])
def test_a_real_device_misses_no_more_ticks_than_the_virtual_one(
    kind: str, turns: Turns
) -> None:
    # Each turn with one of the virtual device right after it: within minutes a machine's own share
    # went from 0.2 to 12 %. One decides most of the time; where it does not, the machine may have
    # stalled in it, and the median of more decides.
    more: list[float] = []
    for rounds in ROUNDS:
        more += [
            turns.take(kind) - TIMES * turns.take(VIRTUAL)
            for _ in range(len(more), rounds)
        ]
        if median(more) <= MORE:
            return
    pytest.fail(
        f"{kind} missed more than {TIMES} times the virtual device's ticks, by"
        f" {[f'{one:.2%}' for one in more]}"
    )
