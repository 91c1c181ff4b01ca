"""Recordings as they are read: cut anywhere, damaged anywhere, and what their figures say."""

from __future__ import annotations

import contextlib
import os
import struct
import time
import zlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.records import Message as RawMessage
from mcap.stream_reader import StreamReader, breakup_chunk

from messages.topics import DEVICE_STATE, FORCE, PROXY, event, status
from messages.types import DeviceState, Event, Message, NodeStatus
from nodes.recording import mcap_walk
from nodes.recording.accounts import accounts, completeness, overruns
from nodes.recording.reader import RECOVERY, Recording
from nodes.recording.recover import recover
from nodes.recording.summary import quantile, summarise
from nodes.recording.wall_clock import LOG_OFFSET, PUBLISH_OFFSET
from nodes.recording.writer import Output, RecordError, RecordWriter, mcap_writer
from tests.support.recorded import PERIOD, drop

OFFSETS = (LOG_OFFSET, PUBLISH_OFFSET)
MAGIC = b"\x89MCAP0\r\n"
# HAPTIC_FUZZ=50 makes a long run of it.
FUZZ = settings(
    max_examples=60 * int(os.environ.get("HAPTIC_FUZZ", "1")),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def write(path: Path, sent: list[tuple[str, Message]], flush_every: int = 120) -> None:
    with RecordWriter(path, {"scenario": "drop", "pace": "lockstep"}, overwrite=True) as writer:
        for number, (topic, message) in enumerate(sent, 1):
            writer.write(topic, message, message.stamp + 1e-4)
            if number % flush_every == 0:
                writer.flush()


class Whole:
    """A sound recording in memory, with the places of its chunks as the reference library tells them.

    Attributes
    ----------
    data : bytes
        The file.
    sent : list
        Topics and messages.
    ends : list of tuple of int
        For each chunk where it ends, and how many messages are in it and before.
    """

    def __init__(self, path: Path) -> None:
        self.sent = list(drop(200, switch=50))
        write(path, self.sent)
        self.data = path.read_bytes()
        with path.open("rb") as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
            assert summary is not None
            self.ends = [(0, 0)]
            for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
                stream.seek(index.chunk_start_offset)
                chunk = next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
                assert isinstance(chunk, Chunk)
                count = sum(isinstance(record, RawMessage) for record in breakup_chunk(chunk, validate_crc=True))
                self.ends.append((index.chunk_start_offset + index.chunk_length, self.ends[-1][1] + count))
        assert self.ends[-1][1] == len(self.sent)
        assert len(self.ends) > 4

    def within(self, cut: int) -> int:
        """Messages in chunks that end at or before a place.

        Parameters
        ----------
        cut : int
            Where the file ends [bytes].

        Returns
        -------
        int
            How many.
        """
        return max(count for end, count in self.ends if end <= cut)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    return Whole(tmp_path_factory.mktemp("whole") / "r.mcap")


def read(path: Path) -> list[tuple[str, Message]]:
    return [(entry.topic, entry.message) for entry in Recording(path).entries()]


# -- cut files -------------------------------------------------------------------------------------------------------


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
        with pytest.raises(RecordError, match="no message that could be saved"):
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
    check_cut(whole, tmp_path / "r.mcap", data.draw(st.integers(0, len(whole.data) - 1)))


def test_cut_at_the_very_edges(whole: Whole, tmp_path: Path) -> None:
    edges = [end for end, _ in whole.ends[1:]]
    for cut in [0, 1, 7, 8, 9, *(edge + step for edge in edges for step in (-1, 0, 1)), len(whole.data) - 1]:
        check_cut(whole, tmp_path / "r.mcap", cut)


def test_a_file_with_an_unwritten_tail(whole: Whole, tmp_path: Path) -> None:
    # What a power cut leaves on some file systems: the length is there, the data are zeros.
    cut = whole.ends[2][0]
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data[:cut] + bytes(4096))
    assert not Recording(path).complete
    assert read(path) == whole.sent[: whole.ends[2][1]]


