"""Compiled code runs only if it is the user's own, whole and current."""

from __future__ import annotations

import ctypes
import os
import pickle
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from nodes.compiled import build, cache
from nodes.compiled.choose_tick import choose
from nodes.compiled.library import obtain
from nodes.compiled.message_fields import NotCompilableError
from nodes.compiled.source_files import ROOT, Source, source_of, sources_of

TINY = "tests.support.tiny_kernel"
SOURCES = {"nodes/arithmetic.py": source_of(ROOT / "nodes" / "arithmetic.py")}
ENTRY = cache.CacheEntry(kind="o", content=b"machine code")
needs_root = pytest.mark.skipif(
    os.getuid() != 0, reason="only root can give a file to another user"
)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use a compiled-code folder of the test's own."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    return cache.folder()


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the tiny kernel once; return the cache folder."""
    base = tmp_path_factory.mktemp("tiny")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_CACHE_DIR", str(base))
        build.build([TINY])
    return base


@pytest.fixture
def kept(tiny: Path, place: Path) -> Path:
    """Compile the tiny kernel; return its cache file."""
    shutil.copytree(tiny, place.parent.parent)
    return place / f"{TINY}.tick"


@pytest.mark.process
@pytest.mark.smoke
def test_what_was_kept_is_found_and_runs(kept: Path) -> None:
    assert obtain(TINY)(41) == 42
    assert kept.stat().st_mode & 0o077 == 0


def _open_to_others(path: Path) -> None:
    path.chmod(0o777 if path.is_dir() else 0o666)


def _of_another_user(path: Path) -> None:
    os.chown(path, 4711, 4711)


def _link(path: Path) -> None:
    aside = path.with_name("aside")
    path.rename(aside)
    path.symlink_to(aside)


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path, 0o600)


@pytest.mark.process
@pytest.mark.parametrize(
    "steps", range(4), ids=["entry", "folder", "haptic-nodes", "base"]
)
@pytest.mark.parametrize(
    "spoil",
    [_open_to_others, pytest.param(_of_another_user, marks=needs_root), _link],
    ids=lambda spoil: spoil.__name__,
)
def test_nothing_is_loaded_that_somebody_else_could_have_written(
    kept: Path, spoil: Callable[[Path], None], steps: int
) -> None:
    spoil([kept, *kept.parents][steps])
    if spoil is _link and steps == 3:
        # What leads to the folder may be a link of one's own, as /home often is.
        assert obtain(TINY)(41) == 42
        return
    with pytest.raises(
        NotCompilableError,
        match=r"remove it|may write there|Too many levels|Not a directory",
    ):
        obtain(TINY)
    told: list[str] = []
    assert choose("compiled", [TINY], told.append) == "plain"
    assert len(told) == 1
    assert "compiled code is not taken from there" in told[0]


@pytest.mark.process
@needs_root
def test_a_link_of_another_user_on_the_way_is_not_followed(kept: Path) -> None:
    base = kept.parent.parent.parent
    _link(base)
    os.chown(base, 4711, 4711, follow_symlinks=False)
    with pytest.raises(NotCompilableError, match="a symbolic link of another user"):
        obtain(TINY)


@pytest.mark.process
def test_an_entry_that_is_no_file_is_refused(kept: Path) -> None:
    _pipe(kept)
    with pytest.raises(NotCompilableError, match="must be a file of user"):
        obtain(TINY)


@pytest.mark.parametrize("name", ["../evil.tick", "/evil.tick", "a/b", "", ".."])
def test_names_are_bare(place: Path, name: str) -> None:
    with pytest.raises(cache.CacheRefusedError, match="no name of an entry"):
        cache.read(name)
    with pytest.raises(cache.CacheRefusedError, match="no name of an entry"):
        cache.write(name, ENTRY, SOURCES)


@pytest.mark.process
@pytest.mark.parametrize("kind", ["half", "empty", "one bit"])
def test_half_a_library_counts_as_none_and_is_healed(kept: Path, kind: str) -> None:
    whole = kept.read_bytes()
    bit = len(whole) // 2
    kept.write_bytes(
        {
            "half": whole[:bit],
            "empty": b"",
            "one bit": whole[:bit] + bytes([whole[bit] ^ 1]) + whole[bit + 1 :],
        }[kind]
    )
    assert build.find(TINY) is None
    with pytest.raises(NotCompilableError, match="is not compiled on this machine"):
        obtain(TINY)
    if kind == "half":
        told: list[str] = []
        assert choose("compiled", [TINY], told.append) == "compiled"
        assert obtain(TINY)(41) == 42


@pytest.mark.process
def test_what_runs_is_what_was_checked(kept: Path) -> None:
    kernel = obtain(TINY)
    # A library that is mapped from its file would die of SIGBUS, or of what was written over it.
    with kept.open("r+b") as file:
        file.truncate(10)
    assert kernel(41) == 42
    maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    assert str(kept.parent) not in maps


def test_other_sources_make_other_code(place: Path, tmp_path: Path) -> None:
    cache.write("kernel.tick", ENTRY, SOURCES)
    assert cache.read("kernel.tick") == ENTRY
    other = Source("0" * 64, "0" * 64)
    cache.write("kernel.tick", ENTRY, {"nodes/arithmetic.py": other})
    assert cache.read("kernel.tick") is None
    cache.write("kernel.tick", ENTRY, {"nodes/gone.py": other})
    assert cache.read("kernel.tick") is None


RULE = '''"""Rules."""


def rule(x: float) -> float:
    """Return the half."""
    return 0.5 * x  # exactly
'''


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ('"""Rules."""', '"""All rules."""', True),
        ('    """Return the half."""\n', "", True),
        ("  # exactly", "", True),
        ("0.5 * x", "(0.5 * x)", True),
        ("0.5 * x", "0.25 * x", False),
        ("-> float", "-> int", False),
        ("return 0.5 * x", "assert x\n    return 0.5 * x", False),
        ("def rule", "def (", False),
        ("exactly", "\x00", False),
    ],
)
def test_only_other_code_is_compiled_again(
    before: str,
    after: str,
    same: bool,
    place: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cache, "ROOT", tmp_path)
    monkeypatch.setattr(cache, "folder", lambda: place)
    source = tmp_path / "rules.py"
    source.write_text(RULE, encoding="utf-8")
    cache.write("kernel.tick", ENTRY, {"rules.py": source_of(source)})
    source.write_text(RULE.replace(before, after, 1), encoding="utf-8")
    assert cache.read("kernel.tick") == (ENTRY if same else None)


@pytest.mark.parametrize(
    ("module", "needs"),
    [
        ("sim.lab.monte_carlo.virtual", "nodes/laws/excitation.py"),
        ("sim.play.one_axis_loop", "nodes/arithmetic.py"),
        ("sim.experiments.drop", "sim/play/one_axis_loop.py"),
        ("nodes.coupling.kernel", "messages/types.py"),
        (TINY, "tests/support/tiny_kernel.py"),
    ],
)
def test_every_source_counts_near_and_far(module: str, needs: str) -> None:
    assert needs in sources_of(module)


@pytest.mark.process
def test_sources_are_those_that_are_loaded() -> None:
    code = (
        "import sys; import sim.lab.monte_carlo.virtual; from nodes.compiled import"
        " cache;print(*{m.__file__ for n, m in sys.modules.items() if n.split('.')[0] in"
        " ('messages', 'nodes', 'sim')})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = {str(Path(file).relative_to(ROOT)) for file in done.stdout.split()}
    assert loaded <= {
        *sources_of("sim.lab.monte_carlo.virtual"),
        "nodes/compiled/cache.py",
        "nodes/compiled/source_files.py",
    }


class Evil:
    """A pickle that executes code when read."""

    def __reduce__(self) -> tuple[Callable[..., None], tuple[str]]:
        return os.mkdir, ("evil",)


SCENE = """
import numba
from sim.play.compiled import compiled
from nodes.arithmetic import fir
print(compiled()(fir)((2.0, 1.0), (1.0, 3.0), 0))
"""


def scene(folder: Path) -> subprocess.CompletedProcess[str]:
    """Compile a function of the one-process loop in a separate process."""
    return subprocess.run(
        [sys.executable, "-c", SCENE],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
    )


@pytest.mark.slow
def test_the_one_process_loop_reads_no_pickle_of_others(
    place: Path, tmp_path: Path
) -> None:
    first = scene(tmp_path)
    assert first.stdout == "5.0\n", first.stderr
    (entry,) = place.glob("nodes.arithmetic.*.numba")
    # Somebody who cannot know what to write before it, and somebody else's file that is as it
    # should be.
    entry.write_bytes(pickle.dumps(Evil()))
    assert scene(tmp_path).stdout == "5.0\n"
    healed = cache.read(entry.name)
    assert healed is not None
    cache.write(
        entry.name,
        cache.CacheEntry(kind="numba", content=pickle.dumps(Evil())),
        SOURCES,
    )
    entry.chmod(0o666)
    done = scene(tmp_path)
    assert done.stdout == "5.0\n"
    assert done.stderr.count("\n") == 1
    assert "must be a file of user" in done.stderr
    assert not (tmp_path / "evil").exists()


def test_the_servo_loop_of_a_device_is_not_taken_from_others(place: Path) -> None:
    from nodes.driver.hardware.compile import servo_library
    from nodes.driver.touch.driver import TouchDevice
    from nodes.driver.touch.hdapi import TouchServo

    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    kept = place / "touch-servo.so"
    assert servo_library(TouchDevice.SERVO).servo_size() == ctypes.sizeof(TouchServo)
    kept.write_bytes(kept.read_bytes()[:1000])
    assert servo_library(TouchDevice.SERVO).servo_size() == ctypes.sizeof(TouchServo)
    kept.chmod(0o666)
    assert servo_library(TouchDevice.SERVO).servo_size() == ctypes.sizeof(TouchServo)


# -- what may go wrong while compiling
# -------------------------------------------------------------------------------


@pytest.mark.process
def test_two_that_compile_at_once_do_no_harm(kept: Path) -> None:
    kept.unlink()
    build.build([TINY, TINY])
    assert obtain(TINY)(41) == 42
    seconds = kept.with_suffix(".seconds").name
    assert sorted(path.name for path in kept.parent.iterdir()) == [seconds, kept.name]


def test_who_waited_for_an_entry_finds_it(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, locked = threading.Event(), cache._locked

    def tried(at: int, lock: str) -> int | None:
        held = locked(at, lock)
        if held is None:
            waits.set()
        return held

    def found() -> cache.CacheEntry | None:
        with cache.making("a.tick"):
            return cache.read("a.tick")

    # Another process makes it.
    with cache.making("other.tick"):
        folder = os.open(place, os.O_RDONLY)
    lock = ".a.tick.making"
    held = locked(folder, lock)
    assert held is not None
    monkeypatch.setattr(cache, "_locked", tried)
    with ThreadPoolExecutor(1) as beside:
        second = beside.submit(found)
        assert waits.wait(60.0)
        cache.write("a.tick", ENTRY, SOURCES)
        os.unlink(lock, dir_fd=folder)
        os.close(held)
        assert second.result(60.0) == ENTRY
        assert [path.name for path in place.iterdir()] == ["a.tick"]
        # A thread of the same process does not wait, nor does anybody without an end.
        with cache.making("a.tick"):
            assert beside.submit(found).result(60.0) == ENTRY
    held = locked(folder, lock)
    assert held is not None
    monkeypatch.setattr(cache, "LOCK_TIMEOUT", 0.0)
    assert found() == ENTRY
    os.close(held)
    os.close(folder)


@pytest.mark.process
def test_without_a_linker_the_object_file_runs(
    place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    build.build([TINY])
    found = build.find(TINY)
    assert found is not None
    assert found.kind == "o"
    assert obtain(TINY)(41) == 42


@pytest.mark.parametrize("trouble", ["a full disk", "a file in its place"])
def test_where_nothing_can_be_kept_one_line_says_so(
    place: Path, trouble: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if trouble == "a full disk":
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        cache.write("other.tick", ENTRY, SOURCES)
        resource.setrlimit(resource.RLIMIT_FSIZE, (512, limits[1]))
    else:
        place.parent.parent.write_text("in the way", encoding="ascii")
    told: list[str] = []
    try:
        assert choose("compiled", [TINY], told.append) == "plain"
    finally:
        if trouble == "a full disk":
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert len([line for line in told if "using the plain tick" in line]) == 1
    assert "\n" not in "".join(told)
    if trouble == "a full disk":
        # Nothing half-written is left.
        assert [path.name for path in place.iterdir()] == ["other.tick"]


@pytest.mark.process
def test_in_a_folder_that_cannot_be_written_to_one_line_says_so(tmp_path: Path) -> None:
    """As in a container with a read-only root; root drops its write permission."""
    base = tmp_path / "base"
    base.mkdir(mode=0o500)
    without: list[str] = []
    if os.getuid() == 0:
        setpriv = shutil.which("setpriv")
        if setpriv is None:
            pytest.skip("root writes anywhere, and there is no setpriv")
        without = [setpriv, "--bounding-set=-dac_override,-dac_read_search"]
    program = (
        f"from nodes.compiled.choose_tick import choose; print(choose('compiled', ['{TINY}'],"
        " print))"
    )
    done = subprocess.run(
        [*without, sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(base / "kept")},
        capture_output=True,
        text=True,
        check=True,
    )
    said = done.stdout.splitlines()
    assert said[-1] == "plain"
    assert len([line for line in said if "using the plain tick" in line]) == 1
    assert "Permission denied" in said[-2]
    assert done.stderr == ""
    assert not list(base.iterdir())
