"""The scene in one process: device, environment, coupling and driver in one loop.

It predicts the distributed loop, thousands of times faster. `play` is one function: it runs
interpreted (slow, for the test that compares both) or compiled, over the very kernels that the
nodes call.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from nodes.laws import CompiledLaw
from sim.arrays import Array
from sim.play.compiled import numbers_of
from sim.play.given import Given
from sim.play.one_axis_inputs import Scene, contact_of, guard_of, in_numbers, motion_of
from sim.play.one_axis_loop import play, play_compiled
from sim.play.one_axis_tables import Arrivals, LawTables, Records

# longest run of one process, which stores some 100 bytes per tick
MAX_TICKS: Final = 10_000_000


@dataclass(frozen=True)
class PlannedSwap:
    """A change of the law between two ticks."""

    tick: int  # first tick at which the new law acts
    law: CompiledLaw  # the new law
    # Length of the cross-fade [ticks], 0 for none: force (1−w)·old + w·new, w = (j+1)/ramp at the
    # j-th tick after the swap. A swap during a cross-fade starts from the law being faded in.
    ramp: int = 0


@dataclass(frozen=True)
class Trace:
    """Record of a run, one value per tick."""

    period: float  # sampling period [s]
    position: Array  # true position when sampled [m], shape (ticks,)
    velocity: Array  # true velocity when sampled [m/s], shape (ticks,)
    measured: Array  # encoder reading [m], shape (ticks,)
    deflection: Array  # deflection of the coupling [m], shape (ticks,)
    # Force passed to the device, after the driver's limits [N], shape (ticks,). Delay and
    # saturation of the device come after it.
    force: Array
    # position [m] and velocity [m/s] after the last tick, shape (2,)
    final: tuple[float, float]

    @property
    def time(self) -> Array:
        """Sampling instants [s]."""
        return np.arange(len(self.position), dtype=np.float64) * np.float64(self.period)


def run(
    scene: Scene,
    law: CompiledLaw,
    ticks: int,
    swaps: Sequence[PlannedSwap] = (),
    memory: int = 0,
    interpreted: bool = False,
    given: Given | None = None,
) -> Trace:
    """Play a scene from rest: no force and a constant deflection before tick 0.

    Parameters
    ----------
    scene : Scene
        Device, surface, period and conventions.
    law : CompiledLaw
        Law of tick 0.
    ticks : int
        Length of the run.
    swaps : sequence of PlannedSwap
        Later laws, in the order of their ticks.
    memory : int
        Least length of the history [ticks], over which swapped-in recursive laws are warmed up.
    interpreted : bool
        Run without compiling, thousands of times slower. A law with code of its own always runs
        interpreted, and so does a driver that does more than lower forces.
    given : Given, optional
        Additional inputs.

    Returns
    -------
    Trace
        Every tick.

    Raises
    ------
    ValueError
        For impossible ticks, swaps or laws.
    """
    return run_with_asked(scene, law, ticks, swaps, memory, interpreted, given)[0]


def _check(law: CompiledLaw, ticks: int, swaps: Sequence[PlannedSwap]) -> None:
    if ticks < 1:
        raise ValueError(f"ticks is {ticks}, expected at least 1")
    if ticks > MAX_TICKS:
        raise ValueError(
            f"ticks is {ticks}, expected at most {MAX_TICKS}: one process keeps all of a run;"
            " launch a longer one"
        )
    for i, swap in enumerate(swaps):
        earliest = swaps[i - 1].tick if i else 0
        if swap.tick < earliest:
            raise ValueError(
                f"swaps[{i}].tick is {swap.tick}, expected at least {earliest}: swaps come in order"
            )
        if swap.ramp < 0:
            raise ValueError(
                f"swaps[{i}].ramp is {swap.ramp}, expected 0 or more ticks"
            )
    for i, candidate in enumerate([law, *(swap.law for swap in swaps)]):
        if not candidate.finite:
            raise ValueError(
                f"law {i} of the run has a coefficient that is not finite: taps {candidate.taps}"
            )
        if candidate.evaluate is not None and swaps:
            raise ValueError(
                f"law {i} of the run has code of its own, which one process cannot swap: use the"
                " nodes"
            )


def run_with_asked(
    scene: Scene,
    law: CompiledLaw,
    ticks: int,
    swaps: Sequence[PlannedSwap] = (),
    memory: int = 0,
    interpreted: bool = False,
    given: Given | None = None,
) -> tuple[Trace, Array]:
    """Play as `run` does; return the trace and the forces before the driver's limits [N].

    The forces are 0 in real time.
    """
    _check(law, ticks, swaps)
    given = given or Given()
    own = law.own_code()
    if own is not None:
        numbered = None if interpreted else numbers_of(own, ticks)
        interpreted = numbered is None
        own = own if numbered is None else numbered
    laws = [law, *(swap.law for swap in swaps)]
    recursive = any(candidate.sections for candidate in laws)
    ring = max(2, memory, *(len(candidate.taps) for candidate in laws))
    taps_from = list(
        itertools.accumulate((len(candidate.taps) for candidate in laws), initial=0)
    )
    states_from = list(
        itertools.accumulate(
            (2 * len(candidate.sections) for candidate in laws), initial=0
        )
    )

    def numbers(values: Any, kind: Any = np.float64) -> Any:
        return list(values) if interpreted else np.array(values, dtype=kind)

    motion = motion_of(scene, ticks, given)
    arrivals = None
    if given.arrivals is not None:
        when, answers, values = given.arrivals
        late = 1.0 if scene.next_tick else 0.0
        arrivals = Arrivals(
            numbers(np.asarray(when, dtype=np.float64).tolist()),
            numbers(np.asarray(answers).tolist(), np.int64),
            numbers(np.asarray(values, dtype=np.float64).tolist()),
            late + scene.device.delay,
            numbers([0.0] * ticks),
            numbers([0.0] * len(when)),
        )
    records = Records(*(numbers([0.0] * ticks) for _ in Records._fields))
    nudged = (
        np.zeros((ticks, 3))
        if given.nudged is None and given.read is not None
        else given.nudged
    )
    contact = contact_of(scene)
    if not interpreted:
        motion, contact = in_numbers(ticks, motion, contact, lockstep=arrivals is None)
    loop = play if interpreted else play_compiled
    final = loop(
        ticks,
        motion,
        contact,
        LawTables(
            numbers([tap for candidate in laws for tap in candidate.taps]),
            numbers(taps_from, np.int64),
            (
                numbers(
                    [c for candidate in laws for s in candidate.sections for c in s]
                )
                if recursive
                else None
            ),
            numbers(states_from, np.int64),
            numbers([swap.tick for swap in swaps], np.int64),
            numbers([swap.ramp for swap in swaps], np.int64),
        ),
        numbers([0.0] * states_from[-1]),
        numbers([0.0] * (2 * ring)),
        numbers([0.0] * motion.waiting),
        records,
        guard_of(scene, numbers),
        own,
        arrivals,
        nudged,
        given.read,
    )
    position, velocity, measured, deflections, force, asked = (
        np.asarray(row, dtype=np.float64) for row in records
    )
    return Trace(
        scene.period, position, velocity, measured, deflections, force, final
    ), asked
