"""Jumps without motion: changed surfaces, re-centred or lost devices, tools inside bodies."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from messages.codec import Decoder
from messages.topics import DEVICE_STATE, FORCE, PROXY, event
from messages.types import DeviceState, Proxy, Vector
from nodes.environment.node import Environment
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import (
    Friction,
    KnownShapes,
    Solid,
    identity_of,
    matched,
    mesh,
    scene_table,
)
from nodes.environment.shapes.touchable import TOOL_RADIUS
from nodes.environment.surfaces import parse_surface
from nodes.environment.touched_surface import TouchedSurface
from nodes.launcher import launch_file
from nodes.recording.reader import Recording
from sim.play.chain import Instead
from sim.play.player import play
from tests.support import slowly
from tests.support.launching import running, typed
from tests.support.setups import setup_of
from tests.support.shapes import box_triangles

FIXTURES = Path(__file__).parents[2] / "fixtures" / "begin"
PERIOD = 0.002
BALL: dict[str, Any] = {"kind": "sphere", "radius": 0.03}


def environment(surface: dict[str, Any], **given: Any) -> Environment:
    node = Environment(
        setup_of(
            name="environment",
            axes=["x", "y", "z"],
            parameters={"surface": surface, **given},
        )
    )
    node.configure()
    return node


def answers(node: Environment, states: list[DeviceState]) -> list[Proxy]:
    """Return the answers to states, as in the node's loop."""
    found = []
    for state in states:
        payload = node.respond(state)
        assert payload is not None
        node.counters.seq = node.counters.answered = state.seq
        found.append(Decoder(Proxy).decode(payload))
    return found


def at(*places: Vector, first: int = 0, rebased: int = 0) -> list[DeviceState]:
    return [
        DeviceState(seq=first + k, stamp=0.0, position=place, rebased=rebased)
        for k, place in enumerate(places)
    ]


@pytest.mark.process
@pytest.mark.parametrize("tick", ["plain", "compiled"])
def test_a_wall_that_is_moved_live_has_the_bits_of_one_process(
    tick: str, tmp_path: Path
) -> None:
    """A hand presses with 2.3 N when it comes 10 mm nearer, which asked for 52 N at once."""
    scene = str(FIXTURES / "press_hold.yaml")
    with running(tmp_path, scene, "pace:=lockstep", f"--tick={tick}") as launch:
        launch.wait_ticks(500)
        told = typed(
            launch, "param", "set", "environment", "surface.position", "0.010"
        ).stdout
        launch.wait_ticks(500)
        launch.interrupt()
    recording = Recording(next(tmp_path.rglob("*.mcap")))
    proxies, forces = recording.messages(PROXY), recording.messages(FORCE)
    jump = max(proxy.rebased for proxy in proxies)
    assert jump > 0
    assert str(jump) in told
    moved = {"kind": "plane", "axis": "x", "position": 0.010, "normal": -1}
    ticks = jump + 300
    played = play(
        launch_file.read(scene, {}),
        ticks=ticks,
        instead=Instead(environment=[(jump, {"surface": moved})]),
    )
    assert [
        state.position for state in recording.messages(DEVICE_STATE)[:ticks]
    ] == list(map(tuple, played.measured.tolist()))
    felt = forces[jump - 1].force[0]
    step = np.abs(np.diff([force.force[0] for force in forces[jump - 1 : ticks]]))
    # 10 N come in 75 ticks; the hand gives way meanwhile, at well under 0.05 m/s.
    assert step.max() < 10.0 / 75.0 + 1000.0 * PERIOD * 0.05 + 8.0 * 0.05
    (reason,) = [
        one.reason
        for one in recording.messages(event("coupling"))
        if one.kind == "eased"
    ]
    assert f"tick {jump}:" in reason
    # 2.3 N were felt, and of the 12.3 N that are asked the driver hands over 7.9 N.
    assert f"a force step of {7.9 + felt:.4g} N, eased over 0.15 s" in reason


