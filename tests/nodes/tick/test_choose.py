"""Which tick a launch takes, and that the plain one runs, with a reason, where the compiled one cannot be had."""

from __future__ import annotations

from pathlib import Path

import pytest

from nodes.tick.choose import choose
from nodes.tick.fields import NotCompilableError
from nodes.tick.library import functions, library_of_pyzmq, obtain

KERNEL = "nodes.tick.kernels.environment"


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Forget what was compiled before."""
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


def test_what_cannot_be_compiled_is_said_and_the_plain_tick_runs(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # numba as it is where its compiler fails: decorated functions stay what they are.
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    told: list[str] = []
    assert choose("compiled", [KERNEL], told.append) == "plain"
    assert "compiling the tick" in told[0]
    assert KERNEL in told[1]
    # A node, on another machine too, loads what is there and never compiles.
    with pytest.raises(NotCompilableError, match=r"environment is not compiled on this machine; `haptic launch"):
        obtain(KERNEL)


def test_the_library_is_the_one_that_pyzmq_uses() -> None:
    assert "zmq" in Path(library_of_pyzmq()).name
    assert all(functions().values())
