"""Messages to and from Haply's service, without the service."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import SimpleNamespace
from typing import cast

import pytest
from websockets.sync.client import ClientConnection

from nodes.driver.haply import surplus
from nodes.driver.haply.service import MAX_BUTTONS, PROFILE, ask, buttons, command, read
from nodes.driver.haply.surplus import SurplusAnswers, SurplusError


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("force", [None, (1.0, -2.0, 3.5)])
def test_a_command_asks_for_the_position_or_sets_the_force(
    force: tuple[float, float, float] | None, first: bool
) -> None:
    """Only the first one names the session, whose profile the service then keeps."""
    said = json.loads(command("042", force, first=first))
    (device,) = said["inverse3"]
    assert device["device_id"] == "042"
    assert device["commands"] == (
        {"probe_position": {}}
        if force is None
        else {"set_cursor_force": {"vector": {"x": 1.0, "y": -2.0, "z": 3.5}}}
    )
    session = {"configure": {"profile": {"name": PROFILE}}}
    assert said.get("session") == (session if first else None)


def test_buttons_are_bits_in_the_order_of_their_names() -> None:
    def state(pressed: dict[str, object]) -> str:
        return json.dumps({"wireless_verse_grip": [{"state": {"buttons": pressed}}]})

    assert buttons(read("{}")) == (0, False)
    assert buttons(read(state({"b": True, "a": False, "c": True, "d": 1}))) == (
        0b0110,
        False,
    )
    names = [f"b{n:02}" for n in range(MAX_BUTTONS + 1)]
    most = dict.fromkeys(names[:-1], True)
    assert buttons(read(state(dict(most)))) == (2**MAX_BUTTONS - 1, False)
    assert buttons(read(state({**most, names[-1]: True}))) == (2**MAX_BUTTONS - 1, True)
    with pytest.raises(ValueError, match="what it should not"):
        read("[1")


class Socket:
    """A connection on which some answers have come."""

    def __init__(self, answers: int) -> None:
        self.left = answers

    def recv(self, timeout: float) -> str:
        """Return the next answer without waiting."""
        assert timeout == 0
        if not self.left:
            raise TimeoutError
        self.left -= 1
        return str(self.left)


def test_a_hundred_surplus_answers_are_tolerated_at_once_and_ten_a_second() -> None:
    counted: list[int] = []
    tolerated = SurplusAnswers(counted.append)
    tolerated.begin()
    began = time.monotonic()
    assert tolerated.newest(cast(ClientConnection, Socket(0)), "asked") == "asked"
    assert tolerated.newest(cast(ClientConnection, Socket(100)), "asked") == "0"
    assert counted == list(range(1, 101))
    with pytest.raises(SurplusError):
        tolerated.newest(cast(ClientConnection, Socket(10**6)), "asked")
    assert 101 <= len(counted) <= 101 + 10.0 * (time.monotonic() - began)


def test_tolerance_comes_back_by_ten_answers_a_second_up_to_a_hundred(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 50.0
    monkeypatch.setattr(surplus, "time", SimpleNamespace(monotonic=lambda: now))
    tolerated = SurplusAnswers(lambda _: None)

    def more(answers: int) -> None:
        tolerated.newest(cast(ClientConnection, Socket(answers)), "asked")

    tolerated.begin()
    more(100)
    now += 3.0
    more(30)
    with pytest.raises(SurplusError):
        more(1)
    now += 60.0
    more(100)
    with pytest.raises(SurplusError):
        more(1)


@pytest.mark.parametrize(
    ("status", "body", "expected"),
    [
        (200, b'{"ok": true, "data": [1]}', [1]),
        (200, b'{"ok": false, "data": [1]}', None),
        (200, b"[true]", None),
        (200, b"no JSON", None),
        (404, b'{"ok": true, "data": [1]}', None),
        # A mebibyte is read, and a byte more is cut off.
        (200, b'{"ok": true, "data": [1]}'.ljust(1 << 20), [1]),
        (200, b'{"ok": true, "data":'.ljust((1 << 20) - 3) + b"[1]}", None),
    ],
)
def test_what_the_service_says_is_asked_by_http(
    status: int, body: bytes, expected: object
) -> None:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            assert self.path == "/devices"
            self.send_response(status)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        answering = threading.Thread(target=server.handle_request)
        answering.start()
        assert ask("127.0.0.1", server.server_port, "/devices") == expected
        answering.join()
        port = server.server_port
    assert ask("127.0.0.1", port, "/devices") is None
