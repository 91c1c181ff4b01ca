"""Figures of recordings: content, formats, time span, no overlapping texts."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import colors, image
from matplotlib.patches import Rectangle

from messages import topics
from messages.types import DeviceState, Force, Message, NodeStatus, Proxy, Receipt
from nodes.cli import main
from nodes.recording import plot, plot_panels
from nodes.recording.overlay import RUNS, force_over_position, overlay, sight_of
from nodes.recording.reader import Recording
from nodes.recording.series import BINS, POINTS, Line, Lines, Spans
from nodes.recording.writer import RecordWriter
from tests.support import slowly, thoroughly
from tests.support.overlap import overlaps
from tests.support.recorded import PERIOD, PUBLISHES, drop

MISSED = (40, 41, 150)


def write(path: Path, sent: Sequence[tuple[str, Message]], **manifest: str) -> Path:
    with RecordWriter(
        path,
        {"scenario": "floor_drop", "pace": "realtime", "publishes": PUBLISHES}
        | manifest,
    ) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp + 1e-4)
    return path


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write(tmp_path / "drop.mcap", list(drop(300, missed=MISSED, switch=100)))


def texts(figure: Any) -> str:
    return "\n".join(
        text.get_text()
        for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))
    )


# -- lines in bounded memory
# -----------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50),
    st.integers(POINTS, 3 * POINTS),
)
def test_a_long_line_keeps_every_extreme_where_it_was(
    spikes: list[float], count: int
) -> None:
    rng = np.random.default_rng(1)
    time = np.arange(count + 1) * PERIOD
    value = rng.normal(size=len(time))
    value[rng.integers(0, len(time), len(spikes))] = spikes
    line = Line(0.0, time[-1], 1)
    for at, one in zip(time.tolist(), value.tolist(), strict=True):
        line.add(at, one)
    thin_time, thin = line.arrays()
    assert len(thin) <= POINTS
    assert (thin.max(), thin.min()) == (value.max(), value.min())
    assert np.all(np.diff(thin_time) > 0.0)
    width = time[-1] / BINS
    for extreme in (value.argmax(), value.argmin()):
        # Ticks that lie on an edge belong to either side, by rounding.
        near = np.abs(thin_time - time[extreme]) <= width * (1.0 + 1e-9)
        assert value[extreme] in thin[near, 0]


def test_a_short_line_is_what_was_recorded() -> None:
    line = Line(0.0, 1.0, 2)
    for number in range(POINTS):
        line.add(number * 1e-4, float(number), np.nan)
    time, values = line.arrays()
    assert values[:, 0].tolist() == list(range(POINTS))
    assert time[7] == 7 * 1e-4
    assert Line(0.0, 0.0, 3).arrays()[1].shape == (0, 3)


def test_spans_tell_when() -> None:
    spans = Spans(10.0, 20.0)
    for begin, end in ((10.0, 10.0), (12.5, 14.0), (14.0, 15.0), (20.0, 20.0)):
        spans.add(begin, end, "damping")
    found = list(spans.spans())
    assert [name for name, _, _ in found] == ["damping"] * 3
    width = 10.0 / BINS
    for (_, low, high), (begin, end) in zip(
        found, ((10.0, 10.0), (12.5, 15.0), (20.0, 20.0)), strict=True
    ):
        assert begin - width <= low <= begin
        assert end <= high + 1e-9 <= end + 2.0 * width


# -- one run
# --------------------------------------------------------------------------------------------------


def near(picture: Any, color: str) -> Any:
    """Mask of pixels with a colour, or its blend with white by a third or more."""
    ink = 1.0 - picture[:, :, :3]
    pure = 1.0 - np.array(colors.to_rgb(color))
    share = ink @ pure / (pure @ pure)
    rest = np.abs(ink - share[:, :, None] * pure).max(axis=2)
    return (share > 0.33) & (share < 1.1) & (rest < 0.05)


def test_the_title_is_on_top_the_time_below_and_a_switch_in_every_panel(
    tmp_path: Path,
) -> None:
    """The switch is named once, by the law that it chose, at its own time."""
    path = write(tmp_path / "drop.mcap", list(drop(100, switch=60)), pace="lockstep")
    panels: list[Any] = plot.figure_of(Recording(path), start=0.0, stop=None).axes
    first, *rest = panels
    assert first.get_title(loc="left") == "floor_drop"
    assert [axes.get_title(loc="left") for axes in rest] == [""] * len(rest)
    labels = [axes.get_xlabel() for axes in panels]
    assert labels == [""] * len(rest) + ["simulated time [s]"]
    for axes in panels:
        dotted = [line for line in axes.lines if line.get_linestyle() == ":"]
        at = [line.get_xdata()[0] for line in dotted if len(line.get_xdata()) == 2]
        assert at == pytest.approx([60 * PERIOD], abs=1e-12)
    named = [text for text in first.texts if text.get_text() == "stiffer"]
    assert [text.xy[0] for text in named] == pytest.approx([60 * PERIOD], abs=1e-12)
    assert "stiffer" not in [text.get_text() for axes in rest for text in axes.texts]


def test_plot_shows_the_run(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["bag", "plot", str(bag), "--from", "0", "--json"]) == 0
    out = Path(json.loads(capsys.readouterr().out)["plot"])
    picture = image.imread(out)
    height, width, _ = picture.shape
    assert width == 1200
    assert height > 800
    # The device's line runs through nearly the whole width, and leaves a height that shows the
    # bounces.
    device = near(picture, plot_panels.COLORS["device"])
    assert device.any(axis=0).mean() > 0.8
    assert device.any(axis=1).mean() > 0.3
    # The switch is a dotted line through all panels.
    switch = near(picture, plot_panels.COLORS["switch"]).sum(axis=0)
    assert switch.max() > 0.2 * height


def test_what_is_drawn_are_the_recorded_values_in_the_units_of_their_axes(
    bag: Path,
) -> None:
    """Each point of a curve is a message's value at its tick; missed ticks have no response."""
    recording = Recording(bag)
    states: list[DeviceState] = recording.messages(topics.DEVICE_STATE)
    forces: list[Force] = recording.messages(topics.FORCE)
    proxies: list[Proxy] = recording.messages(topics.PROXY)
    answered = {state.seq - 1: state for state in states[1:]}
    known = {
        "device": {state.seq: 1e3 * state.position[2] for state in states},
        "proxy": {one.seq: 1e3 * one.proxy[2] for one in proxies},
        "surface": {
            one.seq: 1e3 * (one.position[2] - one.distance * one.normal[2])
            for one in proxies
        },
        "law": {one.seq: one.force[2] for one in forces},
        "after limits": {seq: state.force[2] for seq, state in answered.items()},
        "given out by the virtual side": {
            state.seq: 1e3 * state.energy for state in states
        },
        "p50": {
            seq: 1e6 * one.response
            for seq, one in answered.items()
            if one.response > 0.0
        },
    }
    found = set()
    for line in (
        line for axes in plot.figure_of(recording).axes for line in axes.lines
    ):
        label = str(line.get_label())
        name = "p50" if label.startswith("p50") else label
        if name not in known:
            continue
        found.add(name)
        ticks = [round(at / PERIOD) for at in np.asarray(line.get_xdata())]
        drawn = np.asarray(line.get_ydata()).tolist()
        # One product and one difference of doubles.
        assert drawn == pytest.approx(
            [known[name][tick] for tick in ticks], rel=1e-14
        ), name
        shown = [
            known[name][tick]
            for tick in range(min(ticks), max(ticks))
            if tick in known[name]
        ]
        assert (min(drawn), max(drawn)) == pytest.approx(
            (min(shown), max(shown)), rel=1e-14
        ), name
    assert found == set(known)


