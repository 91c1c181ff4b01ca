"""Files of ``haptic bag export``, read by their target programs, and `read`."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from pyarrow import parquet
from scipy.io import loadmat

from messages import topics
from messages.types import DeviceState, Event, Force, Handle, Message
from nodes.cli import main
from nodes.recording import table as table_of_ticks
from nodes.recording.export import columns, export_mat, export_npz, plain_names
from nodes.recording.reader import Recording
from nodes.recording.table import COLUMNS, read
from nodes.recording.writer import RecordError, RecordWriter
from tests.support.recorded import PERIOD, drop
from tests.support.strategies import TYPES

BEGUN = 12345.678
"""Stamp of the first tick; tables still start at 0 [s]."""

EVENT = Event(
    seq=0,
    stamp=BEGUN,
    node="driver",
    kind="eased",
    reason="eased over 0.15 s",
    data={"from_n": 0.5, "ease_s": 0.15},
)


def write(path: Path, sent: list[tuple[str, Message]]) -> None:
    with RecordWriter(
        path,
        {"scenario": "drop"},
        launch_file="run: {}\n",
        parameters={"coupling": '{"stiffness":1500.0}'},
    ) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp + 1e-4)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    sent = [
        (t, msgspec.structs.replace(m, stamp=m.stamp + BEGUN))
        for t, m in drop(300, missed=(40, 41), switch=100)
    ]
    for number, (topic, message) in enumerate(sent):
        if isinstance(message, DeviceState):
            told = {"target": (1e-3 * message.seq, 0.0, 0.0), "changed_at": 0.25}
            sent[number] = topic, msgspec.structs.replace(message, **told)
    sent.insert(
        1,
        (
            topics.HANDLE,
            Handle(seq=0, stamp=BEGUN, orientation=(0.5, -0.5, 0.5, 0.5), gripper=0.01),
        ),
    )
    sent.insert(2, (topics.event("driver"), EVENT))
    write(tmp_path / "drop.mcap", sent)
    return tmp_path / "drop.mcap"


def exported(
    capsys: pytest.CaptureFixture[str], bag: Path, *words: str
) -> dict[str, Path]:
    assert main.main(["bag", "export", str(bag), *words, "--json"]) == 0
    files = json.loads(capsys.readouterr().out.splitlines()[-1])["files"]
    assert all(Path(file).is_file() for file in files)
    return {Path(file).name: Path(file) for file in files}


def parse(text: str, like: object) -> object:
    if isinstance(like, bool):
        return bool(int(text))
    if isinstance(like, dict):
        return json.loads(text)
    return type(like)(text)  # type: ignore[call-arg]


# -- the table of ticks
# ----------------------------------------------------------------------------------------------


def test_a_row_holds_what_belongs_to_its_tick(bag: Path) -> None:
    table = read(bag)
    recording = Recording(bag)
    states: list[DeviceState] = recording.messages(topics.DEVICE_STATE)
    forces: list[Force] = recording.messages(topics.FORCE)
    assert set(table) == set(COLUMNS)
    assert {len(column) for column in table.values()} == {300}
    # Times of stamps near 12345 s are good to 2^-40 s.
    np.testing.assert_allclose(table["time"], np.arange(300) * PERIOD, atol=1e-11)
    np.testing.assert_array_equal(
        table["position"], [state.position for state in states]
    )
    # The force that a state tells is that of the tick before it.
    np.testing.assert_array_equal(
        table["force"][:-1], [state.force for state in states[1:]]
    )
    assert np.isnan(table["force"][-1]).all()
    for name in ("mean_force", "changed_at", "force_seq", "response"):
        np.testing.assert_array_equal(
            table[name][:-1], [getattr(state, name) for state in states[1:]]
        )
    # What the next state would have told is not 0.
    assert (
        np.isnan(table["response"][-1]),
        np.isnan(table["changed_at"][-1]),
        table["force_seq"][-1],
    ) == (True, True, -1)
    np.testing.assert_array_equal(table["target"], [state.target for state in states])
    assert np.ptp(table["target"][:, 0]) > 0.0
    np.testing.assert_array_equal(
        table["force_asked"], [force.force for force in forces]
    )
    assert table["response"][[40, 41]].tolist() == [0.0, 0.0]
    assert (table["law"][99], table["law"][100]) == ("pd", "stiffer")


def test_a_recording_longer_than_the_window_has_every_answer(tmp_path: Path) -> None:
    """Rows are emitted during reading, each with the next tick's report."""
    path, ticks = tmp_path / "r.mcap", table_of_ticks._WINDOW + 200
    sent = list(drop(ticks))
    write(path, sent)
    table = read(path)
    states = [message for _, message in sent if isinstance(message, DeviceState)]
    forces = [message for _, message in sent if isinstance(message, Force)]
    assert len(table["seq"]) == ticks
    for name in (
        "force",
        "mean_force",
        "response",
        "age",
        "delay",
        "force_seq",
        "changed_at",
    ):
        np.testing.assert_array_equal(
            table[name][:-1],
            [getattr(state, name) for state in states[1:]],
            err_msg=name,
        )
    np.testing.assert_array_equal(
        table["force_asked"], [force.force for force in forces]
    )


