"""Drop tests of linear devices, rigid or with a joint and a lag, in compiled code.

The device is one matrix per tick (`nodes.stability.flexible`), exact for a held force. Contact,
history and clamping are the kernels of the nodes, and the verdict is that of
`sim.experiments.drop`. In quick mode, for searches, a drop that has stayed close to its rest counts
as settled; the result of a search is then played to the end.

This is no scene of the player, because a search drops a hundred thousand laws inside one compiled
function, on devices with a joint and a lag, and gives up at the first rise. A rigid device falls as
in the player (tests/sim/design/test_fall.py).
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from nodes.compiled.kernels.sources import kernel
from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant
from sim.design.demand import RIGID, Demand
from sim.experiments.drop import CONVENTION as USUAL
from sim.experiments.drop import GRAVITY, Convention, fall, floor_force
from sim.experiments.settling import Criterion, rests, rises
from sim.play.compiled import compiled

CLOSE = 0.01  # a quick drop settles if it stays this close to its rest [share of the tolerance]


class Falls(NamedTuple):
    """Drops, one per row: transition matrices of the device, weight, height, conventions."""

    step: Any
    new: Any
    old: Any
    pull: Any
    whole: Any
    weight: Any
    start: Any
    raw: Any
    clamp: Any


def falls(
    demand: Demand,
    masses: Sequence[float],
    conventions: Sequence[tuple[bool, bool]],
    heights: Sequence[float],
) -> Falls:
    """Prepare drops of all masses, joints and lags, conventions and heights, in this order.

    Damping is the smallest and delay the longest of the demand.
    """
    rows: list[tuple[Any, ...]] = []
    most = 2
    for mass, beyond in itertools.product(masses, demand.beyond or (RIGID,)):
        plant = FlexiblePlant(mass, demand.damping, demand.delay[1], 0.0, *beyond)
        whole, step, new, old = plant.held(demand.period)
        pull = plant.pulled(demand.period, GRAVITY)
        most = max(most, len(new))
        for (raw, clamp), height in itertools.product(conventions, heights):
            rows.append(
                (step, new, old, pull, whole, mass * GRAVITY, height, raw, clamp)
            )

    def padded(i: int) -> Any:
        return np.array([np.pad(row[i], (0, most - len(row[i]))) for row in rows])

    return Falls(
        *(padded(i) for i in range(4)),
        *(np.array([row[i] for row in rows]) for i in range(4, 9)),
    )


@kernel
def settles_one(
    i: int,
    drops: Any,
    taps: Any,
    recursive: Any,
    ticks: int,
    tolerance: float,
    quick: bool,
) -> bool:
    """Drop once and check that it settles, by the rules of `sim.experiments.drop`."""
    size = drops.step.shape[1]
    length = max(len(taps), 2)
    history: Any = np.zeros(2 * length)
    memory: Any = np.zeros(len(recursive) // 2)
    whole = drops.whole[i]
    forces = np.zeros(whole + 2)
    state = np.zeros(size)
    moved = np.zeros(size)
    start = drops.start[i]
    state[0] = start
    if size >= 4:
        state[2] = start
    stiffness = 0.0
    for m in range(len(taps)):
        stiffness += taps[m]
    for j in range(len(recursive) // 4):
        stiffness += (recursive[4 * j] + recursive[4 * j + 1]) / (
            1.0 + recursive[4 * j + 2] + recursive[4 * j + 3]
        )
    if not stiffness > 0.0:
        return False
    rest = -drops.weight[i] / stiffness
    quarter = ticks - ticks // 4
    patience = 60 + length + whole
    head, close, fallen_in, touches = 0, 0, False, False
    low = np.inf
    high = -np.inf
    total = 0.0
    for k in range(ticks):
        x = state[0]
        head, force, touches = floor_force(
            x,
            taps,
            recursive,
            memory,
            history,
            head,
            length,
            drops.raw[i],
            drops.clamp[i],
        )
        fallen_in = fallen_in or touches
        if fallen_in and rises(x, start, tolerance):
            return False
        if k >= quarter:
            low = min(low, x)
            high = max(high, x)
            total += x
            if high - low > tolerance or x > 0.0:
                return False
        if quick:
            close = close + 1 if abs(x - rest) <= CLOSE * tolerance else 0
            if close > patience:
                return True
        for j in range(whole + 1, 0, -1):
            forces[j] = forces[j - 1]
        forces[0] = force
        for a in range(size):
            moved[a] = (
                drops.pull[i, a]
                + drops.new[i, a] * forces[whole]
                + drops.old[i, a] * forces[whole + 1]
            )
            for b in range(size):
                moved[a] += drops.step[i, a, b] * state[b]
        state, moved = moved, state
    return rests(high - low, total / (ticks - quarter), rest, tolerance, tolerance)


def fallen(
    plant: FlexiblePlant,
    period: float,
    law: CompiledLaw,
    height: float,
    ticks: int,
    convention: Convention = USUAL,
) -> tuple[Any, Any]:
    """Return position [m] and force [N] at each tick of a device dropped on a law's wall.

    The device includes its joint and lag.
    """
    whole, step, new, old = plant.held(period)
    pull = plant.pulled(period, GRAVITY)
    forces = [0.0] * (whole + 2)
    state = np.zeros(len(new))
    state[0] = height
    if len(new) >= 4:
        state[2] = height

    def move(force: float) -> float:
        nonlocal forces, state
        forces = [force, *forces[:-1]]
        state = step @ state + pull + new * forces[whole] + old * forces[whole + 1]
        return float(state[0])

    return fall(move, law, height, ticks, convention)


def _settled(
    drops: Any, taps: Any, recursive: Any, ticks: int, tolerance: float, verdicts: Any
) -> None:
    for i in range(len(verdicts)):
        verdicts[i] = settles_one(i, drops, taps, recursive, ticks, tolerance, False)


_settled_compiled = compiled()(_settled)


def settled(
    law: CompiledLaw, drops: Falls, criterion: Criterion | None = None
) -> list[bool]:
    """Check which drops settle with a law, played to the end."""
    criterion = criterion or Criterion()
    verdicts = np.zeros(len(drops.whole), dtype=np.bool_)
    recursive = np.array([number for section in law.sections for number in section])
    _settled_compiled(
        drops,
        np.array(law.taps),
        recursive,
        criterion.ticks,
        criterion.tolerance,
        verdicts,
    )
    return [bool(one) for one in verdicts]
