"""Reading recordings: cut or damaged anywhere, and their figures."""

from __future__ import annotations

import contextlib
import os
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from messages.topics import DEVICE_STATE, FORCE
from messages.types import DeviceState, Message
from nodes.recording import mcap_walk
from nodes.recording.parts import part
from nodes.recording.reader import RECOVERY, Recording
from nodes.recording.recover import extract, recover
from nodes.recording.writer import Output, RecordError, RecordWriter, mcap_writer
from tests.support.recorded import drop
from tests.support.whole import Whole

MAGIC = b"\x89MCAP0\r\n"
FUZZ = settings(max_examples=60)


def read(path: Path) -> list[tuple[str, Message]]:
    return [(entry.topic, entry.message) for entry in Recording(path).entries()]


# -- cut files
# --------------------------------------------------------------------------------------------------


def check_cut(whole: Whole, path: Path, cut: int) -> None:
    path.write_bytes(whole.data[:cut])
    if cut < len(MAGIC):
        with pytest.raises(RecordError, match="no MCAP recording"):
            Recording(path)
        return
    recording = Recording(path)
    kept = whole.sent[: whole.within(cut)]
    assert not recording.complete
    assert recording.recovered
    assert recording.cut
    assert read(path) == kept
    out = path.with_name("out.mcap")
    if not kept:
        with pytest.raises(RecordError, match="no message could be recovered"):
            recover(path, out, overwrite=True)
        return
    saved = recover(path, out, overwrite=True)
    assert sum(saved.messages.values()) == len(kept)
    assert len(saved.problems) == 1
    recovered = Recording(out)
    assert recovered.complete
    assert recovered.recovered
    assert recovered.manifest == recording.manifest
    assert read(out) == kept
    with out.open("rb") as stream:
        count = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
    assert count == len(kept)


@FUZZ
@given(data=st.data())
def test_cut_anywhere(whole: Whole, tmp_path: Path, data: st.DataObject) -> None:
    check_cut(
        whole, tmp_path / "r.mcap", data.draw(st.integers(0, len(whole.data) - 1))
    )


def test_cut_at_the_very_edges(whole: Whole, tmp_path: Path) -> None:
    edges = [end for end, _ in whole.ends[1:]]
    for cut in [
        0,
        1,
        7,
        8,
        9,
        *(edge + step for edge in edges for step in (-1, 0, 1)),
        len(whole.data) - 1,
    ]:
        check_cut(whole, tmp_path / "r.mcap", cut)


def test_a_file_with_an_unwritten_tail(whole: Whole, tmp_path: Path) -> None:
    # What a power cut leaves on some file systems: the length is there, the data are zeros.
    cut = whole.ends[2][0]
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data[:cut] + bytes(4096))
    assert not Recording(path).complete
    assert read(path) == whole.sent[: whole.ends[2][1]]


# -- damaged files
# --------------------------------------------------------------------------------------------------


def check_changed(
    whole: Whole, path: Path, place: int, flip: int, may_cost: int
) -> None:
    changed = bytearray(whole.data)
    changed[place] ^= flip
    path.write_bytes(changed)
    with pytest.raises(RecordError, match=re.escape(path.name)):
        Recording(path)
    out = path.with_name("out.mcap")
    saved = recover(path, out, overwrite=True)
    assert saved.problems
    assert RECOVERY in Recording(out).metadata
    kept = read(out)
    remaining = iter(whole.sent)
    assert all(entry in remaining for entry in kept), (
        "what is recovered is what was recorded, in order"
    )
    assert len(kept) >= len(whole.sent) - may_cost


@FUZZ
@given(data=st.data())
def test_any_changed_byte_is_noticed(
    whole: Whole, tmp_path: Path, data: st.DataObject
) -> None:
    place = data.draw(st.integers(0, len(whole.data) - 1))
    flip = data.draw(st.integers(1, 255))
    # One byte can spoil one chunk, no more.
    largest = max(
        b[1] - a[1] for a, b in zip(whole.ends[:-1], whole.ends[1:], strict=True)
    )
    check_changed(whole, tmp_path / "r.mcap", place, flip, largest)


