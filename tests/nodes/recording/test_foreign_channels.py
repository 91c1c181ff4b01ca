"""Recordings that other programs leave or write, read as far as they can be."""

from __future__ import annotations

import itertools
import json
import math
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from messages.topics import DEVICE_STATE, PROXY
from nodes.recording.accounts import completeness
from nodes.recording.facts import axes_of, period_of, stamped_rate
from nodes.recording.play import play
from nodes.recording.reader import Recording
from nodes.recording.table import read
from nodes.recording.writer import RecordError, RecordWriter
from nodes.view.replay import ReplayPages
from sim.identify.experiment import read as experiment
from tests.support.launching import typed_in
from tests.support.recorded import PERIOD, PUBLISHES, drop

TICKS = 260


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a lockstep run of 260 ticks, received within 0.05 s."""
    path = tmp_path_factory.mktemp("ours") / "drop.mcap"
    manifest = {
        "run": "drop",
        "scenario": "drop",
        "rate_hz": repr(1 / PERIOD),
        "axes": "z",
        "pace": "lockstep",
        "publishes": PUBLISHES,
        "wall_minus_monotonic_s": repr(time.time() - 100.0),
    }
    with RecordWriter(path, manifest) as writer:
        for number, (topic, message) in enumerate(drop(TICKS)):
            writer.write(topic, message, 100.0 + 5e-5 * number)
    return path


def tooled(
    source: Path,
    out: Path,
    *,
    metadata: str = "first",
    compression: CompressionType = CompressionType.ZSTD,
    foreign: str = "",
) -> Path:
    """Copy a recording as a merge or filter tool does: metadata first, last or not at all."""
    with source.open("rb") as stream, out.open("wb") as target:
        reader = make_reader(stream)
        writer: Any = Writer(target, compression=compression)
        writer.start(profile="", library="a tool")
        records = [(one.name, one.metadata) for one in reader.iter_metadata()]
        if metadata == "first":
            for record in records:
                writer.add_metadata(*record)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        if foreign:
            kind = writer.register_schema("ft.Sample", "jsonschema", b"{}")
            probe = writer.register_channel("/ft/status", foreign, kind)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in channels:
                if schema.id not in schemas:
                    schemas[schema.id] = writer.register_schema(
                        schema.name, schema.encoding, schema.data
                    )
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            if foreign:
                writer.add_message(
                    probe, message.log_time, b'{"fx": 1}', message.publish_time
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        if metadata == "last":
            for record in records:
                writer.add_metadata(*record)
        writer.finish()
    return out


WAYS = list(
    itertools.product(
        ("first", "last", "none"),
        (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE),
        ("", "json", "cdr"),
    )
)


@pytest.mark.parametrize(("metadata", "compression", "foreign"), WAYS)
def test_a_copy_by_a_tool_reads_as_the_original_does(
    ours: Path,
    tmp_path: Path,
    metadata: str,
    compression: CompressionType,
    foreign: str,
) -> None:
    was = Recording(ours)
    path = tooled(
        ours,
        tmp_path / "t.mcap",
        metadata=metadata,
        compression=compression,
        foreign=foreign,
    )
    now = Recording(path)
    assert now.topics == was.topics
    assert (now.duration, now.complete) == (was.duration, True)
    assert (period_of(now), axes_of(now)) == (PERIOD, ["z"])
    before, after = read(ours), read(path)
    for column in before:
        np.testing.assert_array_equal(before[column], after[column], err_msg=column)
    assert list(now.foreign) == (["/ft/status"] if foreign else [])
    if foreign:
        assert now.foreign["/ft/status"].messages == sum(
            f.messages for f in was.topics.values()
        )
        assert (foreign == "cdr") == (
            "only JSON is read" in now.foreign["/ft/status"].text
        )
    text = completeness(now).text
    if metadata == "none":
        assert "no tick missing in seq" in text
        assert "losses of driver unknown: the file has lost its manifest" in text
        # Received within 0.05 s, on the clock of the stamps.
        assert abs(now.first_log) < 60.0
    else:
        assert text == completeness(was).text == "complete, nothing lost"
        assert now.first_log == was.first_log


def test_gaps_of_a_file_without_metadata_are_those_inside_its_messages(
    ours: Path, tmp_path: Path
) -> None:
    """A foreign writer may leave MCAP's sequence and publish time at zero."""
    out = tmp_path / "zero.mcap"
    recording = Recording(ours)
    with out.open("wb") as target:
        writer: Any = Writer(target)
        writer.start(profile="", library="lab")
        for entry in recording.entries([DEVICE_STATE]):
            if entry.message.seq in (50, 51):
                continue
            channel = writer.register_channel(DEVICE_STATE, "json", 0)
            writer.add_message(channel, 0, msgspec.json.encode(entry.message), 0, 0)
        writer.finish()
    found = Recording(out)
    figures = found.topics[DEVICE_STATE]
    assert (figures.gaps, figures.back, figures.last_seq) == (2, 0, TICKS - 1)
    assert found.duration == (TICKS - 1) * PERIOD
    assert stamped_rate(found) == 1 / PERIOD


