"""Recordings as written: schemas for viewers, exact round trips, what survives a bad end."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from messages.schema import schema, schema_json
from messages.topics import DEVICE_STATE
from messages.types import DeviceState, Force, Message
from nodes.recording.reader import Recording
from nodes.recording.writer import CHUNK_SIZE, Output, RecordError, RecordWriter, save
from tests.support.recorded import drop
from tests.support.schemas import validate
from tests.support.strategies import TYPES, messages


def state(seq: int) -> DeviceState:
    return DeviceState(
        seq=seq, stamp=seq * 0.002, position=(0.0, 0.0, 1e-3 / (seq + 1))
    )


# -- schemas
# --------------------------------------------------------------------------------------------------


def keywords(value: Any) -> set[str]:
    if isinstance(value, dict):
        return set(value) | {word for item in value.values() for word in keywords(item)}
    if isinstance(value, list):
        return {word for item in value for word in keywords(item)}
    return set()


@pytest.mark.parametrize("message_type", TYPES)
def test_schema_is_valid_and_flat(message_type: type[Message]) -> None:
    found = schema(message_type)
    jsonschema.Draft202012Validator.check_schema(found)
    # What Foxglove and Lichtblick cannot read: references, alternatives, and arrays with a schema
    # per item.
    assert not keywords(found) & {
        "$ref",
        "$defs",
        "anyOf",
        "oneOf",
        "allOf",
        "prefixItems",
    }
    assert found["type"] == "object"
    assert all(isinstance(told["type"], str) for told in found["properties"].values())
    assert json.loads(schema_json(message_type)) == found


@pytest.mark.parametrize("message_type", TYPES)
def test_every_field_is_described(message_type: type[Message]) -> None:
    names = [field.name for field in msgspec.structs.fields(message_type)]
    properties = schema(message_type)["properties"]
    assert list(properties) == names
    assert [name for name in names if not properties[name].get("description")] == []


@given(data=st.data(), message_type=st.sampled_from(TYPES))
def test_messages_fit_their_schema(
    data: st.DataObject, message_type: type[Message]
) -> None:
    message = data.draw(messages(message_type))
    validate(json.loads(msgspec.json.encode(message)), schema(message_type))


@pytest.mark.parametrize(
    "change",
    [
        {"seq": -1},
        {"seq": 0.5},
        {"position": [0.0, 0.0]},
        {"position": [0.0] * 4},
        {"safety": 1},
        {"stamp": "0"},
    ],
)
def test_schema_refuses(change: dict[str, Any]) -> None:
    good = json.loads(msgspec.json.encode(state(0)))
    validate(good, schema(DeviceState))
    with pytest.raises(jsonschema.ValidationError):
        validate(good | change, schema(DeviceState))


def test_schema_refuses_types_it_cannot_flatten() -> None:
    class Odd(Message, frozen=True, kw_only=True, gc=False):
        value: int | str = 0

    with pytest.raises(TypeError, match=r"Odd\.value.*UnionType"):
        schema(Odd)


# -- round trips
# --------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(
    written=st.lists(
        st.tuples(st.sampled_from(TYPES).flatmap(messages), st.floats(0.0, 1e9)),
        min_size=1,
        max_size=20,
    )
)
def test_round_trip_to_the_bit(
    tmp_path: Path, written: list[tuple[Message, float]]
) -> None:
    path = tmp_path / "r.mcap"
    with RecordWriter(path, {"scenario": "any"}, overwrite=True) as writer:
        for message, log_time in written:
            writer.write(f"/{type(message).__name__}/x", message, log_time)
    read = list(Recording(path).entries())
    # Encoded forms are compared: they tell −0.0 from 0.0, which == does not.
    assert [msgspec.msgpack.encode(entry.message) for entry in read] == [
        msgspec.msgpack.encode(message) for message, _ in written
    ]
    assert [type(entry.message) for entry in read] == [
        type(message) for message, _ in written
    ]
    for entry, (_, log_time) in zip(read, written, strict=True):
        # Half a nanosecond from rounding, and two roundings of a double.
        assert abs(entry.log_time - log_time) <= 0.5e-9 + 2.0**-51 * log_time


def test_the_reference_reader_agrees(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(400, switch=100))
    with RecordWriter(
        path,
        {"scenario": "drop"},
        launch_file="ticks: 400\n",
        parameters={"coupling": "{stiffness: 1500}"},
    ) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp + 1e-4)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(sent)
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        # A chunk is closed by the record that crosses the limit: a message, or a schema with its
        # channel.
        longest = max(len(schema_json(message_type)) for message_type in TYPES) + 100
        sizes = [chunk.uncompressed_size for chunk in summary.chunk_indexes]
        assert max(sizes) <= CHUNK_SIZE + longest
        assert min(sizes[:-1]) > CHUNK_SIZE
        read = list(reader.iter_messages(log_time_order=False))
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    for (topic, message), (record_schema, channel, raw) in zip(sent, read, strict=True):
        assert record_schema is not None
        assert (channel.topic, channel.message_encoding, record_schema.encoding) == (
            topic,
            "json",
            "jsonschema",
        )
        assert json.loads(raw.data) == json.loads(msgspec.json.encode(message))
        assert raw.publish_time == round(message.stamp * 1e9)
        assert raw.sequence == message.seq
    assert metadata["manifest"] == {"scenario": "drop"}
    assert metadata["launch_file"] == {"yaml": "ticks: 400\n"}
    assert metadata["parameters"] == {"coupling": "{stiffness: 1500}"}
    assert metadata["versions"]["haptic-nodes"]


def test_stamps_that_mcap_cannot_hold_are_clamped(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = [
        DeviceState(seq=0, stamp=stamp, position=(0.0, 0.0, 0.0))
        for stamp in (-1.0, 0.0, 1e300)
    ]
    with RecordWriter(path, {}) as writer:
        for message in sent:
            writer.write(DEVICE_STATE, message, -5.0)
    assert [entry.message for entry in Recording(path).entries()] == sent


# -- bad ends
# --------------------------------------------------------------------------------------------------


def test_everything_flushed_is_readable_while_writing_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordWriter(path, {}) as writer:
        for seq in range(10):
            writer.write(DEVICE_STATE, state(seq), 0.0)
        assert DEVICE_STATE not in Recording(path).topics
        writer.flush()
        writer.write(DEVICE_STATE, state(10), 0.0)
        recording = Recording(path)
        assert not recording.complete
        assert recording.topics[DEVICE_STATE].messages == 10
    assert Recording(path).topics[DEVICE_STATE].messages == 11


KILLED = """
    import sys
    from messages.types import DeviceState
    from nodes.recording.writer import RecordWriter
    writer = RecordWriter(sys.argv[1], {"scenario": "killed"})
    for seq in range(10**9):
        writer.write("/device/state", DeviceState(seq=seq, stamp=seq * 0.002, position=(0.0, 0.0,
          0.0)), seq * 0.002)
        if seq % 250 == 249:
            writer.flush()
            print(seq, flush=True)
