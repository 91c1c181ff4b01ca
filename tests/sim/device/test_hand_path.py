"""A hand's path from a file: one axis or three, tables and recordings; mistakes are met."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest

from messages.errors import UsageError
from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.parameters.store import ParameterError, convert
from nodes.recording.writer import RecordWriter
from sim.device.driver import along
from sim.device.hand import Hand, path_position
from sim.device.model import DeviceModel

N = 300
TIME = np.arange(N) * 0.004
X, Y, Z = (np.round(0.03 * np.sin(TIME * w), 6) for w in (3.0, 5.0, 7.0))

Walk = Callable[..., Path]


@pytest.fixture
def walk(tmp_path: Path) -> Walk:
    def write(names: str, *columns: Any, name: str = "walk.csv") -> Path:
        path = tmp_path / name
        rows = np.stack(
            [np.asarray(column, dtype=float) for column in columns], axis=1
        ).tolist()
        text = "\n".join([names, *(",".join(map(repr, row)) for row in rows)])
        path.write_text(text + "\n", encoding="utf-8")
        return path

    return write


def hand(source: Path, **given: Any) -> Hand:
    made: Hand = convert(
        {"stiffness": 150.0, "file": str(source), **given}, Hand, "hand"
    )
    return made


def devices(made: Hand, axes: str = "xyz") -> list[Hand]:
    model = DeviceModel(mass=0.1, hand=made)
    found = [one.hand for one in along(model, tuple(axes))]
    assert all(one is not None for one in found)
    return [one for one in found if one is not None]


def test_three_axes_of_a_file_are_those_of_the_scene(walk: Walk) -> None:
    made = hand(walk("t,x,y,z", TIME, X, Y, Z))
    for one, wanted in zip(devices(made), (X, Y, Z), strict=True):
        # The path goes through every row, and is linear between.
        for k in (0, 1, 17, N - 1):
            assert path_position(one.path, float(TIME[k])) == wanted[k]
        middle = 0.5 * (TIME[4] + TIME[5])
        assert path_position(one.path, float(middle)) == pytest.approx(
            0.5 * (wanted[4] + wanted[5]), abs=1e-16
        )


def test_one_axis_goes_to_the_first_and_the_others_rest(walk: Walk) -> None:
    first, second = devices(hand(walk("t,z", TIME, Z)), "xy")
    assert path_position(first.path, float(TIME[9])) == Z[9]
    assert second.path == [(0.0, 0.0)]
    assert second.repeat is None


@pytest.mark.parametrize(
    ("names", "factors", "given"),
    [
        ("t [ms],x [mm]", (1e3, 1e3), {}),
        ("t,x", (1.0, 1e3), {"units": {"position": "mm"}}),
        ("t,x", (1e3, 1.0), {"units": {"time": "ms"}}),
        (
            "frame,marker",
            (1 / 0.004, 1.0),
            {"columns": {"position": "marker"}, "rate": 250.0},
        ),
        (
            "sec,marker",
            (1.0, 1.0),
            {"columns": {"position": ["marker"], "time": "sec"}},
        ),
    ],
)
def test_units_columns_and_rate_are_chosen(
    walk: Walk, names: str, factors: tuple[float, float], given: dict[str, Any]
) -> None:
    made = hand(walk(names, TIME * factors[0], X * factors[1]), **given)
    for k in (3, 100):
        # Two roundings of the factor, there and back.
        assert made.point(float(TIME[k])) == pytest.approx(X[k], rel=1e-12)


def test_times_count_from_the_first_row_and_may_be_uneven(walk: Walk) -> None:
    """As motion capture stamps frames; what is at rest needs no corners."""
    uneven = TIME + 0.001 * np.sin(np.arange(N)) * (np.arange(N) > 0)
    made = hand(walk("t,x", 1.7e9 + uneven, X), units={"time": "s"})
    # A double near 1.7e9 has steps of 2.4e-7 s; the hand moves at most at 0.09 m/s.
    assert made.point(float(uneven[50])) == pytest.approx(X[50], abs=1e-7)
    still = np.where(TIME < 0.5, 0.0, 0.01)
    assert len(hand(walk("t,x", TIME, still)).corners) == 4


def test_a_hidden_marker_is_passed_in_a_line(walk: Walk) -> None:
    """Times still count from the first row of the file."""
    hidden = np.isin(np.arange(N), (0, 1, 40, 41))
    made = hand(walk("t,x", TIME, np.where(hidden, np.nan, X)))
    for k in (2, 39, 42):
        assert made.point(float(TIME[k])) == X[k]
    assert made.point(0.0) == X[2]
    third = (TIME[40] - TIME[39]) / (TIME[42] - TIME[39])
    between = X[39] + third * (X[42] - X[39])
    assert made.point(float(TIME[40])) == pytest.approx(between, abs=1e-15)


def test_a_recording_is_a_path_by_its_position_or_by_its_target(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordWriter(path, {"rate_hz": "250"}) as writer:
        for k in range(N):
            state = DeviceState(
                seq=k,
                stamp=77.0 + float(TIME[k]),
                position=(0.0, float(Y[k]), float(Z[k])),
                target=(0.0, float(X[k]), 0.0),
            )
            writer.write(DEVICE_STATE, state, 0.0)
    of_axes = devices(hand(path))
    assert of_axes[0].path == [(0.0, 0.0)]
    for one, wanted in zip(of_axes[1:], (Y, Z), strict=True):
        assert [place for _, place in one.path][:5] == wanted[:5].tolist()
    pulled = hand(path, columns={"position": "target"})
    # Stamps near 77 s are rounded to 1.4e-14 s.
    assert pulled.point(float(TIME[9])) == pytest.approx(X[9], abs=1e-14)
    with pytest.raises(ParameterError, match="only columns"):
        hand(path, units={"position": "mm"})


@pytest.mark.parametrize(
    ("names", "columns", "given", "words"),
    [
        ("t,x", (TIME, 1e3 * X * 30), {}, r"are they in mm .*units: \{position: mm\}"),
        ("t,x", (1e3 * TIME, X), {}, r"Is it in ms \(250 Hz\)\?.*units: \{time: ms\}"),
        ("t,x", (TIME[::-1], X), {}, "line 3, column 't': the time does not grow"),
        ("k,x", (TIME, X), {}, "rate: HZ"),
        (
            "t,q",
            (TIME, X),
            {},
            r"which column is the position.*columns: \{position: NAME\}",
        ),
        (
            "t,x",
            (TIME, X),
            {"columns": {"position": "q"}},
            "no column 'q'.*there are t, x",
        ),
        (
            "t,x",
            (TIME, np.where(TIME < 0.6, np.nan, X)),
            {},
            "line 2, column 'x': no number .* different rates",
        ),
        (
            "t,x",
            (TIME, X),
            {"rate": 100.0},
            "rate 100, while column 't' advances 250 times",
        ),
        ("t,x", (TIME, X), {"path": [[0, 0]]}, "path or file: both are given"),
        ("t,x", (TIME, X), {"file": ""}, "path or file: neither is given"),
        (
            "t,x",
            (TIME, X),
            {"file": "", "path": [[0, 0]], "rate": 5.0},
            "are of a file",
        ),
        (
            "t,x",
            (TIME, X),
            {"repeat": 0.5},
            r"repeat is 0.5 s, but the path ends at 1.196 s",
        ),
        ("t,x", (TIME, X), {"file": "no.csv"}, "No such file"),
        ("t,x", (TIME, X), {"file": "/dev/zero"}, "is no regular file"),
        (
            "t,x",
            (TIME, X),
            {"columns": {"force": "x"}},
            r"columns\.force: expected position",
        ),
    ],
)
def test_a_mistake_is_met_with_what_was_meant(
    walk: Walk, names: str, columns: Any, given: dict[str, Any], words: str
) -> None:
    path = walk(names, *columns)
    with pytest.raises(ParameterError, match=words) as refused:
        hand(path, **given)
    assert "hand" in str(refused.value)
    assert "--" not in str(refused.value)


def test_an_axis_has_a_path_of_its_own_beside_a_file(walk: Walk) -> None:
    one = walk("t,x", TIME, X)
    other = walk("t,x", TIME, Y, name="other.csv")
    base = {"stiffness": 150.0, "file": str(one)}
    for own, wanted in (({"file": str(other)}, Y[9]), ({"path": [[0.0, 0.02]]}, 0.02)):
        model: DeviceModel = convert(
            {"mass": 0.1, "hand": base, "axes": {"y": {"hand": own}}},
            DeviceModel,
            "device",
        )
        first, second = (m.hand for m in along(model, ("x", "y")))
        assert first is not None
        assert second is not None
        assert path_position(first.path, float(TIME[9])) == X[9]
        assert path_position(second.path, float(TIME[9])) == wanted


def test_a_file_that_changes_is_read_again(walk: Walk) -> None:
    assert hand(walk("t,x", TIME, X)).point(float(TIME[9])) == X[9]
    assert hand(walk("t,x", TIME[:-1], Y[:-1])).point(float(TIME[9])) == Y[9]


SCENE = """
summary: a hand from a file
run: {{rate: 500.0, pace: lockstep, duration: 1.0, axes: {axes}}}
nodes:
  driver:
    kind: sim_driver
    parameters:
      safety: {{peak_force: 40.0, slew: 20000.0}}
      device: {{mass: 0.1, damping: 1.0, hand: {{stiffness: 150.0, damping: 2.0, {hand}}}}}
  environment:
    kind: environment
    parameters: {{surface: {surface}}}
  coupling:
    kind: coupling
    parameters: {{law: pd, laws: {{pd: {{kind: pd, stiffness: 400.0, damping: 2.0}}}}}}