def _lab(path: Path, rate: float, stamps: Any, **manifest: str) -> Path:
    """Write states at given stamps as a lab does from PROTOCOL.md."""
    with path.open("wb") as target:
        writer: Any = Writer(target)
        writer.start(profile="", library="lab")
        schema = writer.register_schema("haptic.DeviceState", "jsonschema", b"{}")
        channel = writer.register_channel(DEVICE_STATE, "json", schema)
        if manifest:
            writer.add_metadata("manifest", manifest)
        for k, stamp in enumerate(stamps):
            force = [math.sin(k / 5.0), 0.0, 0.0]
            state = {
                "seq": k,
                "stamp": float(stamp),
                "position": [1e-5 * round(100 * math.sin(k / 7.0)), 0.0, 0.0],
                "force": force,
                "mean_force": force,
                "force_seq": k - 1,
            }
            at = round(k / rate * 1e9)
            writer.add_message(channel, at, json.dumps(state).encode(), at, k)
        writer.finish()
    return path


@pytest.mark.parametrize("factor", [0.5, 0.97, 0.995, 1.0, 1.005, 1.03, 2.0])
def test_a_declared_rate_is_compared_with_the_stamps(
    tmp_path: Path, factor: float
) -> None:
    """At 1 %: the identified mass goes with the square of the period."""
    rate = 500.0
    path = _lab(
        tmp_path / "lab.mcap",
        rate,
        np.arange(1000) / rate,
        rate_hz=repr(factor * rate),
        axes="x",
    )
    if abs(factor - 1.0) < 0.01:
        assert period_of(Recording(path)) == 1.0 / (factor * rate)
        return
    words = f"rate_hz is {factor * rate:g}, while .* advance 500 times a second"
    with pytest.raises(RecordError, match=words):
        experiment(path)
    shown = typed_in(tmp_path, "bag", "info", "lab.mcap").stdout
    assert "advance 500 times a second" in shown


@pytest.mark.parametrize("rate", [300.0, 333.0, 500.0, 1000.0, 1024.0, 8000.0])
def test_a_rate_that_is_not_declared_is_that_of_the_stamps(
    tmp_path: Path, rate: float
) -> None:
    """A real-time loop's stamps are late by up to a fraction of a tick."""
    rng = np.random.default_rng(1)
    stamps = 1000.0 + (np.arange(1000) + rng.uniform(0.0, 0.3, 1000)) / rate
    recording = Recording(_lab(tmp_path / "lab.mcap", rate, stamps))
    assert 1.0 / period_of(recording) == pytest.approx(rate, rel=1e-12)
    assert axes_of(recording) == ["x"]
    assert experiment(recording.path).period == pytest.approx(1.0 / rate, rel=1e-12)


@pytest.mark.parametrize("stamps", [[0.0] * 50, [0.0], np.arange(50) * 1e3])
def test_stamps_that_give_no_rate_are_told(tmp_path: Path, stamps: Any) -> None:
    path = _lab(tmp_path / "lab.mcap", 500.0, stamps)
    with pytest.raises(
        RecordError, match=r"rate_hz is missing, and the stamps .* give no rate"
    ):
        period_of(Recording(path))


class _Published:
    """Counts what is played."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send(self, topic: bytes, payload: bytes) -> None:
        self.sent.append(topic + payload)

    def keep(self) -> None:
        pass


@pytest.mark.parametrize("pace", ["lockstep", "realtime"])
def test_a_replay_has_the_time_base_of_the_run(
    tmp_path: Path, pace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lockstep run of 0.5 s received in 0.05 s is played in 0.5 s."""
    path = tmp_path / "r.mcap"
    with RecordWriter(path, {"pace": pace}) as writer:
        for number, (topic, message) in enumerate(drop(TICKS)):
            writer.write(topic, message, 100.0 + 5e-5 * number)
    clock = [0.0]
    monkeypatch.setattr("nodes.recording.play.time.monotonic", lambda: clock[0])
    monkeypatch.setattr(
        "nodes.recording.play.time.sleep", lambda s: clock.__setitem__(0, clock[0] + s)
    )
    publisher: Any = _Published()
    recording = Recording(path)
    played = list(play(recording, publisher))
    total = sum(figures.messages for figures in recording.topics.values())
    assert len(played) == len(publisher.sent) == total
    lasts = recording.duration if pace == "lockstep" else recording.wall_duration
    assert clock[0] == pytest.approx(lasts, rel=1e-9)
    # From the middle on, what comes later only.
    clock[0] = 0.0
    late = list(play(recording, publisher, offset=lasts / 2))
    assert 0 < len(late) < total
    assert clock[0] == pytest.approx(lasts / 2, rel=0.02)


