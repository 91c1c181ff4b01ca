"""Soak test: loggers come and go, laws change, nodes die; checks memory and ticks.

It looks for what short runs do not show: growing memory, unaccounted messages, unexplained missed
ticks. Each round attaches loggers, changes parameters, and finally kills one node of the chain;
ticks are excused only from that kill until forces return.

The cause of missed ticks is measured (sim/drill/witness.py).
"""

from __future__ import annotations

import math
import signal
import time
from itertools import cycle
from pathlib import Path

import msgspec

from messages.topics import LOOP
from messages.transport.requests import ControlError
from nodes.recording.accounts import accounts
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError
from sim.drill.drill import RATE, in_order, scene
from sim.drill.witness import UNEXPLAINED, Witness
from sim.measure.haptic_commands import within
from sim.measure.rig import Rig

# Limit of a node's memory growth after the first tenth; allocators round to megabytes [bytes].
GROWTH = 4e6
# Limits of the settling time of a process: a tenth of the run, but until its first chunks are
# written [s].
SETTLED = (4.0, 20.0)
# Additional growth of a logger per message: MCAP's index of chunks stays in memory [bytes].
INDEX = 5.0
MISS_LIMIT = 1e-3  # limit of the share of missed ticks outside respawns


CHAIN = ("driver", "environment", "coupling")

LATE = 0.25  # lateness from which the machine held up the driver [periods]
BLAME = 1.0  # time after an action in which missed ticks are attributed to it [s]


class Soak(msgspec.Struct, kw_only=True):
    """Result of a soak test."""

    duration_s: float = 0.0  # duration [s]
    # Rounds; parameter changes and law switches; loggers attached; nodes killed.
    rounds: int = 0
    changes: int = 0
    loggers: int = 0
    respawns: int = 0
    # Ticks; ticks without a timely answer outside respawns; excused ones during respawns.
    ticks: int = 0
    missed: int = 0
    excused: int = 0
    # Missed ticks at which even the driver woke late or not at all: the machine was held up.
    held_up: int = 0
    # Missed ticks by the last action within `BLAME` before; ``nothing`` for none.
    missed_after: dict[str, int] = {}
    # Missed ticks by measured cause: the driver woken late, a node that waited for its processor
    # or computed, stolen time; else ``unexplained``.
    causes: dict[str, int] = {}
    # Largest memory growth of each node within one of its processes [bytes].
    growth_bytes: dict[str, float] = {}
    # By node: ``sent`` (its own count), ``recorded`` (by the launch's logger), ``lost``.
    accounts: dict[str, dict[str, int]] = {}
    # Messages of other loggers that ended properly, compared with the launch's logger.
    shared: int = 0
    # Memory flat, messages accounted for, recovered after each respawn, nothing left, few misses.
    passed: bool = False
    reasons: list[str] = []  # why it failed


class _Memory:
    """Resident memory of each process of each node, over its life."""

    def __init__(self, settle: float, witness: Witness) -> None:
        self._settle = settle
        self._witness = witness
        self._born: dict[int, float] = {}
        self._first: dict[int, float] = {}
        self.growth: dict[str, float] = {}

    def look(self, rig: Rig) -> None:
        for name in rig.run.nodes:
            try:
                status = rig.call(name, "status", timeout=0.5)
            except ControlError:
                continue
            pid = status["pid"]
            now = time.monotonic()
            if name in CHAIN:
                self._witness.pids[name] = pid
            # Start-up fills caches and queues; growth afterwards is a leak.
            if now - self._born.setdefault(pid, now) < self._settle:
                continue
            first = self._first.setdefault(pid, status["memory"])
            self.growth[name] = max(
                self.growth.get(name, 0.0), status["memory"] - first
            )


def _pass_time(rig: Rig, seconds: float, memory: _Memory) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until and rig.process.poll() is None:
        memory.look(rig)
        rig.let_pass(min(0.5, max(until - time.monotonic(), 0.0)))