"""
WALL = "{kind: plane, position: -0.01}"
SPHERE = "{kind: sphere, position: [0.0, 0.0, -0.05], radius: 0.03}"


def test_a_path_of_a_file_is_that_of_its_numbers_to_the_bit(
    walk: Walk, tmp_path: Path
) -> None:
    """One axis, written as corners or as a file."""
    path = walk("t,z", TIME, Z)
    numbers = [[float(t), float(z)] for t, z in zip(TIME, Z, strict=True)]
    played = []
    for name, given in (("file", f"file: {path}"), ("path", f"path: {numbers}")):
        launch = tmp_path / f"{name}.yaml"
        launch.write_text(
            SCENE.format(axes="[z]", hand=given, surface=WALL), encoding="utf-8"
        )
        played.append(haptic.play(str(launch)))
    assert np.abs(played[0].position_m).max() > 5e-3
    np.testing.assert_array_equal(played[0].position_m, played[1].position_m)
    np.testing.assert_array_equal(played[0].force_n, played[1].force_n)


def test_motion_capture_leads_a_device_in_three_axes(
    walk: Walk, tmp_path: Path
) -> None:
    path = walk(
        "time [ms],px [mm],py [mm],pz [mm]", 1e3 * TIME, 1e3 * X, 1e3 * Y, 1e3 * Z
    )
    launch = tmp_path / "walk.yaml"
    launch.write_text(
        SCENE.format(axes="[x, y, z]", hand=f"file: {path}", surface=SPHERE),
        encoding="utf-8",
    )
    played = haptic.play(str(launch))
    # The hand's spring settles within 0.3 s; then the device follows, late by damping over
    # stiffness, 3/150 s, of at most 0.21 m/s: 4 mm.
    for i, wanted in enumerate((X, Y, Z)):
        at = np.interp(played.time_s, TIME, wanted)
        free = (played.time_s > 0.3) & (played.time_s < TIME[-1]) & ~played.contact
        assert np.abs(played.position_m[free, i] - at[free]).max() < 0.008
        assert np.ptp(played.position_m[:, i]) > 0.03


def test_an_array_is_a_path(tmp_path: Path) -> None:
    """From Python: corners of an array, in one axis or three."""
    one = haptic.hand_path(Z, rate=250.0)
    assert list(one) == ["path"]
    # A product and a quotient round differently.
    np.testing.assert_allclose(
        one["path"], np.stack((TIME, Z), axis=1), rtol=4e-16, atol=0
    )
    three = haptic.hand_path(np.stack((X, Y, Z), axis=1), time=TIME + 5.0)
    model: DeviceModel = convert(
        {
            "mass": 0.1,
            "hand": {"stiffness": 150.0, "path": three["path"]},
            "axes": three["axes"],
        },
        DeviceModel,
        "device",
    )
    for made, wanted in zip(along(model, ("x", "y", "z")), (X, Y, Z), strict=True):
        assert made.hand is not None
        # Times less 5 s are rounded to 9e-16 s.
        assert path_position(made.hand.path, float(TIME[9])) == pytest.approx(
            wanted[9], abs=1e-15
        )
    for given, words in (
        ({"position": Z}, "needs rate or time"),
        ({"position": Z, "rate": 250.0, "time": TIME}, "not both"),
        ({"position": 1e3 * Z * 30, "rate": 250.0}, "are they in mm"),
        ({"position": np.zeros((5, 2)), "rate": 250.0}, r"shape \(5, 2\)"),
        ({"position": Z, "time": TIME[::-1]}, r"time\[1\] does not grow"),
        ({"position": Z, "time": TIME[:-1]}, "299 times and 300 positions"),
        ({"position": Z, "rate": -1.0}, "rate -1 Hz"),
        ({"position": [0.0, float("nan")], "rate": 250.0}, "no finite number"),
    ):
        with pytest.raises(haptic.HapticError, match=words):
            haptic.hand_path(**given)


def test_a_file_is_a_hand_in_python_as_in_a_launch_file(tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    rows = [(0.004 * i, 1e-3 * math.sin(0.02 * i)) for i in range(250)]
    path.write_text(
        "t,position\n" + "".join(f"{t!r},{x!r}\n" for t, x in rows), "utf-8"
    )
    times, where = zip(*rows, strict=True)
    hand = haptic.hand_path(path)
    assert hand == haptic.hand_path(where, time=times)

    def played(own: Any) -> Any:
        device = {"hand": {"repeat": None, **own}}
        return haptic.play(
            "wall_press", duration=0.5, params={"driver": {"device": device}}
        )

    assert np.ptp(played(hand).position_m) > 1e-4
    in_a_file = played({"path": [], "file": str(path)})
    np.testing.assert_array_equal(played(hand).position_m, in_a_file.position_m)
    with pytest.raises(UsageError, match="columns and units are of a file"):
        haptic.hand_path(where, time=times, units="mm")
    with pytest.raises(UsageError, match=r"hand_path: .*No such file"):
        haptic.hand_path(tmp_path / "none.csv")
    path.write_text("t;position\n0,000;0,0\n0,004;0,1\n", "utf-8")
    with pytest.raises(
        UsageError, match=r"with haptic.read\(FILE, decimal_comma=True\)"
    ):
        haptic.hand_path(path)
