"""Invalid messages are refused, reported and counted, and never stop a node."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import topics
from messages.codec import MAX_PAYLOAD, Decoder, MessageRefusedError, encode
from messages.transport.context import new_context
from messages.transport.requests import MAX_REPLY, Reply, decode_reply, decode_request
from messages.transport.sockets import Publisher, Subscription
from messages.types import MAX_COUNT, DeviceState, Force, Message, Proxy
from tests.support.launching import private_runtime_dir, wait_for
from tests.support.setups import setup_of
from tests.support.strategies import TYPES, messages

GOOD: dict[str, Any] = {"seq": 3, "stamp": 0.006, "force": [0.0, 0.0, 1.5]}


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=25)
def test_what_is_encoded_is_decoded(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(kind))
    payload = encode(message)
    assert Decoder(kind).decode(payload) == message
    assert set(msgpack.unpackb(payload)) == set(kind.__struct_fields__)


@pytest.mark.parametrize(
    "change",
    [
        {"seq": -1},
        {"seq": MAX_COUNT + 1},
        {"seq": 1.5},
        {"seq": None},
        {"seq": "3"},
        {"stamp": math.nan},
        {"stamp": math.inf},
        {"stamp": True},
        {"force": [0.0, 0.0, math.nan]},
        {"force": [0.0, -math.inf, 0.0]},
        {"force": [0.0, 0.0]},
        {"force": [0.0, 0.0, 0.0, 0.0]},
        {"force": {"z": 1.0}},
        {"force": "111"},
        {"law": 7},
        {"law": "x" * 129},
        {"revision": -1},
    ],
    ids=str,
)
def test_wrong_types_limits_and_non_finite_are_refused(change: dict[str, Any]) -> None:
    decoder = Decoder(Force)
    assert decoder.decode(msgpack.packb(GOOD)).seq == 3
    with pytest.raises(MessageRefusedError, match="Force"):
        decoder.decode(msgpack.packb({**GOOD, **change}))


@pytest.mark.parametrize("missing", sorted(GOOD))
def test_missing_fields_are_refused(missing: str) -> None:
    with pytest.raises(MessageRefusedError, match=missing):
        Decoder(Force).decode(
            msgpack.packb(
                {name: value for name, value in GOOD.items() if name != missing}
            )
        )


def test_at_the_limits() -> None:
    decoder = Decoder(Force)
    assert decoder.decode(msgpack.packb({**GOOD, "seq": MAX_COUNT})).seq == MAX_COUNT
    assert decoder.decode(msgpack.packb({**GOOD, "law": "x" * 128})).law == "x" * 128
    # A field of a later version is ignored (evolution rule), however it fills the payload up to the
    # limit. bin16 takes one byte more than bin8
    room = MAX_PAYLOAD - len(msgpack.packb({**GOOD, "new": b""})) - 1
    payload = msgpack.packb({**GOOD, "new": b"x" * room})
    assert len(payload) == MAX_PAYLOAD
    assert decoder.decode(payload).force == (0.0, 0.0, 1.5)
    with pytest.raises(MessageRefusedError, match=str(MAX_PAYLOAD)):
        decoder.decode(msgpack.packb({**GOOD, "new": b"x" * (room + 1)}))


def test_deep_nesting_is_refused_not_followed() -> None:
    deep = b"\x91" * 60_000 + b"\xc0"
    for payload in (deep, b"\x84" + msgpack.packb("new") + deep):
        with pytest.raises(MessageRefusedError):
            Decoder(Force).decode(payload)
        with pytest.raises(MessageRefusedError):
            decode_request([payload])


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=40)
def test_every_truncation_is_refused(kind: type[Message], data: st.DataObject) -> None:
    payload = encode(data.draw(messages(kind)))
    cut = data.draw(st.integers(0, len(payload) - 1))
    with pytest.raises(MessageRefusedError):
        Decoder(kind).decode(payload[:cut])
    with pytest.raises(MessageRefusedError):
        Decoder(kind).decode(payload + b"\xc0")


def test_requests_and_replies_are_one_bounded_frame() -> None:
    request = msgpack.packb({"op": "status", "args": {}})
    assert decode_request([request]).op == "status"
    for frames in (
        [],
        [request, request],
        [request + b"\xc0"],
        [b"x" * (MAX_PAYLOAD + 1)],
        [b"\xff\xfe"],
    ):
        with pytest.raises(MessageRefusedError):
            decode_request(frames)
    for frames in ([], [b"", b""], [b"x" * (MAX_REPLY + 1)], [b"\xc1"]):
        with pytest.raises(MessageRefusedError):
            decode_reply(frames)
    # An operation's name and arguments are bounded too: 128 characters, 64 names.
    for wrong in (
        {"op": "x" * 129},
        {"op": 1},
        {"op": "a", "args": {str(i): 0 for i in range(65)}},
        {"op": "a", "b": 1},
    ):
        with pytest.raises(MessageRefusedError):
            decode_request([msgpack.packb(wrong)])


# Long: one garbage after the other against the same node.
@pytest.mark.process
def test_garbage_sent_to_a_running_node_is_counted_and_told(tmp_path: Path) -> None:  # noqa: PLR0915
    """A real coupling process, fed by the test instead of the environment."""
    with private_runtime_dir() as folder:
        inbox, outbox, control = (
            f"ipc://{folder}/{name}" for name in ("environment.pub", "c.pub", "c.ctl")
        )
        setup = setup_of(
            run="garbage",
            run_dir=str(folder),
            name="coupling",
            kind="coupling",
            factory="nodes.coupling.node:Coupling",
            pace="lockstep",
            publish=outbox,
            control=control,
            sources={topics.PROXY: inbox},
            listeners=1,
            parameters={
                "law": "pd",
                "ease": 0.0,
                "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 0.0}},
            },
        )
        (folder / "coupling.json").write_bytes(msgspec.json.encode(setup))
        context = new_context()
        rogue = Publisher(context, inbox)
        answers = Subscription(context, [outbox], [topics.FORCE])
        node = subprocess.Popen(
            [sys.executable, "-m", "nodes", str(folder / "coupling.json")]
        )
        request = context.socket(zmq.REQ)
        request.linger = 0
        request.connect(control)

        def ask(*frames: bytes) -> dict[str, Any]:
            request.send_multipart(frames)
            assert request.poll(20_000)
            found: dict[str, Any] = msgpack.unpackb(request.recv())
            return found

        status = msgpack.packb({"op": "status"})
        try:
            wait_for(rogue.listeners, "the node's subscription")
            topic = topics.PROXY.encode()
            state = DeviceState(seq=0, stamp=0.0, position=(0.0, 0.0, 0.0))
            bad = [
                b"",
                b"\xc1",
                b"\x91" * 50_000,
                b"x" * (MAX_PAYLOAD + 1),
                encode(state),
            ]
            bad += [
                msgpack.packb(
                    {"seq": 1, "stamp": math.nan, "position": [0] * 3, "proxy": [0] * 3}
                )
            ]
            for payload in bad:
                rogue.send(topic, payload)
            # The subscription is a prefix: a longer topic passes ZeroMQ and must be refused here.
            rogue.send(
                topic + b"/x",
                encode(Proxy(seq=1, stamp=0.0, position=(0.0,) * 3, proxy=(0.0,) * 3)),
            )
            good = Proxy(seq=1, stamp=0.002, position=(0.0, 0.0, -0.001), proxy=(0.0,) * 3,
            normal=(0.0, 0.0, 1.0),
                         distance=-0.001, contact=True)  # fmt: skip
            rogue.send(topic, encode(good))
            frames = answers.receive(20_000)
            assert frames is not None
            # The one good message among the garbage is answered: 1000 N/m · 1 mm.
            force = Decoder(Force).decode(frames[1]).force
            assert force[:2] == (0.0, 0.0)
            assert force[2] == pytest.approx(1.0, rel=1e-12)
            told = ask(status)["result"]
            assert told["refused"] == len(bad) + 1
            assert told["received"] == 1
            refusals = 0
            nasty: list[dict[str, Any]] = [
                {"op": "param.get", "args": {"name": 7}},
                {"op": "param.set", "args": {"values": [1]}},
                {"op": "param.set", "args": {"values": {"law": {"a": 1}}}},
                {"op": "param.set"},
                {"op": "law.switch", "args": {"law": None}},
                {"op": "law.show", "args": {"law": 3}},
                {"op": "param.load", "args": {"values": "x"}},
                {"op": "clock.set", "args": {"offset": "1", "error": 0.0}},
                {"op": "clock.set", "args": {"offset": math.nan, "error": 0.0}},
                {"op": "no such thing"},
            ]
            for wrong in nasty:
                reply = ask(msgpack.packb(wrong))
                assert reply["ok"] is False, wrong
                assert reply["error"], wrong
            for garbage in (
                (b"",),
                (b"\xc1",),
                (status, status),
                (b"", b"", b""),
                (b"\x91" * 50_000,),
            ):
                assert ask(*garbage)["ok"] is False
                refusals += 1
            assert ask(status)["result"]["refused"] == len(bad) + 1 + refusals
            ask(msgpack.packb({"op": "stop"}))
            assert node.wait(20) == 0
        finally:
            if node.poll() is None:
                node.kill()
                node.wait()
            request.close()
            answers.close()
            rogue.close()
            context.term()


@pytest.mark.parametrize(
    "remedies",
    [
        None,
        "raise it",
        [{"kind": "at_most", "text": "5", "values": {"a.b": 5.0}}] * 17,
        [{"kind": "at_most", "text": "5", "values": {"a.b": math.nan}}],
        [{"kind": "at_most", "text": "5", "values": {"a.b": "5"}}],
        [{"kind": "at_most", "text": "5" * 5000}],
        [{"text": "5"}],
    ],
)
def test_invalid_remedies_do_not_hide_why_a_request_was_refused(remedies: Any) -> None:
    reply = {"ok": False, "error": "n.gain: 9, limit 3", "remedies": remedies}
    found = decode_reply([msgpack.packb(reply)])
    assert found == Reply(False, error="n.gain: 9, limit 3")
    # What is no refusal, or has no reason, is no reply.
    for wrong in ({"ok": True}, {"error": ""}, {"error": 3}):
        with pytest.raises(MessageRefusedError):
            decode_reply([msgpack.packb({**reply, **wrong})])
