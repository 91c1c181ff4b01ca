"""DHD's ABI as its driver uses it: against the vendor's files, else the emulator's.

``HAPTIC_DHD=/opt/sdk/lib/.../libdrd.a HAPTIC_DHD_HEADER=/opt/sdk/include/dhdc.h pytest
tests/nodes/driver/test_dhd_abi.py``
"""

from __future__ import annotations

import ctypes
import os
import re
from pathlib import Path

import pytest

from nodes.driver.forcedimension import dhd
from nodes.driver.forcedimension.dhd import FUNCTIONS, load_library, stub_source
from nodes.driver.forcedimension.driver import (
    ForceDimensionDevice,
    ForceDimensionDriverParameters,
    ForceDimensionParameters,
)
from sim.emulators.world import World, archive, library

REAL = os.environ.get("HAPTIC_DHD", "")
HEADER = os.environ.get("HAPTIC_DHD_HEADER", "")

TYPES = {
    "int": ctypes.c_int,
    "uint": ctypes.c_uint,
    "double": ctypes.c_double,
    "bool": ctypes.c_bool,
    "char": ctypes.c_char,
    "uchar": ctypes.c_ubyte,
    "unsigned char": ctypes.c_ubyte,
    "size_t": ctypes.c_size_t,
    "const char*": ctypes.c_char_p,
    "char*": ctypes.c_char_p,
    "double *": ctypes.POINTER(ctypes.c_double),
    "ushort *": ctypes.POINTER(ctypes.c_ushort),
    "int []": ctypes.POINTER(ctypes.c_int),
    "double []": ctypes.POINTER(ctypes.c_double),
}
"""C types of dhdc.h."""


def declared(argument: str) -> object:
    """Return the type of an argument of dhdc.h."""
    text = argument.split("=")[0].strip()
    if "][" in text:
        # Two dimensions are a pointer all the same.
        return None
    array = "[]" if "[" in text else ""
    pointer = "*" if "*" in text else ""
    name = re.sub(r"\[.*", "", text).replace("*", " ").split()[:-1]
    word = " ".join(name)
    if word == "char" and pointer:
        return TYPES["char*"]
    return TYPES[f"{word} {array or pointer}".strip()]


@pytest.mark.skipif(
    not HEADER, reason="HAPTIC_DHD_HEADER names no header of the vendor"
)
def test_types_are_those_of_the_vendors_header() -> None:
    text = Path(HEADER).read_text(encoding="utf-8", errors="replace")
    for name, (result, arguments) in FUNCTIONS.items():
        found = re.search(
            rf"^\s*([\w ]+\*?)\s+__SDK\s+{name}\s*\((.*?)\);", text, re.MULTILINE
        )
        assert found, name
        assert TYPES[found[1].strip()] == result, name
        theirs = [declared(one) for one in found[2].split(",") if one.strip()]
        assert len(theirs) == len(arguments), name
        for wanted, ours in zip(theirs, arguments, strict=True):
            assert wanted in (None, ours), (name, wanted, ours)


@pytest.mark.skipif(not REAL, reason="HAPTIC_DHD names no library of the vendor")
def test_the_vendors_library_has_all_and_says_that_no_device_is_there() -> None:
    library = load_library(REAL)
    assert library.dhdGetSDKVersionStr()
    x = ctypes.c_double(7.0)
    # On failure: negative, and the out-parameters left alone.
    assert library.dhdGetPosition(x, x, x, b"\xff") < 0
    assert x.value == 7.0
    assert library.dhdErrorGetLast() != 0
    device = ForceDimensionDevice(
        ForceDimensionDriverParameters(
            force_dimension=ForceDimensionParameters(library=REAL)
        )
    )
    with pytest.raises(OSError, match="no device found"):
        device.connect()
    device.close()


