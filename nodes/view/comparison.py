"""A | B: the hand of a running launch on another law too, played beside it.

What plays it is registered for the launch's kind of driver (entry points ``haptic.beside``). It
runs in a process of its own off the loop's processors, so the loop does not notice. The hand's
targets are those that the driver told; the delay is the one measured. Whenever neither of the two
is in contact, B starts again from where A is: differences do not pile up.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from messages.errors import HapticError
from messages.types import DeviceState, Message
from nodes.base.setup import AXIS_INDEX
from nodes.base.workers import Workers
from nodes.launcher.runs import RunInfo
from nodes.parameters.registry import Registry

PLAYERS = Registry(
    "haptic.beside",
    "player",
    lambda _, found: "" if callable(found) else f"{found!r} cannot be called",
)
"""By kind of driver: position and force from the nodes, a law, the targets of the hand, its beginning and a delay."""

PERIOD = 0.05  # how often B is played on [s]
FREE = 0.4  # both free for so long, B starts again from where A is [s]
LONGEST = 30.0  # after so long it does so in any case [s]
SHOWN = 1.0  # how much of B each message holds: a page that is slow loses none [s]


class Comparison:
    """Plays B. The pages' thread uses it."""

    def __init__(
        self, run: RunInfo, driver: str, put: Callable[[str, dict[str, Any]], None]
    ) -> None:
        self._setups, self._driver = run.nodes, driver
        self._put = put
        setup = run.nodes.get(driver)
        self._period = setup.period if setup else 1.0
        self._axis = AXIS_INDEX[setup.axes[0]] if setup else 0
        self._kind = setup.kind if setup and len(setup.axes) == 1 else ""
        # Whether this launch can be compared: a virtual device on one axis, at a surface and not at
        # a body.
        self.there = self._kind in PLAYERS.names() and all(
            one.kind != "world" for one in run.nodes.values()
        )
        self._late = 1.0 if setup and setup.apply == "next_tick" else 0.0
        self._pool: Workers | None = None
        self._described: Mapping[str, Any] = {}
        self._restart()
        self._before: DeviceState | None = None
        self._job: asyncio.Task[None] | None = None
        self._played_at = 0.0
        self.law = ""  # name of B; empty for none
        # how much later the device answers by now than the launch file says [ticks]
        self.later = 0.0

    def choose(self, law: str, described: Mapping[str, Any]) -> None:
        """Play another law beside the launch, or none."""
        self.law, self._described = law, described
        self._restart()
        self._put("beside", {"law": law})

    def follow(self, laws: Mapping[str, Any]) -> None:
        """Take B's parameters as they are by now: changed, it begins anew."""
        described = laws.get(self.law, self._described)
        if self.law and described != self._described:
            self.choose(self.law, described)

    def delayed(self, ticks: float) -> None:
        """Take how late the device answers by now: with another delay B begins anew."""
        later = ticks - float(self._setups[self._driver].parameters["device"].get("delay", 0.0))
        if later != self.later:
            self.later = later
            self._restart()

    def _restart(self) -> None:
        self._targets: list[float] = []
        self._begin = (0.0, 0.0)
        self._from = 0
        self._free = 0
        self._b_is_free = False

    def take(self, topic: str, message: Message) -> None:
        """Take what the driver tells of its hand."""
        del topic
        if not self.law or not isinstance(message, DeviceState):
            return
        before, self._before = self._before, message
        if before is None or message.seq <= before.seq:
            return
        axis, ticks = self._axis, message.seq - before.seq
        # Without contact for both: nothing is in anybody's history.
        self._free = self._free + ticks if message.force[axis] == 0.0 == before.force[axis] else 0
        longest = len(self._targets) * self._period > LONGEST
        if not self._targets or longest or (self._free * self._period > FREE and self._b_is_free):
            self._restart()
            x, old = message.position[axis], before.position[axis]
            self._begin, self._from = (x, (x - old) / (ticks * self._period)), message.seq
            self._b_is_free = False
        else:
            # A state that was lost on the way: the hand went straight.
            last, now = self._targets[-1], message.target[axis]
            self._targets += [last + (now - last) * k / ticks for k in range(1, ticks)]
        self._targets.append(message.target[axis])

    def step(self, now: float, delay: float) -> None:
        """Play on when it is due and nothing is under way."""
        busy = self._job is not None and not self._job.done()
        if self.law and self._targets and not busy and now - self._played_at > PERIOD:
            self._played_at = now
            self._job = asyncio.get_running_loop().create_task(
                self._play_on(round(max(0.0, delay - self._late) + self.later, 2))
            )

    async def _play_on(self, late: float) -> None:
        law, begun = self.law, self._from
        work = partial(
            _play, self._kind, self._setups, self._described, list(self._targets), self._begin, late
        )
        self._pool = self._pool or Workers(1)
        try:
            position, force = await asyncio.get_running_loop().run_in_executor(self._pool, work)
        except (HapticError, ValueError) as error:
            if law == self.law:
                self.law = ""
                self._put("beside", {"law": "", "why": str(error)})
            return
        if law != self.law or begun != self._from:
            return
        shown = round(SHOWN / self._period)
        self._b_is_free = not force[-round(FREE / self._period) :].any()
        first = max(0, len(force) - shown)
        document = {
            "law": law,
            "t": (begun + first) * self._period,
            "period": self._period,
            "late": late,
            "position": [round(float(x), 8) for x in position[first:]],
            "force": [round(float(f), 5) for f in force[first:]],
        }
        self._put("beside", document)

    async def close(self) -> None:
        """End the process that plays."""
        self.law = ""
        if self._job is not None:
            self._job.cancel()
        if self._pool is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._pool.end)


def _play(kind: str, *words: Any) -> Any:
    """Import what plays where it plays: the view itself stays small."""
    return PLAYERS.load(kind)(*words)
