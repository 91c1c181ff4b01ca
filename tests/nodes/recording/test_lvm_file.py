"""LabVIEW measurement files, as LabVIEW writes them, and formats with another way in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nodes.recording.foreign_table import read_foreign
from nodes.recording.import_table import import_table
from nodes.recording.writer import RecordError

TICKS = 50
TIME = np.arange(TICKS) * 2e-3
POSITION = np.round(10.0 * np.sin(TIME / 0.05), 6)  # [mm]
FORCE = np.round(0.5 * np.cos(TIME / 0.009), 6)
END = "***End_of_Header***"


def lvm(
    x_columns: str = "One",
    *,
    separator: str = "\t",
    comma: bool = False,
    late: float = 0.0,
    step: str = "0.002",
    dimension: str = "Time",
) -> str:
    """Return a file of two channels; the second is `late` [s] where each has times."""
    head = [
        ("LabVIEW Measurement",),
        ("Writer_Version", "2"),
        ("Separator", {"\t": "Tab", ",": "Comma", ";": "Semicolon"}[separator]),
        ("Decimal_Separator", "," if comma else "."),
        ("X_Columns", x_columns),
        ("Date", "2026/11/27"),
        (END, ""),
        ("", ""),
        ("Channels", "2", ""),
        ("Samples", str(TICKS), str(TICKS)),
        ("Y_Unit_Label", "mm", "N"),
        ("X_Dimension", dimension, dimension),
        ("X0", "0.0E+0", "0.0E+0"),
        ("Delta_X", step, "0.002"),
        (END, "", ""),
    ]
    names = ["X_Value", "stage", "load", "Comment"]
    if x_columns == "Multi":
        names = ["X_Value", "stage", "X_Value", "load", "Comment"]
    rows = []
    for t, x, f in zip(TIME.tolist(), POSITION.tolist(), FORCE.tolist(), strict=True):
        values: dict[str, list[object]] = {
            "One": [t, x, f],
            "No": ["", x, f],
            "Multi": [t, x, t + late, f],
        }
        rows.append(
            [f"{value:.6f}" if value != "" else "" for value in values[x_columns]]
        )
    text = [separator.join(line) for line in head]
    body = [separator.join(row) for row in [names, *rows]]
    if comma:
        body = [line.replace(".", ",") for line in body]
        text = [line.replace("0.002", "0,002").replace("0.0E", "0,0E") for line in text]
    text[5] = "Date" + separator + "2026/11/27"
    return "\r\n".join([*text, *body, ""])


@pytest.mark.parametrize("x_columns", ["One", "No", "Multi"])
@pytest.mark.parametrize(
    ("separator", "comma"), [("\t", False), ("\t", True), (";", True), (",", False)]
)
def test_a_file_of_labview_gives_its_channels(
    tmp_path: Path, x_columns: str, separator: str, comma: bool
) -> None:
    path = tmp_path / "rig.lvm"
    text = lvm(x_columns, separator=separator, comma=comma)
    path.write_bytes(text.encode())
    found = read_foreign(path)
    assert list(found.columns) == ["time", "stage", "load"]
    assert found.units == {"time": "s", "stage": "mm", "load": "N"}
    lines = text.splitlines()
    assert [lines[n - 1].strip()[:1] != "" for n in found.lines] == [True] * TICKS
    columns = {"position": ["stage"], "force": ["load"]}
    samples = import_table(path, tmp_path / "rig.mcap", columns=columns).samples
    assert samples.period == 2e-3
    np.testing.assert_allclose(samples.position[:, 0], 1e-3 * POSITION, rtol=1e-12)
    assert samples.force is not None
    np.testing.assert_array_equal(samples.force[:, 0], FORCE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (lvm() + lvm().partition(END)[2], "2 segments .*import the parts on their own"),
        (lvm().partition("Channels")[0], "0 segments"),
        (lvm("Multi", late=1e-3), "times of their own; write it in LabVIEW with one X"),
        (lvm("No", step="0.001"), "its header no Delta_X of all channels"),
        (lvm("No").replace("\t0.002", "\tinf"), "Delta_X is inf s, expected at most"),
        (lvm("No").replace("\t0.002", "\tnan"), "Delta_X is nan s, expected at most"),
        (lvm("No").replace("Delta_X", "Delta_Y"), "no X values, .* no Delta_X"),
        (lvm(dimension="Frequency"), "its X values are Frequency, not times"),
        (lvm().rpartition(END)[0] + END, "no rows below its last header"),
        (lvm() + "1\t2\t3\t4\t5\r\n", "line 67 has more fields than the 4 names"),
    ],
)
def test_what_is_no_such_file_names_its_fault(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "rig.lvm"
    path.write_bytes(text.encode())
    with pytest.raises(RecordError, match=words):
        read_foreign(path)


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("rig.tdms", "nptdms"),
        ("rig.MF4", "asammdf"),
        ("hand.c3d", "ezc3d"),
        ("rig.xlsx", "save the sheet as CSV"),
        ("rig.csv.gz", "gunzip"),
        ("rig.h5", "numpy.savez"),
    ],
)
def test_a_format_of_others_names_a_way_in(tmp_path: Path, name: str, way: str) -> None:
    with pytest.raises(RecordError, match=f"is no table read here.*{way}"):
        read_foreign(tmp_path / name)