def named(folder: Path, verb: str, *options: str) -> None:
    """Run a verb on a file with a foreign topic, which it must name."""
    ends = ["--endpoint", f"ipc://{folder}/p"] if verb == "play" else ["--json"]
    done = typed_in(folder, "bag", verb, "t.mcap", *options, *ends)
    assert "/ft/status" in done.stdout + done.stderr
    if verb in ("plot", "export", "play"):
        assert "not read: /ft/status (ft.Sample in cdr" in done.stderr


FORMS = ("npz", "mat", "parquet", "ros2", "foxglove")


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", ["plot", "plot --xy", *(f"export --format {f}" for f in FORMS)]
)
def test_every_picture_and_format_is_made_of_what_is_read(
    ours: Path, tmp_path: Path, words: str
) -> None:
    tooled(ours, tmp_path / "t.mcap", metadata="none", foreign="cdr")
    named(tmp_path, *words.split())


def test_every_verb_reads_what_it_can_and_names_the_rest(
    ours: Path, tmp_path: Path
) -> None:
    tooled(ours, tmp_path / "t.mcap", metadata="none", foreign="cdr")
    for words in (
        "info",
        "export",
        "play --rate inf",
        "cut --from 0.1 --to 0.2",
        "filter -e /",
        "recover",
    ):
        named(tmp_path, *words.split())
    counts = {
        topic: one.messages
        for topic, one in Recording(tmp_path / "t.mcap").foreign.items()
    }
    saved = Recording(tmp_path / "t.recovered.mcap")
    assert {topic: one.messages for topic, one in saved.foreign.items()} == counts
    part = Recording(tmp_path / "t.cut.mcap")
    assert part.foreign["/ft/status"].messages > 0
    assert part.topics[DEVICE_STATE].messages == 51
    alone = typed_in(
        tmp_path, "bag", "filter", "t.mcap", "-e", "ft", "--out", "ft.mcap", "--json"
    )
    assert json.loads(alone.stdout)["messages"] == counts
    hello = json.loads(ReplayPages(tmp_path / "t.mcap").hello)
    assert "Not read: /ft/status (ft.Sample in cdr" in hello["notice"]
    with pytest.raises(RecordError) as refused:
        Recording(tmp_path / "ft.mcap").require_ticks()
    assert "no ticks; not read: /ft/status (ft.Sample in cdr" in str(refused.value)


def test_a_topic_of_another_program_is_refused_by_what_it_is(
    ours: Path, tmp_path: Path
) -> None:
    recording = Recording(tooled(ours, tmp_path / "t.mcap", foreign="json"))
    with pytest.raises(
        RecordError, match=r"/ft/status is ft\.Sample of another program, as JSON"
    ):
        list(recording.entries(["/ft/status"]))


def test_the_folder_of_a_ros_bag_opens(ours: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {}\n", encoding="utf-8"
    )
    refused = typed_in(tmp_path, "bag", "info", "bag", code=1)
    assert "no MCAP file; read its topics with: haptic bag import bag" in refused.stderr
    tooled(ours, bag / "bag_0.mcap", metadata="none")
    assert Recording(bag).topics == Recording(ours).topics
    done = typed_in(tmp_path, "bag", "recover", "bag", "--json")
    assert json.loads(done.stdout)["out"] == "bag.recovered.mcap"
    tooled(ours, bag / "bag_1.mcap")
    with pytest.raises(RecordError, match="2 MCAP files"):
        Recording(bag)


def test_parts_of_a_lockstep_run_are_cut_at_their_own_times(tmp_path: Path) -> None:
    """Each part has another date for tick 0."""
    sent = list(drop(120))
    manifest = {"run": "r", "pace": "lockstep", "wall_minus_monotonic_s": "1e9"}
    half = len(sent) // 2
    for name, messages in (("r.mcap", sent[:half]), ("r.2.mcap", sent[half:])):
        with RecordWriter(tmp_path / name, manifest) as writer:
            for topic, message in messages:
                writer.write(topic, message, message.stamp)
    typed_in(tmp_path, "bag", "cut", "r.mcap", "--from", "0.1", "--to", "0.2")
    whole, part = Recording(tmp_path / "r.mcap"), Recording(tmp_path / "r.cut.mcap")
    for topic in (DEVICE_STATE, PROXY):
        kept = [m for m in whole.messages(topic) if 0.1 - 1e-9 <= m.stamp <= 0.2 + 1e-9]
        assert part.messages(topic) == kept
        assert part.topics[topic].first_stamp == pytest.approx(kept[0].stamp, abs=2e-9)
        assert part.topics[topic].last_stamp == pytest.approx(kept[-1].stamp, abs=2e-9)
