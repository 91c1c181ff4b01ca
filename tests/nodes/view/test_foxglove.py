"""Foxglove's protocol by hand: topics with schemas, 60 Hz each, read-only parameters."""

from __future__ import annotations

import json
import struct
import subprocess
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from messages.topics import DEVICE_STATE, FORCE, PROXY
from tests.support.launching import HAPTIC, haptic, running, wait_for
from tests.support.schemas import validate

pytest.importorskip(
    "foxglove",
    reason="the extra is not installed: pip install 'haptic-nodes[foxglove]'",
)


@pytest.mark.slow
def test_topics_and_parameters_live(tmp_path: Path) -> None:
    with running(tmp_path, "touch_wall", "rate:=1000", "--without", "logger") as launch:
        errors = tmp_path / "view.txt"
        with open(errors, "wb") as file:
            view = subprocess.Popen(
                [*HAPTIC, "view", "--json", "--foxglove", "0"],
                cwd=tmp_path,
                env=launch.environment,
                stdout=subprocess.DEVNULL,
                stderr=file,
            )
        try:
            place = wait_for(
                lambda: (
                    errors.read_text(encoding="utf-8").partition("ws://")[2].strip()
                ),
                "the port",
            )
            protocol = Subprotocol("foxglove.sdk.v1")
            with connect(
                f"ws://{place}", subprotocols=[protocol], open_timeout=20.0
            ) as client:
                _talk(client, launch)
        finally:
            view.terminate()
            assert view.wait(30.0) == 0


def _talk(client: Any, launch: Any) -> None:
    channels: dict[str, dict[str, Any]] = {}

    def next_text(op: str, deadline: float = 30.0) -> dict[str, Any]:
        until = time.monotonic() + deadline
        while time.monotonic() < until:
            found = client.recv(timeout=deadline)
            if isinstance(found, str):
                message: dict[str, Any] = json.loads(found)
                if message["op"] == "advertise":
                    channels.update(
                        {channel["topic"]: channel for channel in message["channels"]}
                    )
                if message["op"] == op:
                    return message
        raise AssertionError(f"no {op} within {deadline} s")

    while not {DEVICE_STATE, PROXY, FORCE} <= set(channels):
        next_text("advertise")
    ids = {channel["id"]: topic for topic, channel in channels.items()}
    loop = [DEVICE_STATE, PROXY, FORCE]
    subscriptions = [
        {"id": i, "channelId": channels[topic]["id"]} for i, topic in enumerate(loop)
    ]
    assert len(ids) == len(channels)
    client.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
    counts: Counter[str] = Counter()
    times: dict[str, list[int]] = {topic: [] for topic in loop}
    while min(counts[topic] for topic in loop) < 60:
        found = client.recv(timeout=30.0)
        if isinstance(found, bytes) and found[0] == 1:
            number, stamp = struct.unpack_from("<IQ", found, 1)
            topic = loop[number]
            validate(json.loads(found[13:]), json.loads(channels[topic]["schema"]))
            times[topic].append(stamp)
            counts[topic] += 1
    for topic, stamps in times.items():
        # 1000 a second come in; 60 a second go out at most, one drain more or less at the ends.
        assert (len(stamps) - 2) / ((stamps[-1] - stamps[0]) * 1e-9) <= 60.0 * 1.02, (
            topic
        )
    name = "coupling.laws.pd.stiffness"
    client.send(
        json.dumps({"op": "getParameters", "parameterNames": [name], "id": "get"})
    )
    answer = next_text("parameterValues")
    while answer.get("id") != "get":
        answer = next_text("parameterValues")
    assert [(one["name"], one["value"]) for one in answer["parameters"]] == [
        (name, 1000.0)
    ]
    client.send(
        json.dumps(
            {
                "op": "setParameters",
                "parameters": [{"name": name, "value": 1100.5}],
                "id": "set",
            }
        )
    )
    # Any page of a browser here could have asked for that.
    refused = next_text("status")
    assert name in refused["message"]
    assert "haptic param set" in refused["message"]
    assert launch.call("coupling", "param.get", name="laws.pd.stiffness") == 1000.0


@pytest.mark.process
def test_without_the_extra_it_says_how_to_get_it(tmp_path: Path) -> None:
    """Tested with an interpreter in which foxglove cannot be imported."""
    (tmp_path / "foxglove.py").write_text(
        "raise ImportError('No module named foxglove')", encoding="utf-8"
    )
    (tmp_path / "open.yaml").write_text(
        "summary: s\nnodes: {view: {kind: view, parameters: {foxglove: 0}}}\n",
        encoding="utf-8",
    )
    import os

    told = haptic(
        tmp_path,
        "launch",
        "open.yaml",
        code=2,
        environment={**os.environ, "PYTHONPATH": str(tmp_path)},
    ).stderr
    assert "pip install 'haptic-nodes[foxglove]'" in told