@pytest.mark.slow
def test_plot_marks_missed_ticks_and_the_period(tmp_path: Path) -> None:
    amounts = []
    for name, missed, pace in (
        ("none", (), "realtime"),
        ("some", MISSED, "realtime"),
        ("lockstep", (), "lockstep"),
    ):
        write(tmp_path / f"{name}.mcap", list(drop(300, missed=missed)), pace=pace)
        picture = image.imread(
            plot.plot(Recording(tmp_path / f"{name}.mcap"), tmp_path / f"{name}.png")
        )
        amounts.append(int(near(picture, plot_panels.COLORS["late"]).sum()))
    without, with_missed, lockstep = amounts
    # Without a deadline there is no period line; two marks (two of the three ticks are neighbours)
    # are triangles of 5 pt.
    assert lockstep == 0
    assert without > 300
    assert with_missed > without + 60


@pytest.mark.parametrize(
    ("ending", "start"),
    [("png", b"\x89PNG\r\n"), ("svg", b"<?xml"), ("PDF", b"%PDF-"), ("", b"\x89PNG")],
)
def test_files_are_what_they_are_called(bag: Path, ending: str, start: bytes) -> None:
    out = bag.with_name("picture" + (f".{ending}" if ending else ""))
    assert main.main(["bag", "plot", str(bag), "--out", str(out)]) == 0
    assert out.read_bytes().startswith(start)