def test_a_static_library_is_linked_once(tmp_path: Path, cached: Path) -> None:
    """The emulator as a static library, as the vendor ships it."""
    path = archive("dhd", tmp_path)
    library = load_library(str(path))
    assert library.dhdErrorGetLast() == 0
    (made,) = cached.rglob("linked-*")
    before = made.stat().st_mtime_ns
    assert load_library(str(path)).dhdErrorGetLast() == 0
    assert made.stat().st_mtime_ns == before
    with pytest.raises(OSError, match="no such file"):
        load_library(str(tmp_path / "libnone.a"))
    with pytest.raises(OSError, match="has no dhdErrorGetLast"):
        load_library(str(archive("hd", tmp_path)))


@pytest.fixture
def cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Link into a folder of the test's own."""
    kept = tmp_path / "cache"
    kept.mkdir(mode=0o700)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(kept))
    return kept


@pytest.mark.parametrize("form", ["so", "a"])
@pytest.mark.parametrize(
    "name", ["dhdSetWatchdog", "dhdErrorGetLast", "dhdJointAnglesToInertiaMatrix"]
)
def test_a_library_that_lacks_a_function_is_refused_by_its_name(
    form: str, name: str, tmp_path: Path, cached: Path
) -> None:
    """Another version: the emulator with one function renamed."""
    del cached
    renamed = f"-D{name}={name}_of_old"
    path = (
        archive("dhd", tmp_path, renamed)
        if form == "a"
        else library("dhd", tmp_path, renamed)[0]
    )
    with pytest.raises(
        OSError,
        match=rf"^{re.escape(str(path))} has no {name}: it is not Force Dimension's library",
    ):
        load_library(str(path))


def test_what_cannot_be_linked_or_loaded_is_refused_in_one_line(
    tmp_path: Path, cached: Path
) -> None:
    del cached
    needs = archive("dhd", tmp_path, "-Dusleep=libusb_of_old")
    with pytest.raises(
        OSError, match="it needs libusb_of_old, which nothing here has; "
    ) as refused:
        load_library(str(needs))
    assert "\n" not in str(refused.value)
    text = tmp_path / "libtext.a"
    text.write_text("no library", encoding="ascii")
    with pytest.raises(OSError, match="nm cannot read"):
        load_library(str(text))
    shared = tmp_path / "libtext.so"
    shared.write_text("no library", encoding="ascii")
    for path in (shared, tmp_path / "libnone.so"):
        with pytest.raises(
            OSError,
            match=rf"{path.name} cannot be loaded .*install the Force Dimension SDK",
        ):
            load_library(str(path))


def test_only_what_the_vendor_s_logger_lacks_is_filled_in() -> None:
    """A listing of ``nm``: members, undefined names, and those that another member defines."""
    logger = "_ZN14forcedimension6logger"
    listing = f"""
usb.o:
0000000000000000 T dhdOpen
                 U {logger}4stopEv
                 U {logger}5startEv
                 U {logger}5startEv
                 U malloc

log.o:
0000000000000010 W {logger}4stopEv
0000000000000020 t {logger}5startEv
"""
    line = "__attribute__((weak)) long {name}(void) {{ return 0; }}\n"
    # A local function, `t`, is none that another member finds.
    assert stub_source(listing) == line.format(name=f"{logger}5startEv")
    for kind in "TDBRW":
        whole = f"{listing}0000000000000030 {kind} {logger}5startEv\n"
        assert stub_source(whole) == stub_source("") == "int unused;\n"


def test_a_world_is_kept_in_its_file(tmp_path: Path) -> None:
    World(tmp_path / "w").state.mass = 0.5
    assert World(tmp_path / "w").state.mass == 0.5


def test_indices_and_codes_are_those_of_dhdc_h() -> None:
    """DHD_STATUS_* and DHD_ERROR_* of SDK 3.17; the watchdog counts 125 µs."""
    assert (dhd.STATUS, dhd.RESET, dhd.WATCHDOG_UNIT) == (17, 3, 125e-6)
    assert sorted(dhd.CONDITIONS) == [1, 2, 3, 4, 5, 6]
    words = {0: "no error", 3: "busy", 5: "no device", 7: "timed out", 11: "memory"}
    words |= {15: "index", 18: "redundant", 20: "in use", 22: "regulation"}
    for code, word in words.items():
        assert word in dhd.ERRORS[code]
    assert len(dhd.ERRORS) == 23