"""


@pytest.mark.process
@pytest.mark.smoke
def test_a_killed_writer_loses_nothing_that_was_flushed(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(KILLED), str(path)],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        for _ in range(20):
            flushed = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        told = process.stdout.read().split()
    flushed = int(told[-1]) if told else flushed
    recording = Recording(path)
    assert recording.recovered
    assert recording.manifest == {"scenario": "killed"}
    seqs = [message.seq for message in recording.messages(DEVICE_STATE)]
    assert seqs == list(range(len(seqs)))
    assert len(seqs) > flushed


def test_a_full_device_is_told(tmp_path: Path) -> None:
    with pytest.raises(
        RecordError, match=r"/dev/full: No space left on device after 0 bytes"
    ):
        RecordWriter("/dev/full", {}, overwrite=True)


FILL = """
    import sys
    from messages.types import DeviceState
    from nodes.recording.writer import RecordError, RecordWriter
    exec(sys.argv[2])
    writer = RecordWriter(sys.argv[1], {"scenario": "full"})
    try:
        for seq in range(10**6):
            writer.write("/device/state", DeviceState(seq=seq, stamp=seq / 7, position=(seq / 3,
              seq / 11, 0.0)), 0.0)
    except RecordError as error:
        print(error, flush=True)
    late = DeviceState(seq=0, stamp=0.0, position=(0.0, 0.0, 0.0))
    for action in (writer.flush, lambda: writer.write("/device/state", late, 0.0)):
        try:
            action()
        except RecordError as error:
            print(error, flush=True)
    writer.close()
    from nodes.recording.reader import Recording
    recording = Recording(sys.argv[1])
    print(recording.topics["/device/state"].messages, seq, recording.topics["/device/state"].gaps,
      recording.cut)
