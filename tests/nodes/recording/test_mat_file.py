"""MAT files: as scipy reads them, and damaged ones within bounds."""

from __future__ import annotations

import contextlib
import resource
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

from nodes.recording.import_table import import_table
from nodes.recording.mat_file import read_mat
from nodes.recording.writer import RecordError

VARIABLES: dict[str, Any] = {
    "t": np.arange(40.0)[:, None] * 0.01,
    "wide": np.arange(12.0).reshape(3, 4),
    "single": np.array([[1.5, -2.0]], dtype=np.float32),
    "counts": np.array([[1, 2, 300]], dtype=np.int32),
    "small": np.array([[1, 2, 255]], dtype=np.uint8),
    "long": np.array([[2**60, -5]], dtype=np.int64),
    "flag": np.array([[True, False]]),
    "cube": np.arange(24.0).reshape(2, 3, 4),
    "text": "some words",
    "units": "1 µm − 3 °",
    "names": np.array(["pd", "", "multi_term"], dtype=object),
    "run": {"t": np.arange(5.0), "inner": {"x": np.eye(2), "law": "pd"}},
}


@pytest.mark.parametrize("compressed", [False, True])
def test_every_kind_of_array_is_read_as_scipy_reads_it(
    tmp_path: Path, compressed: bool
) -> None:
    path = tmp_path / "r.mat"
    savemat(
        path,
        VARIABLES,
        do_compression=compressed,
        oned_as="column",
        long_field_names=True,
    )
    ours, theirs = read_mat(path), loadmat(path)
    for name in ("t", "wide", "single", "counts", "small", "long", "flag", "cube"):
        np.testing.assert_array_equal(ours[name], theirs[name], err_msg=name)
        assert ours[name].shape == theirs[name].shape
    assert ours["text"] == "some words"
    assert ours["units"] == "1 µm − 3 °"
    assert ours["names"] == ["pd", "", "multi_term"]
    np.testing.assert_array_equal(ours["run"]["t"][:, 0], np.arange(5.0))
    np.testing.assert_array_equal(ours["run"]["inner"]["x"], np.eye(2))
    assert ours["run"]["inner"]["law"] == "pd"


def test_version_4_and_the_other_byte_order(tmp_path: Path) -> None:
    path = tmp_path / "r.mat"
    savemat(path, {"t": VARIABLES["t"], "wide": VARIABLES["wide"]}, format="4")
    for name, values in read_mat(path).items():
        np.testing.assert_array_equal(values, VARIABLES[name])
    numbers = np.array([1.0, 2.0, 3.0])
    head = b"big-endian".ljust(124) + struct.pack(">H", 0x0100) + b"MI"
    body = struct.pack(">II", 6, 8) + struct.pack(">II", 6, 0)
    body += struct.pack(">II", 5, 8) + struct.pack(">ii", 1, 3)
    body += struct.pack(">HH", 1, 1) + b"x\0\0\0"
    body += struct.pack(">II", 9, 24) + numbers.astype(">f8").tobytes()
    path.write_bytes(head + struct.pack(">II", 14, len(body)) + body)
    np.testing.assert_array_equal(read_mat(path)["x"], [numbers])


@pytest.fixture(scope="module", params=["plain", "packed", "4"])
def sound(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> bytes:
    path = tmp_path_factory.mktemp("mat") / "r.mat"
    if request.param == "4":
        savemat(path, {"t": VARIABLES["t"]}, format="4")
    else:
        savemat(
            path,
            VARIABLES,
            do_compression=request.param == "packed",
            long_field_names=True,
        )
    return path.read_bytes()


@settings(max_examples=60)
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused(
    sound: bytes, tmp_path: Path, data: st.DataObject
) -> None:
    """At some of these scipy ends the process; here an error names the file."""
    damaged = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(
            st.integers(0, 255)
        )
    cut = data.draw(st.integers(0, len(damaged)))
    path = tmp_path / "d.mat"
    path.write_bytes(bytes(damaged[:cut] if data.draw(st.booleans()) else damaged))
    # Any other error is a failure.
    with contextlib.suppress(RecordError):
        read_mat(path)


def test_lengths_that_do_not_fit_cost_nothing(tmp_path: Path) -> None:
    """No memory for what a file only claims."""
    head = b"hostile".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    name = struct.pack("<HH", 1, 1) + b"x\0\0\0"

    def array(kind: int, shape: tuple[int, ...], rest: bytes) -> bytes:
        body = struct.pack("<IIII", 6, 8, kind, 0) + struct.pack(
            "<II", 5, 4 * len(shape)
        )
        body += (
            struct.pack(f"<{len(shape)}i", *shape)
            + b"\0" * (-4 * len(shape) % 8)
            + name
            + rest
        )
        return struct.pack("<II", 14, len(body)) + body

    deep = array(6, (1, 1), struct.pack("<IId", 9, 8, 1.0))
    for _ in range(40):
        deep = array(1, (1, 1), deep)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for body, words in (
        (struct.pack("<II", 14, 1 << 31) + flags, "2147483648 bytes, while"),
        (array(6, (1 << 30, 1 << 30), b""), "an array of shape"),
        (array(6, (-1, 3), b""), "an array of shape"),
        (array(6, (1000, 3), struct.pack("<IId", 9, 8, 1.0)), "1 values for the shape"),
        (array(1, (1 << 20, 1), b""), "1048576 elements in"),
        (
            array(
                2, (1, 1), struct.pack("<HHi", 5, 4, 0) + struct.pack("<HHi", 1, 4, 0)
            ),
            "names of",
        ),
        (deep, "nested deeper"),
        (
            array(6, (1, 1), struct.pack("<IId", 99, 8, 1.0)),
            "type 99 in place of numbers",
        ),
    ):
        path = tmp_path / "h.mat"
        path.write_bytes(head + body)
        with pytest.raises(RecordError, match=words):
            read_mat(path)
    packed = zlib.compress(bytes(1 << 26))
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    assert read_mat(path) == {}
    # The last one unpacks to 64 MiB; nothing else takes any [KiB].
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000


def test_version_7_3_is_told_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "r.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(100))
    with pytest.raises(RecordError, match=r"version 7\.3 \(HDF5\); save it with -v7"):
        import_table(path, tmp_path / "r.mcap")


@pytest.mark.parametrize("levels", [16, 17])
def test_sixteen_levels_of_cells_are_read(tmp_path: Path, levels: int) -> None:
    deep: Any = np.array([[7.0]])
    for _ in range(levels):
        cell = np.empty((1, 1), dtype=object)
        cell[0, 0] = deep
        deep = cell
    path = tmp_path / "deep.mat"
    savemat(path, {"deep": deep})
    if levels > 16:
        with pytest.raises(RecordError, match="structures nested deeper than 16"):
            read_mat(path)
        return
    found = read_mat(path)["deep"]
    for _ in range(levels):
        (found,) = found
    assert found.tolist() == [[7.0]]
