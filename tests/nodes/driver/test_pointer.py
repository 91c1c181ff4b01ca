"""The pointer file: no torn values, expiry after silence, one owner at a time."""

from __future__ import annotations

import math
import struct
import threading
import time
from pathlib import Path

import pytest

from nodes.driver.pointer import (
    PointerReader,
    PointerWriter,
    awaited_pointer,
    pointer_file,
)
from tests.support.launching import wait_for
from tests.support.setups import MadeLater, setup_of


def test_what_is_written_is_read_and_let_go(tmp_path: Path) -> None:
    reader = PointerReader(tmp_path / "p", 60.0)
    assert reader.read() is None
    writer = PointerWriter(tmp_path / "p")
    writer.write((0.01, -0.02, 0.03))
    assert reader.read() == (0.01, -0.02, 0.03)
    writer.let_go()
    assert reader.read() is None
    with pytest.raises(ValueError, match="finite"):
        writer.write((math.nan, 0.0, 0.0))
    writer.close()
    reader.close()


def test_a_hand_that_the_launch_promises_is_waited_for_and_no_other(
    tmp_path: Path,
) -> None:
    path = pointer_file(tmp_path, "driver")
    given_up = MadeLater(path, lambda: PointerReader(path, 60.0).close())

    def awaited(**changed: object) -> Path:
        return awaited_pointer(
            setup_of(
                **{
                    "run_dir": str(tmp_path),
                    "control": "ipc:///c",
                    "parameters": {"pointer": {}},
                    **changed,
                }
            ),
            given_up,
        )

    others: list[dict[str, object]] = [
        {"parameters": {}},
        {"parameters": {"pointer": None}},
        {"pace": "lockstep"},
        {"control": "tcp://10.0.0.1:5"},
    ]
    for none in others:
        assert awaited(**none) == path
    assert given_up.asked == 0
    PointerWriter(awaited()).close()
    assert given_up.asked == 3


def test_a_value_expires(tmp_path: Path) -> None:
    reader, writer = PointerReader(tmp_path / "p", 0.05), None
    writer = PointerWriter(tmp_path / "p")
    begun = time.monotonic()
    writer.write((1.0, 0.0, 0.0))
    wait_for(lambda: reader.read() is None, "the value expires", 10.0)
    assert time.monotonic() - begun >= 0.05
    writer.close()
    reader.close()


def test_a_value_is_never_half_old_and_half_new(tmp_path: Path) -> None:
    reader = PointerReader(tmp_path / "p", 60.0)
    ended = threading.Event()

    def write() -> None:
        writer = PointerWriter(tmp_path / "p")
        n = 0.0
        while not ended.is_set():
            n += 1.0
            writer.write((n, 2.0 * n, 3.0 * n))
        writer.close()

    thread = threading.Thread(target=write)
    thread.start()
    try:
        wait_for(lambda: reader.read(), "the first value")
        for _ in range(50_000):
            found = reader.read()
            assert found is not None
            assert found == (found[0], 2.0 * found[0], 3.0 * found[0])
    finally:
        ended.set()
        thread.join()
        reader.close()


def test_a_torn_value_gives_the_one_before(tmp_path: Path) -> None:
    """After a writer was killed mid-write, the first count is ahead of the last."""
    path = tmp_path / "p"
    reader = PointerReader(path, 60.0)
    writer = PointerWriter(path)
    writer.write((1.0, 0.0, 0.0))
    assert reader.read() == (1.0, 0.0, 0.0)
    # The count before the value is written, and half of the value is another one.
    torn = bytearray(path.read_bytes())
    torn[-8:] = (99).to_bytes(8, "little")
    torn[8:16] = struct.pack("<d", 5.0)
    with open(path, "r+b") as file:
        file.write(torn)
    assert reader.read() == (1.0, 0.0, 0.0)
    writer.close()
    reader.close()
