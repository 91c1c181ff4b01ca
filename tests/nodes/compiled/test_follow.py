"""A coupling's compiled and plain ticks on real sockets: omitted ticks, late messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import pytest

from messages import topics
from messages.codec import MAX_PAYLOAD, Decoder, encode
from messages.transport.context import new_context
from messages.transport.sockets import Publisher, Subscription
from messages.types import Force, Proxy
from nodes.compiled.choose_tick import choose
from nodes.compiled.load import load_kernel
from nodes.coupling.node import Coupling
from sim.measure.haptic_commands import wait_for
from tests.support.setups import setup_of

# One of taps alone, one with a recursive section, which sees what is bridged too.
LAWS = {
    "pd": {"kind": "pd", "stiffness": 500.0, "damping": 3.0},
    "pd_filtered": {
        "kind": "pd_filtered",
        "stiffness": 500.0,
        "damping": 3.0,
        "cutoff": 60.0,
    },
    "stiff": {"kind": "pd", "stiffness": 800.0, "damping": 3.0},
}
MEMORY = 64


def proxy_of(seq: int, stamp: float) -> Proxy:
    depth = -1e-3 - 1e-5 * (seq * 7 % 11)
    vector = (0.0, 0.0, depth)
    return Proxy(
        seq=seq,
        stamp=stamp,
        position=vector,
        proxy=(0.0, 0.0, 0.0),
        normal=(0.0, 0.0, 1.0),
        distance=depth,
        contact=True,
        delay=0.1,
    )


Feed: TypeAlias = Callable[[Publisher, Callable[[int], Force]], None]


def answered(
    place: Path,
    tick: str,
    law: str,
    pace: str,
    feed: Feed,
    schedule: Sequence[dict[str, Any]] = (),
    made: list[Coupling] | None = None,
) -> tuple[list[Force], Coupling]:
    """Run a coupling on this thread, fed by another; return its answers."""
    assert choose(tick, [Coupling.kernel_module], print) == tick  # type: ignore[arg-type]
    context = new_context()
    source, sink = f"ipc://{place}/proxy", f"ipc://{place}/force"
    node = Coupling(
        setup_of(
            name="coupling",
            kind="coupling",
            tick=tick,
            pace=pace,
            sources={topics.PROXY: source},
            parameters={
                "law": law,
                "laws": LAWS,
                "memory": MEMORY,
                "stability": "off",
                "figures": False,
                "schedule": list(schedule),
            },
        )
    )
    if made is not None:
        made.append(node)
    load_kernel(node)
    node.configure()
    proxies, node.publisher = Publisher(context, source), Publisher(context, sink)
    node.connect(
        lambda endpoints, wanted, queue: Subscription(context, endpoints, wanted, queue)
    )
    inbox = Subscription(context, [sink], [topics.FORCE])
    wait_for(
        lambda: proxies.listeners() and node.publisher.listeners(), "both subscriptions"
    )
    forces: list[Force] = []

    def force_of(seq: int) -> Force:
        while not forces or forces[-1].seq != seq:
            frames = inbox.receive(10_000)
            assert frames is not None, f"no force for tick {seq}"
            forces.append(Decoder(Force).decode(frames[1]))
        return forces[-1]

    failed: list[BaseException] = []

    def work() -> None:
        try:
            feed(proxies, force_of)
        except BaseException as error:  # noqa: BLE001  # told by the thread that waits
            failed.append(error)
        node.stopping = True

    thread = threading.Thread(target=work)
    thread.start()
    node.loop()
    thread.join()
    for socket in (inbox, proxies, node.publisher, node.inbox):
        assert socket is not None
        socket.close()
    context.term()
    assert not failed, failed
    return forces, node


def one_by_one(
    ticks: Sequence[int],
) -> Callable[[Publisher, Callable[[int], Force]], None]:
    def feed(proxies: Publisher, force_of: Callable[[int], Force]) -> None:
        for seq in ticks:
            proxies.send_hop(topics.PROXY.encode(), encode(proxy_of(seq, 0.002 * seq)))
            force_of(seq)

    return feed


@pytest.mark.parametrize("law", LAWS)
def test_ticks_left_out_are_bridged_with_the_same_bits(
    tmp_path: Path, law: str
) -> None:
    # Gaps of 1, 5, almost as long as the memory, and one beyond it.
    ticks, at = list(range(20)), 19
    for missing in (1, 5, MEMORY - 2, MEMORY - 1, 3 * MEMORY):
        at += missing + 1
        ticks += [at, at + 1, at + 2]
        at += 2
    runs = {
        tick: answered(tmp_path, tick, law, "lockstep", one_by_one(ticks))
        for tick in ("plain", "compiled")
    }
    (plain, one), (compiled, other) = runs["plain"], runs["compiled"]
    assert [force.seq for force in compiled] == ticks
    assert [force.force for force in compiled] == [force.force for force in plain]
    assert other.counted() == one.counted()
    assert other.ticks_compiled == len(ticks) - 1  # the first one is plain
    assert one.ticks_compiled == 0


@pytest.mark.parametrize("tick", ["plain", "compiled"])
def test_of_messages_that_are_too_late_the_newest_is_answered(
    tmp_path: Path, tick: str
) -> None:
    late = 7

    def feed(proxies: Publisher, force_of: Callable[[int], Force]) -> None:
        # In time until here: a minute ahead is not late, whatever the machine does.
        proxies.send_hop(
            topics.PROXY.encode(), encode(proxy_of(0, time.monotonic() + 60.0))
        )
        force_of(0)
        for seq in range(1, late + 1):
            proxies.send_hop(
                topics.PROXY.encode(), encode(proxy_of(seq, time.monotonic() - 60.0))
            )
        force_of(late)

    forces, node = answered(tmp_path, tick, "pd", "realtime", feed)
    # How many had arrived when it looked is the machine's to say; each was answered or left out,
    # and those are counted.
    assert len(forces) + node.counters.skipped == late + 1
    assert node.counters.gaps == node.counters.skipped
    assert node.status().received == len(forces) + node.counters.skipped
    if tick == "compiled":
        assert node.ticks_compiled == len(forces) - 1  # the first one is plain


def test_both_ticks_take_and_refuse_the_same(tmp_path: Path) -> None:
    """Compiled ticks accepted payloads up to 64 bytes too long; plain ones lost a tick."""

    def padded(seq: int, size: int) -> bytes:
        plain: dict[str, Any] = msgspec.to_builtins(proxy_of(seq, 0.002 * seq))
        empty = len(msgspec.msgpack.encode({**plain, "later": bytes(60_000)})) - 60_000
        payload = msgspec.msgpack.encode({**plain, "later": bytes(size - empty)})
        assert len(payload) == size
        return payload

    def feed(proxies: Publisher, force_of: Callable[[int], Force]) -> None:
        topic = topics.PROXY.encode()
        sizes = {
            2: MAX_PAYLOAD,
            3: MAX_PAYLOAD + 1,
            5: MAX_PAYLOAD + 64,
            7: MAX_PAYLOAD + 65,
        }
        for seq in range(20):
            if seq in (9, 10, 12):
                # A message of one frame, twice in a row, and once alone.
                proxies._hop(topic)
            proxies.send_hop(
                topic,
                padded(seq, sizes[seq])
                if seq in sizes
                else encode(proxy_of(seq, 0.002 * seq)),
            )
            if sizes.get(seq, 0) <= MAX_PAYLOAD:
                force_of(seq)

    runs = {}
    for tick in ("plain", "compiled"):
        forces, node = answered(tmp_path, tick, "pd", "lockstep", feed)
        assert [force.seq for force in forces] == [
            seq for seq in range(20) if seq not in (3, 5, 7)
        ]
        runs[tick] = (
            [force.force for force in forces],
            node.events.refused,
            node.counters.gaps,
            node.received,
        )
        assert (node.events.refused, node.counters.gaps) == (6, 3)
    assert runs["compiled"] == runs["plain"]


def test_swaps_and_fades_stay_compiled_with_the_same_bits(tmp_path: Path) -> None:
    """Swaps hard and faded, recursive laws, a gap in mid-fade, swaps during a fade."""
    schedule = [
        {"at": 0.020, "law": "pd_filtered", "ramp": 12},
        {"at": 0.060, "law": "pd", "ramp": 9},
        {"at": 0.100, "law": "pd_filtered"},
    ]
    ticks = [*range(14), *range(17, 33), *range(36, 90)]
    runs, nodes = {}, {}
    for tick in ("plain", "compiled"):
        node: list[Coupling] = []

        def feed(
            proxies: Publisher,
            force_of: Callable[[int], Force],
            node: list[Coupling] = node,
        ) -> None:
            for seq in ticks:
                proxies.send_hop(
                    topics.PROXY.encode(), encode(proxy_of(seq, 0.002 * seq))
                )
                force_of(seq)
                # Each during the fade of the one before.
                if law := {60: "pd", 63: "pd_filtered", 70: "stiff"}.get(seq):
                    node[0]._switch_law(law, ramp=11)

        forces, made = answered(tmp_path, tick, "pd", "lockstep", feed, schedule, node)
        runs[tick], nodes[tick] = (
            [(force.force, force.law, force.revision) for force in forces],
            made,
        )
    assert runs["compiled"] == runs["plain"]
    assert {law for _, law, _ in runs["plain"]} == {"pd", "pd_filtered", "stiff"}
    # Plain are the first tick, those of the three scheduled swaps and no other; a request is taken
    # up between two ticks.
    assert nodes["compiled"].ticks_compiled == len(ticks) - 4
