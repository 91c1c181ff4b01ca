"""``haptic topic`` and ``haptic bag record`` beside a real running launch."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import statistics
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from messages.codec import encode
from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT
from messages.types import Force
from nodes.cli import main
from nodes.cli.topic import Spread
from nodes.launcher.runs import RunInfo, new_run_dir, write_run
from nodes.recording.reader import Recording
from sim.measure.rig import full_pipe
from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    Running,
    private_runtime_dir,
    running,
    typed,
    wait_for,
)
from tests.support.setups import setup_of

RATE = 250.0
SLACK = 0.5
"""Time that a process may wait on a loaded machine before its next flush [s]."""


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(
        tmp_path_factory.mktemp("launch"),
        "floor_drop",
        "duration:=0",
        f"rate:={RATE:g}",
    ) as found:
        yield found


def told(launch: Running, *words: str, code: int = 0) -> Any:
    return json.loads(
        typed(launch, *words, "--json", code=code).stdout.splitlines()[-1]
    )


# -- list, info, echo
# ------------------------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.smoke
def test_list(launch: Running) -> None:
    found = told(launch, "topic", "list")
    assert found["run"] == launch.run.run
    loop = {
        DEVICE_STATE: "driver",
        PROXY: "environment",
        FORCE: "coupling",
        RECEIPT: "coupling",
    }
    nodes = ("driver", "environment", "coupling", "logger")
    expected = loop | {
        f"/{node}/{kind}": node for node in nodes for kind in ("status", "event")
    }
    assert {
        topic: entry["node"] for topic, entry in found["topics"].items()
    } == expected
    assert found["topics"][DEVICE_STATE]["type"] == "DeviceState"
    text = typed(launch, "topic", "list").stdout
    assert [line.split()[0] for line in text.splitlines()] == list(found["topics"])


@pytest.mark.process
@pytest.mark.smoke
def test_info(launch: Running) -> None:
    found = told(launch, "topic", "info", FORCE)
    assert (found["type"], found["node"], found["per_tick"]) == (
        "Force",
        "coupling",
        True,
    )
    assert found["endpoint"] == launch.run.nodes["coupling"].listen
    assert "[N]" in found["schema"]["properties"]["force"]["description"]
    assert "published by coupling" in typed(launch, "topic", "info", FORCE).stdout


@pytest.mark.process
@pytest.mark.smoke
def test_echo(launch: Running) -> None:
    lines = typed(
        launch, "topic", "echo", DEVICE_STATE, "-n", "5", "--json"
    ).stdout.splitlines()
    states = [json.loads(line) for line in lines]
    seqs = [state["seq"] for state in states]
    assert seqs == sorted(set(seqs))
    assert len(seqs) == 5
    text = typed(launch, "topic", "echo", DEVICE_STATE, "-n", "1").stdout.splitlines()
    assert text[-1] == "---"
    assert [line.split(":")[0] for line in text[:-1]] == list(states[0])
    words = ("topic", "echo", DEVICE_STATE, "-n", "1", "--field", "position[2]")
    # Between where the drop began and the deepest a spring of 1000 N/m lets it; while the other
    # nodes are kept from a busy machine's processors it falls through, and comes back.
    wait_for(
        lambda: -0.01 < float(typed(launch, *words).stdout) <= 0.01,
        "the floor holds it",
    )
    done = typed(
        launch, "topic", "echo", DEVICE_STATE, "-n", "1", "--field", "speed", code=2
    )
    assert "--field speed: no such field; there are seq, stamp, position" in done.stderr


# -- hz, bw, delay
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_hz(launch: Running) -> None:
    found = told(launch, "topic", "hz", DEVICE_STATE, "-n", "250")
    assert found["topic"] == DEVICE_STATE
    assert (found["messages"], found["refused"]) == (250, 0)
    spread = found["interval_s"]
    assert spread["min"] <= spread["mean"] <= spread["max"]
    # 249 intervals between the first and the last receipt, by definition of both.
    assert spread["mean"] * found["rate_hz"] == pytest.approx(1.0, rel=1e-9)
    # One second of ticks, each end of which a loaded machine may delay by some hundredths.
    assert found["rate_hz"] == pytest.approx(RATE, rel=0.15)


@pytest.mark.process
def test_bw(launch: Running) -> None:
    found = told(launch, "topic", "bw", FORCE, "-n", "50")
    size = found["size_bytes"]
    assert found["bandwidth_bytes_per_s"] == pytest.approx(
        found["rate_hz"] * size["mean"], rel=1e-12
    )
    # seq and revision are the only numbers of the message that MessagePack shortens, to 1 byte from
    # at most 9.
    whole = encode(Force(seq=0, stamp=1.5, force=(0.5, 0.5, 0.5), law="pd", revision=0))
    assert (
        len(FORCE) + len(whole)
        <= size["min"]
        <= size["max"]
        <= len(FORCE) + len(whole) + 16
    )


@pytest.mark.process
def test_delay(launch: Running) -> None:
    found = told(launch, "topic", "delay", DEVICE_STATE, "-n", "100")
    delay = found["delay_s"]
    # One clock for all processes of a host: nothing arrives before it was sent.
    assert 0.0 < delay["min"] <= delay["p50"] <= delay["p99"] <= delay["max"]
    assert delay["min"] <= delay["mean"] <= delay["max"]


@pytest.mark.process
def test_duration_ends_the_listening(launch: Running) -> None:
    found = told(launch, "topic", "hz", DEVICE_STATE, "--duration", "0.4")
    # At most the ticks of that time, and the one at its end.
    assert 1 <= found["messages"] <= 0.4 * RATE + 1


@pytest.mark.process
def test_a_silent_topic_is_told_by_the_exit_code(launch: Running) -> None:
    assert (
        told(launch, "topic", "hz", RECEIPT, "--duration", "0.2", code=1)["messages"]
        == 0
    )
    assert (
        typed(launch, "topic", "echo", RECEIPT, "--duration", "0.2", code=1).stdout
        == ""
    )


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_prints_the_figures_so_far(launch: Running, number: int) -> None:
    with subprocess.Popen(
        [*HAPTIC, "topic", "hz", DEVICE_STATE],
        env=launch.environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        process.send_signal(number)
        rest = process.stdout.read().splitlines()
    assert process.returncode == 0
    assert first.startswith("average rate: ")
    assert rest[-1].startswith("average rate: ")


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize("verb", ["info", "echo", "hz", "bw", "delay"])
def test_unknown_topics(launch: Running, verb: str) -> None:
    done = typed(launch, "topic", verb, "/device/stat", code=2)
    assert "no topic '/device/stat'; did you mean /device/state?" in done.stderr
    assert (
        "there are /device/state, "
        in typed(launch, "topic", verb, "zzz", code=2).stderr
    )


def test_no_launch_no_topics(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with private_runtime_dir() as runtime_dir:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(runtime_dir))
        assert main.main(["topic", "list"]) == 2
    assert "nothing is running" in capsys.readouterr().err


def test_lockstep_has_no_delay(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with private_runtime_dir() as runtime_dir:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(runtime_dir))
        path = new_run_dir("quick")
        driver = setup_of(
            run="quick",
            run_dir=str(path),
            factory="sim.device.driver:SimDriver",
            pace="lockstep",
            publish=f"ipc://{path}/driver.pub",
            control=f"ipc://{path}/driver.ctl",
        )
        write_run(
            path,
            RunInfo(
                run="quick",
                scenario="quick",
                launcher=os.getpid(),
                nodes={"driver": driver},
            ),
        )
        assert main.main(["topic", "delay", DEVICE_STATE]) == 2
    assert "in lockstep stamps are simulated time" in capsys.readouterr().err


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50))
def test_spread_is_that_of_the_statistics_module(values: list[float]) -> None:
    spread = Spread()
    for value in values:
        spread.add(value)
    # Welford's recurrence is stable: some tens of roundings of the largest value, squared for the
    # variance.
    largest = max(map(abs, values))
    assert spread.count == len(values)
    assert (spread.low, spread.high) == (min(values), max(values))
    assert spread.mean == pytest.approx(
        statistics.fmean(values), abs=1e-14 * len(values) * largest
    )
    assert spread.deviation**2 == pytest.approx(
        statistics.pvariance(values), abs=1e-14 * len(values) * largest**2
    )


# -- bag record
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_record_for_a_while(launch: Running) -> None:
    path = launch.folder / "while.mcap"
    found = told(launch, "bag", "record", "--duration", "1", "--out", str(path))
    recording = Recording(path)
    assert found == {
        "recording": str(path),
        "messages": sum(topic.messages for topic in recording.topics.values()),
    }
    assert recording.complete
    assert recording.manifest["run"] == launch.run.run
    # It came late, and from then on has everything.
    assert recording.topics[DEVICE_STATE].first_seq > 0
    assert {DEVICE_STATE, PROXY, FORCE, "/driver/status"} <= set(recording.topics)
    assert (
        "already exists"
        in typed(launch, "bag", "record", "--out", str(path), code=2).stderr
    )
    told(
        launch,
        "bag",
        "record",
        FORCE,
        "--duration",
        "0.3",
        "--out",
        str(path),
        "--force",
    )
    assert list(Recording(path).topics) == [FORCE]


@pytest.mark.process
def test_the_duration_begins_with_the_first_message(tmp_path: Path) -> None:
    """If connecting took longer than the duration, nothing was recorded."""
    path = tmp_path / "late.mcap"
    with running(
        tmp_path, "floor_drop", "duration:=0", "--without", "logger"
    ) as launch:
        launch.wait_ticks(10)
        nodes = [launch.pid(name) for name in ("driver", "environment", "coupling")]
        for pid in nodes:
            os.kill(pid, signal.SIGSTOP)
        with subprocess.Popen(
            [*HAPTIC, "bag", "record", "--duration", "0.3", "--out", str(path)],
            env=launch.environment,
        ) as process:
            wait_for(path.exists, "the recorder listens")
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(0.6)
            for pid in nodes:
                os.kill(pid, signal.SIGCONT)
            assert process.wait(DEADLINE) == 0
    assert Recording(path).topics[DEVICE_STATE].messages


@contextlib.contextmanager
def recording_into(launch: Running, path: Path) -> Iterator[subprocess.Popen[str]]:
    """Record until the block ends; it begins after the first flush."""
    with subprocess.Popen(
        [*HAPTIC, "bag", "record", "--out", str(path), "--json"],
        env=launch.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            wait_for(
                lambda: path.exists() and path.stat().st_size and ticks_in(path),
                "the first flush",
            )
            yield process
        finally:
            process.kill()


def ticks_in(path: Path) -> int:
    recording = Recording(path)
    return (
        recording.topics[DEVICE_STATE].messages
        if DEVICE_STATE in recording.topics
        else 0
    )


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_record_until_a_signal(launch: Running, number: int) -> None:
    path = launch.folder / f"signal{number}.mcap"
    with recording_into(launch, path) as process:
        process.send_signal(number)
        out, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    recording = Recording(path)
    assert recording.complete
    assert json.loads(out)["messages"] == sum(
        topic.messages for topic in recording.topics.values()
    )


@pytest.mark.process
def test_who_ends_a_recorder_that_only_begins_gets_a_complete_recording(
    launch: Running,
) -> None:
    """Once it announces Ctrl-C, it obeys. Its output pipe is full here, so it blocks there."""
    path = launch.folder / "begun.mcap"
    reading, writing = full_pipe()
    words = [*HAPTIC, "bag", "record", "--out", str(path), "--json"]
    with subprocess.Popen(
        words, env=launch.environment, stdout=subprocess.PIPE, stderr=writing, text=True
    ) as process:
        try:
            os.close(writing)
            wait_for(
                lambda: "pipe_write" in Path(f"/proc/{process.pid}/wchan").read_text(),
                "the first line",
            )
            process.send_signal(signal.SIGINT)
            # Until it has room.
            threading.Thread(
                target=lambda: [
                    None for _ in iter(lambda: os.read(reading, 65536), b"")
                ]
            ).start()
            out, _ = process.communicate(timeout=30)
        finally:
            process.kill()
    assert process.returncode == 0
    assert Recording(path).complete
    assert json.loads(out)["messages"] == sum(
        topic.messages for topic in Recording(path).topics.values()
    )


@pytest.mark.process
def test_a_killed_recorder_loses_at_most_half_a_second(launch: Running) -> None:
    path = launch.folder / "killed.mcap"
    with recording_into(launch, path) as process:
        seen = ticks_in(path)
        wait_for(lambda: ticks_in(path) > seen, "another flush")
        process.kill()
        ended = time.monotonic()
    cut = Recording(path)
    assert not cut.complete
    assert ended - (cut.first_log + cut.wall_duration) < 0.5 + SLACK
    saved = told(launch, "bag", "recover", str(path))
    assert saved["recovered"] is True
    whole = Recording(saved["out"])
    assert whole.complete
    assert {
        topic: figures.messages for topic, figures in whole.topics.items()
    } == saved["messages"]
    assert saved["messages"][DEVICE_STATE] == cut.topics[DEVICE_STATE].messages


@pytest.mark.process
def test_a_full_disk_ends_the_logger_and_not_the_loop(tmp_path: Path) -> None:
    mount = [
        "unshare",
        "--mount",
        "sh",
        "-c",
        'mount -t tmpfs -o size=64k tmpfs "$0" && exec "$@"',
        str(tmp_path),
    ]
    if (
        subprocess.run([*mount, "true"], capture_output=True, check=False).returncode
        != 0
    ):
        pytest.skip("mounting a small tmpfs in a private namespace needs root")
    script = """
        cd "$0"
        "$@" launch floor_drop pace:=lockstep duration:=6 --no-plot --json | tail -1
        "$@" bag info --json recordings/*.mcap | tail -1
    """
    with private_runtime_dir() as runtime_dir:
        done = subprocess.run(
            [*mount, "sh", "-c", script, str(tmp_path), *HAPTIC],
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime_dir)},
            capture_output=True,
            text=True,
            check=False,
        )
    assert "Traceback" not in done.stderr
    assert re.search(
        r"\[logger\] recording: .*: No space left on device after \d+ bytes",
        done.stderr,
    )
    figures, info = map(json.loads, done.stdout.splitlines())
    assert figures["ticks"] == 3000
    assert info["recovered"] is True
    assert 0 < info["topics"][DEVICE_STATE]["messages"] < 3000
    assert info["topics"][DEVICE_STATE]["gaps"] == 0