@pytest.mark.parametrize("byte", range(-1, 8))
@pytest.mark.parametrize("flip", [0x01, 0x20, 0x80, 0xFF])
def test_a_changed_opcode_or_length_of_a_chunk_costs_nothing(
    whole: Whole, tmp_path: Path, byte: int, flip: int
) -> None:
    # Its second byte lays the chunk's end into a later one, whose messages are sound all the same.
    check_changed(
        whole, tmp_path / "r.mcap", whole.starts[0] + 1 + byte, flip, may_cost=0
    )


@pytest.mark.parametrize("byte", range(8))
@pytest.mark.parametrize("flip", [0x01, 0x20, 0x80, 0xFF])
def test_a_changed_inner_length_of_a_chunk_costs_nothing(
    whole: Whole, tmp_path: Path, byte: int, flip: int
) -> None:
    """Zstd ignores data after its frame, so later chunks counted as part of it."""
    inner = whole.starts[0] + mcap_walk.FRAME.size + mcap_walk.CHUNK_HEAD.size + 8
    check_changed(whole, tmp_path / "r.mcap", inner + byte, flip, may_cost=0)


@settings(max_examples=20)
@given(data=st.data())
def test_a_changed_head_of_a_chunk_costs_its_own_messages_at_most(
    whole: Whole, tmp_path: Path, data: st.DataObject
) -> None:
    n = data.draw(st.integers(0, len(whole.starts) - 1))
    place = whole.starts[n] + data.draw(
        st.integers(0, mcap_walk.FRAME.size + mcap_walk.CHUNK_HEAD.size + 40)
    )
    own = whole.ends[n + 1][1] - whole.ends[n][1]
    check_changed(
        whole, tmp_path / "r.mcap", place, data.draw(st.integers(1, 255)), own
    )