def test_an_unknown_ending_is_refused(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = bag.with_name("picture.jpeg2")
    assert main.main(["bag", "plot", str(bag), "--out", str(out)]) == 1
    assert "not a plot format: .png, .svg, .pdf" in capsys.readouterr().err
    assert not out.exists()


def test_a_figure_shows_positions_in_millimetres_and_states_where_they_were(
    tmp_path: Path,
) -> None:
    sent = []
    for topic, message in drop(300):
        later = msgspec.structs.replace(message, stamp=message.stamp + 5.0)
        if isinstance(later, DeviceState) and 100 <= later.seq < 140:
            later = msgspec.structs.replace(later, safety="damping")
        sent.append((topic, later))
    recording = Recording(write(tmp_path / "late.mcap", sent))
    figure = plot.figure_of(recording, start=0.0)
    axes = figure.axes[0]
    assert axes.get_ylabel().endswith("[mm]")
    drawn = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.lines}
    states = np.array(
        [state.position[2] for state in recording.messages(topics.DEVICE_STATE)]
    )
    device = drawn["device"][np.isfinite(drawn["device"])]
    # A product with 1000 and a rounding of it.
    assert [device.min(), device.max()] == pytest.approx(
        [1e3 * states.min(), 1e3 * states.max()], rel=1e-12
    )
    # The floor of the drop is at 0.
    assert np.unique(drawn["surface"]).tolist() == [0.0]
    low, high = axes.get_ylim()
    margin = 0.1 * (device.max() - device.min())
    assert device.min() - margin < low < device.min()
    assert device.max() < high < device.max() + margin
    shown = [
        (patch.get_x(), patch.get_x() + patch.get_width())
        for panel in figure.axes
        for patch in panel.patches
        if isinstance(patch, Rectangle)
        and str(patch.get_label()).startswith("safety: ")
    ]
    # From the first such state to the first other one, to a bin of the figure's width.
    assert np.array(shown) == pytest.approx(
        np.array([[100 * PERIOD, 140 * PERIOD]]), abs=2.0 * 300 * PERIOD / BINS + PERIOD
    )


def test_the_first_picture_shows_the_contact_not_the_rest(tmp_path: Path) -> None:
    long = Recording(write(tmp_path / "long.mcap", list(drop(6000))))
    figure = plot.figure_of(long)
    position, *_, response = figure.axes
    shown = position.get_xlim()[1]
    # The response time is told in full; position and force until a while after the drop is at rest.
    assert response.get_xlim()[1] > 11.9
    rest = Lines(long).rest()
    assert rest < shown < 1.5 * rest < 2.0
    states: list[DeviceState] = long.messages(topics.DEVICE_STATE)
    last = states[-1].position[2]
    spread = max(s.position[2] for s in states) - min(s.position[2] for s in states)
    away = [s.stamp for s in states if abs(s.position[2] - last) > 0.011 * spread]
    assert rest >= away[-1] - 12.0 / BINS
    assert "at rest from" in texts(figure)
    # What is asked for is what is shown.
    asked = plot.figure_of(long, start=0.0).axes[0].get_xlim()
    assert asked[1] > 11.9
    low, high = plot.figure_of(long, 0.02, 0.2).axes[0].get_xlim()
    assert low == pytest.approx(0.02, abs=0.01)
    assert high == pytest.approx(0.2, abs=0.01)


def test_a_run_that_does_not_rest_is_shown_whole(tmp_path: Path) -> None:
    sent = [
        (
            topics.DEVICE_STATE,
            DeviceState(
                seq=k, stamp=k * PERIOD, position=(0.0, 0.0, 0.01 * math.sin(0.05 * k))
            ),
        )
        for k in range(2000)
    ]
    figure = plot.figure_of(Recording(write(tmp_path / "r.mcap", sent)))
    assert figure.axes[0].get_xlim()[1] > 3.99


