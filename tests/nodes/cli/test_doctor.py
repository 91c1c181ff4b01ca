"""haptic doctor: findings, remedies, and exit codes for scripts."""

from __future__ import annotations

import json
import os
import platform
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq

from nodes.base import realtime
from nodes.base.wake_ups import wake_ups
from nodes.cli.doctor import OPEN_FILES, interpreter
from nodes.cli.main import main
from tests.support.launching import haptic, private_runtime_dir, typed_in


def examined(folder: Path, code: int, **environment: str) -> dict[str, Any]:
    done = haptic(
        folder, "doctor", "--json", code=code, environment={**os.environ, **environment}
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.process
@pytest.mark.smoke
def test_this_machine_can_run_a_loop_and_each_remedy_belongs_to_a_finding(
    tmp_path: Path,
) -> None:
    with private_runtime_dir() as runtime_dir:
        figures = examined(tmp_path, 0, HAPTIC_RUNTIME_DIR=str(runtime_dir))
    assert figures["fine"] is True
    names = {check["name"] for check in figures["checks"]}
    assert {
        "SCHED_FIFO",
        "processors",
        "timer slack",
        "wake-ups",
        "RT throttling",
        "CPU governor",
        "kernel",
    } <= names
    assert {
        "compiled tick",
        "locked memory",
        "open files",
        "runtime directory",
        "ZeroMQ",
        "Python",
    } <= names
    for check in figures["checks"]:
        assert check["found"]
        assert (check["state"] == "ok") == (check["remedy"] == "")
    wake_up = figures["wake_up_us"]["normal"]
    assert 0.0 < wake_up["p50"] <= max(wake_up.values())
    granted = next(
        check["state"] == "ok"
        for check in figures["checks"]
        if check["name"] == "SCHED_FIFO"
    )
    assert ("fifo" in figures["wake_up_us"]) == granted


@pytest.mark.parametrize("path", ["x" * 90, "file/below"])
def test_a_runtime_directory_that_cannot_be_used_is_essential(
    tmp_path: Path, path: str
) -> None:
    with private_runtime_dir() as folder:
        (folder / "file").write_text("")
        environment = {"HAPTIC_RUNTIME_DIR": str(folder / path)}
        done = typed_in(tmp_path, "doctor", "--json", code=1, environment=environment)
        figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["fine"] is False
    (missing,) = (check for check in figures["checks"] if check["state"] == "missing")
    assert missing["name"] == "runtime directory"
    assert "HAPTIC_RUNTIME_DIR" in missing["remedy"]


def test_too_few_open_files_are_told_at_the_edge(
    capsys: pytest.CaptureFixture[str],
) -> None:
    import resource

    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    processors = os.sched_getaffinity(0)
    codes = []
    try:
        for limit in (OPEN_FILES, OPEN_FILES - 1):
            resource.setrlimit(resource.RLIMIT_NOFILE, (limit, before[1]))
            codes.append(main(["doctor"]))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        os.sched_setaffinity(0, processors)
    assert codes == [0, 1]
    assert f"needed: {OPEN_FILES}" in capsys.readouterr().out


def test_wake_ups_are_ordered() -> None:
    late = wake_ups(period=0.0005, count=20)
    assert 0.0 < late["p50"] <= late["p99"] <= late["max"]


@pytest.mark.parametrize(
    ("counts", "expected"), [((5, 900), 0), ((900, 5), 1), ((7, 7), 1), ((0, 1), 0)]
)
def test_the_chain_gets_the_processor_that_devices_interrupt_least(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    counts: tuple[int, int],
    expected: int,
) -> None:
    # Timers and calls between processors do not count, and processor 2 is not ours.
    table = tmp_path / "interrupts"
    table.write_text(
        f"           CPU0       CPU1       CPU2\n 36: {counts[0]} {counts[1]} 0  PCI-MSIX"
        " virtio1-req.0\n 38: 1 1 0 PCI-MSIX virtio2-input.0\nLOC: 1 99999 5 Local timer"
        " interrupts\nERR: 0\n"
    )
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    assert realtime.quietest_processor(str(table)) == expected
    assert realtime.quietest_processor(str(tmp_path / "none")) == 1


@pytest.mark.parametrize(
    ("prefix", "flags", "found"),
    [
        ("/usr", "", ("ok", "the distribution's build")),
        ("/opt/python", "", ("limited", "built without PGO")),
        ("/opt/python", "'--enable-optimizations'", ("ok", "built with PGO")),
    ],
)
def test_an_interpreter_is_judged_by_what_is_known_of_its_build(
    prefix: str, flags: str, found: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "base_prefix", prefix)
    monkeypatch.setattr(
        "sysconfig.get_config_var", {"CONFIG_ARGS": flags, "PY_CORE_CFLAGS": ""}.get
    )
    python = interpreter()
    assert (python.state, python.found.split(", ")[-1]) == found


def test_a_report_has_versions_machine_load_and_configuration_and_names_nobody(
    tmp_path: Path,
) -> None:
    home = tmp_path / "somebody"
    (home / "keys" / "allowed").mkdir(parents=True)
    (home / "keys" / "allowed" / "a-friend.key").touch()
    environment = {
        "HOME": str(home),
        "HAPTIC_KEYS": str(home / "keys"),
        "HAPTIC_COMPILE": "asked",
    }
    with private_runtime_dir() as runtime_dir:
        environment["HAPTIC_RUNTIME_DIR"] = str(runtime_dir)
        done = typed_in(tmp_path, "doctor", "--report", code=0, environment=environment)
    said = done.stdout
    for section in (
        "### Versions",
        "### Machine",
        "### Configuration",
        "### haptic doctor",
    ):
        assert section in said
    for told in (
        f"- Python: CPython {platform.python_version()}",
        f"- pyzmq: {zmq.__version__}",
        f"- libzmq: {zmq.zmq_version()}",
        f"- numpy: {np.__version__}",
        "- HAPTIC_COMPILE: asked",
        "- HAPTIC_KEYS: ~/keys",
        "- keys: 1 machines are allowed",
        "- launches that run: none",
    ):
        assert told in said
    assert re.search(
        r"- load over 1, 5 and 15 min: \d+\.\d\d, \d+\.\d\d, \d+\.\d\d$", said, re.M
    )
    # Of the user's own limits, not of the processor that the wake-ups are measured on.
    assert f" {len(os.sched_getaffinity(0))} to be used" in said
    assert re.search(r"- haptic-nodes: \d+\.\d+\.\d+", said)
    assert str(home) not in said
    assert "a-friend" not in said


def test_a_report_is_answered_as_figures_too(tmp_path: Path) -> None:
    with private_runtime_dir() as runtime_dir:
        done = typed_in(
            tmp_path,
            "doctor",
            "--report",
            "--json",
            code=0,
            environment={"HAPTIC_RUNTIME_DIR": str(runtime_dir)},
        )
    figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["versions"]["libzmq"] == zmq.zmq_version()
    assert {"machine", "configuration", "checks"} <= set(figures)
