"""What sends a compiled tick back to the interpreter: the table of nodes/ARCHITECTURE.md."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from messages.codec import Decoder, encode
from messages.transport.context import new_context
from messages.transport.sockets import Publisher, Subscription
from messages.types import MAX_COUNT, DeviceState, Message, NodeStatus, Proxy, Vector
from nodes.base.node import Node
from nodes.compiled.choose_tick import choose
from nodes.compiled.load import load_kernel
from nodes.coupling.node import Coupling
from nodes.driver.device import DeviceLimits
from nodes.driver.node import Driver
from nodes.environment.node import Environment
from nodes.environment.shapes.touchable import Touchable
from nodes.environment.surfaces import Meeting, Plane
from sim.measure.haptic_commands import wait_for
from tests.support import ROOT
from tests.support.scripted import HandInC, Script, ScriptedSimulation, assert_alike
from tests.support.scripted import played as scripted
from tests.support.scripted_world import Arrival, at
from tests.support.scripts import BOX, answer, answers_but, driver, moving
from tests.support.setups import setup_of

TICKS = 12


class Bowl(Plane, frozen=True, kw_only=True):
    """A surface with Python code."""

    def meeting(self) -> Callable[[Vector], Meeting]:
        """Return the contact of a plane."""
        return super().meeting()


PD = {"kind": "pd", "stiffness": 500.0, "damping": 3.0}


def state_of(seq: int, **changes: Any) -> DeviceState:
    return DeviceState(
        **{
            "seq": seq,
            "stamp": 0.002 * seq,
            "position": (0.0, 0.0, -1e-3),
            "force": (0.0, 0.0, 0.0),
            **changes,
        }
    )


def proxy_of(seq: int, depth: float = -1e-3) -> Proxy:
    position = (0.0, 0.0, depth)
    return Proxy(
        seq=seq,
        stamp=0.002 * seq,
        position=position,
        proxy=(0.0, 0.0, 0.0),
        normal=(0.0, 0.0, 1.0),
        distance=depth,
        contact=True,
    )


class Case(NamedTuple):
    """A node, its messages (bytes are refused), requests after tick 5, expected plain ticks."""

    kind: type[Node]
    parameters: dict[str, Any]
    sent: Sequence[Message | bytes]
    plain: int
    ask: Callable[[Any], Any] = lambda _: None


def environment(sent: Sequence[Message | bytes], plain: int, **surface: Any) -> Case:
    return Case(Environment, {"surface": surface or {"kind": "plane"}}, sent, plain)


def coupling(
    sent: Sequence[Message | bytes],
    plain: int,
    ask: Callable[[Any], Any] = lambda _: None,
    **more: Any,
) -> Case:
    laws = {"pd": PD, "soft": {**PD, "stiffness": 400.0}, "own": {"kind": "excitation"}}
    parameters = {"law": "pd", "laws": laws, "memory": 16, "stability": "off", **more}
    # its first tick is plain, too
    return Case(Coupling, parameters, sent, min(plain + 1, TICKS), ask)


STATES = [state_of(seq) for seq in range(TICKS)]
BALL = {"kind": "sphere", "position": [0.0, 0.0, -0.02], "radius": 0.0195}
PROXIES = [proxy_of(seq) for seq in range(TICKS)]
CASES = {
    ("environment", "a surface of another package"): environment(STATES, TICKS),
    ("environment", "shapes that come into a scene begun without any"): (
        environment(STATES, TICKS - 6)._replace(
            ask=lambda node: node.changes.change(
                lambda: node.store.changed({"surface": BALL}), node.prepare
            )
        )
    ),
    ("environment", "a driver in a fault"): environment(
        [
            *STATES[:4],
            *(state_of(seq, safety="fault") for seq in range(4, 7)),
            *STATES[7:],
        ],
        3,
    ),
    ("environment", "a jump of the device"): environment(
        [
            *STATES[:5],
            *(state_of(seq, rebased=5) for seq in range(5, 9)),
            *(state_of(seq, rebased=9) for seq in range(9, 12)),
        ],
        2,
    ),
    ("coupling", "the first tick, and a jump"): coupling(
        [
            *PROXIES[:5],
            *(msgspec.structs.replace(proxy, rebased=5) for proxy in PROXIES[5:]),
        ],
        1,
    ),
    ("coupling", "the tick of a scheduled swap"): coupling(
        PROXIES,
        2,
        schedule=[{"at": 0.006, "law": "soft"}, {"at": 0.012, "law": "pd", "ramp": 3}],
    ),
    ("coupling", "a law with code of its own"): coupling(PROXIES, TICKS, law="own"),
    ("coupling", "a force that is not finite"): coupling(
        [*PROXIES[:6], proxy_of(6, -1e306), *PROXIES[7:]], 1
    ),
    ("all", "a message that is refused, or comes once more"): coupling(
        [*PROXIES[:4], b"no message", PROXIES[4], PROXIES[4], *PROXIES[5:]], 0
    ),
    ("all", "a request, between two ticks"): coupling(
        PROXIES, 0, lambda node: node._switch_law("soft", ramp=4)
    ),
}
STAYS = {
    "a hard surface, and one for both sides": environment(
        STATES, 0, kind="anchor", position=[0.0, 0.0, 0.01]
    ),
    "shapes": environment(STATES, 0, **BALL),
    "a driver that lets its force in, or has stopped": environment(
        [
            *STATES[:4],
            state_of(4, safety="ramp"),
            state_of(5, safety="stopped"),
            *STATES[6:],
        ],
        0,
    ),
    "nothing to touch": environment(STATES, 0, kind="free"),
    "a gap": coupling([*PROXIES[:3], *PROXIES[6:]], 0),
    "a gap longer than the memory": coupling(
        [*PROXIES[:6], proxy_of(40), proxy_of(41)], 0
    ),
    "a recursive law": coupling(
        PROXIES,
        0,
        law="filtered",
        laws={"filtered": {**PD, "kind": "pd_filtered", "cutoff": 60.0}},
    ),
}


def played(place: Path, case: Case) -> tuple[Node, int]:
    """Run a node in lockstep on this thread, fed by another; return it and its answer count."""
    context = new_context()
    source, sink = f"ipc://{place}/in", f"ipc://{place}/out"
    heard = case.kind.listens_to[0]
    name = "coupling" if case.kind is Coupling else "environment"
    setup = setup_of(
        name=name,
        kind=name,
        tick="compiled",
        pace="lockstep",
        axes=["x", "y", "z"],
        sources={heard: source},
        parameters=case.parameters,
    )
    node: Any = case.kind(setup)
    load_kernel(node)
    node.configure()
    feed, node.publisher = Publisher(context, source), Publisher(context, sink)
    node.connect(
        lambda endpoints, wanted, queue: Subscription(context, endpoints, wanted, queue)
    )
    inbox = Subscription(context, [sink], [case.kind.publishes[0]])
    wait_for(
        lambda: feed.listeners() and node.publisher.listeners(), "both subscriptions"
    )
    answers: list[bytes] = []

    def work() -> None:
        try:
            for message in case.sent:
                feed.send_hop(
                    heard.encode(),
                    message if isinstance(message, bytes) else encode(message),
                )
                if isinstance(message, bytes):
                    wait_for(lambda: node.events.refused, "the refusal")
                else:
                    frames = inbox.receive(20_000)
                    assert frames is not None, f"no answer to {message}"
                    answers.append(frames[1])
                    if message.seq == 5:
                        case.ask(node)
        finally:
            node.stopping = True

    thread = threading.Thread(target=work)
    thread.start()
    node.loop()
    thread.join()
    for socket in (inbox, feed, node.publisher, node.inbox):
        socket.close()
    context.term()
    seqs = [msgspec.msgpack.decode(answer)["seq"] for answer in answers]
    assert seqs == [
        message.seq for message in case.sent if not isinstance(message, bytes)
    ]
    return node, len(set(seqs))


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    kernels = [
        Coupling.kernel_module,
        Driver.kernel_module,
        Environment.kernel_module,
        Touchable.kernel_module,
    ]
    assert choose("compiled", kernels, print) == "compiled"


@pytest.mark.parametrize("row", CASES, ids=": ".join)
def test_what_goes_back_does_and_the_rest_of_the_run_does_not(
    row: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if row[1] == "a surface of another package":
        monkeypatch.setattr("nodes.environment.node.parse_surface", lambda *_: Bowl())
    node, ticks = played(tmp_path, CASES[row])
    assert node.counters.ticks == ticks
    assert ticks - node.ticks_compiled == CASES[row].plain


@pytest.mark.parametrize("row", STAYS)
def test_what_is_not_in_the_table_stays_compiled(row: str, tmp_path: Path) -> None:
    node, ticks = played(tmp_path, STAYS[row])
    assert (node.counters.ticks, ticks - node.ticks_compiled) == (
        ticks,
        STAYS[row].plain,
    )


def test_gaps_without_an_end_are_still_a_count(tmp_path: Path) -> None:
    """Two jumps to the largest tick overflowed the status' counter."""
    jumps = [
        state_of(seq)
        for seq in (0, MAX_COUNT - 1, MAX_COUNT, 0, MAX_COUNT - 1, MAX_COUNT)
    ]
    node, _ = played(tmp_path, environment(jumps, 0))
    assert Decoder(NodeStatus).decode(encode(node.status())).gaps == MAX_COUNT


