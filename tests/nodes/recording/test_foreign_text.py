"""Tables of other programs: lines around the rows, units, times and arrays."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.recording.foreign_table import read_foreign
from nodes.recording.foreign_text import read_text
from nodes.recording.foreign_units import factor_of
from nodes.recording.import_table import Imported, import_table
from nodes.recording.writer import RecordError

TICKS = 40
TIME = np.arange(TICKS) * 2e-3
POSITION = np.round(0.01 * np.sin(TIME / 0.05), 6)
ROWS = [f"{t!r},{x!r}" for t, x in zip(TIME.tolist(), POSITION.tolist(), strict=True)]
BARE = "\n".join(ROWS) + "\n"

Import = Callable[..., Imported]


@pytest.fixture
def imported(tmp_path: Path) -> Import:
    """Return a function that writes a file and imports it."""

    def run(content: str | bytes, name: str = "log.csv", **options: Any) -> Imported:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return import_table(path, tmp_path / "log.mcap", overwrite=True, **options)

    return run


def is_the_rig(found: Imported) -> None:
    np.testing.assert_array_equal(found.samples.position[:, 0], POSITION)
    assert found.samples.seq.tolist() == list(range(TICKS))
    assert found.samples.period == pytest.approx(2e-3, rel=1e-12)


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_rows_are_found_whatever_stands_around_them(data: st.DataObject) -> None:
    """Names, numbers and lines of a table are those that were written, in any dress."""
    number = st.floats(allow_nan=False, allow_infinity=False, width=32)
    wide = data.draw(st.integers(2, 4))
    rows = data.draw(
        st.lists(st.lists(number, min_size=wide, max_size=wide), min_size=2, max_size=6)
    )
    delimiter = data.draw(st.sampled_from([",", ";", "\t", "|", "  "]))
    comma = delimiter != "," and data.draw(st.booleans())
    names = [f"q{n}" for n in range(wide)]
    style = data.draw(st.sampled_from(["plain", "bracket", "line", "comment", "bare"]))
    above = data.draw(
        st.sampled_from([[], ["Rig 7, serial 12", "made in May"], ["***", ""]])
    )
    if style == "bare" and len(above) and above[-1]:
        above = [*above, "# log"]
    head = delimiter.join(f"{n} [mm]" if style == "bracket" else n for n in names)
    before = [f"# {head}" if style == "comment" else head] if style != "bare" else []
    if style == "line":
        before.append(delimiter.join(["(mm)"] * wide))
    lines = [*([] if style in ("comment", "bare") else above), *before]
    at = []
    for row in rows:
        lines += data.draw(st.sampled_from([[], [], [""], ["# pause"]]))
        texts = [repr(v).replace(".", ",") if comma else repr(v) for v in row]
        lines.append(delimiter.join(texts))
        at.append(len(lines))
    ending = data.draw(st.sampled_from(["\n", "\r\n", "\r"]))
    code = data.draw(
        st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(ending.join([*lines, ""]).encode(code))
        found = read_foreign(path, decimal_comma=comma)
    expected = [str(n + 1) for n in range(wide)] if style == "bare" else names
    assert list(found.columns) == expected
    values = np.array([found.numbers(name) for name in found.columns]).T
    np.testing.assert_array_equal(values, rows)
    assert list(found.lines) == at
    with_units = style in ("bracket", "line")
    assert found.units == (dict.fromkeys(names, "mm") if with_units else {})


@pytest.mark.parametrize(
    "text",
    [
        "t,x\n" + "\r\r\n".join(ROWS) + "\r\r\n",
        "t / s,x / m\n" + BARE,
        "time (sec),Pos X (Meters)\n" + BARE,
        "log.t,log.x\n" + BARE,
        "x,t\n" + "".join(f'"{r.split(",")[1]}","{r.split(",")[0]}"\n' for r in ROWS),
        "t;x\n" + BARE.replace(",", ";") + "# end\n\n",
        "t,x\n"
        + "".join(
            f"2026-11-27T23:59:59.{n * 2:03d}Z,{r.split(',')[1]}\n"
            for n, r in enumerate(ROWS)
        ),
        "t,x\n"
        + "".join(
            f"9:30:00,{n * 2:03d};{r.split(',')[1]}\n" for n, r in enumerate(ROWS)
        ).replace("t,x", "t;x"),
    ],
    ids=("blank", "over", "words", "struct", "quoted", "comment", "iso", "clock"),
)
def test_what_other_programs_write_is_read(imported: Import, text: str) -> None:
    is_the_rig(imported(text if ";" not in text else text.replace("t,x", "t;x")))


def test_quoted_decimal_commas_are_read_as_asked(imported: Import) -> None:
    text = "t,x\n" + "".join(
        ",".join(f'"{v.replace(".", ",")}"' for v in row.split(",")) + "\n"
        for row in ROWS
    )
    with pytest.raises(RecordError, match="line 2: '0,0' has a decimal comma"):
        imported(text)
    is_the_rig(imported(text, decimal_comma=True))


def test_a_row_with_a_text_is_no_line_of_names(imported: Import) -> None:
    """A row above the first row of numbers alone would be lost without a word."""
    with pytest.raises(RecordError, match="line 2, column 'x': 'n/a' is no number"):
        imported("t,x\n0.0,n/a\n" + BARE[8:])


@pytest.mark.parametrize(
    ("role", "name", "value"),
    # A pound is 0.45359237 kg, an inch 25.4 mm (both by definition); standard gravity.
    [
        ("force", "lbf", 4.4482216152605),
        ("force", "kgf", 9.80665),
        ("force", "Newtons", 1.0),
        ("force", "n", 1.0),
        ("position", "feet", 12 * 0.0254),
        ("position", "Millimetres", 1e-3),
        ("position", "µm", 1e-6),
        ("time", "Seconds", 1.0),
        ("time", "msec", 1e-3),
    ],
)
def test_units_by_their_other_names(role: str, name: str, value: float) -> None:
    assert factor_of(role, name) == pytest.approx(value, rel=1e-15)
    assert factor_of("time" if role != "time" else "force", name) is None


@pytest.mark.parametrize("rate", [300.0, 400.0, 601.0, 850.0])
def test_times_in_whole_milliseconds_have_no_gaps(
    imported: Import, rate: float
) -> None:
    """Their steps differ, though no row is missing: 3 and 4 ms at 300 Hz."""
    count = 200
    rows = "".join(f"{n * 1e3 // rate:.0f},{n}e-6\n" for n in range(count))
    found = imported("t_ms,x\n" + rows).samples
    assert found.seq.tolist() == list(range(count))
    # A line through stamps that are rounded by up to 1 ms, over their whole length.
    assert 1.0 / found.period == pytest.approx(rate, rel=2e-3 * rate / count)
    # A row that is missing is no rounding.
    kept = "".join(f"{n},{n}e-6\n" for n in range(count) if n not in (90, 91))
    missing = imported("t_ms,x\n" + kept).samples.seq.tolist()
    assert missing == [n for n in range(count) if n not in (90, 91)]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0.08,1e300\n", r"line 42: the position is 1e\+300 m, .* remove that row"),
        ("0.08,1e9\n", "line 42: the position"),
        ("1e300,0\n", r"line 42, column 't': 0.078 to 1e\+300 is a gap of more than"),
        ("1e17,0\n", "more than a day"),
        ("0.078,0\n", r"\(0.078 to 0.078; 1 such rows\); remove the repeated rows"),
        ("0.07,0\n", r"\(0.078 to 0.07; 1 such rows\); sort the rows"),
        ("0.08", "the first line 2; if the file was cut there, remove that line"),
    ],
)
def test_a_damaged_row_is_named(imported: Import, rows: str, words: str) -> None:
    with pytest.raises(RecordError, match=words):
        imported("t,x\n" + BARE + rows)
    if "position" in words:
        with pytest.raises(RecordError, match=words):
            imported("t,x\n" + BARE + rows, units={"position": "m"})


def test_an_error_names_few_of_many_columns(imported: Import) -> None:
    with pytest.raises(RecordError, match="c19 and 2980 more; choose") as refused:
        imported(
            ",".join(f"c{n}" for n in range(3000)) + 2 * ("\n" + 2999 * "0," + "0")
        )
    assert len(str(refused.value)) < 400


def test_no_line_makes_the_search_long(tmp_path: Path) -> None:
    """Rows are searched in the first lines only, and an open quote ends at the file."""
    path = tmp_path / "words.csv"
    path.write_text("a,b\n" + "word,word\n" * 5000, encoding="utf-8")
    assert len(read_text(path, decimal_comma=False).lines) == 5000
    path.write_text('t,x\n0,0\n0,0\n"' + BARE, encoding="utf-8")
    with pytest.raises(
        RecordError, match="line 4: a quote is not closed before line 43"
    ):
        read_text(path, decimal_comma=False)
    path.write_text('t,x\n0,0\n0,0\n"' + BARE * 500, encoding="utf-8")
    with pytest.raises(RecordError, match="line 4: is no CSV: field larger"):
        read_text(path, decimal_comma=False)


def test_times_and_vectors_of_arrays(tmp_path: Path) -> None:
    nanoseconds = np.rint(TIME * 1e9).astype("timedelta64[ns]")
    stamps = np.datetime64("2026-11-27T10:00:00") + nanoseconds
    wide = np.stack([POSITION, 2 * POSITION, 3 * POSITION], axis=1)
    for times in (nanoseconds, stamps):
        np.savez(tmp_path / "log.npz", t=times, x=POSITION)
        is_the_rig(
            import_table(tmp_path / "log.npz", tmp_path / f"{times.dtype.kind}.mcap")
        )
    np.save(tmp_path / "log.npy", np.stack([TIME, POSITION], axis=1))
    columns = {"time": ["1"], "position": ["2"]}
    is_the_rig(import_table(tmp_path / "log.npy", tmp_path / "n.mcap", columns=columns))
    np.savez(tmp_path / "two.npz", t=TIME, values=np.stack([POSITION, TIME], axis=1))
    chosen = {"position": ["values_1"]}
    is_the_rig(import_table(tmp_path / "two.npz", tmp_path / "w.mcap", columns=chosen))
    # A header that promises more than the file has.
    data = (
        (tmp_path / "log.npy").read_bytes().replace(b"(40, 2)", b"(2147483648, 2)", 1)
    )
    (tmp_path / "lie.npy").write_bytes(data)
    with pytest.raises(RecordError, match="no NPY of a plain array"):
        import_table(tmp_path / "lie.npy", tmp_path / "l.mcap", columns=columns)
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    lists = pa.array(wide.tolist(), type=pa.list_(pa.float64()))
    parquet.write_table(
        pa.table({"t": stamps, "position": lists}), tmp_path / "log.parquet"
    )
    found = import_table(tmp_path / "log.parquet", tmp_path / "p.mcap")
    is_the_rig(found)
    np.testing.assert_array_equal(found.samples.position, wide)


def test_times_of_the_clock_go_on_after_midnight(imported: Import) -> None:
    begin = 86_400_000 - 20  # [ms] of a day: midnight is tick 10
    since = [(begin + 2 * k) % 86_400_000 for k in range(TICKS)]
    clock = [
        f"{t // 3_600_000:02d}:{t // 60_000 % 60:02d}:{t // 1000 % 60:02d}.{t % 1000:03d}"
        for t in since
    ]
    rows = zip(clock, POSITION.tolist(), strict=True)
    text = "time,x\n" + "".join(f"{t},{x!r}\n" for t, x in rows)
    is_the_rig(imported(text))
    # With dates, a time that goes back does.
    dated = text.replace("\n00:", "\n2026-11-27T00:").replace(
        "\n23:", "\n2026-11-27T23:"
    )
    with pytest.raises(RecordError, match="the time does not grow"):
        imported(dated)


@pytest.mark.parametrize("state", ["", "idle,"])
def test_a_quote_that_is_not_closed_takes_no_rows(imported: Import, state: str) -> None:
    """Before, the rows behind it were gone where its own column was not read."""
    rows = [f"{row},{state}1" for row in ROWS]
    names = f"t,x,{'state,' if state else ''}note"
    rows[5] = rows[5][:-1] + '"1'
    for close in ("", '1"'):
        rows[30] = rows[30][:-1] + (close or "1")
        with pytest.raises(RecordError, match=r"line 7: a quote is not closed"):
            imported("\n".join([names, *rows]))
    # Closed, a line break inside quotes is text.
    rows[5] = rows[5][:-2] + '"the tool\nslipped"'
    rows[30] = rows[29].replace(ROWS[29], ROWS[30])
    is_the_rig(imported("\n".join([names, *rows])))


def test_a_number_alone_above_the_names_is_no_row(imported: Import) -> None:
    """As motion capture writes its rate."""
    text = f"Trajectories\n500\n,Hand:A\nt,x\ns,m\n{BARE}"
    is_the_rig(imported(text))


def test_a_line_of_units_is_read_beside_texts(imported: Import) -> None:
    rows = [
        f"{1e3 * t!r},idle,{1e3 * x!r}"
        for t, x in zip(TIME.tolist(), POSITION.tolist(), strict=True)
    ]
    found = imported("\n".join(["t,state,x", "ms,,mm", *rows])).samples
    np.testing.assert_allclose(found.position[:, 0], POSITION, rtol=1e-12)
    assert found.sources == {"position": "x in mm", "time": "t in ms"}


@pytest.mark.parametrize("written", ["1_0", "1_0.5"])
def test_digits_joined_as_in_python_are_no_number(
    imported: Import, written: str
) -> None:
    with pytest.raises(RecordError, match=rf"'{written}' is no number"):
        imported(f"t,x\n{BARE}{TICKS * 2e-3!r},{written}\n")
