"""Processor load of a launch's chains: estimated before the start, measured in the run.

The processor time of a tick is stored beside the compiled code, by kind of chain. The next launch
uses it to warn if this machine cannot carry its chains, and to spread them over the processors.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from messages import topics
from nodes.base.node_kinds import load, node_kinds
from nodes.compiled.cache import folder
from nodes.launcher.launch_spec import Launch
from nodes.parameters.interface_words import interface

# Share of a processor that chains may take; above it they delay each other and miss ticks.
CARRIED: Final = 0.75
# Share of a processor left to loggers, pages and the launcher if chains use all processors.
LISTENERS: Final = 0.25
# Share of lost ticks above which a run on busy processors counts as overloaded.
LATE: Final = 0.05
# Share of its time above which a processor counts as busy; FIFO tasks get at most 0.95.
BUSY: Final = 0.85
# exit code of a launch with more chains than its processors carry
OVERLOADED: Final = 4
# duration below which a run does not show the cost of a tick [s]
_SHORTEST: Final = 0.5
_KINDS_KEPT: Final = 256


class Known(msgspec.Struct, frozen=True):
    """Costs measured here before."""

    costs: dict[str, float] = {}  # kind of chain to processor time of a tick [s]


Cause = Literal["", "chains", "others"]
"""Why a run lost ticks: its own chains or other processes; empty for another reason."""


class Load(msgspec.Struct, frozen=True, kw_only=True):
    """Load of the chains' processors during a run, and how many chains they carry."""

    chains: int
    rate_hz: float
    tick_cost_us: float  # mean processor time of one tick of a chain
    processors: int
    busy: float  # share of these processors' time that the chains took
    waited: float  # time that chains' processes waited for a processor, per second of the run
    carried: int  # number of such chains that the machine carries
    lost: float  # share of ticks not answered in time
    cause: Cause  # why ticks were lost

    @property
    def text(self) -> str:
        """Return the summary's text about an overload; empty if there was none."""
        if not self.cause:
            return ""
        chains = f"{_counted(self.chains)} at {self.rate_hz:g} Hz lost {self.lost:.1%} of the ticks"
        of = (
            "one processor" if self.processors == 1 else f"{self.processors} processors"
        )
        if self.cause == "chains":
            return (
                f"{chains}: they took {self.busy:.0%} of {of}, {self.tick_cost_us:.0f} µs a tick;"
                f" this machine carries about {_counted(self.carried)} of that kind: start fewer,"
                f" lower run.rate, or use {interface.get().tick('compiled')}"
            )
        return (
            f"{chains}: they took {self.busy:.0%} of {of}, and waited for other processes"
            f" {self.waited:.2g} s per second; stop other programs, or grant SCHED_FIFO (haptic"
            " doctor)"
        )


def _counted(chains: int) -> str:
    return f"{chains or 'no'} chain{'' if chains == 1 else 's'}"


def _hops(launch: Launch, namespace: str) -> list[str]:
    kinds = node_kinds()
    inside = {
        name: load(kinds[spec.kind])
        for name, spec in launch.nodes.items()
        if name.rpartition("/")[0] == namespace
    }
    return [
        name
        for name, kind in inside.items()
        if any(topic in kind.publishes for topic in topics.LOOP)
    ]


def kind_of_chain(launch: Launch, namespace: str, tick: str) -> str:
    """Return a key of what determines a tick's cost: nodes, surface, axes, tick and rate.

    The rate counts because a tick after a long pause finds cold caches: at 500 Hz it costs twice as
    much as at 8 kHz.
    """
    parts = [tick, f"{2 ** round(math.log2(launch.run.rate))} Hz"]
    for name in _hops(launch, namespace):
        spec = launch.nodes[name]
        surface = spec.parameters.get("surface")
        parts += [
            spec.kind,
            str(surface.get("kind", ""))[:64] if isinstance(surface, Mapping) else "",
        ]
    axes = launch.axes.get(namespace) or launch.run.axes
    return " ".join([*parts, "".join(axes)])


def _place() -> Path:
    return folder().parent / "chain_costs.json"


