"""Pages of a recording: the page of a running launch, with a time slider.

The recording is played once through the code that serves a running launch, and the output is stored
with its time. Each page then has its own position in time.
"""

from __future__ import annotations

import asyncio
import math
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT
from messages.types import DeviceState, Event, Receipt
from nodes.client.moved_device import moved_delay
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.laws.law_fields import all_law_fields
from nodes.parameters.store import ParameterError, convert
from nodes.recording.facts import (
    axes_of,
    group,
    parameters_of,
    period_of,
    publishers_of,
    refuse_foreign_files,
)
from nodes.recording.foreign_channels import described
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError
from nodes.view.commands import CommandError
from nodes.view.feed import Feed
from nodes.view.live import HISTORY, Facts, LiveRun
from nodes.view.server import SEND_PERIOD, Page, PageServer
from nodes.view.stability_map import drawn_map

if TYPE_CHECKING:
    from nodes.view.drawn_bodies import RecordedBodies, RecordedShapes

# Time span of the plots after the present position, so that a later moment can be picked [s].
AHEAD = 30.0
OVER = 20_000  # limit of bins of another recording drawn over this one
WHOLE = 4000  # limit of bins that show all of a recording at once
SCENES = 60.0  # scene snapshots stored per second of a long run
SHORT = 6000.0  # scene snapshots of a short one, in which each tick may have its own
# Limits for a whole recording; in a longer one each covers more ticks.
BIN_LIMIT, SCENE_LIMIT = 400_000.0, 40_000.0
FOREVER = 1e9  # longer than any recording [s]
STATUSES = 0.1  # time between two stored statuses of the same kind [s]
IDLE = 0.05  # time between checks whether to stop [s]


def _curve(low: Any, high: Any, row: int, two: bool) -> list[float | None]:
    """Return a series as numbers; with `two`, the smallest and largest of each bin."""
    values = np.stack([low[row], high[row]], axis=1).ravel() if two else low[row]
    return [
        None if math.isnan(one) else one
        for one in np.round(values.astype(float), 8).tolist()
    ]


