"""Swap laws and set parameters of a running loop thousands of times; count missed ticks.

A machine misses ticks without any swap. So blocks of requests alternate with idle blocks of the
same length within one run, and each missed tick is counted in its block.
"""

import argparse
import math
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from messages.topics import DEVICE_STATE, FORCE, RECEIPT
from messages.transport.requests import ControlError
from messages.types import DeviceState, Receipt
from nodes.parameters.quantities import COUNT, SECONDS, declare
from nodes.recording.accounts import overruns
from nodes.recording.reader import Recording
from nodes.recording.summary import quantile
from sim.cli.answers import add_answer, report
from sim.measure.measured_launch import Running, machine

LAWS = ("pd", "pd_alpha", "multi_term")
SETTLED = 2500  # ticks until the drop is at rest, to the last bit that matters
MEMORY = 12  # ticks, a few more than the longest memory of the laws
# Largest difference of positions at rest [m]: about fifty units in the last place of 1 mm.
STILL = 1e-17


@dataclass
class Block:
    """A stretch of time with requests or without."""

    busy: bool  # whether requests were made
    # On the host's monotonic clock [s].
    began: float
    ended: float


@dataclass
class Asked:
    """Requests to the coupling and their results."""

    # one per answered request
    answers: list[dict[str, Any]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)  # time until each answer [s]
    refused: list[str] = field(default_factory=list)  # texts of refusals
    # busy and idle stretches, alternating
    blocks: list[Block] = field(default_factory=list)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--swaps", type=COUNT, default=1000, help="swaps of laws (default %(default)s)"
    )
    parser.add_argument(
        "--sets",
        type=COUNT,
        default=1000,
        help="sets of parameters (default %(default)s)",
    )
    parser.add_argument(
        "--duration",
        type=SECONDS,
        default=60.0,
        help="time for all [s], half of it idle (default 60)",
    )
    declare(parser, rate=500.0)
    parser.add_argument(
        "--blocks",
        type=COUNT,
        default=20,
        help="busy blocks, each with an idle one (default %(default)s)",
    )
    add_answer(parser, run, files=False)


def _ask_all(
    ask: Callable[..., Any], swaps: int, sets: int, blocks: int, duration: float
) -> Asked:
    """Send the requests, evenly spaced within a block as far as the answers arrive in time."""
    asked = Asked()
    total = swaps + sets
    # Evenly mixed for any ratio: request k is a swap when the cumulative share of swaps crosses an
    # integer.
    plan = [
        "swap" if (k + 1) * swaps // total > k * swaps // total else "set"
        for k in range(total)
    ]
    spacing = duration / (2 * total)
    swapped = 0
    for block in range(blocks):
        part = plan[block * total // blocks : (block + 1) * total // blocks]
        began = time.monotonic()
        for k, kind in enumerate(part):
            time.sleep(max(0.0, began + k * spacing - time.monotonic()))
            asked_at = time.monotonic()
            try:
                if kind == "swap":
                    swapped += 1
                    found = ask("law.switch", law=LAWS[swapped % len(LAWS)])
                else:
                    # At rest damping has no effect, so setting it must not change the force either.
                    law, damping = (
                        LAWS[k % len(LAWS)],
                        2.5 + 0.5 * (len(asked.answers) % 3),
                    )
                    found = ask(
                        "param.set",
                        values={f"laws.{law}.damping": damping}
                        if law == "pd"
                        else {"ramp": k % 4},
                    )
                asked.answers.append(found)
            except ControlError as error:
                asked.refused.append(str(error))
            asked.times.append(time.monotonic() - asked_at)
        ended = time.monotonic()
        asked.blocks.append(Block(True, began, ended))
        time.sleep(ended - began)
        asked.blocks.append(Block(False, ended, time.monotonic()))
    return asked


def _equal_at_rest(ask: Callable[..., Any]) -> None:
    """Correct each law's leak, so that all have the same H(1) and a swap at rest has no step."""
    wanted = ask("law.show", law="pd")["h1_n_per_m"]
    for law in LAWS[1:]:
        # Twice, because the sum of taps is rounded.
        for _ in range(2):
            h1 = ask("law.show", law=law)["h1_n_per_m"]
            stiffness = ask("param.get", name=f"laws.{law}.stiffness")
            ask(
                "param.set", values={f"laws.{law}.stiffness": stiffness + (wanted - h1)}
            )
    # Swaps are faster without the figures of both laws.
    ask("param.set", values={"figures": False})


def measure(
    swaps: int, sets: int, blocks: int, duration: float, rate: float = 500.0
) -> dict[str, Any]:
    """Run one launch and change it throughout."""
    with Running(
        "floor_drop", "duration:=0", f"rate:={rate}", "height:=0.001"
    ) as launch:

        def ask(op: str, **args: Any) -> Any:
            return launch.call("coupling", op, **args)

        _equal_at_rest(ask)
        before = int(ask("param.set", values={"ramp": 0})["revision"])
        launch.wait_ticks(SETTLED)
        asked = _ask_all(ask, swaps, sets, blocks, duration)
        figures = launch.finish(signal.SIGINT)
        return _figures(
            Recording(launch.folder / figures["recording"]), figures, asked, before
        )


def _quantiles(values: list[float], unit: float) -> dict[str, float]:
    ordered = sorted(values) or [math.nan]
    return {
        name: round(quantile(ordered, share) * unit, 3)
        for name, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0))
    }


