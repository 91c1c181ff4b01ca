"""What a page waits for is computed before what it does not wait for."""

from __future__ import annotations

import asyncio
import time
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.asyncio.client import connect

from nodes.launcher import launch_file
from nodes.launcher.runs import RunInfo
from nodes.view import map_drawer
from nodes.view.law_edges import edges_of_laws
from nodes.view.map_drawer import DELAY_PERIOD, MapDrawer
from nodes.view.run_page import RESTED, Attention
from nodes.view.run_pages import RunPages
from nodes.view.server import SEND_PERIOD, PageServer
from nodes.view.stability_map import ANY_DELAYS, ANY_NEAR, map_in_steps
from sim.play.hops import setup_of
from tests.support.coroutines import complete
from tests.support.idle_page import IdlePage

T = 0.002
PD = {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}
PLANT = {"mass": 0.1, "damping": 1.0}


class Drawn:
    """A drawer, and all that it published."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.put: list[str] = []
        self.maps: list[dict[str, Any]] = []
        self.points = 0  # steps of the maps after their planes

        async def inertia() -> None:
            return None

        def counted(*inputs: Any) -> Any:
            steps = map_in_steps(*inputs)
            yield next(steps)
            for step in steps:
                self.points += 1
                yield step

        monkeypatch.setattr(map_drawer, "map_in_steps", counted)
        monkeypatch.setattr(map_drawer, "MAP_PERIOD", 0.0)
        self.waits = False
        self.drawer = MapDrawer({}, T, inertia, self.publish, lambda: self.waits)

    def publish(self, kind: str, content: dict[str, Any]) -> None:
        """Note a document."""
        self.put.append(kind)
        if kind == "map":
            self.maps.append(content)

    def step(self, rests: bool, delay: float = 1.0, **law: Any) -> None:
        """Step with a changed law or delay [ticks], a page being open."""
        laws = {"active": "pd", "laws": {"pd": PD | law}, "plant": PLANT}
        self.drawer.step(laws, delay, is_seen=True, rests=rests)

    async def job(self) -> None:
        """Wait until what was started is done."""
        if self.drawer._job is not None:  # nothing else tells its end
            await self.drawer._job


def test_limits_for_moving_worlds_wait_until_the_page_rests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They came at once, 0.4 s of the processor on which the page drew and a law switched."""
    drawn = Drawn(monkeypatch)

    async def play() -> None:
        for stiffness in (1000.0, 900.0):
            for _ in range(3):
                drawn.step(rests=False, stiffness=stiffness)
                await drawn.job()
        assert drawn.put == ["edges", "map"] * 2
        assert drawn.points == 0

        drawn.step(rests=True, stiffness=900.0)
        while drawn.points < 2:
            await asyncio.sleep(1e-3)
        # The page is used again: the present point is the last one, and none is lost.
        drawn.step(rests=False, stiffness=900.0)
        await drawn.job()
        begun = drawn.points
        assert begun < ANY_NEAR + ANY_DELAYS
        drawn.step(rests=True, stiffness=900.0)
        await drawn.job()
        drawn.step(rests=True, stiffness=900.0)
        await drawn.job()

    complete(play())
    drawn.drawer.close()
    assert ["any_world" in one for one in drawn.maps] == [False, False, True]
    # One step per point, and one with the map.
    assert drawn.points == ANY_NEAR + ANY_DELAYS + 1


def test_a_trembling_delay_draws_a_map_seldom_and_a_law_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = Drawn(monkeypatch)

    monkeypatch.setattr(map_drawer, "MAP_PERIOD", DELAY_PERIOD / 4.0)

    async def step(periods: float, delay: float, stiffness: float) -> int:
        """Step so many of the shortest periods after the last map began."""
        after = periods * map_drawer.MAP_PERIOD
        drawn.drawer._begun_at = time.monotonic() - after
        drawn.step(rests=False, delay=delay, stiffness=stiffness)
        await drawn.job()
        return len(drawn.maps)

    async def play() -> None:
        assert await step(1.1, 1.0, 1000.0) == 1
        # The next delay counts soon, as after the start; then at twice the pause, up to a limit.
        waits = ((0.5, 1), (1.1, 2), (1.5, 2), (2.1, 3), (3.5, 3), (4.1, 4), (4.1, 5))
        for k, (periods, maps) in enumerate(waits):
            assert await step(periods, 1.2 + 0.2 * k, 1000.0) == maps
        for periods, maps in ((0.5, 5), (1.1, 6)):
            assert await step(periods, 2.4, 900.0) == maps

    complete(play())
    drawn.drawer.close()