class Timeline:
    """Items for pages, each with the time since tick 0 from which it is valid [s]."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.items: list[Any] = []
        self.kind: Any = None  # kind of the last item, for whoever adds them

    def add(self, at: float, item: Any) -> None:
        """Append an item."""
        self.times.append(max(at, self.times[-1]) if self.times else at)
        self.items.append(item)

    def until(self, at: float) -> int:
        """Count the items valid at a time."""
        return bisect_right(self.times, at)


def _facts(recording: Recording) -> Facts:
    manifest = recording.manifest
    period = period_of(recording)
    axes = axes_of(recording)
    published = publishers_of(recording)
    # Older recordings do not list publishers; assume the usual name.
    driver = next(
        (name for name, topics in published.items() if DEVICE_STATE in topics), "driver"
    )
    summary = manifest.get("summary", "")
    run = manifest.get("run", recording.path.stem)
    return Facts(
        run,
        manifest.get("scenario", ""),
        summary,
        period,
        manifest.get("pace", ""),
        "on_arrival",  # what is replayed has its delays in it: none is added
        axes,
        driver,
    )


class ReplayPages:
    """Serves a recording, optionally with another one drawn `over` it.

    Both start at their first ticks; RecordError without ticks. `progress` gets the share read so
    far: an hour of recording takes minutes.
    """

    def __init__(
        self,
        path: Path,
        over: Path | None = None,
        progress: Callable[[float], None] = lambda _: None,
        most_bins: float = BIN_LIMIT,
        notice: str = "",
    ) -> None:
        recording = Recording(path)
        recording.require_ticks()
        self._facts = _facts(recording)
        span = recording.topics[DEVICE_STATE]
        ticks = span.last_seq - span.first_seq + 1
        # Time of the first tick since tick 0, and from the first to the last tick [s].
        self.begin = span.first_seq * self._facts.period
        self.duration = (ticks - 1) * self._facts.period
        self._scene_period = max(
            min(1.0 / SCENES, self.duration / SHORT), self.duration / SCENE_LIMIT
        )
        per_second = most_bins / max(self.duration, 1.0)
        self.live = LiveRun(self._facts, self.duration + 10.0, per_second)
        self.scenes, self.statuses, self.log, self.laws = (
            Timeline(),
            Timeline(),
            Timeline(),
            Timeline(),
        )
        self._bodies: RecordedBodies | RecordedShapes | None = None
        self._driver: dict[str, Any] = {}
        self._plant: Any = None
        self._shape: dict[str, Any] = {}
        self._delay = 0.0
        notices = [notice] if notice else []
        notices += self._read(recording, progress)
        if not recording.complete:
            notices.append(
                f"The recording is cut: it ends at {self.begin + self.duration:.1f} s."
            )
        if recording.foreign:
            notices.append(f"Not read: {described(recording.foreign)}.")
        feed = self.live.feed
        document = {
            "series": feed.names,
            "bin_s": feed.per_bin * self._facts.period,
            "replay": True,
            "hand": False,
            "has_hand": any(
                scene[16:19] != (0.0, 0.0, 0.0) for scene, _ in self.scenes.items
            ),
            "begin_s": self.begin,
            "end_s": self.begin + self.duration,
            "period_s": self._facts.period,
            "opens": True,
            "notice": " ".join(notices),
            "shape": self._shape,
            "fields": all_law_fields(),
        }
        self.hello = msgspec.json.encode(
            {"type": "hello", **self._facts.hello(), **document}
        ).decode()
        self.over = "" if over is None else self.read_over(over)
        # serves the pages
        self.server = PageServer(lambda: ReplayPage(self), opened=opened)
        self._mapping = ThreadPoolExecutor(1, "map")
        self._maps: dict[str, Future[dict[str, Any]]] = {}

    def _read(
        self, recording: Recording, progress: Callable[[float], None]
    ) -> list[str]:
        """Play the recording once; return notices for the page."""
        notices = self._read_parameters(recording)
        live = self.live
        period = self._facts.period
        known = [
            topic
            for topic in recording.topics
            if topic in (DEVICE_STATE, PROXY, FORCE, RECEIPT) or topic.count("/") == 2
        ]
        delays = states = 0.0
        unknown_delay = False
        replaced = math.inf
        next_scene = next_report = self.begin
        log_time = 0.0
        pending = False  # whether the scene of the newest state is still to be stored
        for topic, log_time, message in recording.entries(known):
            if pending and isinstance(message, DeviceState):
                # Proxy and force of that tick have come by now.
                pending = self._store_moment(log_time)
            live.keep(topic, message, log_time)
            if isinstance(message, Receipt):
                self._read_receipt(message)
            elif isinstance(message, Event) and message.kind == "delay":
                self._read_delay(message)
                unknown_delay |= "delay_ticks" not in message.data
            elif isinstance(message, Event) and message.kind == "surface":
                replaced = min(replaced, message.seq * period)
            while live.board.logged > len(self.log.items):
                texts, _, _ = live.board.since(1 << 62, len(self.log.items))
                self.log.add(message.seq * period, texts[0])
            if not isinstance(message, DeviceState):
                continue
            if self._bodies is not None:
                self._bodies.follow(message)
            at = message.seq * period
            delays = delays + message.delay
            states = states + 1.0
            if at >= next_scene:
                next_scene = at + self._scene_period - 0.5 * period
                pending = True
            if at >= next_report:
                next_report = at + 0.2
                progress((at - self.begin) / max(self.duration, period))
        if pending:
            self._store_moment(log_time)
        live.feed.file(all_of_them=True)
        self._delay = delays / states if states else 0.0
        if self._shape and replaced < math.inf:
            notices.append(
                f"The surface was replaced at {replaced:.1f} s: drawn is the one of the launch."
            )
        if unknown_delay:
            notices.append(
                "The device's delay was changed, but this older recording has no value for it: the"
                " map shows the initial delay."
            )
        return notices

    def _store_moment(self, now: float) -> bool:
        """Store scene and status of the newest state; return False: none is pending any more."""
        live = self.live
        poses = None
        if self._bodies is not None:
            poses = self._bodies.poses().astype(np.float32)
        scene = live.feed.now()
        self.scenes.add(scene[0], (scene, poses))
        live.feed.file()
        state, proxy = live.feed.state, live.feed.proxy
        kind = (state and state.safety, proxy and proxy.contact)
        # The words change with what is felt; their numbers, some times a second.
        told = self.statuses
        if kind != told.kind or scene[0] >= told.times[-1] + STATUSES:
            told.kind = kind
            live.board.put("status", live.status(now))
            texts, _, _ = live.board.since(0, live.board.logged)
            told.add(scene[0], texts[0])
        return False

    def read_over(self, path: Path, name: str = "") -> str:
        """Return another recording as a document, to be drawn over this one.

        Both begin at their first ticks. RecordError without ticks, or without this one's axes.
        """
        recording = Recording(path)
        recording.require_ticks()
        facts = _facts(recording)
        axes = self._facts.axes
        if missing := sorted(set(axes) - set(facts.axes)):
            raise RecordError(
                f"{path}: has no axis {missing[0]}, so it cannot be drawn over"
                f" {self._facts.run}"
            )
        span = recording.topics[DEVICE_STATE]
        seconds = (span.last_seq - span.first_seq + 1) * facts.period
        feed = Feed(axes, facts.period, seconds + 1.0, OVER / max(seconds, 1.0))
        for message in recording.messages(DEVICE_STATE):
            feed.take(DEVICE_STATE, message)
            feed.file()
        feed.file(all_of_them=True)
        begin = span.first_seq * facts.period
        times, low, high = feed.stored()
        two = not np.array_equal(low, high, equal_nan=True)
        shown = np.repeat(times, 2) if two else times
        document = {
            "times": np.round(self.begin + shown - begin, 6).tolist(),
            **{
                kind: {
                    axis: _curve(low, high, feed.names.index(f"{kind}.{axis}"), two)
                    for axis in axes
                }
                for kind in ("position", "force")
            },
        }
        return msgspec.json.encode(
            {"type": "over", "name": name or path.stem, **document}
        ).decode()

    def _read_parameters(self, recording: Recording) -> list[str]:
        """Read the initial laws and the scene; return why a scene is not drawn."""
        notices: list[str] = []
        for name, parameters in parameters_of(recording).items():
            if "law" in parameters:
                self._read_coupling(name, parameters)
            elif "device" in parameters:
                self._driver = parameters
            elif ("surface" in parameters or "scene" in parameters) and len(
                self._facts.axes
            ) > 1:
                notices += self._read_shape(name, parameters, recording)
        if self.laws.items and isinstance(
            delay := group(self._driver, "device").get("delay"), int | float
        ):
            self.laws.items[0]["device_delay"] = delay
        return notices

    def _read_shape(
        self, name: str, parameters: dict[str, Any], recording: Recording
    ) -> list[str]:
        from nodes.view.drawn_bodies import (
            RecordedBodies,
            RecordedShapes,
            met_ticks,
            scene_changes,
        )
        from nodes.view.shape import bodies_of, moves, shape_of

        # Without the shape's package or file, the flat views remain.
        try:
            refuse_foreign_files(recording, parameters, name)
            if "scene" in parameters:
                self._bodies = RecordedBodies(
                    parameters,
                    self._facts.period,
                    name,
                    met_ticks(recording),
                    scene_changes(recording, name),
                )
                self._shape = bodies_of(self._bodies.world)
            else:
                self._shape = shape_of(parameters)
                if moves(self._shape):
                    self._bodies = RecordedShapes(
                        parameters, self._facts.period, met_ticks(recording)
                    )
        except (ParameterError, RecordError, OSError) as error:
            return [f"The scene is not drawn: {error}"]
        return []

    def _read_coupling(self, name: str, parameters: dict[str, Any]) -> None:
        try:
            coupling: CouplingParameters = convert(parameters, CouplingParameters, name)
            book = LawBook(name, self._facts.period)
            laws = {
                law: book.description(coupling, law) for law in book.names(coupling)
            }
        except ParameterError:
            # The law is not installed here; its receipts still show its parameters.
            return
        self._plant = parameters.get("plant")
        document = {
            "node": name,
            "active": coupling.law,
            "laws": laws,
            "named": list(coupling.laws),
            "ramp": coupling.ramp,
        }
        self.laws.add(self.begin, document)

    def _read_receipt(self, receipt: Receipt) -> None:
        try:
            after = msgspec.json.decode(receipt.after)
            law = after.pop("law")
        except (
            msgspec.DecodeError,
            RecursionError,
            KeyError,
            AttributeError,
            TypeError,
        ):
            return
        if not isinstance(law, str):
            return
        before: dict[str, Any] = (
            self.laws.items[-1]
            if self.laws.items
            else {"node": "", "laws": {}, "ramp": 0}
        )
        laws = {**before["laws"], law: after} if "kind" in after else before["laws"]
        self.laws.add(
            receipt.seq * self._facts.period, {**before, "active": law, "laws": laws}
        )

    def _read_delay(self, event: Event) -> None:
        """Apply a change of the virtual device's delay, which changes the stability map."""
        if (ticks := event.data.get("delay_ticks")) is not None and self.laws.items:
            self.laws.add(
                event.seq * self._facts.period,
                {**self.laws.items[-1], "device_delay": ticks},
            )

    async def run(self, stopping: Callable[[], bool]) -> None:
        """Serve until told to stop; the caller starts the server."""
        self.draw_first_map()
        try:
            while not stopping():
                await asyncio.sleep(IDLE)
        finally:
            await self.server.stop()
            self.close()

    @property
    def whole(self) -> bytes:
        """All of the recording in few bins, for its slider."""
        return self.live.feed.overview(WHOLE)

    def map_of(self, laws: dict[str, Any], tell: Callable[[str], None]) -> None:
        """Start drawing the map of the active law; pass it to `tell` when ready."""
        active = laws["active"]
        described = laws["laws"].get(active)
        if described is None:
            return
        later = laws.get("device_delay")

        async def draw() -> None:
            found = await asyncio.wrap_future(self._drawn(described, later))
            document = {"law": active, "device_delay": later, **found}
            tell(msgspec.json.encode({"type": "map", **document}).decode())

        self._job = asyncio.get_running_loop().create_task(draw())

    def _drawn(
        self, described: Mapping[str, Any], later: float | None
    ) -> Future[dict[str, Any]]:
        """Return the map of a law with a delay of the device; each is drawn once."""
        key = repr((described, later))
        if key not in self._maps:
            inputs = self.map_inputs(described, later)
            self._maps[key] = self._mapping.submit(drawn_map, *inputs)
        return self._maps[key]

    def draw_first_map(self) -> None:
        """Draw the map of the beginning before a page asks for it."""
        for laws in self.laws.items[:1]:
            if (described := laws["laws"].get(laws["active"])) is not None:
                self._drawn(described, laws.get("device_delay"))

    def map_inputs(
        self, described: Mapping[str, Any], later: float | None
    ) -> tuple[Mapping[str, Any], float, Any, Mapping[str, Any], float]:
        """Return the arguments of `drawn_map` for a law and a delay of the device [ticks]."""
        plant, driver = self._with(later)
        return described, self._facts.period, plant, driver, self._delay

    def close(self) -> None:
        """End the thread that draws maps."""
        self._mapping.shutdown(cancel_futures=True)

    def _with(self, later: float | None) -> tuple[Any, dict[str, Any]]:
        """Return plant and driver parameters with another delay of the device [ticks]."""
        plant, driver = self._plant, self._driver
        device = group(driver, "device")
        if later is None or not device:
            return plant, driver
        before = float(device.get("delay", 0.0))
        if plant is not None:
            declared = float(plant.get("device_delay", 0.0))
            plant = {**plant, "device_delay": moved_delay(declared, later, before)}
        return plant, {**driver, "device": {**device, "delay": later}}