# Long: one story in time, from the launch to its verdict.
def soak(  # noqa: PLR0915
    seconds: float, round_seconds: float = 60.0, miss_limit: float = MISS_LIMIT
) -> Soak:
    """Run a soak test of `seconds` [s]."""
    content = scene()
    content["nodes"]["logger"]["respawn"] = False
    content["nodes"]["coupling"]["parameters"]["laws"]["soft"] = {
        "kind": "pd",
        "stiffness": 500.0,
        "damping": 2.0,
    }
    found = Soak()
    witness = Witness(1.0 / RATE)
    memory = _Memory(min(max(seconds / 10.0, SETTLED[0]), SETTLED[1]), witness)
    stiffness = cycle((800.0, 1200.0, 1000.0))
    law = cycle(("soft", "pd"))
    victims = cycle(("coupling", "environment", "driver"))
    excused: list[tuple[int, int]] = []
    done: list[tuple[int, str]] = []
    complete: list[str] = []
    rig = Rig(content)
    with rig:
        begun = time.monotonic()
        while time.monotonic() - begun < seconds and rig.process.poll() is None:
            part = (
                min(round_seconds, max(seconds - (time.monotonic() - begun), 1.0)) / 6.0
            )
            number = found.rounds = found.rounds + 1
            done.append((rig.states[-1].seq, "loggers attached"))
            staying = rig.beside("bag", "record", "--out", f"round{number}.mcap")
            killed = rig.beside("bag", "record", "--out", f"killed{number}.mcap")
            found.loggers += 2
            # Wait for them: on a busy machine their start takes as long as their visit.
            for name in ("round", "killed"):
                within((rig.folder / f"{name}{number}.mcap").exists, 20.0)
            for _ in range(4):
                _pass_time(rig, part, memory)
                done.append((rig.states[-1].seq, "parameters and law changed"))
                rig.call(
                    "coupling",
                    "param.set",
                    values={"laws.pd.stiffness": next(stiffness)},
                )
                rig.call("coupling", "law.switch", law=next(law), ramp=20)
                found.changes += 2
            done.append((rig.states[-1].seq, "loggers killed and stopped"))
            killed.kill()
            staying.send_signal(signal.SIGINT)
            killed.wait()
            staying.wait()
            complete.append(f"round{number}.mcap")
            found.respawns += 1
            victim = next(victims)
            struck = rig.states[-1].seq
            seen = len(rig.states)
            rig.kill(victim)
            if not within(
                lambda seen=seen: len(rig.states) > seen + 50 and in_order(rig.states),  # type: ignore[misc]
                20.0,
            ):
                found.reasons.append(
                    f"round {number}: not recovered within 20 s after {victim} was killed:"
                    f" {rig.errors}"
                )
                break
            excused.append((struck, rig.states[-1].seq))
            done.append((rig.states[-1].seq, f"{victim} respawned"))
            _pass_time(rig, 2.0 * part, memory)
        found.duration_s = time.monotonic() - begun
        rig.end()
        _account(rig.folder, found, complete)
    witness.close()
    _explain(rig, found, _count(rig, found, excused, done), witness)
    found.growth_bytes = memory.growth
    index = INDEX * sum(account["recorded"] for account in found.accounts.values())
    limits = {
        node: GROWTH + (index if node == "logger" else 0.0) for node in memory.growth
    }
    found.reasons += [
        f"{node}: memory grew by {growth / 1e6:.1f} MB, limit {limits[node] / 1e6:.1f} MB"
        for node, growth in memory.growth.items()
        if growth > limits[node]
    ]
    if found.missed > miss_limit * found.ticks:
        found.reasons.append(
            f"missed {found.missed} of {found.ticks} ticks outside respawns, limit {miss_limit:g}"
            " of them"
        )
    if miss_limit < 1.0 and found.causes.get(UNEXPLAINED):
        found.reasons.append(
            f"{found.causes[UNEXPLAINED]} missed ticks have no cause that was measured"
        )
    if rig.exit_code != 0:
        found.reasons.append(
            f"the launch ended with exit code {rig.exit_code}: {rig.said}"
        )
    found.reasons += [f"left behind: {what}" for what in rig.left]
    found.passed = not found.reasons
    return found


