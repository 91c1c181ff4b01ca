"""A recording as one table: a row per tick with state, proxy and force."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.types import DeviceState, Force, Message, Proxy
from nodes.recording.reader import Recording

if TYPE_CHECKING:
    import numpy as np

__all__ = ["COLUMNS", "VECTORS", "Row", "read", "rows"]

_GONE = (math.nan, math.nan, math.nan)

Row = tuple[DeviceState, DeviceState | None, Proxy | None, Force | None]

COLUMNS: dict[str, tuple[str, str, Callable[[Row], Any]]] = {
    "time": ("s", "time after the first tick", lambda r: r[0].stamp),
    "seq": ("", "number of the tick", lambda r: r[0].seq),
    "stamp": (
        "s",
        "time on the clock of the run: the host's monotonic clock, or seq·T in lockstep",
        lambda r: r[0].stamp,
    ),
    "position": ("m", "position of the device", lambda r: r[0].position),
    "force": (
        "N",
        "force handed to the device at this tick, after all limits",
        lambda r: r[1].force if r[1] else _GONE,
    ),
    "mean_force": (
        "N",
        "mean of the forces on the device during this tick",
        lambda r: r[1].mean_force if r[1] else _GONE,
    ),
    "changed_at": (
        "ticks",
        "part of this tick after which its first new force was handed over; 1 where none was",
        lambda r: r[1].changed_at if r[1] else math.nan,
    ),
    "force_seq": (
        "",
        "tick that the force answers",
        lambda r: r[1].force_seq if r[1] else -1,
    ),
    "force_asked": (
        "N",
        "force that the law asked for at this tick",
        lambda r: r[3].force if r[3] else _GONE,
    ),
    "proxy": (
        "m",
        "proxy: on the surface in contact, else at the device",
        lambda r: r[2].proxy if r[2] else _GONE,
    ),
    "normal": (
        "",
        "outward normal of the surface; zero without one",
        lambda r: r[2].normal if r[2] else _GONE,
    ),
    "distance": (
        "m",
        "signed distance to the surface, negative inside",
        lambda r: r[2].distance if r[2] else math.nan,
    ),
    "contact": (
        "",
        "whether the surface is touched, as far as that was recorded",
        lambda r: bool(r[2] and r[2].contact),
    ),
    "law": ("", "law that computed the force", lambda r: r[3].law if r[3] else ""),
    "revision": (
        "",
        "changes of law or parameters so far",
        lambda r: r[3].revision if r[3] else -1,
    ),
    "response": (
        "s",
        "time until the force was there; 0 when it came too late",
        lambda r: r[1].response if r[1] else math.nan,
    ),
    "age": (
        "ticks",
        "age of the force that was used",
        lambda r: r[1].age if r[1] else -1,
    ),
    "delay": (
        "ticks",
        "measured delay from sample to force",
        lambda r: r[1].delay if r[1] else math.nan,
    ),
    "lateness": (
        "s",
        "how long after its deadline the tick was sampled",
        lambda r: r[0].lateness,
    ),
    "missed": (
        "",
        "ticks so far that were not answered in time",
        lambda r: r[0].missed,
    ),
    "overruns": ("", "ticks so far that the driver left out", lambda r: r[0].overruns),
    "energy": (
        "J",
        "energy given out by the virtual side so far",
        lambda r: r[0].energy,
    ),
    "guard": (
        "J",
        "account of the passivity guard: owed (+), in store (−)",
        lambda r: r[0].guard,
    ),
    "target": (
        "m",
        "where a simulated hand pulls the device to; zero without one",
        lambda r: r[0].target,
    ),
    "safety": ("", "what the driver does with forces", lambda r: r[0].safety),
}
"""Columns of the table: unit, meaning, and the function that gets the value from a row.