class ReplayPage:
    """An open page of a recording, with its own position in time."""

    def __init__(self, pages: ReplayPages) -> None:
        self._pages = pages
        self._end = pages.begin + pages.duration
        self._at = pages.begin
        self._since = time.monotonic()
        self._speed = 1.0
        self._playing = True
        self._first = self._cursor = -1
        self._void = True
        self._shown = math.nan
        self._outbox: list[str | bytes] = [
            pages.hello,
            pages.whole,
            *([pages.over] if pages.over else []),
        ]
        self._late: deque[str] = deque()  # from other threads
        self._go(pages.begin)

    def _go(self, at: float) -> None:
        """Jump to a time; bins already sent stay valid, so that dragging the slider is cheap."""
        self._at, self._since = (
            min(max(at, self._pages.begin), self._end),
            time.monotonic(),
        )
        feed = self._pages.live.feed
        first = feed.until(self._at - HISTORY)
        if not self._first <= feed.until(self._at) <= self._cursor:
            self._first = self._cursor = first
            self._void = True
        self._logged = 0
        self._status = self._law = 0
        self._outbox.append('{"type":"reset"}')

    def _time(self) -> float:
        now = time.monotonic()
        if self._playing:
            self._at = min(self._end, self._at + (now - self._since) * self._speed)
            # At its end it stands, also for a page that seeks from there.
            self._playing = self._at < self._end
        self._since = now
        return self._at

    def news(self) -> list[str | bytes]:
        """Return everything not sent yet."""
        pages = self._pages
        at = self._time()
        found = self._outbox
        self._outbox = []
        while self._late:
            found.append(self._late.popleft())
        logged = pages.log.until(at)
        found += pages.log.items[self._logged : logged]
        self._logged = logged
        status = pages.statuses.until(at)
        law = pages.laws.until(at)
        if status != self._status and status:
            found.append(pages.statuses.items[status - 1])
        if law != self._law and law:
            laws = pages.laws.items[law - 1]
            found.append(msgspec.json.encode({"type": "laws", **laws}).decode())
            pages.map_of(laws, lambda text: self._outbox.append(text))
        self._status, self._law = status, law
        end = pages.live.feed.until(at + AHEAD)
        scene = pages.scenes.until(at)
        if (at != self._shown or end > self._cursor or self._void) and scene:
            shown, poses = pages.scenes.items[scene - 1]
            now = (at, *shown[1:])
            if poses is not None:
                placed = np.round(poses.astype(float), 6).tolist()
                found.append(
                    msgspec.json.encode({"type": "poses", "poses": placed}).decode()
                )
            end = max(end, self._cursor)
            found.append(pages.live.feed.frame(self._cursor, end, self._void, now))
            # The capacity of the page's ring buffer.
            self._first = max(self._first, pages.live.feed.until(at - HISTORY))
            self._cursor = end
            self._void = False
            self._shown = at
        return found

    async def due(self) -> None:
        """Wait until its time has gone on."""
        await asyncio.sleep(SEND_PERIOD)

    def hand(self, target: list[float] | None) -> str:
        """Refuse the hand: this is a recording."""
        return "" if target is None else "hand: this is a recording"

    async def ask(self, request: dict[str, Any]) -> Any:
        """Play, pause, seek or change the speed."""
        op = request.get("op")
        self._time()
        if op == "play":
            self._playing = True
            if self._at >= self._end:
                self._go(self._pages.begin)
        elif op == "pause":
            self._playing = False
        elif (
            op == "seek"
            and isinstance(request.get("t"), int | float)
            and abs(request["t"]) < FOREVER
        ):
            self._go(float(request["t"]))
        elif (
            op == "speed"
            and isinstance(request.get("factor"), int | float)
            and 0.0 < request["factor"] <= 100.0
        ):
            self._speed = float(request["factor"])
        else:
            raise CommandError(
                f"{op!r} is refused: a recording can only play, pause, seek and change speed"
            )
        return {"t": self._at, "playing": self._playing}

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def draw_over(self, path: Path, name: str) -> None:
        """Draw another recording over this one, on this page; called from any thread."""
        self._late.append(self._pages.read_over(path, name))


class OpenedPage(ReplayPage):
    """A page of a recording that was sent to it; its threads end with it."""

    def close(self) -> None:
        """End the thread that draws maps."""
        self._pages.close()


def opened(path: Path, name: str, page: Page, over: bool) -> Page:
    """Return the page of a recording that was sent; with `over`, `page` with its curves.

    Raises
    ------
    CommandError
        If it is no recording of a loop, or `page` shows none that it could be drawn over.
    """
    try:
        if not over:
            return OpenedPage(ReplayPages(path, notice=f"{name}; reload to go back."))
        if not isinstance(page, ReplayPage):
            raise CommandError("open: only a recording is drawn over another one")
        page.draw_over(path, Path(name).stem)
    except RecordError as error:
        raise CommandError(str(error).replace(str(path), name)) from error
    return page