"""


def check_full(
    process: subprocess.CompletedProcess[str], expected: str, path: str
) -> None:
    assert process.returncode == 0, process.stderr
    first, second, third, last = process.stdout.splitlines()
    assert first.startswith(f"{path}: {expected} after ")
    assert first.endswith(f"complete the file with: haptic bag recover {path}")
    assert (
        second
        == third
        == f"{path}: writing failed before; nothing more can be recorded in this file"
    )
    messages_kept, written, gaps, cut = last.split(" ", 3)
    # All but the chunk that did not fit is kept: over 64 KiB of messages of at least 150 bytes.
    # (The message whose chunk was written, but not the index behind it, was refused and is kept all
    # the same.)
    assert int(written) - CHUNK_SIZE // 150 < int(messages_kept) <= int(written) + 1
    assert int(gaps) == 0
    # Cut back to whole records: nothing stands behind the cut.
    assert cut.endswith(": 0 bytes after it are no whole record")


@pytest.mark.process
@pytest.mark.smoke
def test_a_file_size_limit_keeps_what_was_recorded(tmp_path: Path) -> None:
    path = str(tmp_path / "r.mcap")
    limit = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))"
    )
    process = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(FILL), path, limit],
        capture_output=True,
        text=True,
        check=False,
    )
    check_full(process, "File too large", path)
    assert os.path.getsize(path) <= 200_000


@pytest.mark.process
@pytest.mark.smoke
def test_a_full_disk_keeps_what_was_recorded(tmp_path: Path) -> None:
    path = str(tmp_path / "r.mcap")
    mount = [
        "unshare",
        "--mount",
        "sh",
        "-c",
        'mount -t tmpfs -o size=256k tmpfs "$0" && exec "$@"',
        str(tmp_path),
    ]
    if (
        subprocess.run([*mount, "true"], capture_output=True, check=False).returncode
        != 0
    ):
        pytest.skip("mounting a small tmpfs in a private namespace needs root")
    process = subprocess.run(
        [*mount, sys.executable, "-c", textwrap.dedent(FILL), path, ""],
        capture_output=True,
        text=True,
        check=False,
    )
    check_full(process, "No space left on device", path)


def test_save_leaves_a_whole_file_or_none(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    save(path, b"first", overwrite=False)
    with pytest.raises(RecordError, match="already exists"):
        save(path, b"second", overwrite=False)
    assert path.read_bytes() == b"first"
    save(path, b"second", overwrite=True)
    assert path.read_bytes() == b"second"
    # What is no file of ours is never removed, whoever runs this.
    link = tmp_path / "link"
    link.symlink_to("/dev/full")
    for place in (Path("/dev/full"), link):
        with pytest.raises(RecordError, match="No space left on device after 0 bytes"):
            save(place, b"data", overwrite=True)
        assert place.is_char_device()


LIMITED = """
    import resource, sys
    from pathlib import Path
    from nodes.recording.writer import RecordError, save
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
    try:
        save(Path(sys.argv[1]), bytes(2000), overwrite=False)
    except RecordError as error:
        print(error)