def _steps_at_rest(states: list[DeviceState], receipts: list[Receipt]) -> list[float]:
    """Return the force steps [N] of changes made at rest.

    If the machine stalls, the mass may be falling during a change; such changes are left out.
    """
    position = {state.seq: state.position[2] for state in states}
    # A tick that was not recorded is not known to be at rest (infinity minus itself is not small
    # either).
    recent = [
        [position.get(one.seq - age, math.inf) for age in range(1, MEMORY + 1)]
        for one in receipts
    ]
    return [
        one.force_step
        for one, part in zip(receipts, recent, strict=True)
        if max(part) - min(part) <= STILL
    ]


def _figures(
    recording: Recording, summary: dict[str, Any], asked: Asked, before: int
) -> dict[str, Any]:
    states = recording.messages(DEVICE_STATE)
    receipts = [
        receipt for receipt in recording.messages(RECEIPT) if receipt.revision > before
    ]
    known = {receipt.revision for receipt in receipts}
    lost = [found for found in asked.answers if found["revision"] not in known]
    steps = _steps_at_rest(states, receipts)
    blocks: dict[bool, list[dict[str, Any]]] = {True: [], False: []}
    for block in asked.blocks:
        part = [state for state in states if block.began <= state.stamp < block.ended]
        first, last = part[0], part[-1]
        # Ticks that a delayed driver skipped count as well, whether the machine or our code delayed
        # it.
        missed = last.missed - first.missed + last.overruns - first.overruns
        responses = [state.response for state in part if state.response > 0.0]
        blocks[block.busy].append(
            {"ticks": last.seq - first.seq, "missed": missed, "responses": responses}
        )
    figures: dict[str, Any] = {
        "machine": machine(),
        "rate_hz": summary["rate_hz"],
        "ticks": summary["ticks"],
        "requests": len(asked.answers) + len(asked.refused),
        "refused": len(asked.refused),
        "receipts": len(receipts),
        "lost": len(lost),
        "forces_lost": recording.topics[FORCE].gaps - (overruns(recording) or 0),
        "at_rest": len(steps),
        "force_step_max_n": max(steps, default=math.nan),
        "answer_ms": _quantiles(asked.times, 1e3),
        "errors": sorted(set(asked.refused))[:5],
    }
    for busy, label in ((True, "busy"), (False, "idle")):
        figures[label] = {
            "ticks": sum(block["ticks"] for block in blocks[busy]),
            "missed": sum(block["missed"] for block in blocks[busy]),
            "blocks_with_missed": sum(block["missed"] > 0 for block in blocks[busy]),
            "response_us": _quantiles(
                [value for block in blocks[busy] for value in block["responses"]], 1e6
            ),
        }
    pairs = list(zip(blocks[True], blocks[False], strict=True))
    figures["missed"] = figures["busy"]["missed"] + figures["idle"]["missed"]
    figures["blocks"] = len(pairs)
    figures["only_busy_missed"] = sum(
        busy["missed"] > 0 == idle["missed"] for busy, idle in pairs
    )
    figures["only_idle_missed"] = sum(
        idle["missed"] > 0 == busy["missed"] for busy, idle in pairs
    )
    return figures


def text(figures: dict[str, Any]) -> str:
    """Format the figures as text."""
    lines = [
        f"{figures['machine']}, {figures['rate_hz']:.1f} Hz, {figures['ticks']} ticks",
        (
            f"  requests {figures['requests']}, receipts {figures['receipts']}, refused"
            f" {figures['refused']}, lost {figures['lost']}; answered in p50"
            f" {figures['answer_ms']['p50']:.1f}, p99 {figures['answer_ms']['p99']:.1f} ms"
        ),
        (
            f"  largest force step {figures['force_step_max_n']:.2g} N, of {figures['at_rest']}"
            " changes at rest"
            if figures["at_rest"]
            else "  largest force step not measured: no change at rest"
        ),
    ]
    for label in ("busy", "idle"):
        part = figures[label]
        lines.append(
            f"  {label}  {part['ticks']} ticks, missed {part['missed']} (in"
            f" {part['blocks_with_missed']} of {figures['blocks']} blocks), response p50"
            f" {part['response_us']['p50']:.0f}, p99 {part['response_us']['p99']:.0f} µs"
        )
    return "\n".join(lines)


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    figures = measure(
        arguments.swaps,
        arguments.sets,
        arguments.blocks,
        arguments.duration,
        arguments.rate,
    )
    return report(
        arguments,
        figures,
        text(figures),
        held=figures["requests"] == figures["receipts"],
    )
