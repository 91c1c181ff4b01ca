"""A running launch as pages see it: bins and scene, receipts and events, and a status that says why there is no force."""

from __future__ import annotations

from collections import deque
from typing import Any

import msgspec

from messages.codec import Decoder, MessageRefusedError
from messages.topics import DEVICE_STATE, message_type
from messages.types import DeviceState, Event, Message, NodeStatus, Receipt
from nodes.launcher.runs import RunInfo
from nodes.view.board import Board
from nodes.view.feed import Feed
from nodes.view.words import explain

STATUS_PERIOD = 0.2
"""How often the status is told [s]."""

RECENT = 5.0
"""How far back percentiles go [s]."""

SILENT_NODE = 1.5
"""A node that has said nothing for so long is told as silent: it sends its status twice a second [s]."""

HISTORY = 30.0
"""How much a page that opens sees of what was before [s]."""


def quantiles_us(responses: deque[float]) -> dict[str, float]:
    """Percentiles of response times.

    Parameters
    ----------
    responses : deque of float
        Response times [s].

    Returns
    -------
    dict
        ``p50``, ``p99`` and ``max`` [µs]; empty without any.
    """
    ordered = sorted(responses)
    if not ordered:
        return {}
    last = len(ordered) - 1
    return {name: ordered[round(last * part)] * 1e6 for name, part in (("p50", 0.5), ("p99", 0.99), ("max", 1.0))}