def test_nothing_is_computed_while_a_page_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A switch of the law took 0.3 to 1.5 s beside maps and edges, 0.1 s without."""
    drawn = Drawn(monkeypatch)
    drawn.waits = True

    async def play() -> None:
        drawn.step(rests=False)
        assert drawn.drawer._job is None
        drawn.waits = False
        drawn.step(rests=False)
        # Another request comes before its first piece.
        drawn.waits = True
        for _ in range(3):
            await asyncio.sleep(map_drawer.LOOK)
        assert drawn.put == []
        drawn.waits = False
        await drawn.job()
        assert drawn.put == ["edges", "map"]

    complete(play())
    drawn.drawer.close()


def test_edges_are_kept_while_a_delay_trembles(monkeypatch: pytest.MonkeyPatch) -> None:
    """All laws' edges were sought anew with each map, at a delay that no map shows."""
    drawn = Drawn(monkeypatch)
    sought: list[str] = []

    def counted(laws: dict[str, Any], devices: Any) -> Any:
        sought.extend(laws)
        return edges_of_laws(laws, devices)

    monkeypatch.setattr(map_drawer, "edges_of_laws", counted)

    async def play() -> None:
        # One twentieth and 0.02 ticks more are the same delay; a law's own K moves no edge.
        for delay, stiffness in ((1.0, 900.0), (1.0699, 800.0), (1.0701, 700.0)):
            drawn.step(rests=False, delay=delay, stiffness=stiffness)
            await drawn.job()

    complete(play())
    drawn.drawer.close()
    assert sought == ["pd", "pd"]
    assert drawn.put == ["edges", "map"] * 3


def test_a_page_rests_once_it_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [50.0]
    monkeypatch.setattr("nodes.view.run_page.time.monotonic", lambda: now[0])
    attention = Attention()
    assert attention.rests
    attention.note()
    now[0] += RESTED
    assert not attention.rests
    now[0] += 1e-6
    assert attention.rests


class OnePicture(IdlePage):
    """A page whose first frame comes when it is allowed to."""

    def __init__(self) -> None:
        self.allowed = False

    def news(self) -> list[str | bytes]:
        """Return a document, or a frame."""
        return [b"frame"] if self.allowed else ["hello"]


def test_a_first_picture_is_sent_before_heavy_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("nodes.view.server.PICTURE_FIRST", 3600.0)
    page = OnePicture()
    server = PageServer(lambda: page)

    async def receive(kind: type) -> None:
        url = server.url.replace("http:", "ws:") + "live"
        async with connect(url) as socket:
            while not isinstance(await socket.recv(), kind):
                pass
            # It still has to be drawn, with the processor that a map would take.
            assert server.draws_first
            await socket.send('{"op": "drawn"}')
            # The answer to a request behind it.
            await socket.send('{"op": "seen", "id": 1}')
            while '"answer"' not in str(await socket.recv()):
                pass

    async def play() -> None:
        assert not server.draws_first
        await server.start()
        assert server.draws_first
        page.allowed = True
        await receive(bytes)
        assert not server.draws_first
        # Another page is coming; its scripts and styles are no page of their own.
        for name, awaited in (("style.css", False), ("", True)):
            with await asyncio.to_thread(urlopen, server.url + name):
                assert server.draws_first is awaited
        # Nobody is waited for without end.
        monkeypatch.setattr("nodes.view.server.PICTURE_FIRST", 0.0)
        with await asyncio.to_thread(urlopen, server.url):
            assert not server.draws_first
        await server.stop()

    complete(play())


class NoMessages:
    """A subscription to a run that sends nothing."""

    def receive(self, timeout_ms: int) -> None:
        """Return None."""


def test_pages_start_no_map_before_the_first_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("nodes.view.server.PICTURE_FIRST", 3600.0)
    launch = launch_file.read("floor_drop", {})
    nodes = {name: setup_of(launch, name) for name in launch.nodes}
    run = RunInfo(run="r", scenario="s", launcher=0, nodes=nodes)
    page = OnePicture()

    async def play() -> None:
        pages = RunPages(run, NoMessages())  # type: ignore[arg-type]
        pages._laws = {"active": "pd", "laws": {"pd": PD}, "plant": PLANT}
        pages.live.changed = pages.live.reshaped = False
        stepped: list[tuple[bool, bool]] = []

        def step(laws: Any, delay: float, is_seen: bool, rests: bool) -> None:
            del laws, delay
            stepped.append((is_seen, rests))

        waits = pages._maps._waits
        await pages.server.start()
        pages._refresh()
        assert waits()
        assert pages._maps._job is None
        pages._maps.step = step  # type: ignore[method-assign]
        pages.server._open_page = lambda: page
        page.allowed = True
        async with connect(pages.server.url.replace("http:", "ws:") + "live") as socket:
            while not isinstance(await socket.recv(), bytes):
                pass
            assert waits()
            await socket.send('{"op": "drawn"}')
            while pages.server.draws_first:
                await asyncio.sleep(SEND_PERIOD)
            assert not waits()
            pages._refresh()
        assert stepped == [(False, False)]
        # A page that somebody sees, and that asks for nothing any more.
        pages._attention.viewers.add(1)
        pages._refresh()
        pages._attention.note()
        pages._refresh()
        assert stepped[1:] == [(True, True), (True, False)]
        # A request has the processor for itself, and what the page shows of its answer.
        with pages._attention.request():
            assert waits()
        assert waits()
        monkeypatch.setattr("nodes.view.run_page.SHOWN", 0.0)
        assert not waits()
        await pages.run(lambda: True, lambda: None)

    complete(play())
