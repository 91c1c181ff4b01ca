"""Choice of the tick: the plain one runs, with a reason, if there is no compiled one."""

from __future__ import annotations

import contextlib
import os
import signal
from pathlib import Path

import pytest

from nodes.cli.doctor import CHECKS
from nodes.compiled import build, cache
from nodes.compiled.build import expected_seconds, find, reason
from nodes.compiled.choose_tick import choose, compile_later
from nodes.compiled.library import functions, library_of_pyzmq, obtain
from nodes.compiled.message_fields import NotCompilableError
from nodes.compiled.source_files import ROOT, sources_of
from tests.support.background import background
from tests.support.launching import running, wait_for

TINY = "tests.support.tiny_kernel"
BROKEN = "tests.support.broken_kernel"
KERNEL = "nodes.environment.kernel"
KERNELS = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in ("nodes", "sim")
    for path in (ROOT / package).rglob("kernel.py")
)


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty the cache of compiled code."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_plain_and_auto_never_wait_for_the_compiler(empty_cache: Path) -> None:
    told: list[str] = []
    assert choose("plain", [KERNEL], told.append) == "plain"
    assert choose("auto", [KERNEL], told.append, scarce=False) == "plain"
    assert told == []
    assert choose("auto", [KERNEL], told.append, scarce=True) == "plain"
    assert "--tick compiled" in told[0]
    assert not list(empty_cache.rglob("*.tick"))


def test_a_compilation_that_failed_is_said_at_every_rate_and_by_the_doctor(
    empty_cache: Path,
) -> None:
    """The doctor said "built …, auto uses it"; a launch below 1 kHz said nothing."""
    failed = cache.CacheEntry(kind="failed", content=f"{KERNEL}: no such type".encode())
    cache.write(f"{KERNEL}.tick", failed, {})
    told: list[str] = []
    assert choose("auto", [KERNEL], told.append, scarce=False) == "plain"
    assert told == [
        f"using the plain tick; the compiled one is not available: {KERNEL}: no such type"
    ]
    found = CHECKS["compiled tick"]()
    assert found.state == "limited"
    assert (
        f"cannot be compiled here: {KERNEL}: no such type; auto uses the plain tick"
        in found.found
    )


def test_a_folder_in_the_place_of_an_entry_lets_the_plain_tick_run(
    empty_cache: Path,
) -> None:
    """A folder in place of a file ended every launch."""
    cache.write(f"{KERNEL}.tick", cache.CacheEntry(kind="so", content=b""), {})
    entry = cache.folder() / f"{KERNEL}.tick"
    entry.unlink()
    entry.mkdir()
    told: list[str] = []
    for wanted in ("auto", "compiled"):
        assert choose(wanted, [KERNEL], told.append) == "plain"
    assert all(f"{entry}: must be a file of user" in text for text in told)
    assert "must be a file of user" in CHECKS["compiled tick"]().found