# -- damaged files ---------------------------------------------------------------------------------------------------


@FUZZ
@given(data=st.data())
def test_any_changed_byte_is_noticed(whole: Whole, tmp_path: Path, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(whole.data) - 1))
    flip = data.draw(st.integers(1, 255))
    changed = bytearray(whole.data)
    changed[place] ^= flip
    path = tmp_path / "r.mcap"
    path.write_bytes(changed)
    with pytest.raises(RecordError, match=r"r\.mcap"):
        Recording(path)
    out = tmp_path / "out.mcap"
    saved = recover(path, out, overwrite=True)
    assert saved.problems
    assert RECOVERY in Recording(out).metadata
    kept = read(out)
    remaining = iter(whole.sent)
    assert all(entry in remaining for entry in kept), "what is recovered is what was recorded, in order"
    # One byte can spoil one chunk, no more.
    largest = max(b[1] - a[1] for a, b in zip(whole.ends[:-1], whole.ends[1:], strict=True))
    assert len(kept) >= len(whole.sent) - largest


@FUZZ
@given(data=st.data())
def test_rubbish_raises_nothing_but_a_record_error(whole: Whole, tmp_path: Path, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(whole.data)))
    stop = data.draw(st.integers(start, min(start + 600, len(whole.data))))
    rubbish = data.draw(st.binary(max_size=300))
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data[:start] + rubbish + whole.data[stop:])
    for work in (lambda: read(path), lambda: recover(path, tmp_path / "out.mcap", overwrite=True)):
        # Anything else than a RecordError fails the test.
        with contextlib.suppress(RecordError):
            work()


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(data: bytes, compression: bytes, size: int, checksum: int) -> bytes:
    head = struct.pack("<QQQI", 0, 0, size, checksum) + struct.pack("<I", len(compression)) + compression
    return record(mcap_walk.CHUNK, head + struct.pack("<Q", len(data)) + data)


BOMB = bytes(1 << 20)
SOUND = record(mcap_walk.CHANNEL, struct.pack("<HHI", 1, 0, 2) + b"/a" + struct.pack("<I", 4) + b"json" + bytes(4))


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (chunk(zstandard.compress(BOMB), b"zstd", 100, 0), "compressed frame has another size"),
        (chunk(b"", b"zstd", mcap_walk.MAX_RECORD + 1, 0), f"limit {mcap_walk.MAX_RECORD}"),
        (chunk(b"", b"lz4", 0, 0), "compressed with 'lz4'"),
        (chunk(b"rubbish", b"zstd", 7, 0), "chunk"),
        (chunk(SOUND, b"", len(SOUND), zlib.crc32(SOUND) ^ 1), "checksum"),
        (chunk(SOUND[:-1], b"", len(SOUND) - 1, 0), "does not fit"),
        (record(mcap_walk.CHANNEL, SOUND[9:].replace(b"json", b"cdr1")), "encoded as 'cdr1'"),
        (SOUND + SOUND.replace(b"/a", b"/b"), "changes its topic"),
        (record(mcap_walk.CHANNEL, b"\1"), "damaged channel"),
        (record(mcap_walk.SCHEMA, b"\1\0\xff\xff\xff\xff"), "damaged schema"),
        (record(mcap_walk.METADATA, struct.pack("<I", 1) + b"\xff" + bytes(4)), "damaged metadata"),
        (record(mcap_walk.MESSAGE, bytes(21)), "damaged message"),
        (record(mcap_walk.MESSAGE, bytes(22)), "channel 0, which is unknown"),
    ],
)
def test_hostile_records_are_told(tmp_path: Path, body: bytes, told: str) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(MAGIC + body)
    with pytest.raises(RecordError, match=told):
        Recording(path)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"not a recording at all", bytes(100)])
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
    with pytest.raises(RecordError, match="cannot be opened: Is a directory"):
        Recording(tmp_path)
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data)
    with pytest.raises(RecordError, match=r"no topic '/nope'; there are /device/state"):
        list(Recording(path).entries(["/nope"]))
    with pytest.raises(RecordError, match="the recording itself"):
        recover(path, path, overwrite=True)
    assert path.read_bytes() == whole.data


