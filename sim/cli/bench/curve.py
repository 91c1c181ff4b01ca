"""Measure the cost of encryption: response over tcp with CURVE against ipc, in one run.

The loop's own environment and coupling run in a process each: one pair answers over ipc, as on one
machine, one pair over tcp on loopback with CURVE, as on two machines. This process drives both in
turn, tick by tick, so that disturbances of the machine affect both alike.
"""

import argparse
import os
import statistics
import subprocess
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec

from messages import topics
from messages.codec import Decoder, encode
from messages.errors import RefusedError
from messages.transport import keys
from messages.transport.context import new_context
from messages.transport.endpoints import Context
from messages.transport.gate import Gate
from messages.transport.sockets import Publisher, Subscription
from messages.types import DeviceState, Force
from nodes.base import realtime
from nodes.base.setup import Scheduling, Setup
from nodes.launcher.child import PYTHON
from nodes.parameters.quantities import ROUNDS, declare, whole
from nodes.recording.summary import quantile
from sim.cli.answers import add_answer, report
from sim.measure.free_ports import free_ports

PATIENCE_MS = 5000  # longest wait for a force [ms]


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(parser, rate=500.0)
    parser.add_argument("--rounds", type=ROUNDS, default=10, help="rounds of each kind")
    parser.add_argument(
        "--ticks", type=whole(1, 10**8), default=250, help="ticks of a round"
    )
    add_answer(parser, run, files=False)


_PARAMETERS: dict[str, dict[str, Any]] = {
    "environment": {
        "surface": {"kind": "plane", "axis": "z", "position": 0.0, "normal": 1}
    },
    "coupling": {
        "law": "pd",
        "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}},
        "stability": "off",
    },
}


class _Loop:
    """Environment and coupling over tcp or ipc, driven by this process."""

    def __init__(
        self,
        context: Context,
        folder: Path,
        name: str,
        key: str,
        period: float,
        stack: ExitStack,
    ) -> None:
        state, proxy, force = (
            f"tcp://127.0.0.1:{free_ports(1)}#{key}"
            if key
            else f"ipc://{folder}/{name}{hop}"
            for hop in range(3)
        )
        quietest = realtime.quietest_processor()
        scheduling = Scheduling(
            cpus=[quietest], aside=sorted(os.sched_getaffinity(0) - {quietest})
        )
        self._publisher = Publisher(context, state)
        stack.callback(self._publisher.close, 0)
        self._inbox = Subscription(context, [force], [topics.FORCE])
        stack.callback(self._inbox.close)
        for kind, place, topic, source in (
            ("environment", proxy, topics.DEVICE_STATE, state),
            ("coupling", force, topics.PROXY, proxy),
        ):
            setup = Setup(
                run=name,
                run_dir=str(folder),
                name=f"{kind}_{name}",
                kind=kind,
                factory=f"nodes.{kind}.node:{kind.capitalize()}",
                period=period,
                pace="lockstep",
                apply="on_arrival",
                axes=["z"],
                ticks=0,
                publish=place,
                control=f"ipc://{folder}/{kind}_{name}.ctl",
                sources={topic: source},
                listeners=1,
                scheduling=scheduling,
                parameters=_PARAMETERS[kind],
            )
            path = folder / f"{kind}_{name}.json"
            path.write_bytes(msgspec.json.encode(setup))
            node = subprocess.Popen(
                [*PYTHON, "-m", "nodes", str(path)], stdin=subprocess.DEVNULL
            )
            stack.callback(node.wait)
            stack.callback(node.terminate)
        self._name, self._seq = name, 0
        self._decode = Decoder(Force).decode
        self._topic = topics.DEVICE_STATE.encode()

    def wait(self) -> None:
        """Wait until both nodes answer."""
        deadline = time.monotonic() + 30.0
        while self._publisher.listeners() < 1:
            if time.monotonic() > deadline:
                raise RefusedError(
                    f"{self._name}: the nodes did not come up within 30 s"
                )
            time.sleep(0.01)
        while self.tick(100) is None:
            if time.monotonic() > deadline:
                raise RefusedError(
                    f"{self._name}: the nodes did not answer within 30 s"
                )
        while self._inbox.receive(100) is not None:
            pass

    def tick(self, patience_ms: int = PATIENCE_MS) -> float | None:
        """Run one tick; return the response time [s], or None without an answer."""
        self._seq += 1
        position = (0.0, 0.0, -1e-3 if self._seq % 2 else 1e-3)
        begun = time.monotonic()
        payload = encode(
            DeviceState(seq=self._seq, stamp=self._seq * 1e-3, position=position)
        )
        self._publisher.send(self._topic, payload)
        while True:
            frames = self._inbox.receive(patience_ms)
            if frames is None:
                return None
            if self._decode(frames[1]).seq == self._seq:
                return time.monotonic() - begun

    def answered(self) -> float:
        """Run one tick that must be answered; return the response time [s]."""
        response = self.tick()
        if response is None:
            raise RefusedError(
                f"{self._name}: no answer within {PATIENCE_MS / 1e3:g} s"
            )
        return response