def test_a_driver_that_was_started_again_gets_no_answers_of_before(
    tmp_path: Path,
) -> None:
    path = tmp_path / "r.mcap"

    def state(seq: int) -> tuple[str, Message]:
        return topics.DEVICE_STATE, DeviceState(
            seq=seq, stamp=0.0, position=(0.0, 0.0, 0.0)
        )

    # A force for a tick that the first driver did not live to publish.
    early = (topics.FORCE, Force(seq=4, stamp=0.0, force=(0.0, 0.0, 7.0), law="pd"))
    write(path, [state(0), state(1), early, *(state(seq) for seq in range(6))])
    table = read(path)
    assert table["seq"].tolist() == [0, 1, 0, 1, 2, 3, 4, 5]
    assert np.isnan(table["force_asked"]).all()
    # Nor does a first tick tell how the last one before it went.
    assert table["force_seq"][1] == -1


def test_what_was_not_recorded_is_told_as_missing(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    sent = [
        (topic, message)
        for topic, message in drop(50)
        if not (topic == topics.FORCE and message.seq in (7, 8))
        and not (topic == topics.PROXY and message.seq in (5, 6))
        and not (topic == topics.DEVICE_STATE and message.seq == 20)
    ]
    write(path, sent)
    table = read(path)
    assert len(table["seq"]) == 49
    assert np.isnan(table["force_asked"][[7, 8]]).all()
    assert np.isnan(table["normal"][[5, 6]]).all()
    assert table["law"][7] == ""
    # Tick 19's outcome would have been told by tick 20.
    assert np.isnan(table["force"][19]).all()
    assert table["age"][19] == -1
    assert table["seq"][20] == 21
    np.testing.assert_array_equal(
        table["proxy"][20], table["position"][20] * (table["distance"][20] > 0.0)
    )


def test_a_recording_without_ticks_has_no_table(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(
        path, [(topic, message) for topic, message in drop(5) if topic == topics.FORCE]
    )
    with pytest.raises(RecordError, match="no message on /device/state"):
        read(path)
    main_code = main.main(["bag", "export", str(path), "--format", "parquet"])
    assert main_code == 1
    assert not path.with_suffix(".parquet").exists()


# -- formats
# --------------------------------------------------------------------------------------------------


def test_csv_reads_back_equal(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = exported(capsys, bag)
    folder = bag.with_name("drop_csv")
    assert sorted(files.values()) == sorted(folder.iterdir())
    recording = Recording(bag)
    for topic, name in plain_names(recording.topics).items():
        entries = list(recording.entries([topic]))
        with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as stream:
            header, *rows = csv.reader(stream)
        assert header == columns(type(entries[0].message))
        assert len(rows) == len(entries)
        for row, entry in zip(rows, entries, strict=True):
            flat: list[Any] = [entry.message.stamp - BEGUN, entry.log_time]
            for value in msgspec.structs.astuple(entry.message):
                flat.extend(value if isinstance(value, tuple) else [value])
            assert len(header) == len(flat)
            # To the last bit: Python writes the shortest text that reads back as the same double.
            assert [
                parse(text, like) for text, like in zip(row, flat, strict=True)
            ] == flat
    with (folder / "ticks.csv").open(newline="", encoding="utf-8") as stream:
        ticks = list(csv.DictReader(stream))
    table = read(bag)
    assert [float(tick["time [s]"]) for tick in ticks] == table["time"].tolist()
    assert [float(tick["position_z [m]"]) for tick in ticks] == table["position"][
        :, 2
    ].tolist()
    assert [tick["law"] for tick in ticks] == table["law"].tolist()
    told = json.loads((folder / "parameters.json").read_text(encoding="utf-8"))
    assert told["parameters"] == {"coupling": {"stiffness": 1500.0}}
    assert (told["manifest"], told["launch_file"]) == (
        {"scenario": "drop"},
        "run: {}\n",
    )
    assert told["columns"]["force"]["unit"] == "N"


def test_columns_carry_units() -> None:
    found = columns(DeviceState)
    assert found[:4] == ["time [s]", "log_time [s]", "seq", "stamp [s]"]
    assert found[4:7] == ["position_x [m]", "position_y [m]", "position_z [m]"]
    assert {
        "force_z [N]",
        "response [s]",
        "lateness [s]",
        "energy [J]",
        "delay [ticks]",
    } <= set(found)
    for message_type in TYPES:
        assert len(set(columns(message_type))) == len(columns(message_type))


def test_npz_reads_back_equal(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = exported(capsys, bag, "--format", "npz")
    assert set(files) == {"drop.npz", "drop.parameters.json"}
    recording = Recording(bag)
    with np.load(files["drop.npz"], allow_pickle=False) as arrays:
        expected = {f"ticks.{field}": array for field, array in read(bag).items()}
        for topic, name in plain_names(recording.topics).items():
            expected |= {
                f"{name}.{field}": array
                for field, array in recording.arrays(topic).items()
            }
            assert arrays[f"{name}.time"][0] == pytest.approx(
                recording.topics[topic].first_stamp - BEGUN, abs=1e-11
            )
        assert set(arrays) == set(expected) | {
            f"{name}.time" for name in plain_names(recording.topics).values()
        }
        for name, array in expected.items():
            np.testing.assert_array_equal(arrays[name], array)
        assert arrays["device_state.position"].shape == (300, 3)
        assert [json.loads(text) for text in arrays["driver_event.data"]] == [
            EVENT.data
        ]


def test_mat_reads_back_equal(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # The ending says what it is.
    files = exported(capsys, bag, "--out", str(bag.with_name("run.mat")))
    assert set(files) == {"run.mat", "run.parameters.json"}
    found = loadmat(files["run.mat"], simplify_cells=True)
    table = read(bag)
    for name, column in table.items():
        np.testing.assert_array_equal(found["ticks"][name], column)
    assert found["device_state"]["position"].shape == (300, 3)
    assert json.loads(found["driver_event"]["data"]) == EVENT.data
    assert (
        json.loads(found["parameters"])["parameters"]["coupling"]["stiffness"] == 1500.0
    )


def test_parquet_reads_back_equal(
    bag: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files = exported(capsys, bag, "--format", "parquet")
    found = parquet.read_table(files["drop.parquet"])
    table = read(bag)
    assert found.num_rows == 300
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(
            found[f"force_asked_{name}"].to_numpy(), table["force_asked"][:, axis]
        )
    assert found["law"].to_pylist() == table["law"].tolist()
    assert found["contact"].to_pylist() == table["contact"].astype(int).tolist()
    assert found.schema.field("force_z").metadata == {b"unit": b"N"}
    assert json.loads(found.schema.metadata[b"parameters"])["manifest"] == {
        "scenario": "drop"
    }
    # Without the extra it is told which one is missing, and nothing is written.
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert (
        main.main(
            [
                "bag",
                "export",
                str(bag),
                "--format",
                "parquet",
                "--out",
                str(bag.with_name("other")),
            ]
        )
        == 1
    )
    assert "pip install 'haptic-nodes[parquet]'" in capsys.readouterr().err
    assert not bag.with_name("other").exists()


def test_parameters_beside_a_file_are_not_replaced_unasked(bag: Path) -> None:
    beside = bag.with_name("x.parameters.json")
    beside.write_text("mine")
    with pytest.raises(RecordError, match=r"x\.parameters\.json: already exists"):
        export_npz(Recording(bag), bag.with_name("x.npz"))
    assert beside.read_text() == "mine"
    assert not bag.with_name("x.npz").exists()
    # Those of the same recording are the same: another format of it shares them.
    beside.unlink()
    assert beside in export_npz(Recording(bag), bag.with_name("x.npz"))
    assert beside in export_mat(Recording(bag), bag.with_name("x.mat"))
