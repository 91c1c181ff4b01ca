"""Outgoing messages during compiled ticks: ticks do not stop, and nothing is lost or old."""

from __future__ import annotations

import ctypes
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from messages import topics
from messages.codec import Decoder
from messages.event_kinds import OtherKind
from messages.transport.context import new_context
from messages.transport.sockets import Publisher, Subscription
from messages.types import Event, NodeStatus
from nodes.coupling.node import Coupling
from nodes.coupling.state import CouplingState
from nodes.recording.accounts import accounts
from nodes.recording.reader import Recording
from tests.support.launching import launch_json
from tests.support.setups import setup_of

RATE = 1000.0
TICKS = {
    "driver": "/device/state",
    "environment": "/environment/proxy",
    "coupling": "/coupling/force",
}


@pytest.fixture(scope="module")
def figures(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, object], Recording]:
    folder = tmp_path_factory.mktemp("mail")
    found = launch_json(
        folder,
        "floor_drop",
        f"rate:={RATE:g}",
        "duration:=3",
        "tick:=compiled",
        "stiffness:=500",
    )
    return found, Recording(folder / str(found["recording"]))


@pytest.mark.process
@pytest.mark.parametrize("node", TICKS)
def test_a_status_says_where_the_node_is_now(
    figures: tuple[dict[str, object], Recording], node: str
) -> None:
    recording = figures[1]
    newest, behind, ticks = 0, [], []
    for entry in recording.entries([TICKS[node], f"/{node}/status"]):
        if entry.topic == TICKS[node]:
            newest = entry.message.seq
        elif (
            isinstance(status := entry.message, NodeStatus)
            and status.state == "running"
        ):
            behind.append(abs(newest - status.seq))
            ticks.append(status.ticks)
    # Every half second of three.
    assert len(ticks) >= 4
    assert ticks == sorted(set(ticks))
    # Messages leave in batches of 2 ms, and a status after one: two batches and the tick under way.
    # A machine that stands still in between may delay some.
    assert statistics.median(behind) <= 2 * 0.002 * RATE + 1


@pytest.mark.process
def test_all_that_was_told_was_sent_and_counted(
    figures: tuple[dict[str, object], Recording],
) -> None:
    found, recording = figures
    assert found["tick"] == "compiled"
    for node, account in accounts(recording).items():
        assert account.finished, node
        assert account.lost == 0, node


def told_during(
    place: Path, kernel: Callable[[Coupling, CouplingState], None]
) -> list[str]:
    """Send while a node runs its scripted compiled ticks; return what leaves afterwards."""
    context = new_context()
    source = f"ipc://{place}/proxy"
    parameters = {
        "law": "pd",
        "laws": {"pd": {"kind": "pd", "stiffness": 500.0, "damping": 3.0}},
    }
    node = Coupling(
        setup_of(
            name="coupling",
            tick="compiled",
            sources={topics.PROXY: source},
            parameters=parameters,
        )
    )

    def ticks(address: int) -> int:
        struct: Any = CouplingState
        kernel(node, struct.from_address(address))
        return 0

    node.kernel = ticks
    node.configure()
    proxies, node.publisher = (
        Publisher(context, source),
        Publisher(context, f"ipc://{place}/force"),
    )
    node.connect(
        lambda endpoints, wanted, queue: Subscription(context, endpoints, wanted, queue)
    )
    compiled: Any = node.make_compiled()
    assert compiled is not None
    compiled.go()
    told = [Decoder(Event).decode(payload).reason for _, payload in node.events.outbox]
    for socket in (proxies, node.publisher, node.inbox):
        assert socket is not None
        socket.close()
    context.term()
    return told


def test_what_is_told_leaves_in_its_order(tmp_path: Path) -> None:
    def unsent(node: Coupling, _: CouplingState) -> None:
        for number in range(5):
            node.events.emit_each(OtherKind("test.kind"), f"{number}")

    def sent_in_between(node: Coupling, state: CouplingState) -> None:
        node.events.emit_each(OtherKind("test.kind"), "0")
        node.events.emit_each(OtherKind("test.kind"), "1")
        # As the kernel does when it has sent it: what is told now must not leave before what waits
        # for the loop.
        assert b"0" in ctypes.string_at(state.outgoing_payload, state.outgoing_size)
        state.outgoing = 0
        node.events.emit_each(OtherKind("test.kind"), "2")

    assert told_during(tmp_path, unsent) == ["0", "1", "2", "3", "4"]
    assert told_during(tmp_path, sent_in_between) == ["1", "2"]