def test_the_plot_tells_of_losses_what_bag_info_tells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # 114 gaps in what the environment answered, because it took the newest: nothing of what it sent
    # is lost.
    sent = [
        (
            topic,
            (
                msgspec.structs.replace(message, sent=186)
                if isinstance(message, NodeStatus) and "env" in topic
                else message
            ),
        )
        for topic, message in drop(300)
        if not (topic == topics.PROXY and 100 <= message.seq < 214)
    ]
    path = write(tmp_path / "r.mcap", sent)
    assert Recording(path).topics[topics.PROXY].gaps == 114
    assert main.main(["bag", "info", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["lost"], told["complete"]) == (0, True)
    assert "recording complete, nothing lost" in texts(plot.figure_of(Recording(path)))


def test_plot_of_texts_that_look_like_formulas(tmp_path: Path) -> None:
    path = write(
        tmp_path / "r.mcap", list(drop(20, switch=5)), scenario=r"$\frac{x$ \n %s"
    )
    assert plot.render(plot.figure_of(Recording(path)), "png").startswith(b"\x89PNG")


def test_plot_of_too_little(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "r.mcap", list(drop(1)))
    assert main.main(["bag", "plot", str(path)]) == 1
    assert "a plot needs at least two" in capsys.readouterr().err
    # Two states and nothing else are enough.
    only = write(
        tmp_path / "only.mcap", [(t, m) for t, m in drop(2) if t == topics.DEVICE_STATE]
    )
    assert main.main(["bag", "plot", str(only)]) == 0
    for words, why in (
        (["--from", "5"], "nothing between 5 and inf s"),
        (["--from", "2", "--to", "1"], "the end must come after the beginning"),
    ):
        assert main.main(["bag", "plot", str(only), "--force", *words]) in (1, 2)
        assert why in capsys.readouterr().err


# -- several runs
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def several(tmp_path: Path) -> list[Path]:
    return [
        write(
            tmp_path / f"run{number}.mcap",
            list(drop(200 + 50 * number, switch=60 + number)),
        )
        for number in range(3)
    ]


def test_runs_lie_over_each_other(
    several: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["bag", "plot", *map(str, several), "--json"]) == 0
    out = Path(json.loads(capsys.readouterr().out)["plot"])
    assert out == several[0].with_name("run0_overlay.png")
    recordings = [Recording(path) for path in several]
    position, force, _ = overlay(recordings, 0.0, 1.0).axes
    for axes, scale, field in ((position, 1e3, "position"), (force, 1.0, "force")):
        drawn = [line for line in axes.lines if np.size(line.get_xdata()) > 2]
        assert len(drawn) == 3
        for line, recording in zip(drawn, recordings, strict=True):
            states: list[DeviceState] = recording.messages(topics.DEVICE_STATE)
            told = [getattr(state, field)[2] * scale for state in states]
            np.testing.assert_array_equal(
                np.asarray(line.get_ydata()), told if field == "position" else told[1:]
            )


def test_force_over_position_pairs_what_belongs_together(several: list[Path]) -> None:
    (axes,) = force_over_position([Recording(several[0])]).axes
    states: list[DeviceState] = Recording(several[0]).messages(topics.DEVICE_STATE)
    pairs = {(a.position[2] * 1e3, b.force[2]) for a, b in pairwise(states)}
    x, y = np.asarray(axes.lines[0].get_data(), dtype=float)
    drawn = {(float(a), float(b)) for a, b in zip(x, y, strict=True) if not np.isnan(a)}
    assert drawn <= pairs
    # All of the bounce is there; what is left out came twice, to a two-thousandth of the picture.
    step = [np.ptp([p[i] for p in pairs]) / 1000 for i in (0, 1)]
    for pair in pairs:
        assert (
            min(
                max(abs(pair[0] - a) / step[0], abs(pair[1] - b) / step[1])
                for a, b in drawn
            )
            < 1.0
        )


def test_force_over_position_of_an_hour_at_rest_is_a_point(tmp_path: Path) -> None:
    at_rest = [
        (
            topics.DEVICE_STATE,
            DeviceState(seq=k, stamp=k * PERIOD, position=(0.0, 0.0, 0.01 * (k < 2))),
        )
        for k in range(5000)
    ]
    (axes,) = force_over_position([Recording(write(tmp_path / "r.mcap", at_rest))]).axes
    assert np.size(axes.lines[0].get_xdata()) < 10


def test_too_many_runs_are_refused(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["bag", "plot", *[str(bag)] * (RUNS + 1)]) == 1
    assert (
        f"{RUNS + 1} recordings; one picture shows 1 to {RUNS}"
        in capsys.readouterr().err
    )


# -- texts
# --------------------------------------------------------------------------------------------------


def crowded() -> Iterator[tuple[str, Message]]:
    """Yield rapid changes, laws with long names, every safety state."""
    for topic, message in drop(600, missed=MISSED):
        if isinstance(message, DeviceState):
            safety = ("ramp", "active", "damping", "zero", "fault")[message.seq // 120]
            yield (
                topic,
                msgspec.structs.replace(
                    message, safety=safety, guard=1e-3, overruns=message.seq // 100
                ),
            )
        elif isinstance(message, Force):
            name = f"a_law_with_quite_a_long_name_{message.seq // 40}"
            yield topic, msgspec.structs.replace(message, law=name)
            if message.seq % 40 == 0 or 300 < message.seq < 320:
                yield (
                    topics.RECEIPT,
                    Receipt(
                        seq=message.seq,
                        stamp=message.stamp,
                        action="switch",
                        before="{}",
                        after="{}",
                    ),
                )
        else:
            yield topic, message


def test_overlapping_texts_are_found() -> None:
    figure = plot.new_figure(4.0)
    figure.text(0.5, 0.5, "one")
    figure.text(0.505, 0.51, "other")
    figure.text(0.5, 0.9, "apart")
    (found,) = overlaps(figure)
    assert found.startswith("'one' over 'other'")


@pytest.mark.slow
@pytest.mark.parametrize("window", [(None, None), (0.0, None), (0.5, 0.7)])
def test_no_text_lies_over_another(
    tmp_path: Path, window: tuple[float | None, float | None]
) -> None:
    path = write(
        tmp_path / "crowded.mcap",
        list(crowded()),
        scenario="a_scenario_with_a_name_that_does_not_end_" * 3,
    )
    assert overlaps(plot.figure_of(Recording(path), *window)) == []


@pytest.mark.parametrize(
    "count",
    [
        2,
        *slowly([1, 7]),
        *thoroughly([RUNS], "test_no_text_lies_over_another_with_several_runs"),
    ],
)
def test_no_text_lies_over_another_with_several_runs(
    tmp_path: Path, count: int
) -> None:
    paths = [
        tmp_path / f"crowded_run_with_a_long_name_of_its_own_{number}.mcap"
        for number in range(count)
    ]
    sent = list(crowded())
    recordings = [
        Recording(write(path, sent, scenario="a_scenario_with_a_long_name" * 2))
        for path in paths
    ]
    assert overlaps(overlay(recordings)) == []
    assert overlaps(force_over_position(recordings)) == []


# -- memory
# --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_long_recording_is_drawn_in_bounded_memory(tmp_path: Path) -> None:
    peaks = []
    for name, ticks in (("short", 4000), ("long", 40_000)):
        path = tmp_path / f"{name}.mcap"
        with RecordWriter(path, {"scenario": name}) as writer:
            for seq in range(ticks):
                stamp = seq * PERIOD
                position = (0.0, 0.0, 0.001 * ((seq * 7919) % 1000))
                writer.write(
                    topics.DEVICE_STATE,
                    DeviceState(seq=seq, stamp=stamp, position=position, response=1e-4),
                    stamp,
                )
                writer.write(
                    topics.FORCE,
                    Force(seq=seq, stamp=stamp, force=position, law="pd"),
                    stamp,
                )
        code = (
            "import resource, sys; from nodes.cli.main import main; assert not main(sys.argv[1:]);"
            "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, "bag", "plot", str(path)],
            check=True,
            capture_output=True,
            text=True,
        )
        peaks.append(int(done.stdout.split()[-1]))
    # Ten times the ticks: 36 000 more, of which the response times are kept (8 bytes each, and
    # sorted) and nothing else.
    grown = (peaks[1] - peaks[0]) * 1024
    assert grown < 36_000 * 100 + 4e6


def test_force_over_position_shows_where_a_force_acts() -> None:
    """A quarter of that more on both sides; all of it, if that is most of it."""
    way = [0.0, 20.0, 21.0, 20.5, 0.0]
    force = [0.0, 0.0, -1.0, -0.5, 0.0]
    assert sight_of([(way, force)]) == (20.375, 21.125)
    # A second run that is felt elsewhere, and points where the pen is lifted.
    other = ([math.nan, 18.0], [math.nan, 0.1])
    assert sight_of([(way, force), other]) == (17.25, 21.75)
    assert sight_of([(way, [0.0] * 5)]) is None
    # A trace of a force far from the wall widens nothing.
    assert sight_of([(way, [-0.02, *force[1:]])]) == (20.375, 21.125)
    assert sight_of([([0.0, 8.0, 10.0], [0.0, 1.0, 1.0])]) == (7.5, 10.5)
    # Six tenths of all, and the rest is shown as well.
    assert sight_of([([0.0, 6.0, 10.0], [0.0, 1.0, 1.0])]) is None