def known_costs() -> dict[str, float]:
    """Return the tick costs measured here before [s], by kind of chain."""
    with contextlib.suppress(OSError, msgspec.DecodeError):
        path = _place()
        if path.stat().st_uid == os.getuid() and path.stat().st_size < 1_000_000:
            found = msgspec.json.decode(path.read_bytes(), type=Known).costs
            return {kind: cost for kind, cost in found.items() if 0.0 < cost < 1.0}
    return {}


def store_costs(measured: Mapping[str, float]) -> None:
    """Store tick costs [s] by kind of chain; do nothing if the folder is not writable."""
    known = known_costs()
    for kind, cost in measured.items():
        known.pop(kind, None)
        known[kind] = cost  # newest last; old entries are dropped
    kept = dict(list(known.items())[-_KINDS_KEPT:])
    with contextlib.suppress(OSError):
        path = _place()
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        draft.write_bytes(msgspec.json.encode(Known(kept)))
        draft.replace(path)


def estimated(launch: Launch, chains: Iterable[str], tick: str) -> dict[str, float]:
    """Return the share of a processor that each chain will take, if its cost is known."""
    known = known_costs()
    costs = {chain: known.get(kind_of_chain(launch, chain, tick)) for chain in chains}
    return {
        chain: cost * launch.run.rate
        for chain, cost in costs.items()
        if cost is not None
    }


def carried(cost: float, rate: float, processors: int) -> int:
    """Return how many chains of a tick `cost` [s] fit at `rate` [Hz] without lost ticks."""
    return max(0, processors * math.floor(CARRIED / (cost * rate))) if cost > 0.0 else 0


def warning(launch: Launch, chains: list[str], tick: str, processors: int) -> str:
    """Return a warning if the machine cannot carry the launch; empty if it can, or unknown."""
    shares = estimated(launch, chains, tick)
    if launch.run.pace != "realtime" or len(shares) < len(chains) or not shares:
        return ""
    whole = sum(shares.values())
    mean = sum(shares.values()) / len(shares)
    if whole <= CARRIED * processors:
        return ""
    rate = launch.run.rate
    limit = carried(mean / rate, rate, processors)
    faster = f", or use {interface.get().tick('compiled')}"
    return (
        f"overload ahead: {_counted(len(chains))} at {rate:g} Hz will take {whole:.0%} of one"
        f" processor, as measured here ({mean / rate * 1e6:.0f} µs a tick), and there are"
        f" {processors}; this machine carries about {_counted(limit)} of that kind: start fewer,"
        f" lower run.rate{'' if tick == 'compiled' else faster}"
    )


def spread(
    chains: Iterable[str], cores: list[int], shares: Mapping[str, float]
) -> dict[str, int]:
    """Return a processor for each chain: the first of `cores` with room, the last as reserve.

    The last core is left to subscribers if possible. A chain of unknown cost counts as a twentieth
    of a processor.
    """
    chains = list(chains)
    share = {chain: shares.get(chain, 0.05) for chain in chains}
    taken = dict.fromkeys(cores, 0.0)
    taken[cores[-1]] += LISTENERS
    found = {}
    for chain in sorted(chains, key=lambda one: -share[one]):
        fits = next(
            (core for core in cores[:-1] if taken[core] + share[chain] <= CARRIED), None
        )
        core = fits if fits is not None else min(cores, key=taken.__getitem__)
        taken[core] += share[chain]
        found[chain] = core
    return {chain: found[chain] for chain in chains}


def _processor_time(pid: int) -> float:
    """Return the processor time of a process with all its threads [s]; 0 if it ended."""
    try:
        # The clock id of a process, as clock_getcpuclockid computes it.
        return time.clock_gettime((~pid << 3) | 2)
    except OSError:
        return 0.0


def _waited(pid: int) -> float:
    """Return how long the threads of a process waited for a processor [s]; 0 if it ended."""
    waited = 0
    with contextlib.suppress(OSError, ValueError):
        for task in os.listdir(f"/proc/{pid}/task"):
            waited += int(
                Path(f"/proc/{pid}/task/{task}/schedstat")
                .read_text(encoding="ascii")
                .split()[1]
            )
    return waited * 1e-9