@pytest.mark.process
@pytest.mark.parametrize("tick", slowly(["plain", "compiled"], but=["compiled"]))
def test_shapes_that_are_begun_in_and_changed_live_have_the_bits_of_one_process(
    tick: str, tmp_path: Path
) -> None:
    """Out of a small ball, into a large one that grows by 2 mm while pressed."""
    scene = str(FIXTURES / "space.yaml")
    with running(tmp_path, scene, f"--tick={tick}") as launch:
        launch.wait_ticks(500)
        shapes = parsed(scene)["shapes"]
        shapes[1]["radius"] = 0.032
        typed(
            launch, "param", "set", "environment", "surface.shapes", json.dumps(shapes)
        )
        launch.wait_ticks(300)
        launch.interrupt()
    recording = Recording(next(tmp_path.rglob("*.mcap")))
    proxies = recording.messages(PROXY)
    jump = max(proxy.rebased for proxy in proxies)
    ticks = min(jump + 200, len(proxies))
    grown = {"kind": "union", "shapes": shapes}
    played = play(
        launch_file.read(scene, {}),
        ticks=ticks,
        instead=Instead(environment=[(jump, {"surface": grown})]),
    )
    assert [
        state.position for state in recording.messages(DEVICE_STATE)[:ticks]
    ] == list(map(tuple, played.measured.tolist()))
    assert [proxy.proxy for proxy in proxies[:ticks]] == list(
        map(tuple, played.proxy.tolist())
    )
    told = [
        one.reason
        for one in recording.messages(event("environment"))
        if one.kind == "inside"
    ]
    assert len(told) == 3
    assert told[0].startswith("the tool begins inside")
    assert told[1].startswith("the tool has come outside")
    # The grown ball reaches the small one: the tool does not fit between, and one of them is free.
    assert told[2].startswith("the tool begins inside")


def parsed(scene: str) -> dict[str, Any]:
    """Return the surface of a scene's file."""
    surface: dict[str, Any] = copy.deepcopy(
        launch_file.read(scene, {}).nodes["environment"].parameters["surface"]
    )
    return surface


def test_a_jump_is_told_until_the_next_one_and_the_later_one_counts() -> None:
    node = environment({"kind": "plane"}, ease=0.3)
    met = answers(node, at(*3 * [(0.0, 0.0, 0.01)]))
    assert [proxy.rebased for proxy in met] == [0, 0, 0]
    changed = node.store.changed({"surface.position": 0.001})
    told: list[tuple[str, str]] = []

    def emit(kind: str, reason: str, *_: Any, **__: Any) -> None:
        told.append((kind, reason))

    node.events.emit = emit  # type: ignore[method-assign]
    node.prepare(changed)(3)
    node.store.accept(changed)
    assert told == [("surface", "surface.position none → 0.001")]
    met = answers(node, at(*2 * [(0.0, 0.0, 0.01)], first=3))
    assert [(proxy.rebased, proxy.ease) for proxy in met] == [(3, 150), (3, 150)]
    # The driver's own jump, later, is eased as the coupling does.
    met = answers(node, at(*2 * [(0.0, 0.0, 0.02)], first=7, rebased=7))
    assert [(proxy.rebased, proxy.ease) for proxy in met] == [(7, 0), (7, 0)]
    # The same surface again is none.
    node.prepare(node.store.changed({"surface.position": 0.001}))(9)
    assert len(told) == 1
    assert answers(node, at((0.0, 0.0, 0.02), first=9, rebased=7))[0].rebased == 7


def test_a_device_that_is_re_centred_into_a_solid_is_free_of_it() -> None:
    node = environment(BALL)
    free, pressed, jumped, still, out, again = answers(
        node,
        [
            *at((0.0, 0.0, 0.04), (0.0, 0.0, 0.029)),
            *at(
                (0.0, 0.0, 0.02),
                (0.0, 0.0, 0.029),
                (0.0, 0.0, 0.031),
                (0.0, 0.0, 0.029),
                first=2,
                rebased=2,
            ),
        ],
    )
    assert [one.contact for one in (free, pressed, jumped, still, out, again)] == [
        False,
        True,
        False,
        False,
        False,
        True,
    ]
    assert not any(jumped.normal)