# -- the driver, whose ticks are compiled whatever happens: what makes them come back in between
# -------------------------

ANSWERED = answers_but()
SILENT = range(20, 70)


def in_lockstep(script: Script, silence: int) -> Script:
    """Delay one answer to a device that can wait by some milliseconds."""
    arrivals = [
        Arrival(at(0, 100.0 * seq + 1000.0 * silence * (seq >= 5)), arrival.frames)
        for seq, arrival in enumerate(script.arrivals)
    ]
    return script._replace(kind=ScriptedSimulation, pace="lockstep", arrivals=arrivals)


DRIVER_CASES = {
    "a change of what the safety does, a refusal": (
        # To damping, to nothing, back to active; two of four refusals are told: at powers of two,
        # as all that repeats.
        driver(
            [*answers_but(*SILENT), *(answer(seq, -3_000.0) for seq in (80, 90, 100))],
            watchdog=5,
            damping_ticks=20,
        ),
        3 + 2,
    ),
    "a call of the device that fails": (
        driver(ANSWERED)._replace(
            hand=lambda: HandInC(
                DeviceLimits(peak_force=8.0, hold=10.0, workspace=BOX), moving, [30, 60]
            )
        ),
        2,
    ),
    "in lockstep, no answer for 0.1 s": (in_lockstep(driver(ANSWERED), 450), 4),
}
DRIVER_STAYS = {
    "late answers, lost ticks, and silence shorter than the watchdog": driver(
        [
            answer(seq, 2_300.0 if seq % 4 == 0 else 500.0)
            for seq in range(120)
            if seq not in (40, 41, 42)
        ],
        {70: 9_000},
    ),
    "next_tick": driver(ANSWERED)._replace(apply="next_tick"),
    "the guard, and limits of peak and slew": driver(
        [answer(seq, force=(0.0, 0.0, -20.0 * (seq % 2))) for seq in range(120)],
        position=lambda seq: (0.0, 0.0, -1e-4 * seq),
        guard={"stiffness": 500.0, "damping": 5.0},
        slew=900.0,
        stop_after=None,
    ),
    "lockstep": in_lockstep(driver(ANSWERED), 0),
}