def test_the_length_of_a_frame_is_read_from_its_blocks() -> None:
    for content in (b"", b"a", bytes(300_000), os.urandom(300_000), b"ab" * 70_000):
        for checksum in (False, True):
            packer = zstandard.ZstdCompressor(
                write_checksum=checksum, write_content_size=checksum
            )
            frame = packer.compress(content)
            assert mcap_walk.frame_length(frame) == len(frame)
            assert mcap_walk.frame_length(frame + b"behind") == len(frame)
            for cut in (0, 3, len(frame) // 2, len(frame) - 1):
                with pytest.raises(ValueError, match=r"frame|header"):
                    mcap_walk.frame_length(frame[:cut])


def test_a_search_for_chunks_does_not_cost_the_square_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each place that looked like a chunk copied the rest of the file."""
    count, each = 3000, 80
    body = b""
    for n in range(count):
        rest = (count - n) * each
        head = (
            struct.pack("<BQQQQI", mcap_walk.CHUNK, rest - 9, 0, 0, 1 << 20, 1)
            + struct.pack("<I", 4)
            + b"zstd"
        )
        body += (head + struct.pack("<Q", rest - 54) + b"\x28\xb5\x2f\xfd").ljust(
            each, b"\0"
        )
    path = tmp_path / "r.mcap"
    path.write_bytes(MAGIC + body)
    looked_at = 0
    unpack = mcap_walk.unpack_chunk

    def spy(of: Path, record: mcap_walk.Record) -> Iterator[mcap_walk.Record]:
        nonlocal looked_at
        looked_at += len(record.content)
        return unpack(of, record)

    monkeypatch.setattr(mcap_walk, "unpack_chunk", spy)
    with pytest.raises(RecordError, match="no message could be recovered"):
        recover(path, tmp_path / "out.mcap")
    # Three passes: the walk, and two searches.
    assert looked_at <= 3 * len(body)


def test_a_small_file_of_a_million_messages_is_refused(tmp_path: Path) -> None:
    """34 kB took 14 s to open and 48 s to recover."""
    empty = record(mcap_walk.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1) + b"{}")
    # What cannot be packed keeps the ratio that is allowed.
    body = SOUND + record(0x80, os.urandom(1000)) + empty * 20_000
    packed = zstandard.compress(body)
    path = tmp_path / "r.mcap"
    path.write_bytes(MAGIC + chunk(packed, b"zstd", len(body), zlib.crc32(body)))
    with pytest.raises(
        RecordError,
        match=r"damaged chunk at byte 8: more than \d+ records, the limit for its size",
    ):
        Recording(path)
    assert (
        sum(recover(path, tmp_path / "out.mcap").messages.values()) < len(packed) + 128
    )


@FUZZ
@given(data=st.data())
def test_rubbish_raises_nothing_but_a_record_error(
    whole: Whole, tmp_path: Path, data: st.DataObject
) -> None:
    start = data.draw(st.integers(0, len(whole.data)))
    stop = data.draw(st.integers(start, min(start + 600, len(whole.data))))
    rubbish = data.draw(st.binary(max_size=300))
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data[:start] + rubbish + whole.data[stop:])
    for work in (
        lambda: read(path),
        lambda: recover(path, tmp_path / "out.mcap", overwrite=True),
    ):
        # Anything else than a RecordError fails the test.
        with contextlib.suppress(RecordError):
            work()


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(data: bytes, compression: bytes, size: int, checksum: int) -> bytes:
    head = (
        struct.pack("<QQQI", 0, 0, size, checksum)
        + struct.pack("<I", len(compression))
        + compression
    )
    return record(mcap_walk.CHUNK, head + struct.pack("<Q", len(data)) + data)


BOMB = bytes(1 << 20)
SOUND = record(
    mcap_walk.CHANNEL,
    struct.pack("<HHI", 1, 0, 2) + b"/a" + struct.pack("<I", 4) + b"json" + bytes(4),
)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (
            chunk(zstandard.compress(BOMB), b"zstd", 100, 0),
            "compressed frame has another size",
        ),
        (
            chunk(bytes(99_999), b"zstd", mcap_walk.MAX_CHUNK + 1, 0),
            f"limit {mcap_walk.MAX_CHUNK}",
        ),
        (chunk(b"", b"lzo", 0, 0), "compressed with 'lzo'; zstd and lz4 are read here"),
        (chunk(b"rubbish", b"lz4", 7, 0), "damaged chunk"),
        (
            chunk(lz4.frame.compress(BOMB), b"lz4", 100, 0),
            "checksum or size|damaged chunk",
        ),
        (chunk(b"rubbish", b"zstd", 7, 0), "chunk"),
        (chunk(SOUND, b"", len(SOUND), zlib.crc32(SOUND) ^ 1), "checksum"),
        (chunk(SOUND[:-1], b"", len(SOUND) - 1, 0), "does not fit"),
        (SOUND + SOUND.replace(b"/a", b"/b"), "changes its topic"),
        (record(mcap_walk.CHANNEL, b"\1"), "damaged channel"),
        (record(mcap_walk.SCHEMA, b"\1\0\xff\xff\xff\xff"), "damaged schema"),
        (
            record(mcap_walk.METADATA, struct.pack("<I", 1) + b"\xff" + bytes(4)),
            "damaged metadata",
        ),
        (record(mcap_walk.MESSAGE, bytes(21)), "damaged message"),
        (record(mcap_walk.MESSAGE, bytes(22)), "channel 0, which is unknown"),
    ],
)
def test_hostile_records_are_told(tmp_path: Path, body: bytes, told: str) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(MAGIC + body)
    with pytest.raises(RecordError, match=told):
        Recording(path)


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP", b"not a recording at all", bytes(100)]
)
def test_other_files_are_no_recordings(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(content)
    for work in (Recording, lambda path: recover(path, tmp_path / "out.mcap")):
        with pytest.raises(RecordError, match=r"no MCAP recording \(\d+ bytes\)"):
            work(path)
    assert not (tmp_path / "out.mcap").exists()


def test_what_is_not_there_is_told(tmp_path: Path, whole: Whole) -> None:
    with pytest.raises(RecordError, match="cannot be opened: No such file"):
        Recording(tmp_path / "nothing.mcap")
    with pytest.raises(RecordError, match="is a folder; name the recording in it"):
        Recording(tmp_path)
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data)
    with pytest.raises(RecordError, match=r"no topic '/nope'; there are /device/state"):
        list(Recording(path).entries(["/nope"]))
    with pytest.raises(RecordError, match="the recording itself"):
        recover(path, path, overwrite=True)
    assert path.read_bytes() == whole.data


def test_a_sound_file_is_copied_and_nothing_is_reported(
    whole: Whole, tmp_path: Path
) -> None:
    path, out = tmp_path / "r.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole.data)
    assert recover(path, out).problems == []
    assert not Recording(out).recovered
    assert read(out) == whole.sent
    with pytest.raises(RecordError, match="already exists"):
        recover(path, out)


def test_all_parts_of_a_recording_are_recovered(tmp_path: Path) -> None:
    path, out = tmp_path / "r.mcap", tmp_path / "out.mcap"
    sent = list(drop(300, switch=200))
    # In lockstep tick 0 has another date in each part.
    manifest = {"run": "r", "pace": "lockstep", "wall_minus_monotonic_s": "1e9"}
    for number, messages in enumerate((sent[:300], sent[300:700], sent[700:]), 1):
        with RecordWriter(part(path, number), manifest) as writer:
            # The topics have other numbers in each.
            for topic, message in messages:
                writer.write(topic, message, message.stamp + 1e-4)
    second = part(path, 2)
    second.write_bytes(second.read_bytes()[:-300])
    before = Recording(path)
    saved = recover(path, out)
    assert sum(saved.messages.values()) == len(sent)
    assert len(saved.problems) == 1
    assert saved.problems[0].startswith(f"{second}: cut at byte")
    found = Recording(out)
    assert read(out) == read(path) == sent
    assert found.topics == before.topics
    assert (found.complete, found.recovered, found.manifest) == (True, True, manifest)
    with pytest.raises(RecordError, match="the recording itself"):
        recover(path, second, overwrite=True)
    with pytest.raises(RecordError, match="the recording itself"):
        extract(before, second, list(before.topics), overwrite=True)


def test_recordings_of_other_versions_and_of_others(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    output = Output(path, overwrite=False)
    writer = mcap_writer(output, "another version")
    older = writer.register_schema("haptic.DeviceState", "jsonschema", b"{}")
    other = writer.register_schema("somebody.Else", "jsonschema", b"{}")
    for topic, number, text in (
        (DEVICE_STATE, older, b'{"seq": 1, "stamp": 2.0, "position": [0, 0, 3e-3]}'),
        (
            "/renamed",
            older,
            b'{"seq": 1, "stamp": 2.0, "position": [0, 0, 3e-3], "added_later": [1]}',
        ),
        ("/other", other, b"{}"),
        (FORCE, 0, b'{"seq": 1, "stamp": 2.0, "force": [0, 0, "much"]}'),
    ):
        writer.add_message(
            writer.register_channel(topic, "json", number), 0, text, 0, 1
        )
    writer.finish()
    output.close()
    recording = Recording(path)
    assert list(recording.topics) == [DEVICE_STATE, "/renamed", FORCE]
    assert recording.foreign["/other"].messages == 1
    expected = DeviceState(seq=1, stamp=2.0, position=(0.0, 0.0, 3e-3))
    assert (
        recording.messages(DEVICE_STATE) == recording.messages("/renamed") == [expected]
    )
    with pytest.raises(
        RecordError, match=r"/other is somebody\.Else of another program"
    ):
        list(recording.entries(["/other"]))
    with pytest.raises(
        RecordError,
        match=r"/coupling/force seq 1 .*Expected `float`, got `str` - at `\$\.force\[2\]`",
    ):
        recording.messages(FORCE)
