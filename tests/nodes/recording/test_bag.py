"""``haptic bag``: output, files and refusals."""

from __future__ import annotations

import json
import re
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zstandard

from messages import topics
from messages.codec import Decoder
from messages.transport.context import new_context
from messages.transport.open_port import OpenPort
from messages.transport.sockets import Subscription
from messages.types import Event, Message
from nodes.cli import main
from nodes.recording import mcap_walk
from nodes.recording.export import export_csv, export_npz, plain_names
from nodes.recording.play import play
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError, RecordWriter
from tests.support.recorded import PUBLISHES, drop

MISSED = (40, 41, 150)


def write(path: Path, sent: list[tuple[str, Message]], **manifest: str) -> None:
    with RecordWriter(
        path,
        {"scenario": "floor_drop", "pace": "realtime", "publishes": PUBLISHES}
        | manifest,
    ) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp + 1e-4)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / "drop.mcap"
    write(path, list(drop(300, missed=MISSED, switch=100)))
    return path


@pytest.fixture
def cut(bag: Path) -> Path:
    path = bag.with_name("cut.mcap")
    data = bag.read_bytes()
    # Behind the second chunk, before the end.
    path.write_bytes(data[: len(data) * 2 // 3])
    return path


def haptic(
    capsys: pytest.CaptureFixture[str], *arguments: str | Path
) -> tuple[int, str, str]:
    code = main.main(["bag", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def answered(
    capsys: pytest.CaptureFixture[str], *arguments: str | Path
) -> dict[str, Any]:
    code, out, err = haptic(capsys, *arguments, "--json")
    assert code == 0, err
    found: dict[str, Any] = json.loads(out.splitlines()[-1])
    return found


# -- info and recover
# ------------------------------------------------------------------------------------------------


def test_info(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = answered(capsys, "info", bag)
    assert told["recovered"] is False
    assert told["complete"] is True
    # From the first tick's stamp to the last one's; recorded to the nanosecond.
    assert told["duration_s"] == pytest.approx(299 * 0.002, abs=1e-9)
    assert {
        topic: (figures["messages"], figures["gaps"])
        for topic, figures in told["topics"].items()
    } == {
        topics.DEVICE_STATE: (300, 0),
        topics.PROXY: (300, 0),
        topics.FORCE: (300, 0),
        topics.RECEIPT: (1, 0),
        "/driver/status": (1, 0),
        "/environment/status": (1, 0),
    }
    assert told["nodes"]["driver"] == {"sent": 300, "recorded": 300, "lost": 0}
    code, out, _ = haptic(capsys, "info", bag)
    assert code == 0
    assert re.search(r"/device/state +300 +500 +0 +0\n", out)
    assert "driver: sent 300, recorded 300: all there" in out


def test_info_and_recover_of_a_cut_file(
    cut: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = answered(capsys, "info", cut)
    assert before["recovered"] is True
    assert before["complete"] is False
    assert before["cut"].startswith(f"{cut}: cut at byte ")
    kept = {topic: figures["messages"] for topic, figures in before["topics"].items()}
    assert 0 < kept[topics.DEVICE_STATE] < 300
    saved = answered(capsys, "recover", cut)
    out = cut.with_suffix(".recovered.mcap")
    assert saved == {
        "out": str(out),
        "messages": kept,
        "problems": [before["cut"]],
        "recovered": True,
    }
    after = answered(capsys, "info", out)
    assert (after["recovered"], after["complete"], after["topics"]) == (
        True,
        True,
        before["topics"],
    )
    assert haptic(capsys, "recover", cut)[0] == 2
    assert haptic(capsys, "recover", cut, "--force")[0] == 0


def test_recover_of_a_sound_file_says_so(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = haptic(capsys, "recover", bag)
    assert code == 0
    assert "nothing was lost" in out


@pytest.mark.parametrize("verb", ["info", "play", "recover", "export", "plot"])
def test_bad_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    code, _, err = haptic(capsys, verb, tmp_path / "nothing.mcap")
    assert (code, err) == (2, f"haptic: {tmp_path}/nothing.mcap: no such file\n")
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"no recording")
    code, out, err = haptic(capsys, verb, bad)
    assert (code, out) == (1, "")
    assert err.startswith(f"haptic: {bad}: ")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [bad], (
        "nothing is written for a file that cannot be read"
    )


def test_record_without_a_launch(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.chdir(tmp_path)
    code, _, err = haptic(capsys, "record")
    assert code == 2
    assert "nothing is running; start something with: haptic launch" in err


# -- files that are written
# -----------------------------------------------------------------------------------------


def test_topics_of_a_file_choose_no_path() -> None:
    found = plain_names(["/../../etc/passwd", "/a/b_c", "/a_b/c", "", "/ü"])
    assert all(re.fullmatch(r"\w{1,110}", name, re.ASCII) for name in found.values())
    assert len(set(found.values())) == len(found)


@pytest.mark.parametrize(
    ("verb", "made"),
    [
        (["export"], "drop_csv"),
        (["plot"], "drop.png"),
        (["plot", "--xy"], "drop_xy.png"),
    ],
)
def test_nothing_is_overwritten_unasked(
    bag: Path, capsys: pytest.CaptureFixture[str], verb: list[str], made: str
) -> None:
    out = bag.with_name(made)
    assert haptic(capsys, *verb, bag)[0] == 0
    code, _, err = haptic(capsys, *verb, bag)
    assert code == 2
    assert f"{out}: already exists; replace it with --force" in err
    assert haptic(capsys, *verb, bag, "--force")[0] == 0
    other = bag.with_name("other")
    assert haptic(capsys, *verb, bag, "--out", other)[0] == 0
    assert sorted(path.name for path in bag.parent.iterdir()) == sorted(
        [bag.name, made, "other"]
    )


def test_exports_tell_a_place_that_cannot_be_written(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag.with_name("file").write_text("")
    for arguments in (["--format", "csv"], ["--format", "npz"]):
        code, _, err = haptic(
            capsys, "export", bag, *arguments, "--out", bag.with_name("file") / "x"
        )
        assert code == 1
        assert "Not a directory" in err
    with pytest.raises(RecordError, match="exists"):
        export_npz(Recording(bag), bag)
    export_csv(Recording(bag), bag.with_name("csv"))
    with pytest.raises(RecordError, match=r"device_state\.csv: File exists"):
        export_csv(Recording(bag), bag.with_name("csv"))


# -- play
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[OpenPort, Subscription]]:
    context = new_context()
    publisher = OpenPort(context, f"ipc://{tmp_path}/p", print)
    inbox = Subscription(context, [f"ipc://{tmp_path}/p"], [""])
    while not publisher.listeners():
        pass
    yield publisher, inbox
    inbox.close()
    publisher.close()
    context.term()


def test_play_publishes_what_was_recorded(
    bag: Path, pair: tuple[OpenPort, Subscription]
) -> None:
    publisher, inbox = pair
    for entry in play(Recording(bag), publisher, rate=float("inf")):
        frames = inbox.receive(5000)
        assert frames is not None
        assert frames[0].decode() == entry.topic
        assert Decoder(type(entry.message)).decode(frames[1]) == entry.message
    assert inbox.receive(0) is None


def test_play_keeps_the_pace(
    tmp_path: Path, pair: tuple[OpenPort, Subscription], monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher, _ = pair
    path = tmp_path / "r.mcap"
    gaps = [0.0, 1.5, 1.5, 4.0]
    with RecordWriter(path, {}) as writer:
        for seq, log_time in enumerate(gaps):
            writer.write(
                "/a/event",
                Event(seq=seq, stamp=0.0, node="a", kind="b", reason=""),
                100.0 + log_time,
            )
    clock = [1000.0]
    monkeypatch.setattr("nodes.recording.play.time.monotonic", lambda: clock[0])
    monkeypatch.setattr(
        "nodes.recording.play.time.sleep",
        lambda wait: clock.__setitem__(0, clock[0] + wait),
    )
    at = [clock[0] - 1000.0 for _ in play(Recording(path), publisher, rate=2.0)]
    # Receipts are kept to the nanosecond, the clock's doubles near 1000 to 1e-13.
    assert at == pytest.approx([gap / 2.0 for gap in gaps], abs=1e-8)
    with pytest.raises(ValueError, match=r"rate is 0\.0"):
        next(play(Recording(path), publisher, rate=0.0))


def test_play_from_the_command_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    context = new_context()
    endpoint = f"ipc://{tmp_path}/q"
    inbox = Subscription(context, [endpoint], [topics.FORCE])
    seqs: list[int] = []
    decoder = Decoder(topics.LOOP[topics.FORCE])

    def listen() -> None:
        while len(seqs) < 300 and (frames := inbox.receive(20_000)) is not None:
            seqs.append(decoder.decode(frames[1]).seq)

    thread = threading.Thread(target=listen)
    thread.start()
    told = answered(
        capsys,
        "play",
        bag,
        "--endpoint",
        endpoint,
        "--topics",
        topics.FORCE,
        "--rate",
        "inf",
        "--wait",
    )
    thread.join()
    inbox.close()
    context.term()
    assert told == {"published": {topics.FORCE: 300}}
    assert seqs == list(range(300))


@pytest.mark.parametrize(
    ("endpoint", "told"),
    [
        ("tcp://0.0.0.0:9872", "a relay serves this machine only"),
        ("tcp://*:9872", "a relay serves this machine only"),
        ("ipc:///nowhere/at/all", "No such file or directory"),
    ],
)
def test_play_refuses_endpoints(
    bag: Path, capsys: pytest.CaptureFixture[str], endpoint: str, told: str
) -> None:
    code, _, err = haptic(capsys, "play", bag, "--endpoint", endpoint)
    assert code == 2
    assert told in err


def test_a_chunk_made_to_fill_the_memory_is_refused_before_it_is_unpacked(
    tmp_path: Path,
) -> None:
    packed = zstandard.compress(bytes(6 << 20))
    head = (
        mcap_walk.CHUNK_HEAD.pack(0, 0, 6 << 20, 0)
        + struct.pack("<I", 4)
        + b"zstd"
        + struct.pack("<Q", len(packed))
    )
    record = mcap_walk.Record(8, mcap_walk.CHUNK, head + packed)
    with pytest.raises(RecordError, match=f"limit {mcap_walk.MAX_RATIO * len(packed)}"):
        mcap_walk.unpack_chunk(tmp_path, record)


def test_what_a_file_says_does_not_command_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.mcap"
    with RecordWriter(
        path, {"scenario": "\x1b]0;owned\x07\x1b[2J", "run": "r"}
    ) as writer:
        writer.write(
            "/a/event", Event(seq=0, stamp=0.0, node="a", kind="b", reason=""), 100.0
        )
    assert main.main(["bag", "info", str(path)]) == 0
    told = capsys.readouterr().out
    assert "owned" in told
    assert "\x1b" not in told
    assert "\x07" not in told