An answer that was not recorded is NaN, an empty text, or −1 for a count.
"""

VECTORS = (
    "position",
    "force",
    "mean_force",
    "force_asked",
    "proxy",
    "normal",
    "target",
)
"""Columns of three numbers: x, y and z."""

_WINDOW = 4096  # ticks that wait for their answers; more than the driver's history


def rows(recording: Recording) -> Iterator[Row]:
    """Yield the ticks of a recording.

    Parameters
    ----------
    recording : Recording
        A recording with ``/device/state``.

    Yields
    ------
    tuple
        State of the tick; the next tick's state, which reports the outcome of this one (None if
        not consecutive); proxy and force that answer the tick (None if not recorded).

    Raises
    ------
    RecordError
        If no state was recorded, or a message does not fit its type.
    """
    recording.require_ticks()
    topics = [
        topic for topic in (DEVICE_STATE, PROXY, FORCE) if topic in recording.topics
    ]
    yield from joined(entry.message for entry in recording.entries(topics))


def joined(messages: Iterable[Message]) -> Iterator[Row]:
    """Yield the ticks of messages.

    Parameters
    ----------
    messages : iterable of Message
        States, proxies and forces, in the order of their receipt.

    Yields
    ------
    tuple
        As `rows`.
    """
    waiting: list[DeviceState] = []
    proxies: dict[int, Proxy] = {}
    forces: dict[int, Force] = {}

    def take(state: DeviceState, following: DeviceState | None) -> Row:
        after = (
            following
            if following is not None and following.seq == state.seq + 1
            else None
        )
        return state, after, proxies.pop(state.seq, None), forces.pop(state.seq, None)

    for message in messages:
        if isinstance(message, DeviceState):
            if waiting and message.seq <= waiting[-1].seq:
                # A restarted driver counts from zero; nothing will answer the old ticks.
                yield from map(take, waiting, [*waiting[1:], None])
                waiting.clear()
                proxies.clear()
                forces.clear()
            waiting.append(message)
            if len(waiting) > _WINDOW:
                yield take(waiting[0], waiting[1])
                del waiting[0]
        elif isinstance(message, Proxy):
            proxies[message.seq] = message
        elif isinstance(message, Force):
            forces[message.seq] = message
        for held in (proxies, forces):
            if len(held) > 2 * _WINDOW:
                # Answers to ticks that were not recorded.
                del held[next(iter(held))]
    yield from map(take, waiting, [*waiting[1:], None])


def read(path: str | Path) -> dict[str, np.ndarray[Any, Any]]:
    """Read a recording as arrays, one row per tick.

    For example ``run = read("recordings/floor_drop-….mcap")``, then ``plt.plot(run["time"],
    run["position"][:, 2])``.

    Parameters
    ----------
    path : str or Path
        An MCAP recording with ``/device/state``.

    Returns
    -------
    dict of str to numpy.ndarray
        N rows per column, SI units, see `COLUMNS`. Of shape (N, 3): ``position`` [m], ``force``,
        ``mean_force`` and ``force_asked`` [N], ``proxy`` [m], ``normal``, ``target`` [m]. Of shape
        (N,): ``time`` [s] from 0, ``seq``, ``stamp`` [s], ``changed_at`` [ticks], ``force_seq``,
        ``distance`` [m], ``contact``, ``law``, ``revision``, ``response`` [s], ``age`` and
        ``delay`` [ticks], ``lateness`` [s], ``missed``, ``overruns``, ``energy`` and ``guard`` [J],
        ``safety``.

    Raises
    ------
    RecordError
        If it is no recording, is damaged, or has no state.
    """
    table = columns_of(rows(Recording(path)))
    table["time"] = table["time"] - table["stamp"][0]
    return table


def columns_of(ticks: Iterable[Row]) -> dict[str, np.ndarray[Any, Any]]:
    """Return ticks as arrays by column.

    Parameters
    ----------
    ticks : iterable of tuple
        Ticks of `rows`.

    Returns
    -------
    dict of str to numpy.ndarray
        As `read`, but ``time`` is the stamp [s].
    """
    import numpy as np

    blocks: dict[str, list[np.ndarray[Any, Any]]] = {name: [] for name in COLUMNS}
    block: list[Row] = []

    def flush() -> None:
        for name, (_, _, value) in COLUMNS.items():
            blocks[name].append(np.array([value(row) for row in block]))
        block.clear()

    for row in ticks:
        block.append(row)
        if len(block) == _WINDOW:
            flush()
    if block:
        flush()
    return {name: np.concatenate(parts) for name, parts in blocks.items()}
