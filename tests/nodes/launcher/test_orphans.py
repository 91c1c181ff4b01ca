"""Whatever is killed, in any order and however early: no node outlives its launcher."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest

from nodes.launcher import reaper, runs
from nodes.launcher.runs import RunInfo, alive, started_at
from tests.support import slowly
from tests.support.launching import (
    haptic,
    private_runtime_dir,
    processes_of,
    running,
    wait_for,
)


@pytest.mark.process
@pytest.mark.parametrize("after", slowly([2, 3, 4, 5], but=[3]))
def test_launcher_and_reaper_killed_during_the_start_leave_nobody(
    tmp_path: Path, after: int
) -> None:
    with running(tmp_path, "wall_press", "duration:=0", ready=False) as launch:
        wait_for(
            lambda: len(processes_of(launch.runtime_dir)) >= after, f"{after} processes"
        )
        for number, line in processes_of(launch.runtime_dir).items():
            if "reaper.py" in line:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
        launch.process.kill()
        launch.process.wait()
        wait_for(
            lambda: not processes_of(launch.runtime_dir), "its nodes end by themselves"
        )
        for path in launch.runtime_dir.rglob("*"):
            # What is left is the next launch's to sweep, when it is a minute old.
            if path.is_dir():
                os.utime(path, (time.time() - 61.0, time.time() - 61.0))
        haptic(
            tmp_path,
            "launch",
            "free_space",
            "duration:=0.01",
            "--no-plot",
            environment=launch.environment,
        )


@pytest.mark.process
def test_a_node_whose_launcher_is_gone_before_it_asks_ends_before_it_does_anything(
    tmp_path: Path,
) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    # Not even its setup is read.
    done = subprocess.run(
        [sys.executable, "-m", "nodes", str(tmp_path / "none.json"), str(gone.pid)],
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, b"")


HIDDEN = "mount -t tmpfs none /proc && exec {command}"


@pytest.mark.process
def test_the_reaper_needs_no_look_into_proc(tmp_path: Path) -> None:
    command = f"{sys.executable} -S -E {reaper.__file__} {tmp_path / 'run'}"
    may = subprocess.run(
        ["unshare", "-m", "sh", "-c", HIDDEN.format(command="true")],
        capture_output=True,
        check=False,
    )
    words = (
        ["unshare", "-m", "sh", "-c", HIDDEN.format(command=command)]
        if may.returncode == 0
        else command.split()
    )
    (tmp_path / "run").mkdir()
    node = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    os.kill(node.pid, signal.SIGSTOP)
    with subprocess.Popen(words, stdin=subprocess.PIPE) as watcher:
        assert watcher.stdin is not None
        watcher.stdin.write(f"{node.pid} 0.0\n{2**22} 0.0\n".encode())
        watcher.stdin.close()
        assert watcher.wait(30.0) == 0
    assert node.wait(10.0) == -signal.SIGTERM
    assert not (tmp_path / "run").exists()


def test_a_number_that_another_process_has_now_is_no_launcher(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own = started_at(os.getpid())
    assert alive(os.getpid())
    assert alive(os.getpid(), own)
    assert not alive(os.getpid(), own + 1)
    assert started_at(2**22) == 0
    with private_runtime_dir() as folder:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        for name, started in (("now", own), ("then", own - 1)):
            path = runs.new_run_dir(name)
            info = RunInfo(
                run=name,
                scenario="s",
                launcher=os.getpid(),
                launcher_started=started,
                nodes={},
            )
            (path / "run.json").write_bytes(msgspec.json.encode(info))
        assert list(runs.runs()) == ["now"]