"""


@pytest.mark.process
@pytest.mark.smoke
def test_save_removes_what_could_not_be_finished(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(LIMITED), str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert (
        done.stdout
        == f"{path}: File too large after 0 bytes (1000 of the next 2000 not written)\n"
    )
    assert not path.exists()


def test_refusals(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordWriter(path, {}) as writer:
        writer.write(DEVICE_STATE, state(0), 0.0)
        with pytest.raises(
            RecordError, match=r"/device/state carries DeviceState, not Force"
        ):
            writer.write(
                DEVICE_STATE, Force(seq=0, stamp=0.0, force=(0.0, 0.0, 0.0)), 0.0
            )
        writer.write(DEVICE_STATE, state(1), 0.0)
    writer.close()
    with pytest.raises(RecordError, match="already closed"):
        writer.write(DEVICE_STATE, state(2), 0.0)
    assert Recording(path).topics[DEVICE_STATE].messages == 2
    with pytest.raises(RecordError, match="already exists"):
        RecordWriter(path, {})
    with pytest.raises(
        RecordError, match="cannot be created: No such file or directory"
    ):
        RecordWriter(tmp_path / "nowhere" / "r.mcap", {})


def test_no_descriptor_is_left_open(tmp_path: Path) -> None:
    before = set(os.listdir("/proc/self/fd"))
    with RecordWriter(tmp_path / "r.mcap", {}) as writer:
        writer.write(DEVICE_STATE, state(0), 0.0)
    with pytest.raises(RecordError):
        RecordWriter("/dev/full", {}, overwrite=True)
    assert set(os.listdir("/proc/self/fd")) == before


LIGHT = """
    import sys
    from messages.types import DeviceState
    from nodes.recording.writer import RecordWriter
    with RecordWriter(sys.argv[1], {}) as writer:
        for seq in range(20000):
            writer.write("/device/state", DeviceState(seq=seq, stamp=seq * 0.002, position=(0.0,
              0.0, seq / 3)), 0.0)
            if seq % 250 == 0:
                writer.flush()
    heavy = {"numpy", "numba", "scipy", "matplotlib"} & set(sys.modules)
    # Not ru_maxrss: that one begins with the memory of the process which started this one.
    peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
    print(int(peak) * 1024, *heavy)
"""


@pytest.mark.process
@pytest.mark.smoke
def test_writing_needs_little_memory_and_no_numpy(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(LIGHT), str(tmp_path / "r.mcap")],
        capture_output=True,
        text=True,
        check=True,
    )
    peak, *heavy = process.stdout.split()
    assert heavy == []
    assert int(peak) < 60e6, "the aim for a logger is 60 MB"


def test_a_file_that_somebody_writes_is_not_overwritten(tmp_path: Path) -> None:
    """Two launches with one path overwrote each other's file, with exit code 0."""
    path = tmp_path / "r.mcap"
    sent = [(topic, message) for topic, message in drop(200)]
    with RecordWriter(path, {}, overwrite=True) as first:
        for topic, message in sent[:300]:
            first.write(topic, message, message.stamp)
        first.flush()
        size = path.stat().st_size
        for work in (
            lambda: RecordWriter(path, {}, overwrite=True),
            lambda: save(path, b"x", overwrite=True),
        ):
            with pytest.raises(
                RecordError, match="another process is writing it; choose another name"
            ):
                work()
        assert path.stat().st_size == size
        for topic, message in sent[300:]:
            first.write(topic, message, message.stamp)
    assert [entry.message for entry in Recording(path).entries()] == [
        message for _, message in sent
    ]
    # Once it is closed, it is free.
    with RecordWriter(path, {}, overwrite=True) as second:
        second.write(*sent[0], 0.0)
    assert len(list(Recording(path).entries())) == 1


def test_the_output_under_a_recording_knows_what_it_has_written(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(b"what was there before")
    with pytest.raises(RecordError, match="already exists"):
        Output(path, overwrite=False)
    output = Output(path, overwrite=True)
    assert output.tell() == path.stat().st_size == 0
    for data in (b"four", b"", b"seven b"):
        before = output.tell()
        assert output.write(data) == len(data)
        assert output.tell() == path.stat().st_size == before + len(data)
    # Who writes it locks it.
    with pytest.raises(RecordError, match="another process is writing it"):
        Output(path, overwrite=True)
    output.close()
    output.close()
    assert path.read_bytes() == b"fourseven b"


def test_a_write_that_fails_leaves_what_was_there_and_tells_how_much(
    tmp_path: Path,
) -> None:
    output = Output(tmp_path / "r.mcap", overwrite=False)
    output.write(b"whole")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8, limits[1]))
    try:
        with pytest.raises(
            RecordError, match=r"after 5 bytes \(2 of the next 5 not written"
        ):
            output.write(b"five!")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert output.path.read_bytes() == b"whole"
    assert output.tell() == 5
    output.close()
