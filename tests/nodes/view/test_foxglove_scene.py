"""A recording for Foxglove: its scene read back by the MCAP library."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import validate
from mcap.reader import make_reader

from nodes.cli.main import main
from nodes.recording.reader import Recording
from nodes.recording.table import read
from nodes.view.foxglove_scene import PER_NEWTON, RATE_LIMIT
from tests.support.launching import launch_json

Update = tuple[int, dict[str, Any]]


def exported(folder: Path, scenario: str, *words: str) -> tuple[Path, Path]:
    """Launch a scenario, and export its recording."""
    recording = folder / str(
        launch_json(folder, scenario, *words, "pace:=lockstep")["recording"]
    )
    assert main(["bag", "export", str(recording), "--format", "foxglove"]) == 0
    return recording, recording.with_suffix(".foxglove.mcap")


def scene_of(file: Path) -> tuple[dict[str, Any], list[Update]]:
    """Return schema and updates of the scene."""
    with file.open("rb") as stream:
        found = [
            (schema, channel, message)
            for schema, channel, message in make_reader(stream).iter_messages(
                topics=["/scene"]
            )
        ]
    schema, channel, _ = found[0]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "foxglove.SceneUpdate",
        "jsonschema",
        "json",
    )
    return json.loads(schema.data), [
        (message.publish_time, json.loads(message.data)) for _, _, message in found
    ]


def entities(updates: list[Update], name: str) -> list[dict[str, Any]]:
    return [
        entity
        for _, update in updates
        for entity in update["entities"]
        if entity["id"] == name
    ]


def at(point: dict[str, float]) -> list[float]:
    return [point["x"], point["y"], point["z"]]


def stamp(entity: dict[str, Any]) -> int:
    return int(entity["timestamp"]["sec"]) * 10**9 + int(entity["timestamp"]["nsec"])


def places(updates: list[Update], name: str, kind: str) -> dict[int, list[float]]:
    """Return by time [ns] the position of an entity's first primitive of a kind [m]."""
    return {
        stamp(e): at(e[kind][0]["pose"]["position"]) for e in entities(updates, name)
    }


@pytest.fixture(scope="module")
def sphere(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return exported(tmp_path_factory.mktemp("sphere"), "sphere_feel", "duration:=1.0")


@pytest.mark.slow
def test_the_shape_comes_once_and_what_moves_as_it_does(
    sphere: tuple[Path, Path],
) -> None:
    recording, file = sphere
    schema, updates = scene_of(file)
    for _, update in updates:
        validate(update, schema)
    (surface,) = entities(updates, "environment")
    (triangles,) = surface["triangles"]
    points = np.array([at(point) for point in triangles["points"]])
    faces = np.array(triangles["indices"]).reshape(-1, 3)
    assert set(faces.ravel()) == set(range(len(points)))
    # On the sphere of the launch file; written in micrometres.
    assert np.linalg.norm(points - [0.05, 0.01, -0.03], axis=1) == pytest.approx(
        0.035, abs=2e-6
    )
    assert updates[0][1]["entities"][0] == surface
    table = read(recording)
    begin = updates[0][0]
    for name in ("proxy", "position"):
        found = entities(updates, "device" if name == "position" else name)
        # The first tick's and then 60 a second.
        assert 0.8 * RATE_LIMIT <= len(found) <= RATE_LIMIT + 1
        for entity in found:
            tick = round((stamp(entity) - begin) * 1e-9 * 500.0)
            if tick < len(table[name]):
                assert (
                    at(entity["spheres"][0]["pose"]["position"])
                    == table[name][tick].tolist()
                )
    assert entities(updates, "proxy")[0]["spheres"][0]["size"] == {
        "x": 0.002,
        "y": 0.002,
        "z": 0.002,
    }
    for entity in (e for _, update in updates for e in update["entities"]):
        assert stamp(entity) in {time for time, _ in updates}


@pytest.mark.process
def test_the_force_is_drawn_from_the_device(sphere: tuple[Path, Path]) -> None:
    recording, file = sphere
    lines = [
        entity["lines"][0]["points"] for entity in entities(scene_of(file)[1], "force")
    ]
    drawn = (
        np.array([np.subtract(at(end), at(begin)) for begin, end in lines]) / PER_NEWTON
    )
    assert np.abs(drawn).max() > 0.1
    # Nobody answered the last tick.
    given = read(recording)["force"][:-1]
    # A difference of positions of some centimetres.
    assert all(np.abs(given - force).sum(axis=1).min() < 1e-12 for force in drawn)


@pytest.mark.process
def test_everything_that_was_recorded_is_still_there(sphere: tuple[Path, Path]) -> None:
    recording, file = sphere
    with file.open("rb") as stream, recording.open("rb") as original:
        found = [
            message.data
            for _, channel, message in make_reader(stream).iter_messages()
            if channel.topic != "/scene"
        ]
        assert sorted(found) == sorted(
            message.data for _, _, message in make_reader(original).iter_messages()
        )
    assert main(["bag", "export", str(recording), "--format", "foxglove"]) != 0
    assert (
        main(
            [
                "bag",
                "export",
                str(recording),
                "--format",
                "foxglove",
                "--out",
                str(recording),
                "--force",
            ]
        )
        != 0
    )
    assert Recording(recording).topics


@pytest.mark.slow
def test_bodies_move_as_they_did(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    _, file = exported(tmp_path, "puck_push", "duration:=1.4")
    _, updates = scene_of(file)
    bodies = entities(updates, "bodies")
    tips, proxies = (
        places(updates, "bodies", "spheres"),
        places(updates, "proxy", "spheres"),
    )
    # The tool in the scene that was stepped again is the proxy that was recorded, to the bit.
    assert len(set(tips) & set(proxies)) > 0.9 * len(tips)
    assert all(tips[time] == proxies[time] for time in set(tips) & set(proxies))
    pucks = list(places(updates, "bodies", "cylinders").values())
    assert np.linalg.norm(np.subtract(pucks[-1], pucks[0])) > 1e-3
    assert bodies[0]["cubes"][0]["size"] == {"x": 0.6, "y": 0.6, "z": 1e-4}


@pytest.mark.slow
def test_what_cannot_be_drawn_is_said(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    scene = tmp_path / "puck.xml"
    from nodes.launcher import launch_file

    launch = launch_file.read("puck_push", {})
    scene.write_text(Path(launch.nodes["environment"].parameters["scene"]).read_text())
    given = tmp_path / "given.yaml"
    given.write_text(f"environment: {{scene: {scene}}}")
    figures = launch_json(
        tmp_path, "puck_push", "duration:=0.2", "pace:=lockstep", "--params", str(given)
    )
    scene.unlink()
    recording = tmp_path / figures["recording"]
    assert main(["bag", "export", str(recording), "--format", "foxglove"]) == 0
    _, updates = scene_of(recording.with_suffix(".foxglove.mcap"))
    (told,) = entities(updates, "left out")
    assert "puck.xml" in told["texts"][0]["text"]
    assert not entities(updates, "bodies")
    assert entities(updates, "proxy")