class Meter:
    """Measures processor time and waiting time of a launch's nodes from the first tick on.

    Parameters
    ----------
    pids : mapping of str to int
        Process of each node of a chain.
    """

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self._before = {name: _processor_time(pid) for name, pid in self._pids.items()}
        self._began = {
            name: (time.monotonic(), _waited(pid)) for name, pid in self._pids.items()
        }
        self._waits: dict[str, float] = {}

    def sample(self) -> None:
        """Update the waiting times of the nodes that still run."""
        for name, pid in self._pids.items():
            at, before = self._began[name]
            if (waited := _waited(pid)) > before and time.monotonic() > at:
                self._waits[name] = (waited - before) / (time.monotonic() - at)

    def processor_times(
        self, reports: Mapping[str, Mapping[str, Any]]
    ) -> dict[str, float]:
        """Return each node's processor time since the first tick [s], from its final report."""
        ends = {name: reports.get(name, {}).get("status", {}) for name in self._pids}
        return {
            name: max(0.0, float(end["cpu"]) - self._before[name])
            for name, end in ends.items()
            if end.get("pid") == self._pids[name]
        }

    def waiting(self) -> float:
        """Return how long all nodes together waited for a processor, per second."""
        return sum(self._waits.values())


def measured_load(
    launch: Launch,
    tick: str,
    meter: Meter,
    reports: Mapping[str, Mapping[str, Any]],
    drivers: Iterable[str],
    processors: int,
) -> Load | None:
    """Return the load of a run that ended, and store the cost of a tick for the next launch.

    Parameters
    ----------
    launch : Launch
        The launch.
    tick : str
        Whether its ticks were compiled: ``plain`` or ``compiled``.
    meter : Meter
        What its nodes used since the first tick.
    reports : mapping of str to mapping
        Final report of each node.
    drivers : iterable of str
        The driver of each chain.
    processors : int
        Processors that the chains share.
    """
    used = meter.processor_times(reports)
    by_chain = {name.rpartition("/")[0]: reports.get(name, {}) for name in drivers}
    load = load_of(launch, sum(used.values()), meter.waiting(), by_chain, processors)
    if load is not None and load.lost < LATE:
        costs = {}
        for chain, report in by_chain.items():
            spent = sum(
                time for name, time in used.items() if name.rpartition("/")[0] == chain
            )
            costs[kind_of_chain(launch, chain, tick)] = spent / max(
                1, report.get("ticks", 0)
            )
        store_costs(costs)
    return load


def load_of(
    launch: Launch,
    used: float,
    waiting: float,
    reports: Mapping[str, Mapping[str, Any]],
    processors: int,
) -> Load | None:
    """Return the load of a run; None if it was too short, or not in real time.

    Parameters
    ----------
    launch : Launch
        The launch.
    used : float
        Processor time of its chains' nodes [s].
    waiting : float
        Time that they waited for a processor, per second.
    reports : mapping of str to mapping
        Final report of each chain's driver.
    processors : int
        Processors that the chains share.
    """
    rate = launch.run.rate
    done = 0
    lost = 0
    most = 0
    for report in reports.values():
        ticks, missed, left_out = (
            int(report.get(name, 0)) for name in ("ticks", "missed", "overruns")
        )
        done = done + ticks - missed
        lost = lost + missed + left_out
        most = max(most, ticks + left_out)
    seconds = most / rate
    if seconds < _SHORTEST or used <= 0.0 or launch.run.pace != "realtime":
        return None
    share = lost / (done + lost)
    cost = used / max(done, 1)  # time spent on lost ticks counts for the answered ones
    busy = used / (seconds * processors)
    return Load(
        chains=len(reports),
        rate_hz=rate,
        tick_cost_us=round(cost * 1e6, 1),
        processors=processors,
        busy=round(busy, 3),
        waited=round(waiting, 3),
        carried=carried(cost, rate, len(os.sched_getaffinity(0))),
        lost=round(share, 4),
        cause=_cause(share, busy, waiting / len(reports)),
    )


def _cause(lost: float, busy: float, waiting: float) -> Cause:
    if lost < LATE:
        return ""
    return "chains" if busy >= BUSY else "others" if waiting >= LATE else ""
