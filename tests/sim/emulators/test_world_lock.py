"""The arm behind an emulator is shared by processes, any of which may be killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sim.emulators.world import World

_TOUCH = (
    "import sys, pathlib; from sim.emulators.world import World;"
    " print(World(pathlib.Path(sys.argv[1])).force())"
)
_DIE = (
    "import os, sys, pathlib; from sim.emulators.world import World; "
    "World(pathlib.Path(sys.argv[1])).state.lock = os.getpid(); os.kill(os.getpid(), 9)"
)


def _touch(path: Path, seconds: float) -> str:
    return subprocess.run(
        [sys.executable, "-c", _TOUCH, str(path)],
        capture_output=True,
        text=True,
        timeout=seconds,
        check=True,
    ).stdout


@pytest.mark.process
def test_a_lock_whose_holder_was_killed_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "world"
    state = World(path).state
    killed = subprocess.run(
        [sys.executable, "-c", _DIE, str(path)], timeout=60.0, check=False
    )
    assert killed.returncode == -signal.SIGKILL
    assert state.lock != 0
    assert _touch(path, 60.0) == "(0.0, 0.0, 0.0)\n"
    assert state.lock == 0


@pytest.mark.slow
def test_a_lock_whose_holder_lives_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "world"
    state = World(path).state
    state.lock = os.getpid()
    with pytest.raises(subprocess.TimeoutExpired):
        _touch(path, 3.0)
    assert state.lock == os.getpid()
    state.lock = 0
    assert _touch(path, 60.0) == "(0.0, 0.0, 0.0)\n"