class LiveRun:
    """Takes a run's messages and keeps what pages are told. One thread uses it.

    Parameters
    ----------
    run : RunInfo
        The run.

    Attributes
    ----------
    feed : Feed
        The bins.
    board : Board
        Everything else.
    delay : float
        Measured delay of the loop, a mean over a few ticks [ticks].
    changed : bool
        Whether a receipt or an event asks for the laws to be read again; who does that sets it back.
    ended : str
        Why the run is over; empty while it goes on.
    """

    def __init__(self, run: RunInfo) -> None:
        self.run = run
        first = next(iter(run.nodes.values()))
        self.period = first.period
        self.axes = list(first.axes)
        self.pace = first.pace
        self.feed = Feed(self.axes, self.period)
        self.board = Board()
        self.delay = 1.0 if first.apply == "next_tick" else 0.0
        self.changed = True
        self.ended = ""
        self.refused = 0
        self._decoders: dict[bytes, tuple[str, Decoder[Message]]] = {}
        self._responses: deque[float] = deque(maxlen=max(100, round(RECENT / self.period)))
        self._heard: dict[str, tuple[NodeStatus, float]] = {}
        self._state_at = -1.0
        self._told = ""
        self._status_at = -1.0
        self._rate: tuple[float, int] = (0.0, 0)
        self._rate_hz = 0.0

    def hello(self) -> dict[str, Any]:
        """Tell a page what run this is.

        Returns
        -------
        dict
            Name, scenario, rate, axes and series.
        """
        return {
            "run": self.run.run,
            "scenario": self.run.scenario,
            "summary": self.run.manifest.get("summary", ""),
            "rate_hz": 1.0 / self.period,
            "pace": self.pace,
            "axes": self.axes,
            "series": self.feed.names,
            "bin_s": self.feed.per_bin * self.period,
            "kept_s": HISTORY,
            "replay": False,
        }

    def take(self, frames: tuple[bytes, bytes], now: float) -> tuple[str, Message] | None:
        """Take one message.

        Parameters
        ----------
        frames : tuple of bytes
            Topic and payload.
        now : float
            Time on the monotonic clock [s].

        Returns
        -------
        tuple of str and Message, or None
            Topic and message; None for one that is not of the protocol.
        """
        known = self._decoders.get(frames[0])
        if known is None:
            name = frames[0].decode("utf-8", errors="replace")
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

    def keep(self, topic: str, message: Message, now: float) -> None:
        """Keep what pages need of a message.

        Parameters
        ----------
        topic : str
            Its topic.
        message : Message
            The message.
        now : float
            Time on the monotonic clock [s].
        """
        if isinstance(message, DeviceState):
            self._state_at = now
            if message.response > 0.0:
                self._responses.append(message.response)
            self.delay += (message.delay - self.delay) / 64.0
        elif isinstance(message, NodeStatus):
            self._heard[message.node] = (message, now)
            if topic == f"/{self._driver}/status" and message.state in ("finished", "failed"):
                self.ended = message.reason or message.state
            return
        elif isinstance(message, Receipt):
            self.changed = True
            self.board.log({"kind": "receipt", "t": message.seq * self.period, **_told_receipt(message)})
            return
        elif isinstance(message, Event):
            if message.kind == "safety":
                self._told = message.reason.partition(": ")[2] or message.reason
            self.board.log(
                {
                    "kind": "event",
                    "t": message.seq * self.period,
                    "node": message.node,
                    "event": message.kind,
                    "text": message.reason,
                }
            )
            return
        self.feed.take(topic, message)

    @property
    def _driver(self) -> str:
        return next((name for name, setup in self.run.nodes.items() if DEVICE_STATE in _publishes(setup.factory)), "")

    def tick(self, now: float) -> None:
        """File bins and tell the status when it is time.

        Parameters
        ----------
        now : float
            Time on the monotonic clock [s].
        """
        self.feed.file(bool(self.ended))
        if now - self._status_at >= STATUS_PERIOD or self.ended:
            self._status_at = now
            self.board.put("status", self._status(now))

    def _status(self, now: float) -> dict[str, Any]:
        state, force = self.feed.state, self.feed.force
        silent = now - self._state_at
        nodes = {
            name: {"state": status.state, "silent_s": round(now - at, 1) if now - at > SILENT_NODE else 0.0}
            for name, (status, at) in self._heard.items()
        }
        told = self._told if state is not None and state.safety not in ("active", "ramp") else ""
        gone = [name for name, found in nodes.items() if found["silent_s"]]
        if gone:
            told = f"{' and '.join(gone)} silent"
        level, text = explain(state, self.feed.proxy, force, silent, told)
        if self.ended:
            level, text = "rest", f"The run has ended: {self.ended}."
        ticks = state.seq if state else 0
        before, count = self._rate
        if now - before >= 1.0:
            self._rate_hz = (ticks - count) / (now - before) if before and ticks >= count else 0.0
            self._rate = (now, ticks)
        return {
            "level": level,
            "words": text,
            "safety": state.safety if state else "",
            "tick": ticks,
            "t": ticks * self.period,
            "rate_hz": round(self._rate_hz, 1),
            "missed": state.missed if state else 0,
            "overruns": state.overruns if state else 0,
            "delay_ticks": round(self.delay, 3),
            "response_us": quantiles_us(self._responses),
            "law": force.law if force else "",
            "revision": force.revision if force else 0,
            "nodes": nodes,
            "ended": self.ended,
        }


def _publishes(factory: str) -> tuple[str, ...]:
    from nodes.base.kinds import load

    return load(factory).publishes


def _told_receipt(receipt: Receipt) -> dict[str, Any]:
    """Tell a receipt by what changed."""
    before, after = _law(receipt.before), _law(receipt.after)
    changed = [
        f"{name} {_short(before.get(name))} → {_short(value)}"
        for name, value in after.items()
        if name not in ("law", "kind") and before.get("law") == after.get("law") and before.get(name) != value
    ]
    names = f"{before.get('law', '?')} → {after.get('law', '?')}"
    return {
        "action": receipt.action,
        "law": after.get("law", ""),
        "after": after,
        "switched": before.get("law") != after.get("law"),
        "text": names
        if before.get("law") != after.get("law")
        else f"{after.get('law', '')}: {', '.join(changed) or 'as it was'}",
        "force_step_n": receipt.force_step,
        "ramp": receipt.ramp,
        "reason": receipt.reason,
        "revision": receipt.revision,
    }


def _law(text: str) -> dict[str, Any]:
    try:
        found = msgspec.json.decode(text)
    except msgspec.DecodeError:
        return {}
    return found if isinstance(found, dict) else {}


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    text = str(value)
    return text if len(text) < 40 else f"{text[:37]}…"
