"""Every parser with damaged input: it may raise only the documented error.

Valid inputs of each parser are cut, spliced, repeated, flipped and mixed with values at which
formats break. The test set does a few hundred per parser; a long run is requested with::

    HAPTIC_FUZZ_SECONDS=600 pytest tests/test_fuzz.py

which shares the seconds among the parsers, or by the number of inputs per parser::

    HAPTIC_FUZZ_INPUTS=10000000 pytest tests/test_fuzz.py -k "wire or request"

HAPTIC_FUZZ_SEED=… repeats or varies it. An input that breaks a parser is shown as a Python literal,
to become a test of that parser.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, cast

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import topics
from messages.codec import Decoder, MessageRefusedError, encode
from messages.errors import AT_MOST, Remedy
from messages.transport import keys
from messages.transport.endpoints import EndpointRefusedError, split
from messages.transport.keys import KeyRefusedError, parse_key
from messages.transport.requests import Reply, Request, decode_reply, decode_request
from messages.types import DeviceState, Event, Force, NodeStatus, Proxy
from nodes.driver.pointer import PointerReader
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.join import Starter
from nodes.launcher.runs import RunError, RunInfo
from nodes.laws.parse import LawRefusedError, parse_law
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording import mcap_walk
from nodes.recording.reader import Recording
from nodes.recording.recover import recover
from nodes.recording.writer import RecordError, RecordWriter
from nodes.view import server
from nodes.view.commands import Commander, CommandError
from nodes.view.shared_hand import SharedHand
from tests.support import ROOT
from tests.support.launching import private_runtime_dir
from tests.support.recorded import drop
from tests.support.scanned import assert_read_alike
from tests.support.setups import setup_of

SECONDS = float(os.environ.get("HAPTIC_FUZZ_SECONDS", "0"))
INPUTS = int(os.environ.get("HAPTIC_FUZZ_INPUTS", "0"))
SEED = int(os.environ.get("HAPTIC_FUZZ_SEED", "1"))
EXAMPLES = 100

TELLING = [
    *(bytes([value]) * count for value in (0x00, 0xFF, 0x7F, 0x80, 0xC1) for count in (1, 2, 4, 8)),
    *(value.to_bytes(8, order) for value in (1, 2**31, 2**32 - 1, 2**63 - 1,
    2**63) for order in ("little", "big")),
    b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00", b"\xcb\x7f\xf0\x00\x00\x00\x00\x00\x00",
    b"\x91" * 2000, b"\xdd\xff\xff\xff\xff",
    b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xd9\xff", b"[" * 200, b"{" * 200,
    b"- " * 50, b"&a *a", b"<<: ",
    b"!!python/object/apply:os.system", b"!!binary x", b"!!timestamp 1", b"2026-13-45", b"1:99:99",
    b".nan", b"-.inf",
    b"1e400", b"0o99", b"0x", b"? ", b"\t", b"\r", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"$(var x)",
    b"---\n", b"...\n",
    b"%YAML 9.9\n",
]  # fmt: skip
"""Values at which formats break: integer limits, lengths, deep nests, tags, characters."""


def damage(luck: random.Random, corpus: list[bytes]) -> bytes:
    """Damage one of some valid inputs in one to six ways."""
    found = bytearray(luck.choice(corpus))
    for _ in range(luck.randint(1, 6)):
        at = luck.randint(0, len(found))
        to = min(len(found), at + luck.choice((1, 2, 4, 8, 40, 1000)))
        way = luck.randrange(7)
        if way == 0 and found:
            found[at % len(found)] ^= 1 << luck.randrange(8)
        elif way == 1:
            del found[at:to]
        elif way == 2:
            found[at:at] = found[at:to] * luck.choice((1, 2, 30))
        elif way == 3:
            piece = luck.choice(TELLING)
            found[at : at + len(piece)] = piece
        elif way == 4:
            found[at:at] = luck.choice(TELLING)
        elif way == 5:
            other = luck.choice(corpus)
            start = luck.randint(0, len(other))
            found[at:to] = other[start : start + luck.choice((1, 4, 40, 1000))]
        else:
            del found[at:]
    return bytes(found)


class Target(NamedTuple):
    """A parser, valid inputs, and the exceptions it may raise."""

    name: str
    corpus: list[bytes]
    parse: Callable[[bytes], object]
    error: tuple[type[Exception], ...]


def _recording() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drop.mcap"
        with RecordWriter(
            str(path), {"run": "r"}, launch_file="x: 1\n", parameters={"driver": "{}"}
        ) as writer:
            for topic, message in drop(40, switch=20):
                writer.write(topic, message, 1.0 + message.stamp)
        return path.read_bytes()


@contextlib.contextmanager
def _file(content: bytes) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        path = Path(folder) / "damaged.mcap"
        path.write_bytes(content)
        yield path


def _read(content: bytes) -> None:
    with _file(content) as path:
        for entry in Recording(path).entries():
            assert entry.topic


def _recover(content: bytes) -> None:
    with _file(content) as path:
        recover(path, path.with_name("saved.mcap"))
        # What was saved is a complete recording, or the promise of recover is broken.
        saved = Recording(path.with_name("saved.mcap"))
        for topic in saved.topics:
            with contextlib.suppress(RecordError):
                saved.messages(topic)


def _parts(recording: bytes) -> list[Target]:
    """Return each kind of record alone: checksums hide them from fuzzing of whole files."""
    kinds: dict[str, tuple[int, Callable[[Path, mcap_walk.Record], object]]] = {
        "channel": (4, mcap_walk.parse_channel),
        "schema": (3, mcap_walk.parse_schema),
        "metadata": (12, mcap_walk.parse_metadata),
        "message": (5, mcap_walk.parse_message),
        "chunk": (6, lambda path, record: list(mcap_walk.unpack_chunk(path, record))),
    }
    with _file(recording) as path:
        records = list(mcap_walk.walk(path))
        for record in [
            record for record in records if record.opcode == mcap_walk.CHUNK
        ]:
            records += mcap_walk.unpack_chunk(path, record)
    targets = []
    for name, (opcode, parse) in kinds.items():
        corpus = [
            bytes(record.content) for record in records if record.opcode == opcode
        ][:20]
        assert corpus, name

        def attempt(
            content: bytes,
            opcode: int = opcode,
            parse: Callable[[Path, mcap_walk.Record], object] = parse,
        ) -> object:
            return parse(Path("x.mcap"), mcap_walk.Record(0, opcode, content))

        targets.append(Target(f"mcap {name}", corpus, attempt, (RecordError,)))
    return targets


def _launch_file(content: bytes) -> None:
    with _file(content) as path:
        scene = path.with_name("scene.yaml")
        # What a scenario names beside itself: a scene of bodies is read with the launch file, for
        # the mass of its tool.
        for folder in ("bodies", "meshes"):
            path.with_name(folder).symlink_to(ROOT / "launch" / folder)
        scene.write_bytes(content)
        launch_file.read(str(scene), {})


def _text(parse: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda content: parse(content.decode("utf-8", "replace"))


def _law(text: str) -> None:
    parse_law(parse_yaml(text, "fuzz"), "fuzz")


def _starter(starter: Starter) -> Callable[[bytes], object]:
    """Check a setup from a launcher on another machine."""

    def accept(content: bytes) -> None:
        try:
            data = msgspec.json.decode(content)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise ParameterError(str(error)) from error
        setup = starter.accept(data)
        shutil.rmtree(setup.run_dir)

    return accept


def _waiting() -> Starter:
    """Create a node that waits for its launcher, with its own keys."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTIC_KEYS", folder)
        keys.new_identity()
        return Starter("environment", "127.0.0.1", 5000)


