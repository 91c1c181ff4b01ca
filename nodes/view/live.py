"""State of a running launch for pages: bins, scene, log, and why there is no force."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

from messages.codec import Decoder, MessageRefusedError
from messages.topics import message_type, split
from messages.types import DeviceState, Event, Message, NodeStatus, Receipt
from nodes.base.node_kinds import load
from nodes.base.setup import AXIS_INDEX, Apply, least_delay
from nodes.driver.force_words import cause_of, explain
from nodes.launcher.run_end import RunEnd, end_of
from nodes.launcher.runs import RunInfo
from nodes.parameters.refusals import cut
from nodes.parameters.store import convert
from nodes.recording.summary import quantile
from nodes.view.feed import BINS_PER_SECOND, Feed
from nodes.view.page_words import event_text
from nodes.view.ringing import Ring, Ringing
from nodes.view.steady_delay import SteadyDelay

STATUS_PERIOD = 0.2  # time between status updates [s]
RECENT = 5.0  # time span of the response-time percentiles [s]
# Time without a status after which a node is shown as silent; it sends two per second [s].
SILENT_NODE = 1.5
LATELY = 10.0  # time span in which missed ticks count as a present problem [s]
HISTORY = 30.0  # time span of the past that a newly opened page shows [s]
KEPT = 60.0  # time span stored for slow pages [s]
LOGGED = 500  # log entries that a newly opened page gets


class Board:
    """Documents by name (only the newest counts) and the log; used by one thread."""

    def __init__(self) -> None:
        self._documents: dict[str, tuple[int, str]] = {}
        self._version = 0
        self._log: deque[str] = deque(maxlen=LOGGED)
        self.logged = 0  # entries of the log so far

    def put(self, kind: str, content: dict[str, Any]) -> None:
        """Replace a document; an unchanged one is not sent again."""
        text = msgspec.json.encode({"type": kind, **content}).decode()
        if kind not in self._documents or self._documents[kind][1] != text:
            self._version += 1
            self._documents[kind] = (self._version, text)

    def log(self, content: dict[str, Any]) -> None:
        """Append to the log."""
        self._log.append(msgspec.json.encode({"type": "log", **content}).decode())
        self.logged += 1

    def since(self, version: int, logged: int) -> tuple[list[str], int, int]:
        """Return new documents and log entries, and the new version and log count."""
        new = sorted(entry for entry in self._documents.values() if entry[0] > version)
        count = min(self.logged - logged, len(self._log))
        entries = list(self._log)[len(self._log) - count :] if count else []
        return [text for _, text in new] + entries, self._version, self.logged


def quantiles_us(responses: deque[float]) -> dict[str, float]:
    """Return p50, p99 and max of the response times [µs]."""
    ordered = sorted(responses)
    if not ordered:
        return {}
    return {
        name: quantile(ordered, part) * 1e6
        for name, part in (("p50", 0.5), ("p99", 0.99), ("max", 1.0))
    }


class Facts(NamedTuple):
    """Constant facts of a run."""

    # Name of the run, name and summary of its launch file.
    run: str
    scenario: str
    summary: str
    period: float  # sampling period T [s]
    # See nodes/base/setup.py.
    pace: str
    apply: Apply
    axes: list[str]  # axes that the scene computes
    driver: str  # name of the driver node
    # directory where the launcher writes why it ends; empty for a recording
    run_dir: str = ""
    # Limit of the force that the driver hands over, if the launch has one [N].
    peak: float | None = None

    def hello(self) -> dict[str, Any]:
        """Return the facts that a page gets first."""
        return {
            "run": self.run,
            "scenario": self.scenario,
            "summary": self.summary,
            "rate_hz": 1.0 / self.period,
            "pace": self.pace,
            "axes": self.axes,
            "kept_s": HISTORY,
            "peak_n": self.peak,
        }


def facts_of(run: RunInfo, driver: str) -> Facts:
    """Return the constant facts of a launch."""
    setup = next(iter(run.nodes.values()))
    summary = run.manifest.get("summary", "")
    axes: list[str] = list(setup.axes)
    peak = None
    if driver:
        parameters = convert(
            run.nodes[driver].parameters,
            load(run.nodes[driver].factory).Parameters,
            driver,
        )
        peak = parameters.safety.peak_force
    return Facts(
        run.run,
        run.scenario,
        summary,
        setup.period,
        setup.pace,
        setup.apply,
        axes,
        driver,
        setup.run_dir,
        peak,
    )


class LiveRun:
    """Collects the messages of a run for pages; used by one thread."""

    def __init__(
        self, facts: Facts, kept: float = KEPT, bins_per_second: float = BINS_PER_SECOND
    ) -> None:
        self._period = facts.period
        self._run_dir = facts.run_dir
        self._driver = facts.driver
        self._driver_status = f"/{facts.driver}/status"
        self.feed = Feed(
            facts.axes, facts.period, kept, min(bins_per_second, BINS_PER_SECOND)
        )
        self.board = Board()  # everything else
        # Measured delay of the loop, smoothed over 64 ticks [ticks].
        self.delay = least_delay(facts.apply)
        self.steady_delay = SteadyDelay()  # its median, for maps
        self.rests = False  # whether the map says that this loop cannot ring
        # Returns how A and B ring; None where nothing is compared.
        self.sings: Callable[[], dict[str, Ring | None] | None] | None = None
        # Whether the laws must be read again after a receipt; reset by the reader.
        self.changed = True
        # Whether the surface may differ from the launch's; reset by the reader.
        self.reshaped = True
        self._end = RunEnd()
        self.ended = ""  # why the run ended; empty while it runs
        self.refused = 0  # messages that do not follow the protocol
        self._decoders: dict[bytes, tuple[str, Decoder[Message]]] = {}
        self._responses: deque[float] = deque(
            maxlen=max(100, round(RECENT / facts.period))
        )
        self._heard: dict[str, tuple[NodeStatus, float]] = {}
        self._state_at = -1.0
        self._why = self._device = self._failed = ""
        self._missed: deque[tuple[float, int]] = deque()
        # One detector per axis: the force's magnitude would reverse twice as often.
        self._ringing = [Ringing(AXIS_INDEX[axis]) for axis in facts.axes]
        self._stop: dict[str, float] = {}
        self._status_at = -1.0
        self._rate: tuple[float, int] = (0.0, 0)
        self._rate_hz = 0.0

    def take(
        self, frames: tuple[bytes, bytes], now: float
    ) -> tuple[str, Message] | None:
        """Decode and store a message; return its topic and content, or None if refused."""
        known = self._decoders.get(frames[0])
        if known is None:
            # A page shows one chain, so topics are named without the namespace.
            name = split(frames[0].decode("utf-8", errors="replace"))[1]
            kind = message_type(name)
            if kind is None:
                self.refused += 1
                return None
            known = self._decoders[frames[0]] = (name, Decoder(kind))
        try:
            message = known[1].decode(frames[1])
        except MessageRefusedError:
            self.refused += 1
            return None
        self.keep(known[0], message, now)
        return known[0], message

    def rings(self) -> Ring | None:
        """Return the strongest ringing of all axes; None if there is none."""
        found = filter(None, (ringing.ring() for ringing in self._ringing))
        return max(found, key=lambda ring: ring.force, default=None)

    def keep(self, topic: str, message: Message, now: float) -> None:
        """Store a decoded message."""
        if isinstance(message, DeviceState):
            self._state_at = now
            if message.response > 0.0:
                self._responses.append(message.response)
            self.delay += (message.delay - self.delay) / 64.0
            time = message.seq * self._period
            for ringing in self._ringing:
                ringing.take(time, message.position, message.force, message.energy)
        elif isinstance(message, NodeStatus):
            self._heard[message.node] = (message, now)
            if topic == self._driver_status:
                # A failed driver may be restarted; only the launcher decides whether the run ends.
                self._failed = (
                    (message.reason or message.state)
                    if message.state == "failed"
                    else ""
                )
                if message.state == "finished":
                    self.end(message.reason or message.state)
            return
        elif isinstance(message, Receipt):
            self.changed = True
            self.board.log(
                {
                    "kind": "receipt",
                    "t": message.seq * self._period,
                    **_receipt_facts(message),
                }
            )
            return
        elif isinstance(message, Event):
            if message.kind in ("device_force", "device_force_back"):
                self._device = message.reason if message.kind == "device_force" else ""
            # The map depends on the delay.
            self.changed |= message.kind == "delay"
            self.reshaped |= message.kind == "surface"
            if message.kind in ("safety", "stopped"):
                self._why = cause_of(message)
                self._stop = {
                    "t": message.seq * self._period,
                    "span_s": message.data.get("span_s", 0.0),
                }
            told = {
                "node": message.node,
                "event": message.kind,
                "text": event_text(message),
                "data": message.data,
            }
            self.board.log({"kind": "event", "t": message.seq * self._period, **told})
            return
        self.feed.take(topic, message)

    def end(self, reason: str) -> None:
        """Mark the run as ended; the launcher's reason takes precedence over `reason`."""
        told = end_of(self._run_dir)
        # If the launch's directory is gone, only the driver's status says what failed.
        self._end = (
            told
            if told.reason
            else RunEnd(self._failed or reason, self._driver if self._failed else "")
        )
        self.ended = self._end.reason

    def _missed_lately(self, now: float, missed: int) -> int:
        """Count the ticks missed in the last LATELY seconds."""
        kept = self._missed
        if kept and missed < kept[-1][1]:
            # A restarted driver counts from zero.
            kept.clear()
        kept.append((now, missed))
        while now - kept[0][0] > LATELY:
            kept.popleft()
        return missed - kept[0][1]

    def tick(self, now: float) -> None:
        """File bins, and update the status when due."""
        if self._failed and not self.ended and end_of(self._run_dir).reason:
            self.end(self._failed)
        self.feed.file(bool(self.ended))
        if self.feed.state is not None:
            self.steady_delay.add(now, self.delay)
        if now - self._status_at >= STATUS_PERIOD or self.ended:
            self._status_at = now
            self.board.put("status", self.status(now))

    def status(self, now: float) -> dict[str, Any]:
        """Return the status document."""
        state, force = self.feed.state, self.feed.force
        before = self.feed.force_before
        if state is not None and before is not None and before.seq == state.force_seq:
            # The force that the law requested when the state's force was handed over.
            force = before
        silent = now - self._state_at
        nodes = {
            name: {
                "state": status.state,
                "silent_s": round(now - at, 1) if now - at > SILENT_NODE else 0.0,
            }
            for name, (status, at) in self._heard.items()
        }
        why = (
            self._why
            if state is not None and state.safety not in ("active", "ramp")
            else ""
        )
        gone = [name for name, found in nodes.items() if found["silent_s"]]
        if gone:
            why = f"{' and '.join(gone)} silent"
        ring = None if self.rests else self.rings()
        sings = self.sings() if self.sings is not None else None
        level, text = explain(
            state, self.feed.proxy, force, silent, why, str(ring or ""), self._device
        )
        if self.ended:
            level = "rest"
            text = f"The run has ended: {self.ended.rstrip('.')}."
            for name, found in nodes.items():
                # The named node caused the end; the others were stopped because of it.
                found |= {
                    "silent_s": 0.0,
                    "state": "failed" if name == self._end.node else "ended",
                }
        ticks = state.seq if state else 0
        missed = state.missed if state else 0
        began, count = self._rate
        if now - began >= 1.0:
            self._rate_hz = (
                (ticks - count) / (now - began) if began and ticks >= count else 0.0
            )
            self._rate = (now, ticks)
        return {
            "level": level,
            "words": text,
            "safety": state.safety if state else "",
            "stop": (
                (self._stop or None)
                if state is not None and state.safety == "stopped"
                else None
            ),
            "tick": ticks,
            "t": ticks * self._period,
            "rate_hz": 0.0 if self.ended else round(self._rate_hz, 1),
            "missed": missed,
            "missed_lately": self._missed_lately(now, missed),
            "overruns": state.overruns if state else 0,
            "delay_ticks": round(self.delay, 3),
            "response_us": quantiles_us(self._responses),
            "law": force.law if force else "",
            "revision": force.revision if force else 0,
            "nodes": nodes,
            "rings": _figures(ring),
            # The same of both laws, where they are compared.
            "sings": sings and {name: _figures(one) for name, one in sings.items()},
            "ended": self.ended,
        }


