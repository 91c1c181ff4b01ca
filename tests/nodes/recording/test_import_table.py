"""Tables of other programs as recordings: columns, units, times, and what is refused."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.recording.export import FORMATS
from nodes.recording.import_table import Imported, import_table
from nodes.recording.plot import figure_of, plot
from nodes.recording.reader import Recording
from nodes.recording.summary import summarise
from nodes.recording.table import read
from nodes.recording.writer import RecordError, RecordWriter
from tests.support.launching import typed_in
from tests.support.recorded import PUBLISHES, drop

TICKS = 60
TIME = np.arange(TICKS) * 1e-3
POSITION = np.round(0.01 * np.sin(TIME / 0.05), 6)
FORCE = np.round(0.5 * np.cos(TIME / 0.009), 4)

Write = Callable[..., Path]


def lines(
    *columns: NDArray[Any],
    names: str = "t,x,F",
    delimiter: str = ",",
    comma: bool = False,
) -> str:
    """Return a text file of columns, as exactly as numbers print, under the first names."""
    names = ",".join(names.split(",")[: len(columns)])
    rows = [
        delimiter.join(repr(v.item()).replace(".", "," if comma else ".") for v in row)
        for row in zip(*columns, strict=True)
    ]
    return "\n".join([names.replace(",", delimiter), *rows]) + "\n"


RIG = lines(TIME, POSITION, FORCE)


@pytest.fixture
def imported(tmp_path: Path) -> Callable[..., Imported]:
    """Return a function that writes a text file and imports it."""

    def run(text: str | bytes, name: str = "rig.csv", **options: Any) -> Imported:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return import_table(path, tmp_path / "rig.mcap", overwrite=True, **options)

    return run


def axis_of(found: Imported, name: str, axis: str = "x") -> NDArray[Any]:
    values: NDArray[Any] = read(found.path)[name][:, "xyz".index(axis)]
    return values


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (RIG, {}),
        (RIG.encode("utf-8-sig"), {}),
        (RIG.encode("utf-16"), {}),
        (lines(TIME, POSITION, FORCE, delimiter=";"), {}),
        (lines(TIME, POSITION, FORCE, delimiter="\t"), {}),
        ("# rig 7\n\n" + lines(TIME, POSITION, FORCE, delimiter=" "), {}),
        (
            lines(TIME, POSITION, FORCE, delimiter=";", comma=True),
            {"decimal_comma": True},
        ),
        (RIG.replace("\n", "\r\n"), {}),
        (RIG.replace("\n", ",\n"), {}),
        (lines(POSITION, FORCE, names="pos,force"), {"rate": 1000.0}),
        (
            RIG.partition("\n")[2],
            {"columns": {"time": ["1"], "position": ["2"], "force": ["3"]}},
        ),
    ],
    ids=(
        "plain",
        "bom",
        "utf16",
        "semi",
        "tab",
        "blank",
        "comma",
        "crlf",
        "end",
        "rate",
        "bare",
    ),
)
def test_a_text_of_any_shape_gives_its_numbers(
    imported: Callable[..., Imported], text: str, options: dict[str, Any]
) -> None:
    found = imported(text, **options)
    table = read(found.path)
    assert found.samples.period == 1e-3
    assert found.samples.sources["position"].split()[0] in ("x", "pos", "2")
    assert found.samples.sources["time"].split()[0] in ("t", "1", "rows")
    np.testing.assert_array_equal(table["position"][:, 0], POSITION)
    # The outcome of the last tick is in no state.
    np.testing.assert_array_equal(table["force"][:-1, 0], FORCE[:-1])
    np.testing.assert_array_equal(table["mean_force"][:-1, 0], FORCE[:-1])
    np.testing.assert_allclose(table["time"], TIME, rtol=0, atol=1e-15)
    assert not table["position"][:, 1:].any()
    # Held forces do the work ∑ F Δx; rounding grows with the number of ticks.
    work = np.concatenate(([0.0], np.cumsum(FORCE[:-1] * np.diff(POSITION))))
    np.testing.assert_allclose(table["energy"], work, rtol=0, atol=TICKS * 1e-17)


@pytest.mark.parametrize(
    ("names", "factors", "units"),
    [
        ("t [ms],x [mm],F [mN]", (1e3, 1e3, 1e3), {}),
        ("time (us),pos (µm),force (N)", (1e6, 1e6, 1.0), {}),
        ("t_ms,pos_mm,F_N", (1e3, 1e3, 1.0), {}),
        ("t,x,F", (1e9, 1e2, 1.0), {"time": "ns", "position": "cm"}),
        ("t,x,F", (1.0, 1e5, 1.0), {"position": "1e-5"}),
        ("t,x [furlong],F", (1.0, 1 / 201.168, 1.0), {"position": "201.168"}),
    ],
)
def test_units_are_those_of_the_name_or_of_the_caller(
    imported: Callable[..., Imported],
    names: str,
    factors: Sequence[float],
    units: dict[str, str],
) -> None:
    columns = [
        v * factor for v, factor in zip((TIME, POSITION, FORCE), factors, strict=True)
    ]
    found = imported(lines(*columns, names=names), units=units)
    # Two roundings of the factor, there and back.
    np.testing.assert_allclose(axis_of(found, "position"), POSITION, rtol=4e-16, atol=0)
    np.testing.assert_allclose(
        axis_of(found, "force")[:-1], FORCE[:-1], rtol=4e-16, atol=0
    )
    assert found.samples.period == 1e-3


def test_nanoseconds_since_1970_stay_exact(imported: Callable[..., Imported]) -> None:
    """A double has steps of 256 ns there."""
    stamps = 1_700_000_000_123_456_789 + 1_000_001 * np.arange(TICKS)
    found = imported(lines(stamps, POSITION), units={"time": "ns"})
    np.testing.assert_allclose(
        np.diff(found.samples.stamp), 1.000001e-3, rtol=1e-12, atol=0
    )
    assert found.samples.period == pytest.approx(1.000001e-3, rel=1e-12)


def test_missing_rows_are_gaps(imported: Callable[..., Imported]) -> None:
    kept = np.r_[0:20, 23:TICKS]
    found = imported(lines(TIME[kept], POSITION[kept], FORCE[kept]))
    assert found.samples.seq.tolist() == kept.tolist()
    assert Recording(found.path).topics[DEVICE_STATE].gaps == 3
    assert "3 ticks missing" in found.text
    force = axis_of(found, "force")
    assert np.flatnonzero(np.isnan(force)).tolist() == [19, len(kept) - 1]


def test_a_column_is_chosen_as_the_file_writes_it(
    imported: Callable[..., Imported],
) -> None:
    text = lines(1e3 * TIME, 1e3 * POSITION, names="when (ms),stage [mm]")
    for time, position in (("when", "stage"), ("when (ms)", "stage [mm]")):
        found = imported(text, columns={"time": [time], "position": [position]})
        assert found.samples.period == 1e-3
    with pytest.raises(
        RecordError, match=r"no column 'stage \[m\]'; did you mean stage"
    ):
        imported(text, columns={"time": ["when"], "position": ["stage [m]"]})


def test_rows_without_a_number_are_gaps(imported: Callable[..., Imported]) -> None:
    """As motion capture writes a marker that is hidden, and said so."""
    hidden = np.isin(np.arange(TICKS), (0, 20, 21, 22))
    text = lines(TIME, np.where(hidden, np.nan, POSITION), FORCE).replace("nan", "")
    found = imported(text)
    kept = np.flatnonzero(~hidden)
    # The first tick is that of the first row with numbers.
    assert found.samples.seq.tolist() == (kept - kept[0]).tolist()
    np.testing.assert_array_equal(found.samples.position[:, 0], POSITION[kept])
    assert "gaps     4 rows without a number, the first at line 2" in found.text
    assert "3 ticks missing in gaps" in found.text
    pushed = np.where(np.isin(np.arange(TICKS), (5, TICKS - 1)), np.nan, FORCE)
    found = imported(lines(TIME, POSITION, pushed))
    assert found.samples.seq.tolist() == [n for n in range(TICKS) if n != 5]
    # A later row is named by its own line, though rows before it are left out.
    damaged = np.where(hidden, np.nan, np.where(TIME == 0.029, 1e9, POSITION))
    with pytest.raises(RecordError, match="line 31: the position is 1e"):
        imported(lines(TIME, damaged, FORCE))


def test_three_axes_by_names_and_by_choice(imported: Callable[..., Imported]) -> None:
    columns = (TIME, POSITION, 2 * POSITION, 3 * POSITION, FORCE, 2 * FORCE, 3 * FORCE)
    named = imported(lines(*columns, names="t,px,py,pz,Fx,Fy,Fz"))
    chosen = imported(
        lines(*columns, names="k1,a,b,c,d,e,f9"),
        columns={
            "time": ["k1"],
            "position": ["a", "b", "c"],
            "force": ["d", "e", "f9"],
        },
    )
    for found in (named, chosen):
        assert found.samples.axes == "xyz"
        for n, axis in enumerate("xyz", 1):
            np.testing.assert_array_equal(
                axis_of(found, "position", axis), n * POSITION
            )
            np.testing.assert_array_equal(
                axis_of(found, "force", axis)[:-1], n * FORCE[:-1]
            )


def test_one_column_goes_to_its_axis(imported: Callable[..., Imported]) -> None:
    for text, options, axis in (
        (lines(TIME, POSITION, FORCE, names="t,z,F"), {}, "z"),
        (RIG, {"axis": "y"}, "y"),
        (RIG, {"axis": "z", "columns": {"position": ["x"]}}, "z"),
    ):
        found = imported(text, **options)
        assert found.samples.axes == axis
        np.testing.assert_array_equal(axis_of(found, "position", axis), POSITION)
        np.testing.assert_array_equal(axis_of(found, "force", axis)[:-1], FORCE[:-1])


BEYOND = lines(TIME * 1e3, POSITION, FORCE)


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (RIG.replace("0.007,", "nan,", 1), {}, "line 9, column 't': no time"),
        (RIG.replace("0.007,", ",", 1), {}, "line 9, column 't': no time"),
        (
            RIG.replace("0.007,", "oops,", 1),
            {},
            "line 9, column 't': 'oops' is no number",
        ),
        (
            RIG.replace("\n0.007,", "\n0.007,inf#", 1),
            {},
            "line 9, column 'x'.*no number",
        ),
        (
            lines(TIME, np.where(TIME == 0.007, np.inf, POSITION), FORCE),
            {},
            "line 9, column 'x': no number",
        ),
        (
            lines(TIME, POSITION, np.where(TIME == 0.007, np.nan, FORCE)),
            {"rate": 1000.0, "ignore_times": True},
            r"line 9, column 'F': no number \(1 such rows of 60\); .*add a column of times",
        ),
        (
            lines(TIME, np.where(np.arange(TICKS) % 2, np.nan, POSITION), FORCE),
            {},
            r"line 3, column 'x': no number \(30 .* columns of different rates\? Import",
        ),
        (
            RIG.replace("F", "y").replace("\n", ",\n").replace("y,", "y,z"),
            {},
            r"'z': no number \(60 .*of 60\); choose others with --columns position=NAME",
        ),
        (RIG + "1,2\n", {}, f"line {TICKS + 2} has 2 fields, the first line 3"),
        (
            lines(TIME, POSITION, FORCE, delimiter=";", comma=True),
            {},
            "--decimal-comma",
        ),
        (
            lines(TIME, POSITION, FORCE, comma=True),
            {},
            "fields have decimal|decimal commas",
        ),
        (
            BEYOND,
            {},
            r"1 Hz if it is seconds\. Is it in ms \(1000 Hz\)\? .*--units time=ms",
        ),
        (lines(TIME * 1e9, POSITION), {}, r"Is it in ns \(1000 Hz\)"),
        (BEYOND, {"rate": 1000.0}, r"Is it in ms \(1000 Hz\)"),
        (
            RIG,
            {"rate": 500.0},
            "--rate 500, while column 't' advances 1000 times a second",
        ),
        (RIG, {"units": {"time": "us"}}, "a rate of 1e"),
        (lines(TIME, 1e3 * POSITION), {}, r"span 9\.\d+ m; are they in mm \(0\.009"),
        (lines(TIME, 1e6 * POSITION), {}, r"are they in um"),
        (lines(TIME, POSITION, 1e4 * FORCE), {}, r"5000 N; is it in mN \(5 N\)"),
        (
            RIG.replace("x", "x [mm]", 1),
            {"units": {"position": "m"}},
            "which one is it",
        ),
        (RIG.replace("x", "x [furlong]", 1), {}, "furlong.*position=NUMBER"),
        (RIG, {"units": {"position": "-3"}}, "known are m, cm, mm"),
        (RIG, {"units": {"mass": "kg"}}, "'mass' is none of position, force, time"),
        (RIG, {"columns": {"postion": ["x"]}}, "did you mean position"),
        (RIG, {"columns": {"position": ["q"]}}, "no column 'q'.*there are t, x, F"),
        (RIG, {"columns": {"position": ["x", "F"]}}, "expected one or three"),
        (RIG, {"ignore_times": True}, "the rate is needed"),
        (lines(TIME, POSITION, FORCE, names="t,x,pos"), {}, "several columns.*x, pos"),
        (
            lines(TIME, POSITION, FORCE, names="t,x,x"),
            {},
            r"x \(column 2\), x \(column 3\)",
        ),
        (lines(TIME, POSITION, FORCE, names="k,x,F"), {}, "--rate HZ"),
        (
            lines(TIME, POSITION, FORCE, names="t,q,F"),
            {},
            "which column is the position",
        ),
        (
            lines(TIME, FORCE / 100, FORCE, FORCE, names="t,x,y,F"),
            {},
            "name the same axes",
        ),
        (lines(TIME[::-1], POSITION), {}, "line 3, column 't': the time does not grow"),
        (
            lines(TIME + 3e-4 * (TIME == 0.007), POSITION),
            {},
            "line 9.*the times are uneven",
        ),
        ("", {}, "is empty"),
        ("t,x,F\n", {}, "no column with a row"),
        ("t,x,F\n0,0,0\n", {}, "1 rows; at least 2"),
        ("\0\1\2" * 50, {}, "is no text"),
    ],
)
def test_a_mistake_is_met_with_what_was_meant(
    imported: Callable[..., Imported],
    tmp_path: Path,
    text: str,
    options: dict[str, Any],
    words: str,
) -> None:
    with pytest.raises(RecordError, match=words):
        imported(text, **options)
    assert not (tmp_path / "rig.mcap").exists()


def test_what_was_meant_can_be_said(imported: Callable[..., Imported]) -> None:
    """Each remedy that an error names leads on."""
    for text, options in (
        (BEYOND, {"units": {"time": "ms"}}),
        (BEYOND, {"rate": 1000.0, "ignore_times": True}),
        (lines(TIME, 1e3 * POSITION, FORCE), {"units": {"position": "mm"}}),
    ):
        found = imported(text, **options)
        assert found.samples.period == 1e-3
        np.testing.assert_allclose(
            axis_of(found, "position"), POSITION, rtol=4e-16, atol=0
        )
    far = imported(lines(TIME, 1e3 * POSITION, FORCE), units={"position": "m"})
    np.testing.assert_array_equal(axis_of(far, "position"), 1e3 * POSITION)


@pytest.mark.parametrize("kind", ["npz", "mat", "parquet"])
def test_arrays_of_other_programs(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"rig.{kind}"
    wide = np.stack((POSITION, 2 * POSITION, 3 * POSITION), axis=1)
    if kind == "npz":
        np.savez(path, t=TIME, position=wide, gain=3.0)
    elif kind == "mat":
        from scipy.io import savemat

        savemat(path, {"run": {"t": TIME[:, None], "position": wide.T, "name": "rig"}})
    else:
        pa = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        fields = [pa.field("t", pa.float64(), metadata={"unit": "s"})]
        fields += [
            pa.field(f"p{axis}", pa.float64(), metadata={"unit": "mm"})
            for axis in "xyz"
        ]
        parts = [TIME, *(1e3 * wide.T)]
        parquet.write_table(pa.table(parts, schema=pa.schema(fields)), path)
    columns = {"time": ["run.t"], "position": [f"run.position_{a}" for a in "xyz"]}
    found = import_table(
        path, tmp_path / "rig.mcap", columns=columns if kind == "mat" else None
    )
    np.testing.assert_allclose(read(found.path)["position"], wide, rtol=4e-16, atol=0)
    assert found.samples.force is None


@pytest.mark.parametrize(
    "name", ["rig.npz", "rig.mat", "rig.parquet", "rig.bag", "rig.mcap"]
)
def test_what_is_no_table_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"hello")
    with pytest.raises(RecordError, match="rig"):
        import_table(path, tmp_path / "out.mcap")
    if name == "rig.npz":
        np.savez(path, x=POSITION)
        # A newer ZIP than Python's: NotImplementedError of zipfile.
        data = path.read_bytes()
        at = data.rindex(b"PK\1\2") + 6
        path.write_bytes(data[:at] + b"\xb3" + data[at + 1 :])
        with pytest.raises(RecordError, match="cannot be read as NPZ"):
            import_table(path, tmp_path / "out.mcap")
    np.savez(tmp_path / "pickled.npz", x=np.array([{}], dtype=object))
    with pytest.raises(RecordError, match="plain arrays"):
        import_table(tmp_path / "pickled.npz", tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize("kind", FORMATS)
def test_our_own_exports_return_every_number(tmp_path: Path, kind: str) -> None:
    source = tmp_path / "drop.mcap"
    manifest = {
        "rate_hz": "500",
        "axes": "z",
        "pace": "lockstep",
        "publishes": PUBLISHES,
    }
    with RecordWriter(source, manifest) as writer:
        for topic, message in drop(80, missed=(30,), switch=40):
            # Two ticks are lost, and with them what their neighbours report.
            if not (isinstance(message, DeviceState) and message.seq in (50, 51)):
                writer.write(topic, message, message.stamp)
    out = tmp_path / ("drop_csv" if kind == "csv" else f"drop.{kind}")
    FORMATS[kind](Recording(source), out)
    found = import_table(out, tmp_path / "again.mcap")
    was, now = read(source), read(found.path)
    assert list(was) == list(now)
    for column in was:
        np.testing.assert_array_equal(was[column], now[column], err_msg=column)
    assert found.samples.period == 0.002


def test_every_verb_reads_an_imported_recording(tmp_path: Path) -> None:
    file = tmp_path / "rig.csv"
    file.write_text(lines(TIME, 1e3 * POSITION, FORCE), encoding="utf-8")
    refused = typed_in(tmp_path, "bag", "import", "rig.csv", code=1)
    assert "--units position=mm" in refused.stderr
    words = ("bag", "import", "rig.csv", "--units", "mm")
    figures = json.loads(typed_in(tmp_path, *words, "--json").stdout)
    assert figures["ticks"] == TICKS
    assert figures["rate_hz"] == 1000.0
    assert "already exists" in typed_in(tmp_path, *words, code=2).stderr
    run = tmp_path / "rig.mcap"
    assert figures["recording"] == run.name
    unread = typed_in(tmp_path, "bag", "info", "rig.csv", code=1)
    assert "haptic bag import rig.csv" in unread.stderr
    assert "imported  rig.csv" in typed_in(tmp_path, "bag", "info", "rig.mcap").stdout
    assert Recording(run).manifest["imported_columns"].count("mm") == 1
    assert summarise(Recording(run)).rate_hz == pytest.approx(1000.0, rel=1e-12)
    plot(Recording(run), tmp_path / "rig.png")
    assert (tmp_path / "rig.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("columns", "panels"),
    [
        ((TIME, POSITION, FORCE), ["position x [mm]", "force x [N]", "energy [mJ]"]),
        ((TIME, POSITION), ["position x [mm]"]),
    ],
)
def test_a_plot_of_a_table_has_the_panels_of_its_columns(
    imported: Callable[..., Imported],
    columns: tuple[NDArray[Any], ...],
    panels: list[str],
) -> None:
    """Before, an empty response time, and a force of zero that nobody measured."""
    recording = Recording(imported(lines(*columns)).path)
    for start in (None, 0.0):
        figure = figure_of(recording, start)
        assert [axes.get_ylabel() for axes in figure.axes] == panels
        assert figure.axes[-1].get_xlabel() == "time [s]"


@pytest.mark.parametrize(
    ("rate", "agrees"), [(1009.9, True), (990.1, True), (1010.1, False), (989.9, False)]
)
def test_a_rate_agrees_with_the_times_to_one_percent(
    imported: Callable[..., Imported], rate: float, agrees: bool
) -> None:
    """The one that is given then holds."""
    if agrees:
        assert 1.0 / imported(RIG, rate=rate).samples.period == pytest.approx(
            rate, rel=1e-12
        )
    else:
        with pytest.raises(RecordError, match=f"--rate {rate:g}, while"):
            imported(RIG, rate=rate)


@pytest.mark.parametrize("days", [0, 1, 2])
def test_a_column_of_dates_belongs_to_the_times_beside_it(
    imported: Callable[..., Imported], days: int
) -> None:
    """Without it, days between two rows would be lost."""
    second = np.arange(TICKS) >= TICKS // 2
    start = datetime.datetime(2026, 2, 28, 23, 59, 59, 970_000)
    rows = [
        (start + datetime.timedelta(days=days * int(late), milliseconds=n)).strftime(
            f"%m/%d/%Y,%I:%M:%S.%f %p,{POSITION[n]}"
        )
        for n, late in enumerate(second)
    ]
    text = "\n".join(["Date,Time,x", *rows])
    if days:
        with pytest.raises(RecordError, match=f"line {TICKS // 2 + 2}.*than a day"):
            imported(text)
    else:
        found = imported(text)
        assert found.samples.seq.tolist() == list(range(TICKS))
        assert found.samples.period == 1e-3
