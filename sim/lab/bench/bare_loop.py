"""Reference loop: the same three hops with pyzmq and msgpack only.

Three processes pass the same maps (same fields, same sizes) around the same sockets, without
checks, counters or recording, and with a spring as law. The difference to a launch is the cost of
haptic-nodes. One process per role::

    python -m sim.lab.bench.bare_loop ROLE FOLDER TICKS CORE FIFO RATE LISTENERS

A logger, which only receives, may be the fourth. The same loop in C is bare_loop.c.
"""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import msgpack
import zmq

from messages.transport.publisher import SEND_QUEUE

ROLES = ("environment", "coupling", "driver")


def _sockets(folder: str, own: str, other: str, listeners: int) -> tuple[Any, Any]:
    context = zmq.Context()
    context.linger = 0
    publisher = context.socket(zmq.XPUB)
    publisher.setsockopt(zmq.XPUB_VERBOSE, 1)
    publisher.sndhwm = SEND_QUEUE
    publisher.bind(f"ipc://{folder}/{own}")
    inbox = context.socket(zmq.SUB)
    inbox.setsockopt(zmq.RECONNECT_IVL, 10)
    inbox.connect(f"ipc://{folder}/{other}")
    inbox.subscribe(b"")
    # Wait for the subscriptions of all listeners: no message is lost from here on.
    for _ in range(1 + listeners):
        publisher.recv()
    return publisher, inbox


def _relay(
    folder: str,
    own: str,
    other: str,
    answer: Callable[[dict[str, Any]], dict[str, Any]],
    listeners: int,
) -> None:
    publisher, inbox = _sockets(folder, own, other, listeners)
    topic = f"/{own}/answer".encode()
    pack = msgpack.Packer().pack
    unpack = msgpack.unpackb
    while True:
        inbox.recv()
        message = unpack(inbox.recv())
        publisher.send(topic, zmq.SNDMORE)
        publisher.send(pack(answer(message)))
        if message["seq"] < 0:
            # Flush the last message before the socket closes.
            publisher.close(linger=1000)
            return


def _proxy(state: dict[str, Any]) -> dict[str, Any]:
    position = state["position"]
    distance = position[2]
    contact = distance < 0.0
    return {
        "seq": state["seq"],
        "stamp": state["stamp"],
        "position": position,
        "proxy": [position[0], position[1], 0.0] if contact else position,
        "normal": [0.0, 0.0, 1.0],
        "distance": distance,
        "contact": contact,
        "delay": state["delay"],
    }


def _force(proxy: dict[str, Any]) -> dict[str, Any]:
    force = [1000.0 * (proxy["proxy"][i] - proxy["position"][i]) for i in range(3)]
    return {
        "seq": proxy["seq"],
        "stamp": proxy["stamp"],
        "force": force,
        "law": "pd",
        "revision": 0,
    }


def _state(seq: int, position: float, force: list[float]) -> dict[str, Any]:
    return {
        "seq": seq,
        "stamp": time.monotonic(),
        "position": [0.0, 0.0, position],
        "force": force,
        "force_seq": seq - 1,
        "age": 0,
        "response": 0.0001,
        "lateness": 0.0,
        "missed": 0,
        "overruns": 0,
        "safety": "active",
        "energy": 0.0,
        "delay": 0.0,
    }


def _log(folder: str) -> None:
    """Receive all messages of the three until each has ended, or for 1 s of silence.

    The timeout is needed because an end message may be dropped.
    """
    context = zmq.Context()
    inbox = context.socket(zmq.SUB)
    inbox.setsockopt(zmq.RECONNECT_IVL, 10)
    for role in ROLES:
        inbox.connect(f"ipc://{folder}/{role}")
    inbox.subscribe(b"")
    inbox.recv()
    inbox.rcvtimeo = 1000
    ends = int(msgpack.unpackb(inbox.recv())["seq"] < 0)
    with contextlib.suppress(zmq.Again):
        while ends < len(ROLES):
            inbox.recv()
            ends += msgpack.unpackb(inbox.recv())["seq"] < 0
    inbox.close(linger=0)


def _drive(folder: str, ticks: int, rate: float, listeners: int) -> dict[str, Any]:
    publisher, inbox = _sockets(folder, "driver", "coupling", listeners)
    pack = msgpack.Packer().pack
    unpack = msgpack.unpackb
    # The inbox's subscription must reach the coupling too: repeat the first tick until it is
    # answered.
    inbox.rcvtimeo = 50
    seq = 0
    answered = False
    while not answered:
        publisher.send(b"/driver/state", zmq.SNDMORE)
        publisher.send(pack(_state(0, 0.01, [0.0, 0.0, 0.0])))
        with contextlib.suppress(zmq.Again):
            inbox.recv()
            inbox.recv()
            answered = True
    inbox.rcvtimeo = 20
    with contextlib.suppress(zmq.Again):
        while True:
            inbox.recv()
    inbox.rcvtimeo = -1
    position, force, missed = 0.01, [0.0, 0.0, 0.0], 0
    responses = []
    begun = time.monotonic()
    for seq in range(1, ticks + 1):
        if rate:
            due = begun + seq / rate
            while (wait := due - time.monotonic()) > 0.0:
                time.sleep(wait)
        sent = time.monotonic()
        publisher.send(b"/driver/state", zmq.SNDMORE)
        publisher.send(pack(_state(seq, position, force)))
        while True:
            inbox.recv()
            answer = unpack(inbox.recv())
            if answer["seq"] == seq:
                break
        force = answer["force"]
        position += 1e-9 * force[2]
        response = time.monotonic() - sent
        responses.append(response)
        if rate and time.monotonic() > due + 1.0 / rate:
            missed += 1
    elapsed = time.monotonic() - begun
    publisher.send(b"/driver/state", zmq.SNDMORE)
    publisher.send(pack(_state(-1, position, force)))
    inbox.recv()
    publisher.close(linger=1000)
    responses.sort()
    return {
        "ticks": ticks,
        "ticks_per_s": ticks / elapsed,
        "missed": missed,
        "response_us": {
            name: responses[min(int(share * ticks), ticks - 1)] * 1e6
            for name, share in (
                ("p50", 0.5),
                ("p99", 0.99),
                ("p999", 0.999),
                ("max", 1.0),
            )
        },
    }


def main(arguments: list[str]) -> int:
    """Run one role."""
    role, folder, ticks, core, fifo, rate, listeners = arguments
    if core != "any":
        os.sched_setaffinity(0, [int(core)])
    if int(fifo):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(fifo)))
    with open("/proc/self/timerslack_ns", "w", encoding="ascii") as slack:
        slack.write("1")
    if role == "environment":
        _relay(folder, "environment", "driver", _proxy, int(listeners))
    elif role == "coupling":
        _relay(folder, "coupling", "environment", _force, int(listeners))
    elif role == "logger":
        _log(folder)
    else:
        print(
            json.dumps(_drive(folder, int(ticks), float(rate), int(listeners))),
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