@pytest.mark.parametrize("row", DRIVER_CASES)
def test_what_brings_a_driver_back_does_and_its_ticks_stay_compiled(
    row: str, tmp_path: Path
) -> None:
    script, times = DRIVER_CASES[row]
    _, node = assert_alike(script, tmp_path)
    assert node.ticks_compiled == node.driving.ticks == 120
    _, usual = scripted(
        in_lockstep(driver(ANSWERED), 0)
        if script.pace == "lockstep"
        else driver(ANSWERED),
        "compiled",
        tmp_path,
    )
    assert node.entered - usual.entered == times


@pytest.mark.parametrize("row", DRIVER_STAYS)
def test_nothing_else_brings_a_driver_back(row: str, tmp_path: Path) -> None:
    _, node = assert_alike(DRIVER_STAYS[row], tmp_path)
    # Once without a tick, to begin with; once until the first force, which is a change of the
    # safety; once for all the rest.
    assert node.entered == 3
    assert node.ticks_compiled == node.driving.ticks


def test_the_page_has_these_rows() -> None:
    text = (ROOT / "nodes" / "ARCHITECTURE.md").read_text(encoding="utf-8")
    table = text.partition("| node | what goes back to the interpreter |")[2].partition(
        "\n\n"
    )[0]
    rows = {
        tuple(cell.strip() for cell in line.split("|")[1:3])
        for line in table.splitlines()[2:]
    }
    assert rows == {*CASES, *(("driver", row) for row in DRIVER_CASES)}
