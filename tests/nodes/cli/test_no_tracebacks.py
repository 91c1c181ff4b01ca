"""A careless shell, a bad file or a full disk: one line of error, never a traceback."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    haptic,
    private_runtime_dir,
    typed_in,
    wait_for,
)

COMMAND = Path(sys.executable).parent / "haptic"


@pytest.mark.parametrize(
    "value",
    [
        "!!int [1]",
        "!!bool x",
        "!!float x",
        "!!int {a: 1}",
        "!!seq x",
        "!!map x",
        "!!null [1]",
    ],
)
def test_tags_that_do_not_fit_are_refused_where_they_stand(
    value: str, tmp_path: Path
) -> None:
    (tmp_path / "given.yaml").write_text(
        f"coupling:\n  ramp: {value}\n", encoding="utf-8"
    )
    told = typed_in(
        tmp_path, "launch", "floor_drop", "--params", "given.yaml", code=2
    ).stderr
    assert "given.yaml" in told
    assert "Traceback" not in told


def test_a_file_that_never_ends_is_not_read_to_its_end(tmp_path: Path) -> None:
    told = typed_in(
        tmp_path, "launch", "floor_drop", "--params", "/dev/zero", code=2
    ).stderr
    assert told.startswith("haptic: /dev/zero: more than ")


@pytest.mark.parametrize("what", ["file", "link"])
def test_a_runtime_directory_that_is_none(what: str, tmp_path: Path) -> None:
    place = tmp_path / "runtime"
    if what == "file":
        place.write_text("", encoding="utf-8")
    else:
        place.symlink_to(tmp_path / "nowhere")
    for words in (("launch", "floor_drop"), ("node", "list"), ("topic", "list")):
        environment = {**os.environ, "HAPTIC_RUNTIME_DIR": str(place)}
        told = typed_in(tmp_path, *words, environment=environment, code=2).stderr
        assert told.startswith(f"haptic: {place}: ")
        assert "HAPTIC_RUNTIME_DIR" in told
        assert "Traceback" not in told


@pytest.mark.process
def test_no_room_for_the_run_s_directory(tmp_path: Path) -> None:
    """A full disk, by /dev/full or a tmpfs without inodes."""
    mounted = tmp_path / "full"
    mounted.mkdir()
    script = (
        f"mount -t tmpfs -o size=4k,nr_inodes=1,mode=700 none {mounted} && exec {COMMAND} launch"
        " floor_drop"
    )
    done = subprocess.run(
        ["unshare", "-m", "-r", "sh", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "HAPTIC_RUNTIME_DIR": str(mounted)},
        capture_output=True,
        text=True,
        check=False,
        timeout=DEADLINE,
    )
    if "unshare" in done.stderr or "mount:" in done.stderr:
        pytest.skip("no mounts for this user")
    assert done.returncode != 0
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.process
@pytest.mark.parametrize(
    "more",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"PYTHONOPTIMIZE": "2"},
    ],
)
def test_odd_interpreters(more: dict[str, str], tmp_path: Path) -> None:
    with private_runtime_dir() as runtime_dir:
        environment = {**os.environ, **more, "HAPTIC_RUNTIME_DIR": str(runtime_dir)}
        words = ("launch", "floor_drop", "pace:=lockstep", "duration:=0.2", "--no-plot")
        done = haptic(tmp_path, *words, environment=environment)
        assert "response  p50" in done.stdout
        assert "Traceback" not in done.stderr
        assert (
            "usage: haptic"
            in haptic(tmp_path, "launch", "--help", environment=environment).stdout
        )
        haptic(tmp_path, "study", "kmax", "--gain", "3", environment=environment)


def test_a_place_that_cannot_be_written_to_is_told_before_the_work(
    tmp_path: Path,
) -> None:
    (tmp_path / "notes").write_text("", encoding="utf-8")
    for out in ("notes/deeper", "/proc/nothing"):
        told = typed_in(
            tmp_path, "study", "kmax", "--gain", "1..5", "--out", out, code=2
        )
        assert told.stderr.startswith(f"haptic: {out}: ")
        assert "choose another --out" in told.stderr
        assert told.stdout == ""


def test_a_launch_that_could_not_record_is_refused_before_it_starts(
    tmp_path: Path,
) -> None:
    told = typed_in(Path("/proc"), "launch", "floor_drop", code=2)
    assert told.stderr.startswith(
        "haptic: recordings/{run}.mcap: /proc cannot be written to: "
    )
    assert "choose another --out-dir" in told.stderr
    (tmp_path / "recordings").write_text("", encoding="utf-8")
    told = typed_in(tmp_path, "launch", "floor_drop", code=2)
    assert "recordings is not a directory; choose another --out-dir" in told.stderr


@pytest.mark.process
def test_an_interrupt_while_the_plot_is_drawn_keeps_the_summary(tmp_path: Path) -> None:
    # matplotlib reads this when it is loaded, and waits for whoever writes it: so long is the plot
    # being drawn.
    settings = tmp_path / "matplotlibrc"
    os.mkfifo(settings)
    writers: list[int] = []

    def is_read() -> bool:
        try:
            writers.append(os.open(settings, os.O_WRONLY | os.O_NONBLOCK))
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
        return bool(writers)

    with private_runtime_dir() as runtime_dir:
        process = subprocess.Popen(
            [*HAPTIC, "launch", "floor_drop", "pace:=lockstep", "--json"],
            cwd=tmp_path,
            env={
                **os.environ,
                "HAPTIC_RUNTIME_DIR": str(runtime_dir),
                "MATPLOTLIBRC": str(settings),
            },
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        wait_for(is_read, "the plot")
        process.send_signal(signal.SIGINT)
        # A signal that comes just before the read does not end the read; the end of the file does.
        os.close(*writers)
        out, told = process.communicate(timeout=DEADLINE)
    figures = json.loads(out.splitlines()[-1])
    assert (process.returncode, figures["ticks"], figures["exit_reason"]) == (
        0,
        1500,
        "done",
    )
    assert figures["plot"] is None
    assert "no plot: interrupted; haptic bag plot recordings/" in told
    assert "Traceback" not in told


def catches_interrupts(pid: int) -> bool:
    """Whether a process has installed its SIGINT handler, as an interpreter does at its start."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught.split()[1], 16) & 1 << (signal.SIGINT - 1))