def _round(
    loops: dict[str, _Loop], ticks: int, period: float
) -> dict[str, list[float]]:
    """Run a round at the loop's rate, tick by tick in turn; return the responses [s]."""
    found: dict[str, list[float]] = {name: [] for name in loops}
    start = time.monotonic()
    for n in range(ticks):
        # A tick of the one, half a period later a tick of the other: both meet the same
        # disturbances.
        for half, (name, loop) in enumerate(loops.items()):
            realtime.sleep_until(start + (n + 0.5 * half) * period)
            found[name].append(loop.answered())
    return found


def measure(rate: float, rounds: int, ticks: int) -> dict[str, Any]:
    """Measure both transports in turn."""
    period = 1.0 / rate
    responses: dict[str, list[list[float]]] = {"ipc": [], "curve": []}
    with (
        tempfile.TemporaryDirectory(prefix="haptic-bench-") as text,
        ExitStack() as stack,
    ):
        folder = Path(text)
        # The user's own keys are not changed.
        stack.enter_context(
            mock.patch.dict(os.environ, HAPTIC_KEYS=str(folder / "keys"))
        )
        me = keys.new_identity()
        denied: list[str] = []
        context = new_context()
        stack.callback(context.term)
        gate = Gate(context, denied.append)
        stack.callback(gate.stop)
        gate.start()
        loops = {
            "ipc": _Loop(context, folder, "ipc", "", period, stack),
            "curve": _Loop(context, folder, "curve", me.public, period, stack),
        }
        for loop in loops.values():
            loop.wait()
        _round(loops, ticks, period)
        for _ in range(rounds):
            for name, found in _round(loops, ticks, period).items():
                responses[name].append(found)
    ratios = sorted(
        statistics.median(curve) / statistics.median(ipc)
        for ipc, curve in zip(*responses.values(), strict=True)
    )
    figures: dict[str, Any] = {
        "rate_hz": rate,
        "rounds": rounds,
        "ticks_per_round": ticks,
        "response_us": {},
    }
    for name, lists in responses.items():
        values = sorted(value for one in lists for value in one)
        shares = {"p50": 0.5, "p99": 0.99}
        figures["response_us"][name] = {
            key: round(quantile(values, part) * 1e6, 1) for key, part in shares.items()
        }
    figures["ratio"] = round(statistics.median(ratios), 4)
    figures["ratio_of_rounds"] = [round(ratio, 4) for ratio in ratios]
    return figures


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    found = measure(arguments.rate, arguments.rounds, arguments.ticks)
    ipc, curve = found["response_us"]["ipc"], found["response_us"]["curve"]
    spread = found["ratio_of_rounds"]
    text = (
        f"three hops at {found['rate_hz']:g} Hz, {found['rounds']} rounds of"
        f" {found['ticks_per_round']} ticks, the two in turn\n  ipc              p50"
        f" {ipc['p50']:.0f} µs, p99 {ipc['p99']:.0f} µs\n  tcp with CURVE   p50 {curve['p50']:.0f}"
        f" µs, p99 {curve['p99']:.0f} µs\n  ratio            {found['ratio']:.3f} (median of the"
        f" rounds, which gave {spread[0]:.3f} to {spread[-1]:.3f})"
    )
    return report(arguments, found, text)