def _figures(ring: Ring | None) -> dict[str, float] | None:
    """Return frequency [Hz] and force [N] of ringing by name; None if there is none."""
    if ring is None:
        return None
    # Plain floats: B's are of an array.
    return {name: float(value) for name, value in ring._asdict().items()}


def _receipt_facts(receipt: Receipt) -> dict[str, Any]:
    """Return the facts of a receipt: what changed, and from which to which law."""
    before = _law(receipt.before)
    after = _law(receipt.after)
    law = after.get("law", "")
    switched = before.get("law") != after.get("law")
    changed = [
        f"{name} {_short(before.get(name))} → {_short(value)}"
        for name, value in after.items()
        if name not in ("law", "kind") and before.get(name) != value
    ]
    text = f"{law}: {', '.join(changed) or 'unchanged; another parameter was set'}"
    told = {
        "action": receipt.action,
        "ramp": receipt.ramp,
        "reason": receipt.reason,
        "revision": receipt.revision,
    }
    if switched:
        text = f"{before.get('law', '?')} → {after.get('law', '?')}"
    return {
        **told,
        "law": law,
        "after": after,
        "switched": switched,
        "text": text,
        "force_step_n": receipt.force_step,
    }


def _law(text: str) -> dict[str, Any]:
    try:
        found = msgspec.json.decode(text)
    except msgspec.DecodeError:
        return {}
    return found if isinstance(found, dict) else {}


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else cut(str(value), 39)
