"""Live data of a launch from Python: streams, the newest message, the last seconds, marks."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import haptic
import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.types import DeviceState, Event, Force
from nodes.base.events import LONGEST_MARK, Clock, Events
from nodes.parameters.store import ParameterError
from nodes.recording.facts import marks_of
from nodes.recording.plot import figure_of
from nodes.recording.plot_panels import COLORS
from nodes.recording.reader import Recording
from nodes.recording.table import columns_of, joined, read
from nodes.recording.writer import RecordWriter
from nodes.view.replay import ReplayPages
from tests.support.coroutines import complete
from tests.support.launching import assert_nothing_left, private_runtime_dir
from tests.support.recorded import PERIOD, drop


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    with private_runtime_dir() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        patch.chdir(folder)
        yield folder
        assert_nothing_left(folder)


# A busy machine is late, which is no matter of listening.
@pytest.mark.filterwarnings("ignore::sim.api.run_summary.LaunchWarning")
@pytest.mark.process
@pytest.mark.slow
def test_a_launch_is_followed_while_it_runs(place: Path) -> None:
    """One launch, because it costs the most: all ways to listen, against its recording."""
    with haptic.launch(
        "wall_press", duration=0, pace="realtime", out_dir=place / "r"
    ) as run:
        states = []
        for state in run.stream(DEVICE_STATE):
            states.append(state)
            if len(states) == 300:
                break
        several = list(run.stream(DEVICE_STATE, FORCE, duration=0.5))
        newest = run.latest(DEVICE_STATE)
        table = run.table(seconds=0.5)
        later = run.latest(DEVICE_STATE)
        marked = run.mark("trial 3")

        async def both() -> tuple[int, int]:
            async def count(topic: str) -> int:
                found = 0
                async for message in run.stream(topic, duration=0.4):
                    assert message.seq >= 0
                    found += 1
                return found

            first, second = await asyncio.gather(count(DEVICE_STATE), count(PROXY))
            return first, second

        heard = complete(both())
        for call, words in (
            (lambda: run.stream("/device/stat"), "did you mean /device/state"),
            (lambda: run.stream(), "name a topic; there are /"),
            (lambda: run.table(seconds=0), "more than 0"),
            (lambda: run.mark(""), "a text of 1 to 200"),
        ):
            with pytest.raises(haptic.HapticError, match=words):
                call()
        run.stop()
        found = run.recording
    recorded = {
        state.seq: state for state in Recording(found.path).messages(DEVICE_STATE)
    }
    assert all(recorded[state.seq] == state for state in states)
    assert len({state.seq for state in states}) == 300
    assert {type(one.message) for one in several} == {DeviceState, Force}
    assert {one.topic for one in several} == {DEVICE_STATE, FORCE}
    assert min(heard) > 10
    assert later.seq > newest.seq > states[-1].seq
    # The table is what the recording says of the same ticks.
    where = np.isin(found["seq"], table["seq"][:-1])
    assert where.sum() == len(table["seq"]) - 1
    for column in ("position", "force", "mean_force", "safety"):
        np.testing.assert_array_equal(
            table[column][:-1], found[column][where], err_msg=column
        )
    assert table.duration_s == pytest.approx(0.5, abs=0.05)
    assert len(table.plot().axes) == 2
    (mark,) = found.marks
    assert mark[1] == "trial 3"
    assert mark[0] == pytest.approx(marked["stamp"] - found["stamp"][0], abs=1e-9)
    with pytest.raises(haptic.HapticError, match="ended"):
        run.mark("too late")


@pytest.mark.process
@pytest.mark.slow
def test_a_listener_changes_no_bit_of_a_run(place: Path) -> None:
    """In lockstep, where a node that waited for a listener would show."""
    finals = []
    for listeners in (0, 3):
        out = place / f"l{listeners}"
        with haptic.launch(
            "wall_press", duration=2.0, pace="lockstep", out_dir=out
        ) as run:
            streams = [iter(run.stream(DEVICE_STATE)) for _ in range(listeners)]
            for stream in streams:
                assert next(stream, None) is not None
            run.wait()
            finals.append(read(run.recording.path))
            for stream in streams:
                stream.close()
    assert len(finals[0]["seq"]) == len(finals[1]["seq"])
    for column in ("position", "force", "force_asked", "proxy", "seq"):
        np.testing.assert_array_equal(
            finals[0][column], finals[1][column], err_msg=column
        )


def test_a_table_of_messages_is_that_of_their_recording(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = list(drop(60, missed=(20,), switch=30))
    with RecordWriter(path, {}) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp)
    wanted = (m for topic, m in sent if topic in (DEVICE_STATE, PROXY, FORCE))
    live, recorded = columns_of(joined(wanted)), read(path)
    assert list(live) == list(recorded)
    for column, values in recorded.items():
        np.testing.assert_array_equal(live[column], values, err_msg=column)


def marked(path: Path) -> Path:
    """Write a drop with a mark at 0.1 s."""
    with RecordWriter(path, {"rate_hz": repr(1 / PERIOD), "axes": "z"}) as writer:
        for topic, message in drop(120):
            writer.write(topic, message, message.stamp)
            if topic == DEVICE_STATE and message.seq == 50:
                for kind in ("mark", "delay"):
                    event = Event(
                        seq=50,
                        stamp=message.stamp,
                        node="driver",
                        kind=kind,
                        reason="trial 3",
                    )
                    writer.write("/driver/event", event, message.stamp)
    return path


def test_a_mark_is_read_drawn_and_listed(tmp_path: Path) -> None:
    path = marked(tmp_path / "r.mcap")
    assert [(event.seq, event.reason) for event in marks_of(Recording(path))] == [
        (50, "trial 3")
    ]
    ((at, text),) = haptic.read(path).marks
    assert at == pytest.approx(50 * PERIOD)
    assert text == "trial 3"
    panel = figure_of(Recording(path)).axes[0]
    assert "trial 3" in [text.get_text() for text in panel.texts]
    (line,) = [line for line in panel.lines if line.get_color() == COLORS["mark"]]
    assert np.asarray(line.get_xdata()) == pytest.approx(50 * PERIOD)
    pages = ReplayPages(path)
    listed = [json.loads(text) for text in pages.log.items]
    assert any(
        one.get("event") == "mark" and one["text"] == "trial 3" for one in listed
    )


def test_a_mark_is_an_event_with_the_text_that_was_given(
    capsys: pytest.CaptureFixture[str],
) -> None:
    seq = 7
    setup: Any = SimpleNamespace(name="driver", period=PERIOD, pace="lockstep")
    events = Events("driver", Clock(setup, lambda: seq), lambda: seq)
    for text in ("a", "trial 3", "x" * LONGEST_MARK):
        assert events.mark(text) == {"tick": 7, "stamp": 7 * PERIOD}
    assert "mark: trial 3" in capsys.readouterr().err
    # Each of them, not the first, second and fourth only.
    assert len(events.outbox) == 3
    for wrong in ("", "  ", "x" * (LONGEST_MARK + 1), 3):
        with pytest.raises(
            ParameterError, match=f"a text of 1 to {LONGEST_MARK} characters"
        ):
            events.mark(wrong)  # type: ignore[arg-type]
    assert len(events.outbox) == 3
