"""Pages of a running launch: messages in, bins and documents out, requests to the nodes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from messages.errors import HapticError
from messages.transport.sockets import Subscription
from messages.types import Message
from nodes.base.setup import AXIS_INDEX
from nodes.client.launches import roles
from nodes.driver.pointer import awaited_pointer
from nodes.launcher.runs import RunInfo
from nodes.laws.law_fields import all_law_fields
from nodes.view.commands import Commander, CommandError
from nodes.view.comparison import Changed, Comparison
from nodes.view.live import LiveRun, facts_of
from nodes.view.map_drawer import MapDrawer
from nodes.view.page_words import in_page_words
from nodes.view.ringing import Ring
from nodes.view.run_page import DRAIN_PERIOD, Attention, RunPage
from nodes.view.server import Page, PageServer
from nodes.view.shared_hand import SharedHand
from nodes.view.shown_surface import ShownSurface

if TYPE_CHECKING:
    from nodes.view.foxglove import Bridge

AT_ONCE = 5000  # messages processed before pages get their turn
ASK_AGAIN = 0.2  # time until nodes that did not answer are asked again [s]
FINAL = 0.5  # time that pages have to receive the end of a run [s]


def _opened(path: Path, name: str, page: Page, over: bool) -> Page:
    from nodes.view.replay import opened

    # Pages of a launch need it only for recordings that are sent to them.
    return opened(path, name, page, over)


class RunPages:
    """Everything behind the pages of one run."""

    def __init__(
        self,
        run: RunInfo,
        inbox: Subscription,
        token: str = "",
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self._run = run
        self._inbox = inbox
        self._commander = Commander(run)
        facts = facts_of(run, self._commander.driver)
        self._period = facts.period
        self._axis = AXIS_INDEX[facts.axes[0]]
        self.live = LiveRun(facts)  # state of the run
        # Target of the simulated hand.
        self.hand = SharedHand(
            awaited_pointer(run.nodes[self._commander.driver], stopping)
        )
        # Serves the pages.
        self.server = PageServer(self._open_page, token, opened=_opened)
        self.seen_to_the_end = 0  # pages that were open when the run ended
        self._comparison = Comparison(run, self._commander.driver, self.live.board.put)
        self.live.sings = self._what_both_do
        # Called with topic and content of every message.
        self.listeners: list[Callable[[str, Message], None]] = [self._comparison.take]
        # A thread for requests, so that none blocks the pages.
        self._asking = ThreadPoolExecutor(1, "ask")
        self._attention = Attention()
        self._maps = MapDrawer(
            run.nodes[self._commander.driver].parameters,
            facts.period,
            self._inertia,
            self.live.board.put,
            lambda: self.server.draws_first or self._attention.answers,
        )
        self._is_exact = self._commander.is_virtual and all(
            one.kind != "world" for one in run.nodes.values()
        )
        self._laws: dict[str, Any] = {}
        self._bridge: Bridge | None = None
        self._shown = ShownSurface(run)
        self._jobs: set[asyncio.Task[None]] = set()
        self._busy: set[str] = set()
        feed = self.live.feed
        document = {
            "series": feed.names,
            "bin_s": feed.per_bin * facts.period,
            "replay": False,
            "hand": self.hand.there,
            "beyond": self._commander.beyond,
            "again": self._commander.beyond,
            "compares": self._comparison.there,
            "sings": self._sings(),
            "opens": True,
            "hides": True,
            "delays": self._commander.delays,
            "shape": self._shown.shape(stopping),
        }
        self.live.board.put(
            "hello", {**facts.hello(), **document, "fields": all_law_fields()}
        )

    def _what_both_do(self) -> dict[str, Ring | None] | None:
        """Return how A and B ring; None where nothing is compared."""
        if not self._comparison.law:
            return None
        return {"a": self.live.rings(), "b": self._comparison.rings}

    def _sings(self) -> bool:
        """Whether a law can be made to ring beside another one: against a plane, by a hand."""
        name = roles(self._run).get("environment", "")
        surface = (self._run.nodes[name].parameters if name else {}).get("surface")
        return (
            self.hand.there
            and self._commander.beyond
            and self._comparison.there
            and len(self._run.nodes[self._commander.driver].axes) == 1
            and isinstance(surface, Mapping)
            and surface.get("kind") == "plane"
        )

    def _open_page(self) -> RunPage:
        return RunPage(self.live, self.hand, self.command, self._attention)

    async def command(self, request: dict[str, Any]) -> Any:
        """Execute a page's request off the pages' thread; refusals are in its own terms."""
        try:
            return await self._command(request)
        except CommandError as error:
            error.remedies = in_page_words(error.remedies, self._commander.beyond)
            raise

    async def _command(self, request: dict[str, Any]) -> Any:
        if self.live.ended:
            raise CommandError(f"the run has ended: {self.live.ended}")
        if request.get("op") == "compare":
            return self._compare(
                request.get("law"), request.get("stiffness"), request.get("hardness")
            )
        # A stop request must not queue behind a node that does not answer.
        thread = None if request.get("op") == "stop" else self._asking
        result = await asyncio.get_running_loop().run_in_executor(
            thread, self._commander.do, request
        )
        if request.get("op") == "record":
            self.live.board.put("record", result)
        self.live.changed = True
        return result

    def _compare(
        self, law: Any, stiffness: Any = None, hardness: Any = None
    ) -> dict[str, Any]:
        """Choose the law simulated beside the launch; an empty name stops.

        B may have another `stiffness`, or another H(1) (`hardness`), than the launch's law [N/m].
        """
        laws = self._laws.get("laws", {})
        if not self._comparison.there:
            raise CommandError(
                "Only a launch with a virtual device, without moving bodies or shapes, can be"
                " compared."
            )
        if law != "" and (not isinstance(law, str) or law not in laws):
            raise CommandError(
                f"No law is named {str(law)[:100]!r}; available: {', '.join(laws)}"
            )
        try:
            self._comparison.choose(
                law, laws.get(law, {}), Changed(stiffness, hardness)
            )
        except (HapticError, msgspec.ValidationError) as error:
            raise CommandError(f"B: {error}") from error
        return {"law": law}

    def bridge(self, port: int) -> int:
        """Serve Foxglove and Lichtblick too; return the port."""
        from nodes.view.foxglove import Bridge

        def do(method: str, *words: Any) -> Any:
            # Called on the library's thread; the sockets belong to the asking thread.
            return self._asking.submit(getattr(self._commander, method), *words).result(
                timeout=30.0
            )

        self._bridge = Bridge(self._run, do, port)
        self.listeners.append(self._bridge.take)
        return self._bridge.port

    async def run(
        self, stopping: Callable[[], bool], between: Callable[[], None]
    ) -> None:
        """Process messages, laws and map until told to stop; the caller starts the server."""
        try:
            while not stopping():
                await self._drain()
                self._refresh()
                self._move_hand()
                if self._commander.records:
                    self._start("recorder", self._look_at_recorder)
                between()
                self._attention.was_read()
                await self._attention.pause(self.live.feed.state)
            await self._finish()
        finally:
            loop = asyncio.get_running_loop()
            ended = loop.run_in_executor(None, self._commander.end)
            await self.server.stop()
            await self._comparison.close()
            if self._bridge is not None:
                await loop.run_in_executor(None, self._bridge.close)
            for job in self._jobs:
                job.cancel()
            await asyncio.gather(*self._jobs, return_exceptions=True)
            await loop.run_in_executor(self._asking, self._commander.close)
            await ended
            self._asking.shutdown()
            self._maps.close()
            self.hand.close()

    def _move_hand(self) -> None:
        state = self.live.feed.state
        proxy = self.live.feed.proxy
        axis = self._axis
        if state is None or self.live.ended:
            return
        self.hand.step(state.target)
        if self._attention.viewers:
            self._comparison.step(time.monotonic(), self.live.delay)
        if self.server.pages:
            self._show_bodies()
            side = proxy.normal[axis] if proxy is not None else 0.0
            surface = (
                proxy.position[axis] - side * proxy.distance
                if proxy is not None and side
                else None
            )
            self.hand.tap(axis, surface, side)

    def _show_bodies(self) -> None:
        poses = self._shown.poses()
        if poses is not None:
            self.live.board.put("poses", poses)

    async def _drain(self) -> int:
        taken = 0
        while (frames := self._inbox.receive(0)) is not None:
            found = self.live.take(frames, time.monotonic())
            if found is not None:
                for listener in self.listeners:
                    listener(*found)
            taken += 1
            if taken % AT_ONCE == 0:
                await asyncio.sleep(0)
        self.live.tick(time.monotonic())
        return taken

    async def _finish(self) -> None:
        """Process messages in flight and wait until pages have received the end."""
        # A run that continues without its view keeps sending, hence the deadline.
        deadline = time.monotonic() + FINAL
        while await self._drain() and time.monotonic() < deadline:
            await asyncio.sleep(DRAIN_PERIOD)
        if not self.live.ended:
            self.live.end("the view was stopped")
        # The environment has ended, so these poses are final.
        self._show_bodies()
        self.live.tick(time.monotonic())
        self._attention.was_read()
        self.seen_to_the_end = self.server.pages
        if self.server.pages:
            await asyncio.sleep(FINAL)

    def _refresh(self) -> None:
        """Start due jobs that are not running: reading laws, drawing the map."""
        live = self.live
        if live.reshaped and not live.ended and self._shown.surface is not None:
            self._start("surface", self._read_surface)
        if live.ended or not self._commander.coupling:
            return
        if live.changed:
            self._start("laws", self._read_laws)
        delay = live.steady_delay.median(live.delay)
        is_seen = bool(self._attention.viewers)
        rests = is_seen and self._attention.rests
        self._maps.step(self._laws, delay, is_seen, rests)
        # A virtual device is exactly the declared one; a real loop may ring all the same.
        live.rests = self._is_exact and self._maps.says_stable(self._laws, delay)

    def _start(self, name: str, job: Callable[[], Any]) -> None:
        if name in self._busy:
            return
        if name == "laws":
            self.live.changed = False
        elif name == "surface":
            self.live.reshaped = False
        self._busy.add(name)

        async def work() -> None:
            try:
                await job()
            finally:
                self._busy.discard(name)

        task = asyncio.get_running_loop().create_task(work())
        self._jobs.add(task)
        task.add_done_callback(self._jobs.discard)

    async def _read_laws(self) -> None:
        def ask() -> dict[str, Any]:
            node = self._commander.coupling
            # Read the delay first: the plant is changed before it, so the plant is never older.
            delay = self._commander.device_delay()
            parameters = self._commander.ask(node, "param.dump")
            chosen = {
                name: parameters.get(name) for name in ("ramp", "plant", "stability")
            }
            named = list(parameters.get("laws", {}))
            return {
                "node": node,
                **self._commander.ask(node, "law.list"),
                "named": named,
                **chosen,
                "device_delay": delay,
            }

        try:
            self._laws = await asyncio.get_running_loop().run_in_executor(
                self._asking, ask
            )
            self._comparison.follow(self._laws["laws"])
            if self._laws["device_delay"] is not None:
                self._comparison.delayed(self._laws["device_delay"])
            self.live.board.put("laws", self._laws)
            if self._bridge is not None:
                await asyncio.get_running_loop().run_in_executor(
                    None, self._bridge.tell_parameters
                )
        except CommandError:
            # A restarting coupling or driver does not answer yet.
            await asyncio.sleep(ASK_AGAIN)
            self.live.changed = True

    async def _read_surface(self) -> None:
        """Draw the surface as it is now, which may not be that of the launch."""
        shown = self._shown
        run = asyncio.get_running_loop().run_in_executor
        try:
            parameters = await run(
                self._asking, self._commander.ask, shown.name, "param.dump"
            )
        except CommandError:
            # A restarting environment does not answer yet.
            await asyncio.sleep(ASK_AGAIN)
            self.live.reshaped = True
            return
        if parameters.get("surface") == shown.surface:
            return
        shape = await run(None, shown.replaced, parameters)
        self._comparison.touch(shown.name, shown.surface)
        if self._bridge is not None:
            self._bridge.replace(shown.name, parameters)
        if shape is not None:
            self.live.board.put("shape", {"shape": shape})

    async def _inertia(self) -> dict[str, Any] | None:
        """Return the masses that the device reports for its poses."""
        return await asyncio.get_running_loop().run_in_executor(
            self._asking, self._commander.inertia
        )

    async def _look_at_recorder(self) -> None:
        """Inform the pages when a recording ends by itself."""
        self.live.board.put(
            "record",
            await asyncio.get_running_loop().run_in_executor(
                self._asking, self._commander.recording
            ),
        )
        await asyncio.sleep(ASK_AGAIN)