def test_a_sound_file_is_copied_and_nothing_is_reported(whole: Whole, tmp_path: Path) -> None:
    path, out = tmp_path / "r.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole.data)
    assert recover(path, out).problems == []
    assert not Recording(out).recovered
    assert read(out) == whole.sent
    with pytest.raises(RecordError, match="exists already"):
        recover(path, out)


def test_recordings_of_other_versions_and_of_others(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    output = Output(path, overwrite=False)
    writer = mcap_writer(output, "another version")
    older = writer.register_schema("haptic.DeviceState", "jsonschema", b"{}")
    other = writer.register_schema("somebody.Else", "jsonschema", b"{}")
    for topic, number, text in (
        (DEVICE_STATE, older, b'{"seq": 1, "stamp": 2.0, "position": [0, 0, 3e-3]}'),
        ("/renamed", older, b'{"seq": 1, "stamp": 2.0, "position": [0, 0, 3e-3], "added_later": [1]}'),
        ("/other", other, b"{}"),
        (FORCE, 0, b'{"seq": 1, "stamp": 2.0, "force": [0, 0, "much"]}'),
    ):
        writer.add_message(writer.register_channel(topic, "json", number), 0, text, 0, 1)
    writer.finish()
    output.close()
    recording = Recording(path)
    assert list(recording.topics) == [DEVICE_STATE, "/renamed", "/other", FORCE]
    expected = DeviceState(seq=1, stamp=2.0, position=(0.0, 0.0, 3e-3))
    assert recording.messages(DEVICE_STATE) == recording.messages("/renamed") == [expected]
    with pytest.raises(RecordError, match="the type of /other is not known here"):
        recording.messages("/other")
    with pytest.raises(RecordError, match=r"/coupling/force seq 1 .*Expected `float`, got `str` - at `\$\.force\[2\]`"):
        recording.messages(FORCE)


# -- figures ---------------------------------------------------------------------------------------------------------


@given(seqs=st.sets(st.integers(0, 2**34), min_size=1, max_size=30))
@example(seqs={2**32 - 1, 2**32, 2**32 + 2})
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_gaps_are_the_missing_numbers(tmp_path: Path, seqs: set[int]) -> None:
    path = tmp_path / "r.mcap"
    ordered = sorted(seqs)
    # MCAP keeps 32 bits of seq; a hole of 2³¹ ticks (six days at 4 kHz) is beyond what can be told.
    ordered = [seq for seq in ordered if seq - ordered[0] < 2**31]
    write(path, [(DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0))) for seq in ordered])
    figures = Recording(path).topics[DEVICE_STATE]
    assert figures.messages == len(ordered)
    assert figures.gaps == ordered[-1] - ordered[0] + 1 - len(ordered)
    assert figures.back == 0


def test_repeats_and_restarts_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    seqs = [0, 1, 1, 2, 5, 0, 1]
    write(path, [(DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0))) for seq in seqs])
    figures = Recording(path).topics[DEVICE_STATE]
    assert (figures.messages, figures.gaps, figures.back) == (7, 2, 2)


def test_figures_of_a_run(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data)
    recording = Recording(path)
    assert recording.complete
    assert recording.cut == ""
    assert not recording.recovered
    assert recording.manifest == {"scenario": "drop", "pace": "lockstep"}
    ticks = recording.topics[DEVICE_STATE]
    assert (ticks.messages, ticks.gaps, ticks.first_seq, ticks.last_seq) == (200, 0, 0, 199)
    # Stamps are kept to the nanosecond.
    assert recording.duration == pytest.approx(199 * PERIOD, abs=1e-9)
    assert ticks.rate == pytest.approx(1.0 / PERIOD, rel=1e-8)
    assert recording.messages("/nope") == []


