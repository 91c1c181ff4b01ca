"""A lab's own files and arrays from Python: read as recordings, identified as a device."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest
from numpy.typing import NDArray

from messages.errors import HapticError, RefusedError, UsageError
from nodes.recording.import_table import import_table
from nodes.recording.writer import RecordError
from sim.identify.experiment import SHORTEST

MASS, DAMPING, PERIOD, STEP = 0.12, 1.7, 2e-3, 1e-5

Rig = tuple[NDArray[np.float64], NDArray[np.float64]]


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return position and force of m dv/dt = f − b v, sampled exactly: the closed form."""
    rng = np.random.default_rng(5)
    decay = math.exp(-DAMPING / MASS * PERIOD)
    x = v = 0.0
    position, force = [], []
    for k in range(1600):
        if k % 20 == 0:
            pushed = float(rng.choice([-0.7, 0.7, 0.35, -0.35])) - 20.0 * x
        position.append(round(x / STEP) * STEP)
        force.append(pushed)
        last = pushed / DAMPING
        x += last * PERIOD + (v - last) * (1.0 - decay) * MASS / DAMPING
        v = last + (v - last) * decay
    return np.array(position), np.array(force)


@pytest.fixture
def csv(rig: Rig, tmp_path: Path) -> Path:
    position, force = rig
    rows = np.stack(
        (np.arange(len(force)) * PERIOD * 1e3, position * 1e3, force), axis=1
    ).tolist()
    path = tmp_path / "rig.csv"
    path.write_text(
        "t [ms];stage;load\n" + "".join(f"{t!r};{x!r};{f!r}\n" for t, x, f in rows),
        "utf-8",
    )
    return path


CHOSEN: dict[str, Any] = {
    "columns": {"position": "stage", "force": "load"},
    "units": {"position": "mm"},
}


def test_arrays_and_their_file_give_the_same_true_device(rig: Rig, csv: Path) -> None:
    position, force = rig
    arrays = haptic.identify(
        position=position, force=force, rate=1.0 / PERIOD, held=False
    )
    for name, true in (("mass_kg", MASS), ("damping_n_s_per_m", DAMPING)):
        found = arrays[name]
        # A third of the 95 % interval more, and less than 1 % in all.
        margin = 0.35 * (found["high"] - found["low"])
        assert found["low"] - margin <= true <= found["high"] + margin
        assert abs(found["value"] / true - 1.0) < 0.01
    table = haptic.identify(csv, held=False, **CHOSEN)
    assert table["mass_kg"]["value"] == pytest.approx(
        arrays["mass_kg"]["value"], rel=1e-6
    )
    assert table.answer["recording"] == str(csv)
    assert table.held
    assert arrays.held


def test_a_file_is_read_as_its_recording_is(
    rig: Rig, csv: Path, tmp_path: Path
) -> None:
    found = haptic.read(csv, **CHOSEN)
    columns = {"position": ["stage"], "force": ["load"]}
    path = import_table(
        csv, tmp_path / "rig.mcap", columns=columns, units={"position": "mm"}
    ).path
    again = haptic.read(path)
    for name, values in found.columns().items():
        np.testing.assert_array_equal(values, again[name])
    assert (found.path, found.scenario) == (csv, "rig")
    np.testing.assert_array_equal(found["force"][:-1, 0], rig[1][:-1])


def test_three_axes_of_arrays(rig: Rig) -> None:
    """The axis pushed hardest is identified, as of a recording."""
    position, force = (np.zeros((len(values), 3)) for values in rig)
    position[:, 1], force[:, 1] = rig
    found = haptic.identify(
        position=position, force=force, rate=1.0 / PERIOD, held=False
    )
    alone = haptic.identify(
        position=rig[0], force=rig[1], rate=1.0 / PERIOD, held=False, axis="y"
    )
    assert found.answer == alone.answer


