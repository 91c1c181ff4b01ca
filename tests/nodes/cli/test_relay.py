"""``haptic relay`` as PlotJuggler sees it: one SUB socket, topic and MessagePack."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.cli import main
from tests.support.launching import HAPTIC, Running, private_runtime_dir, running, typed


@contextlib.contextmanager
def plotjuggler(endpoint: str) -> Iterator[zmq.Socket[bytes]]:
    """Return a SUB socket connected as PlotJuggler's plug-in does, subscribed to everything."""
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.connect(endpoint)
        socket.subscribe("")
        socket.rcvtimeo = 30_000
        yield socket


@contextlib.contextmanager
def relaying(
    environment: Mapping[str, str], *words: str
) -> Iterator[subprocess.Popen[str]]:
    """Run a relay beside the block, and end it in any case."""
    with subprocess.Popen(
        [*HAPTIC, "relay", *words, "--json"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def end(process: subprocess.Popen[str]) -> Any:
    """End a relay as Ctrl-C does; return its answer."""
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30.0)
    assert process.returncode == 0
    return json.loads(out.splitlines()[-1])


Series = dict[str, list[tuple[float, float]]]


def take(socket: zmq.Socket[bytes], series: Series) -> str:
    """Parse one message as PlotJuggler 3.10, protocol msgpack, with ``stamp`` as timestamp.

    From its source (DataStreamZMQ, nlohmann_parsers): the first of several frames is the topic, the
    second the payload, a third would be the time. Maps and arrays become series named by their
    path; numbers and booleans are values, texts are ignored.
    """
    frames = socket.recv_multipart()
    assert len(frames) == 2
    topic, message = frames[0].decode(), msgpack.unpackb(frames[1])
    assert isinstance(message["stamp"], float)

    def flatten(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                flatten(f"{name}/{key}", inner)
        elif isinstance(value, list):
            for number, inner in enumerate(value):
                flatten(f"{name}[{number}]", inner)
        elif isinstance(value, int | float):
            series.setdefault(name, []).append((message["stamp"], float(value)))

    flatten(topic, message)
    return topic


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(
        tmp_path_factory.mktemp("launch"), "floor_drop", "duration:=0"
    ) as found:
        yield found


@pytest.mark.process
def test_plotjuggler_sees_every_topic_at_one_address(
    launch: Running, tmp_path: Path
) -> None:
    # A port of its own would be taken from other tests; what PlotJuggler does with it is the same.
    endpoint = f"ipc://{tmp_path}/r"
    series: Series = {}
    seen: set[str] = set()
    with (
        relaying(launch.environment, endpoint) as relay,
        plotjuggler(endpoint) as socket,
    ):
        while not {DEVICE_STATE, PROXY, FORCE, "/driver/status"} <= seen:
            seen.add(take(socket, series))
        answered = end(relay)
    assert answered["runs"] == [launch.run.run]
    assert answered["relayed"][DEVICE_STATE] > 0
    heights = series[f"{DEVICE_STATE}/position[2]"]
    stamps = [stamp for stamp, _ in heights]
    assert stamps == sorted(stamps)
    # Its workspace ends at -0.2 m: a machine that stalls lets it sink in.
    assert all(-0.2 <= height <= 0.01 for _, height in heights)
    assert f"{PROXY}/contact" in series


@pytest.mark.slow
def test_the_address_stays_from_launch_to_launch(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/r"
    with private_runtime_dir() as runtime:
        environment = {**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime)}
        with (
            relaying(environment, endpoint, "--topics", FORCE) as relay,
            plotjuggler(endpoint) as socket,
        ):
            for _ in range(2):
                subprocess.run(
                    [
                        *HAPTIC,
                        "launch",
                        "floor_drop",
                        "duration:=1",
                        "--without",
                        "logger",
                        "--no-plot",
                    ],
                    cwd=tmp_path,
                    env=environment,
                    capture_output=True,
                    check=True,
                    timeout=60,
                )
                assert take(socket, {}) == FORCE
            answered = end(relay)
    assert len(answered["runs"]) == 2
    assert set(answered["relayed"]) == {FORCE}


@pytest.mark.process
def test_what_is_refused(launch: Running, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["relay", "tcp://0.0.0.0:9872"]) == 2
    assert "a relay serves this machine only" in capsys.readouterr().err
    done = typed(
        launch,
        "relay",
        f"ipc://{launch.folder}/q",
        "--once",
        "--topics",
        "/device/stat",
        code=2,
    )
    assert "did you mean /device/state?" in done.stderr
