"""A | B comparison: simulate the running launch's hand with another law, B.

The player is registered for the launch's kind of driver (entry points ``haptic.beside``). It runs
in a process of its own off the loop's processors, so it does not disturb the loop. It uses the hand
targets that the driver reports and the measured delay. Whenever A and B are both out of contact, B
restarts from A's state, so differences do not accumulate. With several axes it starts there only,
because a proxy that begins inside a shape does not feel it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np

from messages.errors import HapticError
from messages.types import ZERO, DeviceState, Message, Vector
from nodes.base.setup import AXIS_INDEX, least_delay
from nodes.base.workers import Workers
from nodes.launcher.runs import RunInfo
from nodes.laws.parse import law_to_dict, parse_law
from nodes.parameters.registry import Registry
from nodes.view.law_edges import with_hardness
from nodes.view.ringing import Ring, ring_of

PLAYERS = Registry(
    "haptic.beside",
    "player",
    lambda _, found: "" if callable(found) else f"{found!r} cannot be called",
)
"""Player per kind of driver.

It computes position and force from nodes, law, hand targets, initial state and delay.
"""

PLAY_PERIOD = 0.05  # time between two continuations of B [s]
FREE = 0.4  # time without contact of both after which B restarts from A's state [s]
RESTART_AFTER = 30.0  # time after which it restarts in any case [s]
# duration of B that each message contains, so that slow pages miss nothing [s]
SHOWN = 1.0


class Changed(NamedTuple):
    """How B differs from the launch's law of that name."""

    stiffness: float | None = None  # its own stiffness [N/m]
    hardness: float | None = None  # its H(1), by scaling it as a whole [N/m]

    def law(self, described: Mapping[str, Any], period: float) -> Mapping[str, Any]:
        """Return the description of B.

        Raises
        ------
        HapticError
            If there is no such law.
        """
        if self.hardness is not None:
            return with_hardness(described, self.hardness, period)
        if self.stiffness is None:
            return described
        return law_to_dict(parse_law({**described, "stiffness": self.stiffness}, "B"))


class _Chosen(NamedTuple):
    """The law that is played as B."""

    described: Mapping[str, Any]  # as it is played
    changed: Changed  # how it differs from the launch's