@pytest.mark.process
@pytest.mark.smoke("0.1")
@pytest.mark.parametrize("later", [0.0, 0.05, 0.1, 0.2])
def test_an_interrupt_while_the_command_starts_is_quiet(
    later: float, tmp_path: Path
) -> None:
    with private_runtime_dir() as runtime_dir:
        process = subprocess.Popen(
            [COMMAND, "launch", "floor_drop", "duration:=600"],
            cwd=tmp_path,
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime_dir)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        # The interpreter's own start is not ours to quieten; the command begins by giving up its
        # handler. Looked at without a pause; should a busy machine hide that moment, the signal
        # comes later, and must be met as quietly.
        until = time.monotonic() + 3.0
        while not catches_interrupts(process.pid) and time.monotonic() < until:
            pass
        while catches_interrupts(process.pid) and time.monotonic() < until:
            pass
        # Not a wait for anything: where in its start the signal meets the command is what differs.
        until = time.monotonic() + later
        while time.monotonic() < until:
            pass
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=DEADLINE)
    assert process.returncode in (130, -signal.SIGINT)
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("study", "kmax", "--gain", "3", "--rate", "0.5"),
            "argument --rate: 0.5: must be between 1 and 100000",
        ),
        (
            ("lab", "price", "--mass", "1e7"),
            "argument --mass: 1e7: must be between 1e-06 and 1e+06",
        ),
        (
            ("study", "edge", "--delay", "1e4"),
            "argument --delay: 1e4: must be between 1e-09 and 1000, or 0",
        ),
        (
            ("lab", "coverage", "--seed", "-1"),
            "argument --seed: -1: must be between 0 and 4294967295",
        ),
        (
            ("study", "guard", "--points", "1e3"),
            "argument --points: '1e3' is not a whole number",
        ),
        (
            ("lab", "price", "--frequency", "1e300"),
            "argument --frequency: 1e300: must be between 1e-12 and 1e+12",
        ),
        (
            ("bench", "ros2", "--rounds", "0"),
            "argument --rounds: 0: must be between 1 and 10000",
        ),
        (
            ("bag", "play", "none.mcap", "--rate", "5e-324"),
            "argument --rate/-r: 5e-324: must be between 1e-12 and 1e+12",
        ),
        (
            ("device", "info", "touch_driver", "touch:=1", "touch.library:=a"),
            "touch.library:=a: conflicts with touch:=1",
        ),
    ],
)
def test_numbers_and_words_that_fit_nothing_are_refused(
    words: tuple[str, ...], told: str, tmp_path: Path
) -> None:
    refused = typed_in(tmp_path, *words, code=2).stderr
    assert told in refused
    assert "Traceback" not in refused


@pytest.mark.parametrize(
    "kept", [b'{"identified": ', b'{"identified": {}}', b"[1]", b"\xff"]
)
def test_a_tuning_that_was_cut_is_refused_with_its_file(
    kept: bytes, tmp_path: Path
) -> None:
    (tmp_path / "tuning").mkdir()
    (tmp_path / "tuning" / "tune.json").write_bytes(kept)
    refused = typed_in(tmp_path, "tune", "--steps", "design", code=2).stderr
    assert refused.startswith(
        "haptic: tuning/tune.json: is not what haptic tune wrote ("
    )
