"""Figures of several axes: each along its own, curved surfaces along the normal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.types import DeviceState, Force, Message, Proxy
from nodes.recording.difference import difference
from nodes.recording.overlay import force_over_position, overlay
from nodes.recording.plot import figure_of
from nodes.recording.reader import Recording
from nodes.recording.series import Lines
from nodes.recording.writer import RecordWriter
from nodes.view.feed import Feed
from tests.support.recorded import PERIOD, drop

RADIUS, STIFFNESS = 0.02, 800.0


def around(ticks: int = 400) -> Iterator[tuple[str, Message]]:
    """Yield a way around a sphere, in and out of it, with the force −K d n of each tick."""
    before = (0.0, 0.0, 0.0)
    for k in range(ticks):
        turn, away = k / 30.0, RADIUS + 0.004 * math.cos(k / 17.0)
        normal = (math.cos(turn), math.sin(turn) * 0.6, math.sin(turn) * 0.8)
        place = tuple(away * n for n in normal)
        distance = away - RADIUS
        depth = max(0.0, -distance)
        common: dict[str, Any] = {"seq": k, "stamp": k * PERIOD, "position": place}
        yield (
            DEVICE_STATE,
            DeviceState(**common, force=before, mean_force=before, force_seq=k - 1),
        )
        on: Any = tuple((RADIUS if depth else away) * n for n in normal)
        yield PROXY, Proxy(**common, proxy=on, normal=normal, distance=distance)
        before = tuple(STIFFNESS * depth * n for n in normal)  # type: ignore[assignment]
        yield FORCE, Force(seq=k, stamp=k * PERIOD, force=before, law="pd")


def recorded(path: Path, sent: Iterator[tuple[str, Message]], axes: str) -> Recording:
    with RecordWriter(
        path, {"scenario": path.stem, "pace": "lockstep", "axes": axes}
    ) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp)
    return Recording(path)


@pytest.fixture(scope="module")
def sphere(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return recorded(tmp_path_factory.mktemp("s") / "sphere.mcap", around(), "x,y,z")


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Return a drop onto a floor, along z."""
    return recorded(tmp_path_factory.mktemp("w") / "wall.mcap", drop(300), "z")


