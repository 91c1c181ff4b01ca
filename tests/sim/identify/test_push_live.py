"""Identification on a running launch: everything is restored, whatever happens."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.support.launching import HAPTIC, Running, running, typed, wait_for

SCENE = ("floor_buzz", "duration:=0")


def parameters(launch: Running) -> tuple[str, Any]:
    return launch.call("coupling", "law.list")["active"], launch.call(
        "environment", "param.get", name="surface"
    )


@pytest.mark.slow
@pytest.mark.realtime
def test_identify_on_a_running_launch_and_put_everything_back(tmp_path: Path) -> None:
    # A mass that falls while the machine stalls comes back from anywhere.
    (tmp_path / "wide.yaml").write_text(
        "driver: {safety: {workspace: null}}", encoding="utf-8"
    )
    with running(tmp_path, *SCENE, "--params", "wide.yaml") as launch:
        before = parameters(launch)
        # The floor carries 0.98 N of weight, but that might as well be a hand that presses.
        refused = typed(launch, "device", "identify", "--duration", "6", code=1)
        assert "let go first" in refused.stderr
        # Dry friction of 0.06 N carries a part of it.
        assert abs(float(refused.stderr.rsplit("--load ", 1)[1]) - 0.981) <= 0.07
        assert parameters(launch) == before
        heavy = typed(
            launch, "device", "identify", "--load", "60", "--amplitude", "50", code=1
        )
        assert "more than" in heavy.stderr
        # Twelve windows of 100 ticks are needed: what a busy machine loses, or a short push lacks,
        # a longer one makes up for.
        short = typed(
            launch,
            "device",
            "identify",
            "--duration",
            "1.2",
            "--load",
            "0.981",
            code=None,
        )
        assert "pushing again, for longer" in short.stderr
        assert parameters(launch) == before
        done = typed(
            launch, "device", "identify", "--duration", "6", "--load", "0.981", "--json"
        )
        figures = json.loads(done.stdout.splitlines()[-1])
        assert parameters(launch) == before
        assert before[0] == "pd"
        launch.finish(signal.SIGINT, code=None)
    assert figures["stopped"] == "done"
    # The scenario's device; the floor carried its weight, the push does now. Real time on a loaded
    # machine: 5 %.
    for key, truth in (
        ("mass_kg", 0.1),
        ("damping_n_s_per_m", 1.0),
        ("friction_n", 0.06),
        ("load_n", -0.981),
    ):
        assert figures[key]["value"] == pytest.approx(truth, rel=0.05), key
    assert figures["encoder_m"]["value"] == pytest.approx(2.3e-5, rel=1e-9)
    assert len(figures["places"]) == 1


@pytest.mark.process
@pytest.mark.realtime
def test_ctrl_c_puts_everything_back_and_tells_what_is_known(tmp_path: Path) -> None:
    with running(tmp_path, *SCENE) as launch:
        before = parameters(launch)
        process = subprocess.Popen(
            [
                *HAPTIC,
                "device",
                "identify",
                "--duration",
                "600",
                "--load",
                "0.981",
                "--json",
            ],
            cwd=tmp_path,
            env=launch.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            process_group=0,
        )

        def ended() -> bool:
            # On a machine that stalls for seconds the push ends by itself, and must put everything
            # back just so.
            return process.poll() is not None

        wait_for(
            lambda: ended() or parameters(launch)[0] == "identify",
            "the push to take over",
        )
        if not ended():
            # Twice, as impatient people do.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
                os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
        assert parameters(launch) == before
        launch.finish(signal.SIGINT, code=None)
    # What was recorded until then is told, or why it is too little.
    if process.returncode == 0:
        assert json.loads(out.splitlines()[-1])["stopped"] != "done"
    else:
        assert "the push ended: " in err or "nothing was recorded: " in err
        assert "done" not in err


@pytest.mark.process
def test_a_push_that_is_suspended_changes_nothing_when_it_goes_on(
    tmp_path: Path,
) -> None:
    """After Ctrl-Z, expired leases and ``fg``, law and wall were changed for good."""
    with running(tmp_path, *SCENE) as launch:
        before = parameters(launch)
        words = (*HAPTIC, "device", "identify", "--duration", "600", "--load", "0.981")
        pipes: dict[str, Any] = {
            "stdout": subprocess.DEVNULL,
            "stderr": subprocess.PIPE,
        }
        process = subprocess.Popen(
            words,
            cwd=tmp_path,
            env=launch.environment,
            text=True,
            process_group=0,
            **pipes,
        )
        try:
            wait_for(lambda: parameters(launch)[0] == "soft", "the soft spring", 60.0)
            os.killpg(process.pid, signal.SIGSTOP)
            wait_for(
                lambda: parameters(launch) == before,
                "the launch to take law and surface back",
            )
            os.killpg(process.pid, signal.SIGCONT)
            _, err = process.communicate(timeout=60.0)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        assert parameters(launch) == before
        launch.finish(signal.SIGINT, code=None)
    assert process.returncode == 1
    assert (
        "refused: its lease 'borrowed' has run out" in err
        or "held up for too long" in err
    )
    assert "Traceback" not in err