def test_arrays_hold_every_field(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data)
    recording = Recording(path)
    for topic in (DEVICE_STATE, PROXY, FORCE):
        sent = [message for name, message in whole.sent if name == topic]
        arrays = recording.arrays(topic)
        assert set(arrays) == {"log_time"} | {field.name for field in msgspec.structs.fields(type(sent[0]))}
        for name in set(arrays) - {"log_time"}:
            np.testing.assert_array_equal(arrays[name], np.array([getattr(message, name) for message in sent]))
    assert recording.arrays(DEVICE_STATE)["position"].shape == (200, 3)


def test_accounts_compare_sent_with_recorded(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(100))
    write(path, sent)
    found = accounts(Recording(path))
    assert {node: (a.sent, a.recorded, a.lost) for node, a in found.items()} == {
        "driver": (100, 100, 0),
        "environment": (100, 100, 0),
    }
    # Three messages of the environment that never came.
    write(path, [(topic, m) for topic, m in sent if not (topic == PROXY and m.seq in (10, 11, 99))])
    recording = Recording(path)
    assert accounts(recording)["environment"].lost == 3
    assert accounts(recording)["driver"].lost == 0
    assert recording.topics[PROXY].gaps == 2, "the last one leaves no gap: only the account tells"


def test_accounts_of_a_late_logger_and_of_a_respawned_node(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(100))
    write(path, [(topic, m) for topic, m in sent if m.seq >= 40])
    account = accounts(Recording(path))["driver"]
    assert (account.since, account.lost, account.finished) == (40, 0, True)

    def told(pid: int, count: int, state: str) -> tuple[str, Message]:
        return status("environment"), NodeStatus(
            seq=0, stamp=0.0, node="environment", kind="environment", state=state, pid=pid, sent=count
        )

    proxies = [(topic, m) for topic, m in sent if topic == PROXY]
    write(path, [*proxies[:50], told(7, 50, "running"), *proxies[50:], told(8, 51, "finished")])
    account = accounts(Recording(path))["environment"]
    # 50 before the respawn, then 50 more and the status of the first process: 101 recorded, 101 sent.
    assert (account.sent, account.recorded, account.lost) == (101, 101, 0)


def test_what_was_sent_decides_whether_anything_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(100))
    # The environment skips what is no longer the newest: 20 gaps in seq, and all that it sent is there.
    skipped = [m for m in sent if not (m[0] == PROXY and 30 <= m[1].seq < 50) and m[0] != status("environment")]
    write(path, [*skipped, (status("environment"), NodeStatus(**_final("environment", 80)))])
    recording = Recording(path)
    assert recording.topics[PROXY].gaps == 20
    assert (completeness(recording).lost, completeness(recording).text) == (0, "complete, nothing lost")
    write(path, [m for m in sent if not (m[0] == PROXY and 30 <= m[1].seq < 50)])
    assert completeness(Recording(path)).text == "complete, 20 messages lost"
    # Without a node's own count nobody can tell.
    write(path, [m for m in sent if not isinstance(m[1], NodeStatus)])
    assert completeness(Recording(path)).lost is None


def _final(node: str, sent: int) -> dict[str, Any]:
    return {"seq": 100, "stamp": 0.2, "node": node, "kind": node, "state": "finished", "pid": 1, "sent": sent}


def test_viewers_date_a_run_by_the_wall_clock_and_readers_by_the_run(tmp_path: Path) -> None:
    begun = 1_700_000_000.123456789
    paths = []
    for name, manifest in (
        ("old", {}),
        ("wall", {"wall_minus_monotonic_s": repr(begun)}),
        ("lockstep", {"wall_minus_monotonic_s": repr(begun), "pace": "lockstep"}),
    ):
        paths.append(tmp_path / f"{name}.mcap")
        with RecordWriter(paths[-1], manifest) as writer:
            for topic, message in drop(100):
                writer.write(topic, message, message.stamp + 1e-4)
    # To the bit: offsets are whole nanoseconds, taken off before anything is rounded.
    old, *others = ([tuple(entry) for entry in Recording(path).entries()] for path in paths)
    assert all(other == old for other in others)
    figures = [Recording(path) for path in paths]
    assert len({(f.duration, f.first_log, f.wall_duration, f.topics[DEVICE_STATE].rate) for f in figures}) == 1
    with paths[1].open("rb") as stream:
        raw = [message for _, _, message in make_reader(stream).iter_messages()]
    # A double holds the time of day to a quarter of a microsecond.
    assert raw[0].publish_time == pytest.approx(begun * 1e9, abs=256)
    assert raw[0].log_time - raw[0].publish_time == 100_000
    with paths[2].open("rb") as stream:
        simulated = next(message for _, _, message in make_reader(stream).iter_messages())
    # Simulated time has no date; tick 0 gets that of the recording.
    assert abs(simulated.publish_time * 1e-9 - time.time()) < 3600.0