class Comparison:
    """Simulates law B; used by the pages' thread."""

    def __init__(
        self, run: RunInfo, driver: str, put: Callable[[str, dict[str, Any]], None]
    ) -> None:
        self._setups = run.nodes
        self._driver = driver
        self._put = put
        setup = run.nodes.get(driver)
        self._period = setup.period if setup else 1.0
        self._axes = [AXIS_INDEX[axis] for axis in setup.axes] if setup else [0]
        self._kind = setup.kind if setup else ""
        # Whether this launch can be compared: a virtual device without moving bodies or shapes.
        self.there = self._kind in PLAYERS.names() and not any(
            one.kind in ("world", "mujoco") or _moves(one.parameters.get("surface"))
            for one in run.nodes.values()
        )
        self._pool: Workers | None = None
        self._chosen = _Chosen({}, Changed())
        self.rings: Ring | None = None  # how B rings
        self._restart()
        self._before: DeviceState | None = None
        self._job: asyncio.Task[None] | None = None
        self._played_at = 0.0
        self.law = ""  # name of B; empty for none
        # Present delay of the device minus that of the launch file [ticks].
        self.later = 0.0

    def choose(
        self, law: str, described: Mapping[str, Any], changed: Changed | None = None
    ) -> None:
        """Start simulating law `law`, perhaps `changed`; an empty name stops."""
        changed = changed or Changed()
        if law:
            described = changed.law(described, self._period)
        self.law, self._chosen = law, _Chosen(described, changed)
        self.rings = None
        self._restart()
        self._put("beside", {"law": law, "at": self._at})

    @property
    def _late(self) -> float:
        """Delay that the launch has by itself [ticks]."""
        setup = self._setups.get(self._driver)
        return least_delay(setup.apply) if setup else 0.0

    @property
    def _at(self) -> float | None:
        """Stiffness or H(1) of B where it is not the launch's [N/m]."""
        changed = self._chosen.changed
        return changed.stiffness if changed.hardness is None else changed.hardness

    def follow(self, laws: Mapping[str, Any]) -> None:
        """Update B's parameters; if they changed, restart B."""
        if self.law not in laws:
            return
        described = self._chosen.changed.law(laws[self.law], self._period)
        if described != self._chosen.described:
            self.choose(self.law, laws[self.law], self._chosen.changed)

    def delayed(self, ticks: float) -> None:
        """Set the device's present delay [ticks]; if it changed, restart B."""
        later = ticks - float(
            self._setups[self._driver].parameters["device"].get("delay", 0.0)
        )
        if later != self.later:
            self.later = later
            self._restart()

    def touch(self, name: str, surface: Any) -> None:
        """Set the present surface of environment `name`, and restart B."""
        setup = self._setups[name]
        parameters = {**setup.parameters, "surface": surface}
        changed = msgspec.structs.replace(setup, parameters=parameters)
        self._setups = {**self._setups, name: changed}
        self._restart()

    def _restart(self) -> None:
        self._targets: list[Vector] = []
        self._begin = (ZERO, ZERO)
        self._from = 0
        self._free = 0
        self._b_is_free = False

    def take(self, topic: str, message: Message) -> None:
        """Add the hand target of a state."""
        del topic
        if not self.law or not isinstance(message, DeviceState):
            return
        before = self._before
        self._before = message
        if before is None or message.seq <= before.seq:
            return
        ticks = message.seq - before.seq
        # Without contact, the histories of both laws are empty.
        touches = any(message.force[axis] or before.force[axis] for axis in self._axes)
        self._free = 0 if touches else self._free + ticks
        longest = len(self._targets) * self._period > RESTART_AFTER
        is_free = self._free * self._period > FREE
        if not self._targets or longest or (is_free and self._b_is_free):
            free = self._free
            self._restart()
            if len(self._axes) > 1 and not is_free:
                # Begun inside a shape, B would not feel it.
                self._free = free
                return
            span = ticks * self._period
            speed = [
                (x - old) / span
                for x, old in zip(message.position, before.position, strict=True)
            ]
            self._begin = message.position, (speed[0], speed[1], speed[2])
            self._from = message.seq
        else:
            # Interpolate targets of lost states linearly.
            last = self._targets[-1]
            for k in range(1, ticks):
                x, y, z = (
                    a + (b - a) * k / ticks
                    for a, b in zip(last, message.target, strict=True)
                )
                self._targets.append((x, y, z))
        self._targets.append(message.target)

    def step(self, now: float, delay: float) -> None:
        """Continue the simulation when due and idle."""
        busy = self._job is not None and not self._job.done()
        if (
            self.law
            and self._targets
            and not busy
            and now - self._played_at > PLAY_PERIOD
        ):
            self._played_at = now
            late = round(max(0.0, delay - self._late) + self.later, 2)
            self._job = asyncio.get_running_loop().create_task(
                self._play_on(self.law, self._from, late)
            )

    async def _play_on(self, law: str, begun: int, late: float) -> None:
        if law != self.law or begun != self._from or not self._targets:
            return  # another law, or none, was chosen before this task began
        targets: list[Any] = list(self._targets)
        begin: tuple[Any, Any] = self._begin
        if len(self._axes) == 1:
            (axis,) = self._axes
            targets = [target[axis] for target in targets]
            begin = begin[0][axis], begin[1][axis]
        device = self._setups[self._driver].parameters["device"]
        work = partial(
            _play,
            self._kind,
            self._period,
            late + self._late + float(device.get("delay", 0.0)),
            self._setups,
            self._chosen.described,
            targets,
            begin,
            late,
        )
        self._pool = self._pool or Workers(1)
        try:
            position, force, rings = await asyncio.get_running_loop().run_in_executor(
                self._pool, work
            )
        except (HapticError, ValueError) as error:
            if law == self.law and begun == self._from:
                self.law = ""
                self._put("beside", {"law": "", "why": str(error)})
            return
        if law != self.law or begun != self._from:
            return
        self.rings = rings
        shown = round(SHOWN / self._period)
        self._b_is_free = not force[-round(FREE / self._period) :].any()
        first = max(0, len(force) - shown)
        document = {
            "law": law,
            "at": self._at,
            "t": (begun + first) * self._period,
            "period": self._period,
            "late": late,
            "position": np.round(position[first:], 8).tolist(),
            "force": np.round(force[first:], 5).tolist(),
        }
        self._put("beside", document)

    async def close(self) -> None:
        """Stop the simulation process."""
        self.law = ""
        if self._job is not None:
            self._job.cancel()
        if self._pool is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._pool.end)


def _moves(surface: Any) -> bool:
    """Return whether a surface's parameters have a shape that moves."""
    if not isinstance(surface, Mapping):
        return False
    return any("motion" in one for one in [surface, *surface.get("shapes", [])])


def _play(
    kind: str, period: float, delay: float, *words: Any
) -> tuple[Any, Any, Ring | None]:
    """Return position, force and ringing of B; the player is imported in the worker only."""
    position, force = PLAYERS.load(kind)(*words)
    last = round(SHOWN / period)
    rings = (
        ring_of(x[-last:], f[-last:], period, delay)
        for x, f in zip(np.atleast_2d(position.T), np.atleast_2d(force.T), strict=True)
    )
    return position, force, next(filter(None, rings), None)
