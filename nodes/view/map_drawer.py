"""Map and edges of a running launch, computed on a thread when something changed.

First the plane of the active law and the edges of all laws (0.3 s), not while a page waits for its
first picture or an answer; the limits for moving worlds (0.4 s) follow point by point while the
page rests.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Final, NamedTuple

import msgspec

from messages.errors import HapticError
from nodes.view.law_edges import edges_of_laws, rests_of_laws
from nodes.view.stability_map import map_in_steps, plant_of, with_inertia

MAP_PERIOD = 0.25  # shortest time between two maps [s]
# Between maps that differ in the measured delay only it doubles up to this, because the delay may
# tremble for ever [s].
DELAY_PERIOD = 10.0
# Changes of the delay below this do not redraw the map [ticks], and as a part of the delay.
STEADY, STEADY_SHARE = 0.02, 0.05
# Time between two looks whether pages still wait [s].
LOOK = 0.02
_NO_MORE: Final[dict[str, Any]] = {}  # after the last step of a map


class _Inputs(NamedTuple):
    """All that a map depends on."""

    active: str  # name of the law
    laws: Mapping[str, Mapping[str, Any]]  # descriptions of all laws by name
    plant: Any  # declared plant; None if the launch declares none
    own: float | None  # delay of a virtual device [ticks]
    delay: float  # delay of the loop without it [ticks]

    def differs_in_delay_only(self, other: _Inputs | None) -> bool:
        """Whether another map shows the same but for the measured delay."""
        return other is not None and self[:4] == other[:4]

    def is_of(self, other: _Inputs | None) -> bool:
        """Whether another map shows the same, but for an unsteady delay."""
        if other is None or not self.differs_in_delay_only(other):
            return False
        return _is_near(self.delay, other.delay)


def _is_near(delay: float, other: float) -> bool:
    """Whether a delay differs from another no more than an unsteady one does [ticks]."""
    return abs(delay - other) <= STEADY + STEADY_SHARE * other


class MapDrawer:
    """Draws the map of a launch and the edges of its laws; used by the pages' thread.

    Parameters
    ----------
    driver : mapping
        Parameters of the driver.
    period : float
        Sampling period [s].
    inertia : coroutine function
        Masses that the device reports for its poses, or None.
    put : callable
        Publishes a document by name.
    waits : callable
        Returns whether pages wait for something: what is heavy waits for them.
    """

    def __init__(
        self,
        driver: Mapping[str, Any],
        period: float,
        inertia: Callable[[], Awaitable[Mapping[str, Any] | None]],
        put: Callable[[str, dict[str, Any]], None],
        waits: Callable[[], bool],
    ) -> None:
        self._driver, self._period = driver, period
        self._inertia, self._put, self._waits = inertia, put, waits
        self._thread = ThreadPoolExecutor(1, "map")
        self._drawn: _Inputs | None = None  # what the present map shows
        self._map: dict[str, Any] = {}
        # The rest of its computation: the limits for moving worlds; None once they are in it.
        self._steps: Iterator[dict[str, Any] | None] | None = None
        self._rests = False  # whether the page rests
        self._begun_at = 0.0
        self._patience = MAP_PERIOD  # until the next map of another delay [s]
        self._edges: dict[str, float | None] = {}  # by description and device
        self._edges_delay = math.nan  # delay of the loop for which they are [ticks]
        self._job: asyncio.Task[None] | None = None

    def says_stable(self, laws: Mapping[str, Any], delay: float) -> bool:
        """Whether the map of the present laws says that the loop is stable."""
        wanted = _inputs(laws, delay)
        return (
            wanted is not None
            and wanted.is_of(self._drawn)
            and bool(self._map.get("stable"))
        )

    def step(
        self, laws: Mapping[str, Any], delay: float, is_seen: bool, rests: bool
    ) -> None:
        """Start what is due; after the first map only while a page `is_seen`.

        The limits for moving worlds are computed while the page `rests`.
        """
        self._rests = rests
        wanted = _inputs(laws, delay)
        now = time.monotonic()
        if wanted is None or (self._job is not None and not self._job.done()):
            return
        if self._waits():
            return
        if self._drawn is not None and not is_seen:
            return
        if not wanted.is_of(self._drawn):
            later = wanted.differs_in_delay_only(self._drawn)
            pause = self._patience if later else MAP_PERIOD
            if now - self._begun_at < pause:
                return
            self._begun_at = now
            self._patience = min(2.0 * pause, DELAY_PERIOD) if later else MAP_PERIOD
            job = self._draw(wanted)
        elif rests and self._steps is not None:
            job = self._add_moving(wanted, self._steps)
        else:
            return
        self._job = asyncio.get_running_loop().create_task(job)

    async def _draw(self, wanted: _Inputs) -> None:
        self._drawn = wanted
        self._steps = None
        self._map = {}
        seen = await self._inertia()
        driver = self._driver_with(wanted.own)
        edges = await self._on_thread(self._edges_of, wanted, driver, seen)
        self._put("edges", {"device_delay": wanted.own, **edges})
        described = wanted.laws[wanted.active]
        self._steps = map_in_steps(
            described, self._period, wanted.plant, driver, wanted.delay, seen
        )
        self._map = await self._on_thread(next, self._steps)
        self._show(wanted)

    async def _add_moving(
        self, wanted: _Inputs, steps: Iterator[dict[str, Any] | None]
    ) -> None:
        """Compute point by point; what is left when the page no longer rests stays for later."""
        while self._rests:
            found = await self._on_thread(next, steps, _NO_MORE)
            if found is None:
                continue
            self._steps = None
            if found is not _NO_MORE:
                self._map = found
                self._show(wanted)
            return

    def _show(self, wanted: _Inputs) -> None:
        self._put(
            "map", {"law": wanted.active, "device_delay": wanted.own, **self._map}
        )

    def _driver_with(self, own: float | None) -> Mapping[str, Any]:
        """Return the driver's parameters with the device's present delay."""
        if own is None:
            return self._driver
        return {**self._driver, "device": {**self._driver["device"], "delay": own}}

    async def _on_thread(
        self, work: Callable[..., Any], *words: Any, **more: Any
    ) -> Any:
        while self._waits():
            await asyncio.sleep(LOOK)
        job = partial(work, *words, **more)
        return await asyncio.get_running_loop().run_in_executor(self._thread, job)

    def _edges_of(
        self, wanted: _Inputs, driver: Mapping[str, Any], seen: Mapping[str, Any] | None
    ) -> dict[str, Any]:
        """Return edge and H(1) of each law; those that did not change are kept."""
        rest = rests_of_laws(wanted.laws, self._period)
        try:
            plant = with_inertia(plant_of(wanted.plant, driver), seen)
        except (HapticError, ValueError, msgspec.ValidationError):
            plant = None
        if plant is None:
            return {"edges": {}, "rest": rest}
        before = self._edges
        self._edges = {}
        # What the map does not show of a delay that trembles moves no edge either.
        if not _is_near(wanted.delay, self._edges_delay):
            self._edges_delay = wanted.delay
        devices = plant.over_workspace(self._period, self._edges_delay)
        edges = {}
        for name, described in wanted.laws.items():
            # The nominal stiffness is what the edge is sought in.
            free = {key: one for key, one in described.items() if key != "stiffness"}
            key = repr((free, devices))
            if key not in before:
                before |= {key: edges_of_laws({name: described}, devices)[name]}
            self._edges[key] = edges[name] = before[key]
        return {"edges": edges, "rest": rest}

    def close(self) -> None:
        """Drop what was not begun."""
        if self._job is not None:
            self._job.cancel()
        self._thread.shutdown(cancel_futures=True)


def _inputs(laws: Mapping[str, Any], delay: float) -> _Inputs | None:
    """Return what the map of these laws depends on; None before the laws are known."""
    active = laws.get("active", "")
    described = laws.get("laws", {})
    if active not in described:
        return None
    return _Inputs(
        active, described, laws.get("plant"), laws.get("device_delay"), delay
    )