def _setup(starter: Starter) -> bytes:
    return msgspec.json.encode(
        setup_of(
            run="r-1",
            name="environment",
            kind="environment",
            publish=starter.publish,
            control=starter.control,
            sources={"/device/state": f"tcp://127.0.0.1:5600#{'ab' * 32}"},
            lease=10.0,
            by_hand=True,
            parameters={
                "surface": {"kind": "plane", "axis": "z", "position": 0.0, "normal": 1}
            },
        )
    )


def _key_file(content: bytes) -> None:
    with (
        tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("HAPTIC_KEYS", folder)
        (Path(folder) / "allowed").mkdir(mode=0o700)
        for path in (
            Path(folder) / "identity.key",
            Path(folder) / "allowed" / "robot.key",
        ):
            path.write_bytes(content)
            path.chmod(0o600)
        # It never raises: what cannot be read lets in nobody.
        keys.trusted()
        keys.identity()


def _identity() -> bytes:
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTIC_KEYS", folder)
        keys.new_identity()
        return (Path(folder) / "identity.key").read_bytes()


def _page_request(content: bytes) -> None:
    """Execute a page's request in a run without nodes, where every request must be refused."""
    request = server._decoded(content)
    if request is not None and request.get("op") == "hand":
        server._moved(cast("server.Page", _NoHand()), request.get("target"))
    elif request is not None and request.get("op") != "record":
        commander = Commander(RunInfo(run="r", scenario="s", launcher=0, nodes={}))
        with contextlib.suppress(CommandError):
            commander.do(request)
        commander.end()


class _NoHand:
    """A page whose hand is a file mapped by a driver."""

    def hand(self, target: Sequence[float] | None) -> str:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
            reader = PointerReader(Path(folder) / "hand", 1.0)
            hand = SharedHand(Path(folder) / "hand")
            told = hand.move(1, target)
            hand.close()
            reader.close()
        return told


def targets() -> list[Target]:
    """Return every parser of the project that reads external data."""
    wire = [(topic, encode(message)) for topic, message in drop(12, switch=5)]
    wire += [
        ("/a/event", encode(Event(seq=1, stamp=0.1, node="a", kind="k", reason="r")))
    ]
    wire += [
        (
            "/a/status",
            encode(
                NodeStatus(seq=1, stamp=0.1, node="a", kind="k", state="ready", pid=1)
            ),
        )
    ]
    requests = [
        Request("param.set", {"values": {"laws.pd.stiffness": 1e3}}),
        Request("status"),
        Request("law.switch", {"law": "pd"}),
    ]
    way = Remedy(
        AT_MOST, "the largest stiffness that is accepted is 9", {"stiffness": 9.0}
    )
    replies = [
        Reply(True, {"a": [1, 2.5, None, {"b": "c"}]}),
        Reply(False, error="no", remedies=(way,)),
    ]
    scenes = [path.read_bytes() for path in scenario_files.scenarios().values()]
    laws = [
        b"{kind: pd, stiffness: 1000.0, damping: 3.0}",
        b"{kind: pd_alpha, stiffness: 1000.0, damping: 3.0, order: 1.2, taps: 10, gains: paper}",
        (
            b"{kind: multi_term, stiffness: 9.0, damping: 1.0, terms: [{gain: 1.0, order: 0.5}],"
            b" taps: 4, gains: physical}"
        ),
        b"{kind: fir, taps: [1000.0, -3.0]}",
    ]
    recording, starter = _recording(), _waiting()
    found = []
    for topic in {topic for topic, _ in wire}:
        kind = topics.message_type(topic)
        assert kind is not None
        corpus = [payload for name, payload in wire if name == topic]
        found.append(
            Target(
                f"wire {topic}", corpus, Decoder(kind).decode, (MessageRefusedError,)
            )
        )
    found += [
        Target(
            "request",
            list(map(msgspec.msgpack.encode, requests)),
            lambda b: decode_request([b]),
            (MessageRefusedError,),
        ),
        Target(
            "reply",
            list(map(msgspec.msgpack.encode, replies)),
            lambda b: decode_reply([b]),
            (MessageRefusedError,),
        ),
        Target(
            "setup from another machine",
            [_setup(starter)],
            _starter(starter),
            (ParameterError, EndpointRefusedError, KeyRefusedError, RunError),
        ),
        Target(
            "yaml",
            [*scenes, *laws],
            _text(lambda text: parse_yaml(text, "fuzz")),
            (ParameterError,),
        ),
        Target("launch file", scenes, _launch_file, (ParameterError,)),
        Target("law", laws, _text(_law), (ParameterError, LawRefusedError)),
        Target("key", [b"ab" * 32, b"0" * 40], _text(parse_key), (KeyRefusedError,)),
        Target(
            "endpoint",
            [b"tcp://127.0.0.1:1#" + b"ab" * 32, b"ipc:///x"],
            _text(split),
            (EndpointRefusedError, KeyRefusedError),
        ),
        Target("key file", [_identity()], _key_file, (KeyRefusedError,)),
        Target(
            "page request",
            [
                b'{"op":"hand","target":[0.1,0,1]}',
                b'{"op":"set","id":1,"node":"a","values":{"law":"pd","x":[1.5]}}',
                b'{"op":"law","field":"gain","value":1}',
                b'{"op":"switch","law":"pd","ramp":2}',
                b'{"op":"undo"}',
                # Once not answered at all: names that are no names, and a number that no float can
                # hold.
                b'{"op":[1],"id":1}',
                b'{"op":"set","node":[1],"values":3}',
                b'{"op":"hand","target":[0,0,1' + b"0" * 400 + b"]}",
            ],
            _page_request,
            (),
        ),
        *(
            # What is read compiled, the plain decoder must read too, and the same.
            Target(
                f"compiled {kind.__name__}",
                [payload for name, payload in wire if name == topic],
                partial(assert_read_alike, kind),
                (),
            )
            for topic, kind in (
                (topics.DEVICE_STATE, DeviceState),
                (topics.PROXY, Proxy),
                (topics.FORCE, Force),
            )
        ),
        Target("recording", [recording], _read, (RecordError,)),
        Target("recover", [recording], _recover, (RecordError,)),
        *_parts(recording),
    ]
    return sorted(found, key=lambda target: target.name)


TARGETS = targets()


def attempt(target: Target, luck: random.Random) -> bool:
    """Damage an input and parse it; return True if it was still valid."""
    content = damage(luck, target.corpus)
    try:
        target.parse(content)
    except target.error:
        return False
    except Exception as error:
        raise AssertionError(
            f"{target.name}: {type(error).__name__}: {error}; input: {content!r}"
        ) from error
    return True


@pytest.fixture(autouse=True)
def _private(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with private_runtime_dir() as folder:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        yield


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_the_valid_inputs_are_valid(target: Target) -> None:
    for content in target.corpus:
        target.parse(content)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@given(luck=st.randoms(use_true_random=False))
@settings(max_examples=EXAMPLES, database=None)
def test_damaged_input_raises_the_documented_error_only(
    target: Target, luck: random.Random
) -> None:
    attempt(target, luck)


@pytest.mark.skipif(
    not (SECONDS or INPUTS),
    reason="a long run is asked for with HAPTIC_FUZZ_SECONDS or HAPTIC_FUZZ_INPUTS",
)
@pytest.mark.timeout(0)
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_long_run(target: Target) -> None:
    until = time.monotonic() + SECONDS / len(TARGETS)
    count = valid = 0
    while count < INPUTS or time.monotonic() < until:
        valid += attempt(target, random.Random(f"{SEED} {count}"))  # noqa: S311  # to be repeated
        count += 1
    assert count
    print(f"{target.name}: {count} inputs, {valid} of them still valid")
