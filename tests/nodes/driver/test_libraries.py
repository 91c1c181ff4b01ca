"""Where a vendor's library is searched for, and the numbers of HDAPI's header."""

from __future__ import annotations

import ctypes.util
from pathlib import Path

import pytest

from nodes.driver.hardware.libraries import Search, find
from nodes.driver.touch import hdapi


def test_a_library_is_found_by_path_in_folders_and_by_the_linker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Folders of LD_LIBRARY_PATH come before the vendor's, as the dynamic linker has it."""
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    asked: list[str] = []
    monkeypatch.setattr(ctypes.util, "find_library", asked.append)
    monkeypatch.setenv("LD_LIBRARY_PATH", f":{first}:")
    name, places = "libno.so.3", (str(first / "libno.so.3"), str(second / "libno.so.3"))
    cache = "the dynamic linker's cache"
    assert find(name, [str(second)]) == Search(None, (cache, *places))
    Path(places[1]).touch()
    assert find(name, [str(second)]) == Search(places[1], (cache, *places))
    Path(places[0]).touch()
    assert find(name, [str(second)]).library == places[0]
    # A path is no name.
    assert find(places[0], [str(second)]) == Search(places[0], (places[0],))
    assert find("./no.so", [str(second)]) == Search(None, ("./no.so",))
    # The linker is asked last, by the name without what it adds.
    assert find("libc.so.6", []).library is None
    assert asked == ["no", "c"]


def test_hdapi_has_the_numbers_of_its_header() -> None:
    """OpenHaptics 3.4, hdDefines.h."""
    texts = [hdapi.MODEL_TYPE, hdapi.DRIVER_VERSION, hdapi.SERIAL_NUMBER]
    assert texts == [0x2501, 0x2502, 0x2504]
    assert [hdapi.MAX_WORKSPACE, hdapi.CALIBRATION_STYLE] == [0x2550, 0x2555]
    assert [hdapi.MAX_FORCE, hdapi.MAX_CONTINUOUS_FORCE] == [0x2603, 0x2604]
    assert hdapi.FORCE_OUTPUT == 0x4000
    assert [
        hdapi.CALIBRATION_OK,
        hdapi.CALIBRATION_NEEDS_UPDATE,
        hdapi.CALIBRATION_NEEDS_MANUAL,
    ] == [0x5000, 0x5001, 0x5002]
    assert [hdapi.ENCODER_RESET, hdapi.AUTOMATIC, hdapi.INKWELL] == [1, 2, 4]
    assert hdapi.INVALID_HANDLE == 0xFFFFFFFF
    groups = {
        0x0100: ["enum", "value", "operation", "input type", "handle"],
        0x0200: ["warm motors", "force", "impulse", "velocity", "force error"],
        0x0300: ["fault", "initiated", "communication", "configuration", "timer"],
        0x0400: ["begin", "end", "frame"],
        0x0500: ["priority", "scheduler"],
        0x0600: ["licence"],
    }
    expected = {
        base + i: word for base, words in groups.items() for i, word in enumerate(words)
    }
    assert hdapi.ERRORS.keys() == expected.keys()
    for code, word in expected.items():
        assert word in hdapi.error_text(code)
        assert hdapi.error_text(code).endswith(f"(0x{code:04X})")