def test_a_sample_that_is_lost_for_one_tick_frees_nobody() -> None:
    """The proxy waits: it does not restart free inside the solid, nor behind a thin one."""
    place = TouchedSurface(
        parse_surface({"kind": "box", "size": [0.1, 0.1, 0.002]}, "surface"), PERIOD
    )
    held = [(0.0, 0.0, 0.01), (0.0, 0.0, -0.004)]
    for position in held:
        before = place.meet(position)
    assert before[3]
    assert not place.jumped
    lost = place.meet((5e4, 0.0, 0.0))
    assert place.jumped
    assert not lost[3]
    assert place.meet(held[-1]) == before
    assert place.jumped
    place.meet(held[-1])
    assert not place.jumped


@pytest.mark.parametrize("deep", [0.02, 4e-4])
def test_a_solid_that_grows_carries_its_proxy_and_one_that_comes_does_not(
    deep: float,
) -> None:
    """The pressed ball keeps its proxy; deep inside a new ball the proxy is free."""
    place = TouchedSurface(
        parse_surface({"kind": "union", "shapes": [BALL]}, "surface"), PERIOD
    )
    place.meet((0.0, 0.0, 0.04))
    place.meet((0.0, 0.0, 0.028))
    grown = {**BALL, "radius": 0.03 + deep}
    came = {
        "kind": "box",
        "position": [0.0, 0.0, 0.05 + deep - 0.02],
        "size": [0.1, 0.1, 0.04],
    }
    assert place.take(
        TouchedSurface(
            parse_surface({"kind": "union", "shapes": [grown]}, "surface"), PERIOD
        )
    )
    proxy, _, _, contact = place.meet((0.0, 0.0, 0.028))
    assert contact
    assert proxy[2] == pytest.approx(0.03 + deep + TOOL_RADIUS, abs=1e-9)
    free = TouchedSurface(parse_surface({"kind": "free"}, "surface"), PERIOD)
    other = TouchedSurface(
        parse_surface({"kind": "union", "shapes": [came]}, "surface"), PERIOD
    )
    free.take(other)
    free.meet((0.0, 0.0, 0.05))
    assert free.inside == (1 if deep > 5e-4 else 0)


def union(*shapes: dict[str, Any]) -> TouchedSurface:
    return TouchedSurface(
        parse_surface({"kind": "union", "shapes": list(shapes)}, "surface"), PERIOD
    )


def box(z: float, x: float = 0.0, **given: Any) -> dict[str, Any]:
    return {"kind": "box", "position": [x, 0.0, z], "size": [0.05, 0.05, 0.05], **given}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        pytest.param(
            [box(0.0), box(0.0, 0.2)],
            [box(0.0, 0.2), box(0.02)],
            id="listed the other way round",
        ),
        pytest.param(
            [box(0.0, 0.2), box(0.0)],
            [box(0.02)],
            id="the other one removed, and nothing left to tell",
        ),
        pytest.param(
            [{**BALL, "position": [0.2, 0.0, 0.0]}, box(0.0)],
            [box(0.02)],
            id="another kind removed",
        ),
        pytest.param(
            [box(0.0)],
            [{**BALL, "position": [0.2, 0.0, 0.0]}, box(0.02)],
            id="another kind added before it",
        ),
    ],
)
def test_parts_of_a_union_are_known_wherever_they_stand_in_its_list(
    before: list[dict[str, Any]], after: list[dict[str, Any]]
) -> None:
    """A pressed box moved 20 mm in the same change keeps holding the tool."""
    place = union(*before)
    place.meet((0.0, 0.0, 0.04))
    assert place.meet((0.0, 0.0, 0.024))[3]
    assert place.take(union(*after))
    proxy, _, _, contact = place.meet((0.0, 0.0, 0.024))
    if len(before) > len(after) and before[0]["kind"] == "box":
        # Two boxes were there, and one is: nobody knows which, so nothing pushes.
        assert not contact
        assert place.inside == 1
    else:
        assert contact
        assert proxy[2] == pytest.approx(0.045 + TOOL_RADIUS, abs=1e-9)


def test_a_part_that_is_pressed_and_removed_lets_go_and_the_others_stay() -> None:
    place = union(box(0.0), box(0.0, 0.2))
    place.meet((0.0, 0.0, 0.04))
    assert place.meet((0.0, 0.0, 0.024))[3]
    assert place.take(union(box(0.0, 0.2)))
    assert not place.meet((0.0, 0.0, 0.024))[3]
    assert place.inside == 0


