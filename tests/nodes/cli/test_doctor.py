"""haptic doctor: what is there, what is missing, and exit codes a script can rely on."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from nodes.base import realtime
from nodes.cli.doctor import OPEN_FILES, interpreter, wake_ups
from nodes.cli.main import main
from tests.support.launching import haptic, private_runtime_dir, typed_in


def examined(folder: Path, code: int, **environment: str) -> dict[str, Any]:
    done = haptic(folder, "doctor", "--json", code=code, environment={**os.environ, **environment})
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.process
@pytest.mark.smoke
def test_this_machine_can_run_a_loop_and_each_remedy_belongs_to_a_finding(tmp_path: Path) -> None:
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
        check["state"] == "ok" for check in figures["checks"] if check["name"] == "SCHED_FIFO"
    )
    assert ("fifo" in figures["wake_up_us"]) == granted


@pytest.mark.parametrize("path", ["x" * 90, "file/below"])
def test_a_runtime_directory_that_cannot_be_used_is_essential(tmp_path: Path, path: str) -> None:
    with private_runtime_dir() as folder:
        (folder / "file").write_text("")
        environment = {"HAPTIC_RUNTIME_DIR": str(folder / path)}
        done = typed_in(tmp_path, "doctor", "--json", code=1, environment=environment)
        figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["fine"] is False
    (missing,) = (check for check in figures["checks"] if check["state"] == "missing")
    assert missing["name"] == "runtime directory"
    assert "HAPTIC_RUNTIME_DIR" in missing["remedy"]


def test_too_few_open_files_are_told_at_the_edge(capsys: pytest.CaptureFixture[str]) -> None:
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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, counts: tuple[int, int], expected: int
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
