"""Figures of a recording: gaps, accounts, clocks, summary."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from messages.topics import DEVICE_STATE, FORCE, PROXY, event, status
from messages.types import DeviceState, Event, Message, NodeStatus
from nodes.recording.accounts import accounts, completeness, overruns
from nodes.recording.reader import Recording
from nodes.recording.summary import quantile, summarise
from nodes.recording.wall_clock import LOG_OFFSET, PUBLISH_OFFSET
from nodes.recording.writer import Output, RecordError, RecordWriter, mcap_writer
from tests.support.recorded import PERIOD, PUBLISHES, drop
from tests.support.whole import Whole, write

OFFSETS = (LOG_OFFSET, PUBLISH_OFFSET)


# -- figures
# --------------------------------------------------------------------------------------------------


@given(seqs=st.sets(st.integers(0, 2**34), min_size=1, max_size=30))
@example(seqs={2**32 - 1, 2**32, 2**32 + 2})
@settings(max_examples=50)
def test_gaps_are_the_missing_numbers(tmp_path: Path, seqs: set[int]) -> None:
    path = tmp_path / "r.mcap"
    ordered = sorted(seqs)
    # MCAP keeps 32 bits of seq; a hole of 2³¹ ticks (six days at 4 kHz) is beyond what can be told.
    ordered = [seq for seq in ordered if seq - ordered[0] < 2**31]
    write(
        path,
        [
            (DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0)))
            for seq in ordered
        ],
    )
    figures = Recording(path).topics[DEVICE_STATE]
    assert figures.messages == len(ordered)
    assert figures.gaps == ordered[-1] - ordered[0] + 1 - len(ordered)
    assert figures.back == 0


def test_repeats_and_restarts_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    seqs = [0, 1, 1, 2, 5, 0, 1]
    write(
        path,
        [
            (DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0)))
            for seq in seqs
        ],
    )
    figures = Recording(path).topics[DEVICE_STATE]
    assert (figures.messages, figures.gaps, figures.back) == (7, 2, 2)


def test_figures_of_a_run(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data)
    recording = Recording(path)
    assert recording.complete
    assert recording.cut == ""
    assert not recording.recovered
    assert recording.manifest == {
        "scenario": "drop",
        "pace": "lockstep",
        "publishes": PUBLISHES,
    }
    ticks = recording.topics[DEVICE_STATE]
    sent = sum(name == DEVICE_STATE for name, _ in whole.sent)
    assert (ticks.messages, ticks.gaps, ticks.first_seq) == (sent, 0, 0)
    assert ticks.last_seq == sent - 1
    # Stamps are kept to the nanosecond.
    assert recording.duration == pytest.approx((sent - 1) * PERIOD, abs=1e-9)
    assert ticks.rate == pytest.approx(1.0 / PERIOD, rel=1e-8)
    assert recording.messages("/nope") == []


def test_arrays_hold_every_field(whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(whole.data)
    recording = Recording(path)
    for topic in (DEVICE_STATE, PROXY, FORCE):
        sent = [message for name, message in whole.sent if name == topic]
        arrays = recording.arrays(topic)
        assert set(arrays) == {"log_time"} | {
            field.name for field in msgspec.structs.fields(type(sent[0]))
        }
        for name in set(arrays) - {"log_time"}:
            np.testing.assert_array_equal(
                arrays[name], np.array([getattr(message, name) for message in sent])
            )
        assert len(sent) > 1
    ticks = recording.topics[DEVICE_STATE].messages
    assert recording.arrays(DEVICE_STATE)["position"].shape == (ticks, 3)


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
    write(
        path,
        [
            (topic, m)
            for topic, m in sent
            if not (topic == PROXY and m.seq in (10, 11, 99))
        ],
    )
    recording = Recording(path)
    assert accounts(recording)["environment"].lost == 3
    assert accounts(recording)["driver"].lost == 0
    assert recording.topics[PROXY].gaps == 2, (
        "the last one leaves no gap: only the account tells"
    )


def test_accounts_of_a_late_logger_and_of_a_respawned_node(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(100))
    write(path, [(topic, m) for topic, m in sent if m.seq >= 40])
    account = accounts(Recording(path))["driver"]
    assert (account.since, account.lost, account.finished) == (40, 0, True)

    def told(pid: int, count: int, state: str) -> tuple[str, Message]:
        return status("environment"), NodeStatus(
            seq=0,
            stamp=0.0,
            node="environment",
            kind="environment",
            state=state,
            pid=pid,
            sent=count,
        )

    proxies = [(topic, m) for topic, m in sent if topic == PROXY]
    write(
        path,
        [*proxies[:50], told(7, 50, "running"), *proxies[50:], told(8, 51, "finished")],
    )
    account = accounts(Recording(path))["environment"]
    # 50 before the respawn, then 50 more and the status of the first process: 101 recorded, 101
    # sent.
    assert (account.sent, account.recorded, account.lost) == (101, 101, 0)


def test_what_was_sent_decides_whether_anything_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(100))
    # The environment skips what is no longer the newest: 20 gaps in seq, and all that it sent is
    # there.
    skipped = [
        m
        for m in sent
        if not (m[0] == PROXY and 30 <= m[1].seq < 50) and m[0] != status("environment")
    ]
    write(
        path,
        [*skipped, (status("environment"), NodeStatus(**_final("environment", 80)))],
    )
    recording = Recording(path)
    assert recording.topics[PROXY].gaps == 20
    assert (completeness(recording).lost, completeness(recording).text) == (
        0,
        "complete, nothing lost",
    )
    write(path, [m for m in sent if not (m[0] == PROXY and 30 <= m[1].seq < 50)])
    assert completeness(Recording(path)).text == "complete, 20 messages lost"
    # Without a node's own count nobody can tell.
    write(path, [m for m in sent if not isinstance(m[1], NodeStatus)])
    assert completeness(Recording(path)).lost is None


def _final(node: str, sent: int) -> dict[str, Any]:
    return {
        "seq": 100,
        "stamp": 0.2,
        "node": node,
        "kind": node,
        "state": "finished",
        "pid": 1,
        "sent": sent,
    }


def test_viewers_date_a_run_by_the_wall_clock_and_readers_by_the_run(
    tmp_path: Path,
) -> None:
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
    old, *others = (
        [tuple(entry) for entry in Recording(path).entries()] for path in paths
    )
    assert all(other == old for other in others)
    figures = [Recording(path) for path in paths]
    assert (
        len(
            {
                (f.duration, f.first_log, f.wall_duration, f.topics[DEVICE_STATE].rate)
                for f in figures
            }
        )
        == 1
    )
    with paths[1].open("rb") as stream:
        raw = [message for _, _, message in make_reader(stream).iter_messages()]
    # A double holds the time of day to a quarter of a microsecond.
    assert raw[0].publish_time == pytest.approx(begun * 1e9, abs=256)
    assert raw[0].log_time - raw[0].publish_time == 100_000
    with paths[2].open("rb") as stream:
        simulated = next(
            message for _, _, message in make_reader(stream).iter_messages()
        )
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
                writer.add_message(
                    channel,
                    stamp + 100_000,
                    msgspec.json.encode(message),
                    stamp,
                    message.seq,
                )
        writer.finish()
        output.close()
        if clock is None:
            entries = list(Recording(path).entries())
            assert [entry.message for entry in entries] == [
                m for topic, m in sent if topic == DEVICE_STATE
            ]
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
            (
                DEVICE_STATE,
                DeviceState(
                    seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0), overruns=count
                ),
            )
            for seq, count in told
        ],
    )
    recording = Recording(path)
    assert recording.topics[DEVICE_STATE].gaps == overruns(recording) == 5


def test_events_are_read(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    said = Event(
        seq=3, stamp=1.0, node="driver", kind="safety", reason="−0.1 m, limit −0.05 m"
    )
    write(path, [(event("driver"), said)])
    recording = Recording(path)
    assert recording.messages("/driver/event") == [said]
    assert recording.duration == 0.0


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40), st.floats(0.0, 1.0))
def test_quantile_is_numpys(values: list[float], fraction: float) -> None:
    # Both interpolate linearly; numpy groups the terms in another order, which costs a few
    # roundings of the largest value.
    tolerance = 4 * np.finfo(float).eps * max(map(abs, values))
    assert (
        abs(quantile(sorted(values), fraction) - float(np.quantile(values, fraction)))
        <= tolerance + 1e-300
    )


def test_summary_is_true_to_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    missed = (20, 21, 60)
    sent = list(drop(101, missed=missed))
    write(path, sent)
    summary = summarise(Recording(path))
    states = [message for _, message in sent if isinstance(message, DeviceState)]
    assert (summary.ticks, summary.missed, summary.overruns) == (100, 3, 0)
    assert summary.rate_hz == pytest.approx(1.0 / PERIOD, rel=1e-12)
    responses = [
        state.response * 1e6 for state in states[1:] if state.seq - 1 not in missed
    ]
    assert len(responses) == 97
    # The upper end of a bin of 1 µs, of the response that this share did not exceed.
    for name, share in (("p99", 99), ("p50", 50)):  # without the missed ticks' 0
        exact = float(np.percentile(responses, share, method="inverted_cdf"))
        assert -0.05 <= summary.response_us[name] - exact <= 1.05  # rounded to 0.1
    assert summary.response_us["max"] == round(max(responses), 1)
    assert summary.position_m == list(states[-1].position)


def test_ticks_without_an_answer_have_no_response(tmp_path: Path) -> None:
    """More than half of them: as responses of 0 µs they would be the median."""
    path, missed = tmp_path / "r.mcap", tuple(range(10, 80))
    sent = list(drop(101, missed=missed))
    write(path, sent)
    summary = summarise(Recording(path))
    states = [message for _, message in sent if isinstance(message, DeviceState)]
    answered = [state.response * 1e6 for state in states if state.response > 0.0]
    assert (summary.missed, len(answered)) == (70, 30)
    assert min(answered) <= summary.response_us["p50"] <= max(answered) + 1.0
    exact = float(np.percentile(answered, 50, method="inverted_cdf"))
    assert -0.05 <= summary.response_us["p50"] - exact <= 1.05


def test_a_driver_that_was_started_again_adds_to_what_was_missed(
    tmp_path: Path,
) -> None:
    """Counts restart at 0: neither run's counts are lost, and the oldest force is any tick's."""
    path = tmp_path / "r.mcap"
    # seq, missed so far, left out so far, age
    told = [
        (0, 0, 0, 0),
        (1, 1, 0, 3),
        (2, 2, 0, 4),
        (5, 2, 2, 0),
        (0, 0, 0, 0),
        (1, 1, 0, 1),
    ]
    write(
        path,
        [
            (
                DEVICE_STATE,
                DeviceState(
                    seq=seq,
                    stamp=k * PERIOD,
                    position=(0.0, 0.0, 0.0),
                    missed=missed,
                    overruns=left_out,
                    age=age,
                ),
            )
            for k, (seq, missed, left_out, age) in enumerate(told)
        ],
    )
    summary = summarise(Recording(path))
    assert (summary.missed, summary.overruns, summary.age_ticks_max) == (3, 2, 4)
    assert summary.ticks == 4


def test_summary_of_nothing(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(
        path,
        [
            (
                event("driver"),
                Event(seq=0, stamp=0.0, node="driver", kind="x", reason=""),
            )
        ],
    )
    summary = summarise(Recording(path))
    assert (summary.ticks, summary.response_us, summary.position_m) == (0, {}, [])