def _account(folder: Path, found: Soak, names: list[str]) -> None:
    try:
        whole = Recording(folder / "run.mcap")
        verdict = accounts(whole)
        everything = {topic: _ticks(whole, topic) for topic in LOOP}
    except RecordError as error:
        found.reasons.append(str(error))
        return
    found.accounts = {
        node: {"sent": one.sent, "recorded": one.recorded, "lost": one.lost}
        for node, one in verdict.items()
    }
    found.reasons += [
        f"{one.lost} of {node}'s messages are neither recorded nor declared lost"
        for node, one in verdict.items()
        if one.lost
    ]
    for name in names:
        try:
            recording = Recording(folder / name)
            for topic in LOOP:
                own = _ticks(recording, topic)
                if not own:
                    # On a busy machine it ended before it received anything.
                    continue
                # Between its first and last message, a logger must have every message.
                low = min(own)
                high = max(own)
                missing = {seq for seq in everything[topic] if low <= seq <= high} - own
                found.shared += len(own)
                if missing:
                    found.reasons.append(
                        f"{name}: {len(missing)} messages of {topic} that the launch's logger has"
                    )
        except (RecordError, ValueError) as error:
            found.reasons.append(f"{name}: {error}")
    if not whole.complete:
        found.reasons.append("run.mcap: the recording is not complete")


def _ticks(recording: Recording, topic: str) -> set[int]:
    return {message.seq for message in recording.messages(topic)}


def _count(
    rig: Rig, found: Soak, excused: list[tuple[int, int]], done: list[tuple[int, str]]
) -> list[int]:
    """Count the ticks without a timely answer; return those that nothing excuses."""
    states = rig.states
    missed = []
    found.ticks = states[-1].seq - states[0].seq
    # A state reports the tick before it.
    answered = {state.seq - 1 for state in states if state.response > 0.0}
    punctual = {state.seq for state in states if state.lateness < LATE / RATE}
    for seq in range(states[0].seq, states[-1].seq):
        if seq in answered:
            continue
        if any(low <= seq <= high for low, high in excused):
            found.excused += 1
            continue
        missed.append(seq)
        found.held_up += not {seq, seq + 1} <= punctual
        last, what = max(
            (event for event in done if event[0] <= seq), default=(-math.inf, "")
        )
        blamed = what if seq - last <= BLAME * RATE else "nothing"
        found.missed_after[blamed] = found.missed_after.get(blamed, 0) + 1
    found.missed = len(missed)
    return missed


def _explain(rig: Rig, found: Soak, missed: list[int], witness: Witness) -> None:
    """Assign a cause to each missed tick; consecutive ones are one stall."""
    stamps = {state.seq: state.stamp for state in rig.states}
    late = {state.seq for state in rig.states if state.lateness >= LATE / RATE}
    while missed:
        stall = [missed.pop(0)]
        while missed and missed[0] == stall[-1] + 1:
            stall.append(missed.pop(0))
        around = range(stall[0], stall[-1] + 2)
        if any(seq in late or seq not in stamps for seq in around):
            cause = "the driver itself woken late"
        else:
            cause = witness.cause(stamps[stall[0]], stamps[stall[-1]] + 2.0 / RATE)
        found.causes[cause] = found.causes.get(cause, 0) + len(stall)


def text(found: Soak) -> str:
    """Return the result as text."""
    sent = sum(one["sent"] for one in found.accounts.values())
    growth = ", ".join(
        f"{node} {value / 1e6:+.1f}" for node, value in found.growth_bytes.items()
    )
    lines = [
        (
            f"soak {'passed' if found.passed else 'FAILED'}: {found.duration_s:.0f} s at {RATE:g}"
            f" Hz, {found.ticks} ticks"
        ),
        (
            f"  {found.loggers} loggers attached, {found.changes} changes, {found.respawns} nodes"
            " killed and respawned"
        ),
        f"  missed {found.missed} ticks outside the respawns ({found.held_up} while even the driver"
        f" was held up), {found.excused} within them"
        + "".join(
            f"; {count} within {BLAME:g} s of: {what}"
            for what, count in found.missed_after.items()
        ),
        "  causes measured: "
        + (
            ", ".join(f"{count} {cause}" for cause, count in found.causes.items())
            or "none needed"
        ),
        f"  memory growth [MB]: {growth}",
        (
            f"  {sent} messages sent by the nodes' own count,"
            f" {sum(one['lost'] for one in found.accounts.values())} of them not in the launch's"
            f" recording; {found.shared} in those of loggers that came and went"
        ),
    ]
    return "\n".join([*lines, *(f"  {reason}" for reason in found.reasons)])