@pytest.mark.process
def test_what_cannot_be_compiled_is_said_and_the_plain_tick_runs(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # numba as it is where its compiler fails: decorated functions stay what they are.
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    told: list[str] = []
    assert choose("compiled", [KERNEL], told.append) == "plain"
    assert (
        "compiling 1 kernel, once for this version: about 10 s (an estimate" in told[0]
    )
    assert KERNEL in told[1]
    # A node, on another machine too, loads what is there and never compiles.
    with pytest.raises(
        NotCompilableError,
        match=r"environment\.kernel is not compiled on this machine; `haptic launch",
    ):
        obtain(KERNEL)


@pytest.mark.parametrize("module", KERNELS)
def test_every_kernel_compiles_from_the_present_sources(module: str) -> None:
    """Other tests of the run reuse what this compiles."""
    told: list[str] = []
    assert choose("compiled", [module], told.append) == "compiled", told
    assert reason(find(module)) == ""


@pytest.mark.process
def test_the_message_says_what_compiling_took_here_last_time(empty_cache: Path) -> None:
    told: list[str] = []
    assert choose("compiled", [TINY], told.append) == "compiled"
    assert "an estimate: it is the first time here" in told[0]
    seconds, is_measured = expected_seconds([TINY])
    assert is_measured
    assert 0.0 < seconds < 10.0
    cache.write(
        f"{TINY}.seconds", cache.CacheEntry(kind="seconds", content=b"77.0"), {}
    )
    (cache.folder() / f"{TINY}.tick").unlink()
    assert choose("compiled", [TINY], told.append) == "compiled"
    assert (
        told[1]
        == "compiling 1 kernel, once for this version: about 77 s (as it took here last time)"
    )


def test_a_change_of_what_builds_and_keeps_kernels_compiles_none() -> None:
    used = set(sources_of("nodes.compiled.machine_code"))
    assert used == {
        "nodes/__init__.py",
        "nodes/compiled/__init__.py",
        "nodes/compiled/lean_numba.py",
        "nodes/compiled/machine_code.py",
    }
    for module in KERNELS:
        elsewhere = {
            "nodes/compiled/build.py",
            "nodes/compiled/cache.py",
            "nodes/compiled/choose_tick.py",
            "nodes/compiled/source_files.py",
        }
        assert not elsewhere & set(sources_of(module))


@pytest.mark.slow
def test_a_function_that_its_kernel_does_not_name_is_named_with_its_place(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cause = f"{BROKEN}: Untyped global name 'unnamed'"
    told: list[str] = []
    assert choose("compiled", [BROKEN], told.append) == "plain"
    monkeypatch.setenv("HAPTIC_COMPILE", "background")
    compile_later([BROKEN], told.append)
    wait_for(lambda: find(BROKEN), "its failure is noted")
    assert choose("auto", [BROKEN], told.append) == "plain"
    for line in (told[1], told[-1]):
        assert cause in line
        assert "must be named in its kernel" in line
        assert 'broken_kernel.py", line 17' in line


def test_the_library_is_the_one_that_pyzmq_uses() -> None:
    assert "zmq" in Path(library_of_pyzmq()).name
    assert all(functions().values())


@pytest.mark.process
def test_what_a_launch_lacked_is_compiled_in_the_background(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    compile_later([TINY], told.append)
    assert not told
    monkeypatch.setenv("HAPTIC_COMPILE", "background")
    # As two launches that end together do.
    compile_later([TINY], told.append)
    compile_later([TINY], told.append)
    assert told == [
        "the plain tick ran; the compiled one is being made in the background, for the next launch",
        "the plain tick ran; a compilation is under way in the background already",
    ]
    wait_for(lambda: find(TINY), "it is compiled")
    assert obtain(TINY)(41) == 42
    compile_later([TINY], told.append)
    assert len(told) == 2
    assert choose("auto", [TINY], told.append) == "compiled"


def test_a_cache_that_cannot_be_written_is_named(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAPTIC_COMPILE", "background")

    lock = cache.folder() / "background.lock"
    lock.mkdir(mode=0o700, parents=True)  # what is no file cannot be locked
    told: list[str] = []
    compile_later([TINY], told.append)
    assert told == [
        f"the plain tick ran; a compiled one cannot be kept: {lock.parent}: Is a directory"
    ]


@pytest.mark.parametrize(
    ("error", "kept"),
    [
        (ModuleNotFoundError("No module named 'llvmlite'"), False),
        (OSError(28, "No space left on device"), False),
        (TypeError("no float"), True),
    ],
)
def test_a_failure_of_the_machine_is_not_kept_as_one_of_the_kernel(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, kept: bool
) -> None:
    """An environment that was removed while it compiled barred its kernels for good."""

    def fail(_: str) -> bytes:
        raise error

    monkeypatch.setattr(build, "object_file", fail)
    raised = contextlib.nullcontext() if kept else pytest.raises(NotCompilableError)
    with raised:
        build._compile(TINY, keep_failure=True)
    assert (find(TINY) is not None) is kept


@pytest.mark.process
def test_what_fails_in_the_background_is_not_tried_at_each_launch(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAPTIC_COMPILE", "background")
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    told: list[str] = []
    compile_later([TINY], told.append)
    wait_for(lambda: find(TINY), "its failure is noted")
    compile_later([TINY], told.append)
    assert len(told) == 1
    assert choose("auto", [TINY], told.append) == "plain"
    assert "not available: tests.support.tiny_kernel" in told[1]
    with pytest.raises(NotCompilableError, match="tiny_kernel: "):
        obtain(TINY)
    # Who asks for it has it tried again.
    monkeypatch.delenv("NUMBA_DISABLE_JIT")
    assert choose("compiled", [TINY], told.append) == "compiled"


@pytest.mark.process
@pytest.mark.smoke
def test_a_launch_says_which_tick_ran_and_has_the_other_made(
    empty_cache: Path, tmp_path: Path
) -> None:
    variables = {"HAPTIC_COMPILE": "background"}
    with running(
        tmp_path,
        "floor_drop",
        "pace:=lockstep",
        "duration:=0.02",
        environment=variables,
        ready=False,
    ) as launch:
        figures = launch.finish()
        # It forks one for each kernel that it compiles just now.
        (process, line), *_ = sorted(
            background(empty_cache).items(),
            key=lambda found: os.getpgid(found[0]) != found[0],
        )
        try:
            assert {*line.split()[-4:]} == {
                "nodes.driver.kernel",
                "nodes.environment.kernel",
                "nodes.coupling.kernel",
                "sim.device.kernel",
            }
            wait_for(
                lambda: os.sched_getscheduler(process) == os.SCHED_IDLE,
                "it steps aside",
            )
            assert os.getpriority(os.PRIO_PROCESS, process) == 19
            assert os.getsid(process) == process
        finally:
            os.killpg(process, signal.SIGKILL)
    assert figures["tick"] == "plain"
    assert figures["tick_by_node"] == {
        "driver": "plain",
        "environment": "plain",
        "coupling": "plain",
    }
    assert (tmp_path / "stderr.txt").read_text(encoding="utf-8").count(
        "for the next launch"
    ) == 1
