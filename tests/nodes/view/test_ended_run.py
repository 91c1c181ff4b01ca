"""After the end of a run its page says why, and can start another one."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import pytest

import nodes.view.ended_run
from messages.types import ZERO, DeviceState
from nodes.cli.page import is_demo, with_view
from nodes.launcher import launch_file
from nodes.view.ended_run import wait_for_page
from nodes.view.live import HISTORY, Facts, LiveRun
from nodes.view.run_page import (
    DRAIN_PERIOD,
    REST_AFTER,
    REST_PERIOD,
    STILL_PERIOD,
    Attention,
    RunPage,
    Wakes,
)
from tests.support.coroutines import complete
from tests.support.live_page import live, texts


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def asked(monkeypatch: pytest.MonkeyPatch, *operations: str) -> tuple[bool, list[Any]]:
    """Return whether another run was asked for, and what the page was told."""
    monkeypatch.setattr(nodes.view.ended_run, "ABSENCE", 1.0)
    port, wanted, told = free_port(), list[bool](), list[Any]()

    def serve() -> None:
        found = wait_for_page("t", port, "why", ["run.mcap"], lambda: False)
        wanted.append(found)

    thread = threading.Thread(target=serve)
    thread.start()
    deadline = time.monotonic() + 30.0
    while operations and time.monotonic() < deadline:
        try:
            with live(f"http://127.0.0.1:{port}/t/") as page:
                told.append(texts(page, "ended"))
                for number, op in enumerate(operations):
                    page.send(json.dumps({"op": op, "id": number}))
                    told.append(texts(page, "answer", id=number))
            break
        except OSError:
            time.sleep(0.02)
    thread.join(60.0)
    return wanted[0], told


def test_a_page_starts_another_run_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wanted, (end, refused, answer) = asked(monkeypatch, "set", "restart")
    assert wanted
    assert (end["reason"], end["recordings"]) == ("why", ["run.mcap"])
    assert refused["error"] == "The run has ended; press Start again."
    assert answer["ok"]


def test_nobody_is_waited_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked(monkeypatch) == (False, [])
    with socket.socket() as taken, ThreadPoolExecutor(1) as thread:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = int(taken.getsockname()[1])
        for at, ends in ((free_port(), True), (port, False)):
            waits = thread.submit(wait_for_page, "t", at, "", [], partial(bool, ends))
            assert not waits.result()


def test_all_nodes_of_the_loop_of_a_demo_are_started_again() -> None:
    """A demo is what a page may make unstable, which only a virtual device may be."""
    demo, other = (launch_file.read(name, {}) for name in ("touch_wall", "floor_drop"))
    assert (is_demo(demo), is_demo(other)) == (True, False)
    viewed = with_view(demo).nodes
    assert [name for name, spec in viewed.items() if spec.respawn] == [
        *("driver", "environment", "coupling", "view")
    ]


def test_frames_are_seldom_while_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    facts = Facts("r", "s", "", 0.002, "realtime", "on_arrival", ["x"], "driver")
    run, now = LiveRun(facts), [100.0]
    monkeypatch.setattr("nodes.view.run_page.time.monotonic", lambda: now[0])
    page = RunPage(run, None, None, Attention())  # type: ignore[arg-type]
    sent = []
    for k in range(100):
        now[0] += 0.02
        x = 0.0 if k < 50 else 1e-4 * k
        state = DeviceState(seq=10 * k, stamp=0.0, position=(x, 0.0, 0.0), force=ZERO)
        run.keep("/device/state", state, now[0])
        sent.append(sum(isinstance(one, bytes) for one in page.news()))
    # At rest one frame in STILL_PERIOD, and one more at each end; then all of them.
    assert sum(sent[:50]) <= 50 * 0.02 / STILL_PERIOD + 2
    assert sum(sent[50:]) == 50


def test_what_changes_in_the_last_digits_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop at rest never repeats a position to the bit, so that it was read at full rate."""
    now = [100.0]
    monkeypatch.setattr("nodes.view.run_page.time.monotonic", lambda: now[0])
    wakes = Wakes()

    def pause(x: float, rests: bool = True) -> float:
        now[0] += 0.6 * REST_AFTER
        place = (x, 0.0, 0.0)
        state = DeviceState(seq=1, stamp=0.0, position=place, target=place, force=ZERO)
        return wakes.pause(state, rests)

    assert [pause(1e-9 * k) for k in range(3)] == [DRAIN_PERIOD] * 2 + [REST_PERIOD]
    # A page that asks is answered at once, and a movement is seen at once.
    assert pause(0.0, rests=False) == DRAIN_PERIOD
    assert pause(0.0) == REST_PERIOD
    assert pause(1e-3) == DRAIN_PERIOD
    # What creeps moves, too: it is compared with what was last seen.
    assert [pause(1e-3 + 6e-6 * k) for k in range(6)][2:] == [DRAIN_PERIOD] * 4


def test_a_page_that_nobody_sees_gets_nothing_until_it_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    facts = Facts("r", "s", "", 0.002, "realtime", "on_arrival", ["x"], "driver")
    run, now = LiveRun(facts), [100.0]
    monkeypatch.setattr("nodes.view.run_page.time.monotonic", lambda: now[0])
    attention = Attention()
    hidden, other = (RunPage(run, None, None, attention) for _ in range(2))  # type: ignore[arg-type]

    def play(ticks: range) -> list[int]:
        sent = [0, 0]
        for seq in ticks:
            place = (1e-3 * seq, 0.0, 0.0)
            state = DeviceState(seq=seq, stamp=0.0, position=place, force=ZERO)
            run.keep("/device/state", state, now[0])
            if seq % 50 == 0:
                now[0] += 0.1
                run.tick(now[0])
                sent = [
                    many + len(page.news())
                    for many, page in zip(sent, (hidden, other), strict=True)
                ]
        return sent

    def see(on: bool) -> None:
        complete(hidden.ask({"op": "seen", "on": on}))

    assert all(play(range(200)))
    see(False)
    assert len(attention.viewers) == 1
    nothing, all_of_it = play(range(200, 200 + round(1.2 * HISTORY / 0.002)))
    assert nothing == 0 < all_of_it
    see(True)
    assert len(attention.viewers) == 2
    *_, frame = hidden.news()
    kind, count, _, void = struct.unpack_from("<4I", frame)  # type: ignore[arg-type]
    # It begins anew with what a page that opens now would get.
    assert (kind, void) == (1, 1)
    assert count == round(HISTORY / 0.002)
    see(False)
    run.end("a test")
    run.tick(now[0])
    assert any("a test" in text for text in hidden.news() if isinstance(text, str))