def test_a_mesh_is_known_by_its_triangles() -> None:
    """Two meshes, the pressed one second, the first removed: kinds alone mix them up."""
    cube = box_triangles((0.02, 0.02, 0.02))
    one, two = (mesh(prepare_mesh(cube + at, False, "surface")) for at in (0.0, 0.1))

    def known(*solids: Solid) -> KnownShapes:
        return identity_of(scene_table(solids, 1e-5, PERIOD))

    pair, swapped, second = known(one, two), known(two, one), known(two)
    rubbed = known(two._replace(friction=Friction(0.5)))
    assert matched(pair, swapped) == {0: 1, 1: 0}
    assert matched(pair, second) == {0: 1}
    assert rubbed == second


def test_a_surface_is_taken_without_looking_through_its_triangles() -> None:
    """Comparing a mesh of 20 480 triangles took 50 ms between two ticks."""
    place, other, same = (union(box(0.0)) for _ in range(3))
    for one in (place, other, same):
        assert one.numbers is not None
        one.numbers = one.numbers._replace(table=None)  # type: ignore[arg-type]
    assert not place.take(other)


def test_a_surface_that_is_changed_while_the_device_is_lost_is_met_anew() -> None:
    place = union(BALL)
    place.meet((0.0, 0.0, 0.04))
    place.meet((0.0, 0.0, 0.028))
    place.meet((5e4, 0.0, 0.0))
    assert place.take(union({**BALL, "radius": 0.031}))
    place.meet((5e4, 0.0, 0.0))
    assert not place.jumped
    place.meet((0.0, 0.0, 0.03))
    assert place.jumped


def test_a_driver_that_was_started_again_after_a_jump_is_met_anew() -> None:
    """The restarted driver's jump count begins at 0; an own later jump must still count."""
    node = environment(BALL)
    answers(node, at((0.0, 0.0, 0.04)))
    answers(node, at((0.0, 0.0, 0.029), first=3, rebased=3))
    node.prepare(node.store.changed({"surface.radius": 0.0295}))(5)
    (before,) = answers(node, at((0.0, 0.0, 0.029), first=5, rebased=3))
    (met,) = answers(node, at((0.0, 0.0, 0.02), first=900, rebased=0))
    assert (before.rebased, met.rebased) == (5, 900)
    assert not met.contact


@pytest.mark.parametrize("bodies", ["dynamic", "fixed"])
def test_a_tool_that_begins_inside_of_a_body_is_not_thrown(bodies: str) -> None:
    """MuJoCo threw it 92 mm out of a block; now it is free until it has left."""
    pytest.importorskip("mujoco", reason="things that move need MuJoCo")
    scene = {"scene": str(FIXTURES / "inside.xml"), "bodies": bodies, "reach": 0.08}
    found = play(launch_file.read(str(FIXTURES / "mujoco.yaml"), scene), ticks=1000)
    away = np.linalg.norm(found.proxy - found.position, axis=1)
    # The tool trails the device by what accelerates 50 g, and presses by what the hand's 150 N/m
    # make of some millimetres.
    assert not found.force[:20].any()
    assert away.max() < 0.01
    assert np.abs(np.diff(found.force, axis=0)).max() < 1.0


def test_a_tool_that_is_left_behind_is_put_back_to_the_device() -> None:
    mujoco = pytest.importorskip("mujoco", reason="things that move need MuJoCo")
    del mujoco
    from nodes.environment.bodies.moving_scene import MovingScene

    scene = MovingScene(
        FIXTURES / "inside.xml", "tool", PERIOD, "environment", lost=0.25
    )
    assert scene.follow(0, (0.2, 0.0, 0.0), (0.0, 0.0, 0.0), -1, 0.0, True)
    assert not scene.inside
    scene.data.qvel[:3] = (200.0, 0.0, 0.0)
    assert scene.follow(1, (0.2, 0.0, 0.0), (0.0, 0.0, 0.0), 0, 0.0, False)
    assert scene.tool_position == pytest.approx((0.2, 0.0, 0.0), abs=1e-12)
    assert not scene.data.qvel[:3].any()
    assert not scene.follow(2, (0.2, 0.0, 0.0), (0.0, 0.0, 0.0), 1, 0.0, False)