@pytest.fixture(scope="module")
def along_x(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Return a swing along x without a surface."""
    sent = (
        (
            DEVICE_STATE,
            DeviceState(
                seq=k,
                stamp=k * PERIOD,
                position=(0.01 * math.sin(k / 9.0), 0.0, 0.0),
                force=(math.cos(k / 9.0), 0.0, 0.0),
            ),
        )
        for k in range(300)
    )
    return recorded(tmp_path_factory.mktemp("x") / "swing.mcap", sent, "x")


def curves(axes: Any) -> dict[str, Any]:
    """Return what is drawn in a panel, by label."""
    return {
        line.get_label(): np.asarray(line.get_ydata(), dtype=float)
        for line in axes.lines
        if not str(line.get_label()).startswith("_")
    }


def test_three_axes_are_drawn_as_three(sphere: Recording) -> None:
    position, force, *_ = figure_of(sphere).axes
    states: list[DeviceState] = sphere.messages(DEVICE_STATE)
    drawn = curves(position)
    for i, axis in enumerate("xyz"):
        wanted = [1e3 * state.position[i] for state in states]
        np.testing.assert_array_equal(drawn[f"device {axis}"], wanted)
        wanted = [state.force[i] for state in states[1:]]
        np.testing.assert_array_equal(curves(force)[f"after limits {axis}"], wanted)
    # A sphere has no place in such a panel.
    assert "surface" not in drawn


def test_force_over_a_curved_surface_is_drawn_along_its_normal(
    sphere: Recording,
) -> None:
    (axes,) = force_over_position([sphere]).axes
    x, y = np.asarray(axes.lines[0].get_data(), dtype=float)
    seen = np.isfinite(x)
    assert seen.sum() > 300
    assert axes.get_xlabel() == "distance along the normal [mm]"
    # The law itself: K times the depth; four roundings of numbers below 4 N.
    wanted = STIFFNESS * np.maximum(0.0, -x[seen] * 1e-3)
    np.testing.assert_allclose(y[seen], wanted, rtol=0, atol=4e-15)
    assert not any("surface, at" in text.get_text() for text in axes.texts)


def test_the_way_to_a_curved_surface_is_not_shown(tmp_path: Path) -> None:
    """From 100 mm away to 1 mm inside: the felt millimetre fills the panel."""

    def sent() -> Iterator[tuple[str, Message]]:
        normal = (0.0, 0.6, 0.8)
        for k in range(300):
            distance = max(0.1 - 5e-4 * k, -1e-3)
            place, on, force = (
                (scale * normal[0], scale * normal[1], scale * normal[2])
                for scale in (
                    RADIUS + distance,
                    max(RADIUS, RADIUS + distance),
                    STIFFNESS * max(0.0, -distance),
                )
            )
            common: Any = {"seq": k, "stamp": k * PERIOD, "position": place}
            yield DEVICE_STATE, DeviceState(**common, force=force, force_seq=k - 1)
            yield PROXY, Proxy(**common, proxy=on, normal=normal, distance=distance)

    run = recorded(tmp_path / "far.mcap", sent(), "x,y,z")
    (axes,) = force_over_position([run]).axes
    low, high = axes.get_xlim()
    assert low < -1.0
    assert 0.0 < high < 1.0
    assert any("shown: where a force acts" in text.get_text() for text in axes.texts)


def test_a_flat_surface_has_a_place_and_a_curved_one_has_none(
    sphere: Recording, wall: Recording
) -> None:
    assert [Lines(sphere).level(axis) for axis in range(3)] == [None] * 3
    assert Lines(wall).level(2) == pytest.approx(0.0, abs=1e-9)
    assert (Lines(sphere).axes, Lines(wall).axes) == ([0, 1, 2], [2])


def test_runs_of_different_axes_are_each_drawn_along_their_own(
    wall: Recording, along_x: Recording
) -> None:
    figure = overlay([wall, along_x], 0.0, 1.0)
    x_position, z_position, x_force, z_force = figure.axes
    for axes, label, recording, axis, field, scale in (
        (x_position, "position x [mm]", along_x, 0, "position", 1e3),
        (z_position, "position z [mm]", wall, 2, "position", 1e3),
        (x_force, "force x [N]", along_x, 0, "force", 1.0),
        (z_force, "force z [N]", wall, 2, "force", 1.0),
    ):
        assert axes.get_ylabel() == label
        (drawn,) = curves(axes).values()
        states = recording.messages(DEVICE_STATE)
        wanted = [scale * getattr(state, field)[axis] for state in states]
        np.testing.assert_array_equal(
            drawn, wanted if field == "position" else wanted[1:]
        )
    # Both runs are in the legend.
    assert len(figure.legends[0].get_texts()) == 2
    left, right = force_over_position([wall, along_x]).axes
    assert (left.get_xlabel(), right.get_xlabel()) == (
        "position x [mm]",
        "position z [mm]",
    )


@pytest.mark.parametrize("ticks", [300, 9000])
def test_a_difference_is_that_of_the_same_time(tmp_path: Path, ticks: int) -> None:
    """Half the rate and an offset: between its ticks the reference is linear."""

    def ramp(count: int, period: float, offset: float) -> Iterator[tuple[str, Message]]:
        for k in range(count):
            place = (0.0, 0.0, 0.05 * k * period + offset)
            yield (
                DEVICE_STATE,
                DeviceState(seq=k, stamp=5.0 + k * period, position=place),
            )

    fine = recorded(tmp_path / "fine.mcap", ramp(ticks, PERIOD, 3e-6), "z")
    coarse = recorded(tmp_path / "coarse.mcap", ramp(ticks // 4, 3 * PERIOD, 0.0), "z")
    found = difference(fine, Lines(fine), coarse)
    time, values = found.arrays()
    # Nothing beyond the reference's end, but for a bin's width.
    end = 3 * PERIOD * (ticks // 4 - 1)
    assert time[-1] - 5.0 <= end + ticks * PERIOD / 2000 + 1e-9
    # Rounding of stamps near 5 s: 1e-15 s at 0.05 m/s, and of positions below 1 m.
    np.testing.assert_allclose(values[:, 2], 3e-6, rtol=0, atol=1e-15)
    alone = difference(fine, Lines(fine), fine).arrays()[1]
    assert not alone.any()


def test_the_same_run_has_no_difference_and_another_has_its_own(
    wall: Recording, tmp_path: Path
) -> None:
    moved = recorded(
        tmp_path / "moved.mcap", ((topic, m) for topic, m in drop(300, switch=100)), "z"
    )
    panels = overlay([wall, wall, moved], 0.0, 1.0).axes
    assert len(panels) == 3
    assert panels[2].get_ylabel() == "z minus the first [mm]"
    same, other = (np.asarray(line.get_ydata()) for line in panels[2].lines)
    assert not same.any()
    apart = [
        1e3 * (a.position[2] - b.position[2])
        for a, b in zip(
            moved.messages(DEVICE_STATE), wall.messages(DEVICE_STATE), strict=True
        )
    ]
    assert max(map(abs, apart)) > 1.0
    np.testing.assert_array_equal(other, apart)


def test_nothing_lies_beyond_the_frame(tmp_path: Path) -> None:
    """A proxy may be farther away than the device ever is."""

    def sent() -> Iterator[tuple[str, Message]]:
        for k in range(50):
            place = (0.0, 0.0, 0.001 * math.sin(k / 5.0))
            yield DEVICE_STATE, DeviceState(seq=k, stamp=k * PERIOD, position=place)
            on = (0.0, 0.0, 0.01 if k == 20 else place[2])
            yield PROXY, Proxy(seq=k, stamp=k * PERIOD, position=place, proxy=on)

    panel = figure_of(recorded(tmp_path / "r.mcap", sent(), "z")).axes[0]
    low, high = panel.get_ylim()
    for values in curves(panel).values():
        assert low < values.min()
        assert values.max() < high


@pytest.mark.parametrize("kind", ["runs", "pairs", "one"])
def test_labels_fit_and_rounding_is_drawn_as_rest(
    along_x: Recording, tmp_path: Path, kind: str
) -> None:
    """Three narrow panels, one of them of an axis in which nothing moves."""

    def sent() -> Iterator[tuple[str, Message]]:
        for k in range(200):
            swing = math.sin(k / 30.0)
            place = (0.2 + 1e-4 * swing, 1e-19 * math.cos(k / 9.0), -0.1 * swing)
            force = (swing, 1e-16 * math.sin(k / 7.0), 0.1)
            common: dict[str, Any] = {"seq": k, "stamp": k * PERIOD, "position": place}
            yield DEVICE_STATE, DeviceState(**common, force=force, force_seq=k - 1)

    run = recorded(tmp_path / "run.mcap", sent(), "x,y,z")
    draw = {
        "runs": lambda: overlay([run, along_x]),
        "pairs": lambda: force_over_position([run]),
        "one": lambda: figure_of(run),
    }
    figure = draw[kind]()
    figure.draw_without_rendering()
    width = figure.bbox.width
    across = [axes.xaxis.label.get_window_extent() for axes in figure.axes]
    across += [
        text.get_window_extent()
        for axes in figure.axes
        for text in axes.get_xticklabels()
        if axes.get_xlim()[0] <= text.get_position()[0] <= axes.get_xlim()[1]
    ]
    across = [box for box in across if box.width > 0.0]
    assert all(box.x0 >= 0.0 and box.x1 <= width for box in across)
    # Nothing in a row is written over its neighbour.
    for row in {round(box.y0) for box in across}:
        beside = sorted((b.x0, b.x1) for b in across if round(b.y0) == row)
        assert all(a[1] < b[0] for a, b in itertools.pairwise(beside))
    if kind == "one":
        return
    still = [axes for axes in figure.axes if " y" in axes.get_ylabel()]
    assert still
    for axes in still:
        low, high = axes.get_ylim()
        assert high - low >= 1e-4
    if kind == "runs":
        alone = [axes for axes in figure.axes[-3:] if not axes.lines]
        assert len(alone) == 2
        assert all("one run" in axes.texts[0].get_text() for axes in alone)


@pytest.mark.parametrize("late", [0, 1, 3])
def test_a_scene_pairs_position_and_proxy_of_one_tick(late: int) -> None:
    """A device at 3 m/s moves 6 mm in a tick: a wall at 0 must not move with it."""
    feed = Feed(["x", "y", "z"], PERIOD)
    proxies: list[Proxy] = []
    for k in range(60):
        x = 3.0 * PERIOD * k
        place = (x, 0.0, 0.0)
        feed.take(DEVICE_STATE, DeviceState(seq=k, stamp=k * PERIOD, position=place))
        now = feed.now()
        if feed.proxy is not None:
            # The surface that a page draws: position less distance along the normal.
            assert now[1] - now[19] * now[7] == pytest.approx(0.0, abs=1e-15)
        proxies.append(
            Proxy(
                seq=k,
                stamp=k * PERIOD,
                position=place,
                proxy=place,
                normal=(1, 0, 0),
                distance=x,
            )
        )
        if k >= late:
            feed.take(PROXY, proxies[k - late])
    # Without proxies the position goes on alone.
    for k in range(60, 200):
        feed.take(
            DEVICE_STATE,
            DeviceState(seq=k, stamp=k * PERIOD, position=(float(k), 0.0, 0.0)),
        )
    assert feed.now()[1] == 199.0


@pytest.mark.parametrize("length", [3, 22, 60])
def test_a_legend_is_no_wider_than_its_figure(tmp_path: Path, length: int) -> None:
    """Two recordings of one scenario are named by their files, however long these are."""
    runs = []
    for letter in "ab":
        (tmp_path / letter).mkdir()
        path = tmp_path / letter / f"{letter * length}.mcap"
        manifest = {"scenario": "touch_wall", "pace": "lockstep", "axes": "z"}
        with RecordWriter(path, manifest) as writer:
            for topic, message in drop(60):
                writer.write(topic, message, message.stamp)
        runs.append(Recording(path))
    for figure in (overlay(runs), force_over_position(runs)):
        (legend,) = figure.legends
        assert len(legend.get_texts()) == 2
        assert legend.get_window_extent().width <= figure.bbox.width


@pytest.mark.parametrize(
    ("apart", "unit", "scale"), [(9e-4, "µm", 1e6), (5e-3, "mm", 1e3)]
)
def test_a_difference_has_a_unit_of_its_size(
    wall: Recording, tmp_path: Path, apart: float, unit: str, scale: float
) -> None:
    def moved() -> Iterator[tuple[str, Message]]:
        for topic, message in drop(300):
            if isinstance(message, DeviceState):
                x, y, z = message.position
                message = msgspec.structs.replace(message, position=(x, y, z + apart))
            yield topic, message

    other = recorded(tmp_path / "moved.mcap", moved(), "z")
    panel = overlay([wall, other], 0.0, 1.0).axes[2]
    assert panel.get_ylabel() == f"z minus the first [{unit}]"
    drawn = np.asarray(panel.lines[-1].get_ydata())
    # Rounding of positions below 1 m.
    np.testing.assert_allclose(drawn, scale * apart, rtol=0, atol=scale * 1e-15)
