"""The live 3D scene in Foxglove's protocol: the shape once per subscriber, then poses."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from sim.measure.haptic_commands import end, start_command
from tests.support.launching import running, wait_for

pytest.importorskip(
    "foxglove",
    reason="the extra is not installed: pip install 'haptic-nodes[foxglove]'",
)


@contextmanager
def shown(folder: Path, scenario: str, **changed: Any) -> Iterator[str]:
    """Launch a scenario with a Foxglove bridge and changed parameters; yield the address."""
    content = {
        "summary": "A scenario that Foxglove sees.",
        "include": [
            {
                "launch": scenario,
                "arguments": {"duration": 0.0},
                "without": ["logger"],
                "parameters": changed,
            }
        ],
        "nodes": {"view": {"kind": "view", "parameters": {"foxglove": 0}}},
    }
    (folder / "shown.yaml").write_text(json.dumps(content), encoding="utf-8")
    with running(folder, "shown.yaml") as launch:
        yield wait_for(
            lambda: launch.errors.partition("ws://")[2].partition("\n")[0].strip(),
            "the port",
        )


@contextmanager
def subscribed(place: str) -> Iterator[tuple[ClientConnection, dict[str, Any]]]:
    """Connect and subscribe to the scene; return its schema."""
    protocol = Subprotocol("foxglove.sdk.v1")
    with connect(
        f"ws://{place}", subprotocols=[protocol], open_timeout=20.0, max_size=None
    ) as client:
        while True:
            found = client.recv(timeout=30.0)
            if (
                isinstance(found, str)
                and (message := json.loads(found))["op"] == "advertise"
            ):
                scenes = [
                    channel
                    for channel in message["channels"]
                    if channel["topic"] == "/scene"
                ]
                if scenes:
                    break
        (channel,) = scenes
        assert (channel["schemaName"], channel["schemaEncoding"]) == (
            "foxglove.SceneUpdate",
            "jsonschema",
        )
        client.send(
            json.dumps(
                {
                    "op": "subscribe",
                    "subscriptions": [{"id": 1, "channelId": channel["id"]}],
                }
            )
        )
        yield client, json.loads(channel["schema"])


def entities(
    client: ClientConnection, schema: dict[str, Any], seconds: float
) -> list[dict[str, Any]]:
    """Return the entities drawn over a duration of the run."""
    # Made once: to check the schema itself takes longer than to check a message by it.
    validator = jsonschema.validators.validator_for(schema)(schema)
    validator.check_schema(schema)
    found: list[dict[str, Any]] = []
    begin = None
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        message = client.recv(timeout=30.0)
        if not isinstance(message, bytes) or message[0] != 1:
            continue
        (stamp,) = struct.unpack_from("<Q", message, 5)
        begin = stamp if begin is None else begin
        update = json.loads(message[13:])
        validator.validate(update)
        found += update["entities"]
        if stamp - begin > seconds * 1e9:
            return found
    raise AssertionError(f"only {len(found)} entities within a minute")


def at(point: dict[str, float]) -> list[float]:
    return [point["x"], point["y"], point["z"]]


@pytest.mark.slow
def test_the_shape_comes_once_to_each_who_subscribes_then_what_moves(
    tmp_path: Path,
) -> None:
    with shown(tmp_path, "sphere_feel") as place:
        for _ in range(2):
            # The second comes while nothing new happens to the shape.
            with subscribed(place) as (client, schema):
                drawn = entities(client, schema, 3.0)
            named = {
                name: [one for one in drawn if one["id"] == name]
                for name in {one["id"] for one in drawn}
            }
            (surface,) = named["environment"]
            points = np.array(
                [at(point) for point in surface["triangles"][0]["points"]]
            )
            assert np.linalg.norm(
                points - [0.05, 0.01, -0.03], axis=1
            ) == pytest.approx(0.035, abs=2e-6)
            for name in ("device", "proxy"):
                # 60 a second; a stall of the machine may swallow half of them.
                assert 90 <= len(named[name]) <= 3.0 * 60 + 2
            places = np.array(
                [at(one["spheres"][0]["pose"]["position"]) for one in named["proxy"]]
            )
            # It went over the sphere, the tool's radius above it, and never into it.
            off = np.linalg.norm(places - [0.05, 0.01, -0.03], axis=1) - 0.036
            assert off.min() == pytest.approx(0.0, abs=1e-8)
            assert np.ptp(places, axis=0).max() > 0.02


@pytest.mark.slow
def test_bodies_move_for_who_heard_the_beginning(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    # It is pushed away once: only when a client has had the time to come.
    hand = {"path": [[4.2, 0.0], [5.2, 0.07], [5.7, 0.07], [6.7, 0.0]], "repeat": 60.0}
    with (
        shown(tmp_path, "puck_push", driver={"device": {"hand": hand}}) as place,
        subscribed(place) as (client, schema),
    ):
        drawn = entities(client, schema, 6.0)
    bodies = [one for one in drawn if one["id"] == "bodies"]
    assert len(bodies) > 90
    pucks = np.array([at(one["cylinders"][0]["pose"]["position"]) for one in bodies])
    assert np.ptp(pucks, axis=0).max() > 1e-3
    assert not [one for one in drawn if one["id"] == "left out"]


@pytest.mark.slow
def test_who_comes_late_is_told_that_bodies_are_not_drawn(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    with running(tmp_path, "puck_push", "duration:=0", "--without", "logger") as launch:
        launch.wait_ticks(200)
        told = tmp_path / "view.txt"
        with told.open("wb") as file:
            view = start_command(
                "view",
                "--json",
                "--foxglove",
                "0",
                cwd=tmp_path,
                env=launch.environment,
                stdout=file,
                stderr=file,
            )
        try:
            place = wait_for(
                lambda: (
                    told.read_text(encoding="utf-8")
                    .partition("ws://")[2]
                    .partition("\n")[0]
                ),
                "the port",
            )
            with subscribed(place.strip()) as (client, schema):
                drawn = entities(client, schema, 1.0)
        finally:
            end(view)
    assert not [one for one in drawn if one["id"] == "bodies"]
    left_out = next(one for one in drawn if one["id"] == "left out")
    assert "known only to a view started with the run" in left_out["texts"][0]["text"]
    assert [one for one in drawn if one["id"] == "proxy"]