def test_arrays_that_cannot_be_are_refused(rig: Rig) -> None:
    position, force = rig
    broken = position.copy()
    broken[7] = math.nan
    for given, words in (
        ({"position": position}, "needs a recording, or position, force and rate"),
        ({"position": position, "force": force}, "position, force and rate"),
        ({"position": position[:-1], "force": force, "rate": 500}, "need the same"),
        (
            {"position": broken, "force": force, "rate": 500},
            r"position\[7\] is no finite",
        ),
        ({"position": position * 1e3, "force": force, "rate": 500}, "are they in mm"),
        ({"position": position, "force": force, "rate": 0}, "rate 0 Hz"),
        ({"position": [["a"]], "force": force, "rate": 500}, "position: "),
        ({"position": position, "force": force, "rate": 500, "axis": "w"}, "axis 'w'"),
        ({"recording": "a.csv", "force": force, "position": position}, "not both"),
    ):
        with pytest.raises(UsageError, match=words) as refused:
            haptic.identify(**given)
        assert "--" not in str(refused.value)
    few = SHORTEST - 1
    with pytest.raises(RefusedError, match=f"{few} samples"):
        haptic.identify(position=position[:few], force=force[:few], rate=500)


@pytest.mark.parametrize(
    ("stage", "load", "asked"),
    [(1.0, 1.0, False), (1.0, 1.0 / 9.80665e-3, True), (1e-3, 1.0, True)],
    ids=("si", "gram", "km"),
)
def test_a_mass_of_no_device_asks_about_units(
    rig: Rig, stage: float, load: float, asked: bool
) -> None:
    """Another unit scales mass and damping alike, so that the model holds all the same."""
    found = haptic.identify(
        position=stage * rig[0], force=load * rig[1], rate=1.0 / PERIOD, held=False
    )
    verdict = found.text.partition("\n")[0]
    assert verdict.startswith("holds")
    assert found["mass_kg"]["value"] == pytest.approx(MASS * load / stage, rel=0.01)
    assert ("the positions in metres, the forces in newtons" in verdict) is asked


def test_a_refused_identification_names_the_file_that_was_given(
    csv: Path, tmp_path: Path
) -> None:
    short = tmp_path / "short.csv"
    lines = csv.read_text(encoding="utf-8").splitlines(keepends=True)
    short.write_text("".join(lines[:200]), encoding="utf-8")
    with pytest.raises(HapticError, match="are needed") as refused:
        haptic.identify(short, **CHOSEN)
    assert str(short) in str(refused.value)
    assert "haptic-import-" not in str(refused.value)


def test_refusals_name_the_arguments_of_python(csv: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"columns=\{'position': 'NAME'\}") as refused:
        haptic.read(csv)
    assert "--" not in str(refused.value)
    with pytest.raises(RecordError, match=r"units=\{'position': 'mm'\}") as refused:
        haptic.read(csv, columns={"position": "stage"})
    assert "--" not in str(refused.value)
    run = import_table(
        csv,
        tmp_path / "rig.mcap",
        columns={"position": ["stage"]},
        units={"position": "mm"},
    ).path
    with pytest.raises(UsageError, match="units are of tables"):
        haptic.read(run, units="mm")
    with pytest.raises(TypeError, match="unit"):
        haptic.read(csv, unit="mm")


def test_a_hand_of_a_file_names_what_python_gives(tmp_path: Path) -> None:
    table = tmp_path / "count.csv"
    rows = "".join(f"{k},{1e-4 * k * k!r},0,0\n" for k in range(40))
    table.write_text("t,u,v,w\n" + rows)
    with pytest.raises(UsageError, match=r"columns=\{'position': 'NAME'\}"):
        haptic.hand_path(table)
    columns = {"position": "u:v:w"}
    with pytest.raises(UsageError, match=r"rate=HZ, ignore_times=True\)\[.position.\]"):
        haptic.hand_path(table, columns=columns)
    read = haptic.read(table, columns=columns, rate=500, ignore_times=True)
    hand = haptic.hand_path(read["position"], rate=500)
    assert hand["path"][-1] == pytest.approx([39 / 500, 1e-4 * 39**2], rel=1e-9)
    assert set(hand["axes"]) == {"y", "z"}


def test_a_missing_table_is_missing(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="No such file"):
        haptic.read(tmp_path / "none.csv", rate=500)