def test_recordings_of_earlier_versions_and_damaged_clocks(tmp_path: Path) -> None:
    sent = list(drop(20))
    for name, clock in (
        ("none", None),
        ("bad", {"log_time_offset_ns": "x"}),
        ("huge", dict.fromkeys(OFFSETS, "9" * 30)),
    ):
        path = tmp_path / f"{name}.mcap"
        output = Output(path, overwrite=False)
        writer = mcap_writer(output, "earlier")
        if clock is not None:
            writer.add_metadata("clock", clock)
        channel = writer.register_channel(DEVICE_STATE, "json", 0)
        for topic, message in sent:
            if topic == DEVICE_STATE:
                stamp = round(message.stamp * 1e9)
                writer.add_message(channel, stamp + 100_000, msgspec.json.encode(message), stamp, message.seq)
        writer.finish()
        output.close()
        if clock is None:
            entries = list(Recording(path).entries())
            assert [entry.message for entry in entries] == [m for topic, m in sent if topic == DEVICE_STATE]
            assert entries[3].log_time == pytest.approx(3 * PERIOD + 1e-4, abs=1e-9)
        else:
            with pytest.raises(RecordError, match="clock"):
                Recording(path)


def test_overruns_are_gaps_that_the_driver_declares(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    told = [(0, 0), (1, 0), (4, 2), (5, 2), (9, 5)]
    write(
        path,
        [
            (DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0), overruns=count))
            for seq, count in told
        ],
    )
    recording = Recording(path)
    assert recording.topics[DEVICE_STATE].gaps == overruns(recording) == 5


def test_events_are_read(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    said = Event(seq=3, stamp=1.0, node="driver", kind="safety", reason="−0.1 m, limit −0.05 m")
    write(path, [(event("driver"), said)])
    recording = Recording(path)
    assert recording.messages("/driver/event") == [said]
    assert recording.duration == 0.0


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40), st.floats(0.0, 1.0))
def test_quantile_is_numpys(values: list[float], fraction: float) -> None:
    # Both interpolate linearly; numpy groups the terms in another order, which costs a few roundings of the largest value.
    tolerance = 4 * np.finfo(float).eps * max(map(abs, values))
    assert abs(quantile(sorted(values), fraction) - float(np.quantile(values, fraction))) <= tolerance + 1e-300


def test_summary_is_true_to_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    missed = (20, 21, 60)
    sent = list(drop(101, missed=missed))
    write(path, sent)
    summary = summarise(Recording(path))
    states = [message for _, message in sent if isinstance(message, DeviceState)]
    assert (summary.ticks, summary.missed, summary.overruns) == (100, 3, 0)
    assert summary.rate_hz == pytest.approx(1.0 / PERIOD, rel=1e-12)
    responses = [state.response * 1e6 for state in states[1:] if state.seq - 1 not in missed]
    assert len(responses) == 97
    # Another order of interpolation: a few roundings.
    assert summary.response_us["p99"] == pytest.approx(float(np.percentile(responses, 99)), rel=1e-14)
    assert summary.response_us["max"] == max(responses)
    assert summary.position_m == list(states[-1].position)


def test_summary_of_nothing(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, [(event("driver"), Event(seq=0, stamp=0.0, node="driver", kind="x", reason=""))])
    summary = summarise(Recording(path))
    assert (summary.ticks, summary.response_us, summary.position_m) == (0, {}, [])
