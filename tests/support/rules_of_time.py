"""Every rule of time of a driver, as a script in which it acts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from nodes.driver.device import DeviceLimits
from nodes.driver.state import DAMPING, FAULT, NOTHING, RAMP, STOPPED
from tests.support.scripted import Hand, Script
from tests.support.scripted_world import Arrival, T, at
from tests.support.scripts import BOX, TICKS, answer, answers_but, driver, moving

ANSWERED = answers_but()


class Rule(NamedTuple):
    """A script in which a rule acts on arrival, and the evidence; next_tick may differ."""

    script: Script
    acted: Callable[[Any], bool]


SILENT = tuple(range(20, 70))


BEARS = DeviceLimits(peak_force=8.0, hold=10.0, workspace=BOX, latency=0.0)


RULES = {
    "nothing unusual": Rule(
        driver(ANSWERED), lambda s: s.ticks == TICKS and s.missed == s.overruns == 0
    ),
    "watchdog, damping, zero": Rule(
        driver(answers_but(*SILENT), watchdog=5, damping_ticks=20),
        lambda s: (
            (s.entered[DAMPING], s.entered[NOTHING], s.missed) == (1, 1, len(SILENT))
        ),
    ),
    "the watchdog's last tick in time": Rule(
        driver(answers_but(*range(20, 24)), watchdog=5),
        lambda s: s.entered[DAMPING] == 0 and s.missed == 4,
    ),
    "the ramp at the start, and after damping": Rule(
        driver(answers_but(*SILENT), ramp=0.02, recovery=0.04, watchdog=5),
        lambda s: s.entered[RAMP] == 2,
    ),
    "a hand that is pushed by the ramp": Rule(
        driver(
            answers_but(*SILENT),
            recovery=0.05,
            watchdog=5,
            position=lambda seq: (0.0, 0.0, 1e-3 * max(seq - 69, 0)),
        ),
        lambda s: s.entered[RAMP] == 1 and s.safety == RAMP,
    ),
    "slew": Rule(
        driver(
            [
                answer(seq, force=(0.0, 0.0, 5.0 * (seq // 10 % 2)))
                for seq in range(TICKS)
            ],
            slew=500.0,
        ),
        lambda s: s.limited_by[1] > 10,
    ),
    "slew after lost ticks is that of one": Rule(
        driver(
            [
                answer(seq, force=(0.0, 0.0, 0.0 if seq < 40 else 6.0))
                for seq in range(TICKS)
            ],
            {40: 9_000, 60: 4_000},
            slew=500.0,
        ),
        lambda s: s.overruns == 6 and s.force[2] == 6.0,
    ),
    "ticks lost": Rule(
        driver(ANSWERED, {30: 2_000, 50: 1_998, 70: 21_000}),
        lambda s: s.overruns == 1 + 10,
    ),
    "lost ticks and no answers": Rule(
        driver(answers_but(*SILENT), {22: 9_000, 40: 3_000}, watchdog=5),
        lambda s: s.overruns == 5 and s.entered[DAMPING] == 1,
    ),
    "hold: the device lets go in a silence": Rule(
        driver(answers_but(*SILENT), limits={"hold": 6 * T}, watchdog=30),
        lambda s: s.entered[NOTHING] == 1,
    ),
    "hold: it lets go while the driver is held up": Rule(
        driver(ANSWERED, {30: 21_000}, limits={"hold": 4 * T}),
        lambda s: s.entered[NOTHING] == 1 and s.overruns == 10,
    ),
    "hold that ends within a tick": Rule(
        driver(
            answers_but(*SILENT), {60: 9_000}, limits={"hold": 5.5 * T}, watchdog=30
        ),
        lambda s: s.entered[NOTHING] == 1,
    ),
    "continuous force, two gaps in one window": Rule(
        driver(
            [answer(seq, force=(0.0, 0.0, 7.9)) for seq in range(TICKS)],
            {20: 18_000, 40: 18_000},
            continuous_force=1.75,
            thermal_time=0.2,
            slew=100.0,
            peak_force=7.9,
        ),
        lambda s: s.limited_by[2] > 0 and s.overruns == 18,
    ),
    "age: answers that are none to five ticks old": Rule(
        driver(
            [answer(seq, 600.0 + 2000.0 * (seq // 20)) for seq in range(TICKS)],
            max_age=3,
            watchdog=20,
        ),
        # On arrival a driver that is answered late waits for it, and leaves ticks out; under
        # next_tick it does not.
        lambda s: (
            s.overruns > 0
            if s.next_tick == 0
            else s.refused_for[2] > 0 and s.oldest_age >= 3 and s.entered[DAMPING] == 1
        ),
    ),
    "samples that are late, with answers beyond their tick": Rule(
        driver(
            [answer(seq, 2_200.0 if seq % 4 == 0 else 500.0) for seq in range(TICKS)],
            dict.fromkeys(range(0, TICKS, 4), 1_500),
        ),
        lambda s: s.missed == 30 and s.overruns == 0,
    ),
    "every answer late": Rule(
        driver([answer(seq, 2_100.0) for seq in range(TICKS)]),
        lambda s: s.entered[DAMPING] == 0,
    ),
    "every answer twice": Rule(
        driver(
            [answer(seq, 600.0 if seq % 2 else 2_200.0) for seq in range(TICKS)]
            + [answer(seq, 900.0, (0.0, 0.0, 0.5)) for seq in range(TICKS)]
        ),
        lambda s: s.refused_for[1] > 50,
    ),
    "forces for ticks that have not been": Rule(
        driver([*ANSWERED, *(answer(seq, -3_000.0) for seq in range(10, 40))]),
        lambda s: s.refused_for[0] == 30,
    ),
    "a flood of old forces": Rule(
        driver(
            [*ANSWERED]
            + [
                Arrival(at(seq, 100.0 + 10.0 * n), answer(max(seq - 2, 0)).frames)
                for seq in range(10, 20)
                for n in range(TICKS)
            ]
        ),
        lambda s: s.skipped > 500 and s.refused_for[1] > 500,
    ),
    "outside the workspace, and back": Rule(
        driver(
            ANSWERED,
            position=lambda seq: (0.0, 0.0, 0.2 if 30 <= seq < 40 else -1e-3),
            recovery=0.02,
        ),
        lambda s: s.entered[FAULT] == 1 and s.missed == 0,
    ),
    "a loop that swings": Rule(
        driver(
            [
                answer(seq, force=(0.0, 0.0, 20.0 * (-1) ** (seq // 5)))
                for seq in range(TICKS)
            ],
            position=lambda seq: (0.0, 0.0, -1e-3 * abs(seq % 10 - 5)),
            peak_force=7.9,
            stop_after=4,
        ),
        lambda s: s.entered[STOPPED] == 1,
    ),
    "a jump of the position": Rule(
        driver(
            [
                answer(seq, force=(0.0, 0.0, 2.0 if seq < 30 else -5.0))
                for seq in range(TICKS)
            ]
        )._replace(hand=lambda: Hand(BEARS, moving, jumps_at=[30, 70])),
        lambda s: s.entered[RAMP] == 1 and s.rebased == 70,
    ),
    "a first force that is not zero": Rule(
        driver(ANSWERED, ramp=None), lambda s: s.entered[RAMP] == 1
    ),
    "a force that stays at its limit": Rule(
        driver(
            [answer(seq, force=(0.0, 0.0, 20.0)) for seq in range(TICKS)],
            position=lambda seq: (0.0, 0.0, 1e-5 * seq),
            peak_force=7.9,
            stop_after=64,
        ),
        # Once for coming there, seen by the sample of tick 1, and then every 1 s / 64 while 79 µJ
        # more a tick are given out.
        lambda s: s.peaks_count == 1 + (TICKS - 1) // 8,
    ),
    **{
        f"held up in mid-tick, {place}": Rule(
            driver(ANSWERED, limits={"hold": 5 * T})._replace(
                stalls={(40, place): 21_000, (70, place): 4_000}
            ),
            lambda s: s.entered[NOTHING] == 1 and s.entered[RAMP] == 1,
        )
        for place in ("read", "publish", "answer", "stamped")
    },
    "the guard": Rule(
        driver(
            [answer(seq, force=(0.0, 0.0, -2.0)) for seq in range(TICKS)],
            {50: 5_000},
            position=lambda seq: (0.0, 0.0, -1e-4 * seq),
            guard={"stiffness": 500.0, "damping": 5.0},
            limits={"latency": 0.6 * T},
        ),
        lambda s: s.lowered > 0,
    ),
}
