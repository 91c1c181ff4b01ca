"""Shapes that move: the proxy is carried, pushed, pinched; their power is bounded."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.environment.shapes.tables import ENERGY, INSIDE, MOST_POWER, ROWS, SHIFT
from nodes.environment.state import JUMPED
from nodes.environment.surfaces import parse_surface
from nodes.environment.touched_surface import TouchedSurface
from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError
from sim.play.player import play
from tests.support.shapes import box_triangles
from tests.support.touched import T, Touched

SPEED = 0.1


def along(path: list[list[float]], **more: Any) -> dict[str, Any]:
    return {"path": path, "speed": 1.0, "power": 100.0, **more}


def tile(motion: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """Return a box whose top is the plane z = 0."""
    still = {
        "kind": "box",
        "position": [0.0, 0.0, -0.05],
        "size": [0.2, 0.2, 0.1],
        **more,
    }
    return still if motion is None else {**still, "motion": motion}


def test_a_rough_shape_carries_a_proxy_that_sticks_and_a_smooth_one_does_not() -> None:
    path = [[0.0, 0.0, 0.0, 0.0], [1.0, SPEED, 0.0, 0.0]]
    for friction, share in ((2.0, 1.0), (0.0, 0.0)):
        felt = Touched(tile(along(path), friction={"static": friction}))
        felt.at((0.0, 0.0, 0.001))
        for k in range(1, 16):
            deflection, _ = felt.at((0.0, 0.0, -0.001))
            # It sticks as long as the deflection stays within the cone of 2 mm.
            at = share * SPEED * T * k
            assert deflection[0] == pytest.approx(
                at - share * SPEED * T, abs=SPEED * T + 1e-12
            )
            assert deflection[2] == pytest.approx(0.001, abs=1e-9 + 1e-5)


@pytest.mark.parametrize("kind", ["sphere", "box", "mesh"])
def test_a_shape_that_comes_over_a_free_device_pushes_it(
    kind: str, tmp_path: Any
) -> None:
    """A piston from below: the proxy stays on its top, whatever it is made of; nothing jumps."""
    path = [[0.0, 0.0, 0.0, -0.01], [0.5, 0.0, 0.0, 0.01], [1.0, 0.0, 0.0, -0.01]]
    shape = tile(along(path))
    if kind == "sphere":
        shape = {
            "kind": "sphere",
            "position": [0, 0, -0.05],
            "radius": 0.05,
            "motion": along(path),
        }
    if kind == "mesh":
        triangles = box_triangles((0.2, 0.2, 0.1))
        lines = [
            f"v {x!r} {y!r} {z!r}" for x, y, z in triangles.reshape(-1, 3).tolist()
        ]
        lines += [
            f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles))
        ]
        (tmp_path / "box.obj").write_text("\n".join(lines), encoding="ascii")
        low = -0.05 - float(triangles[..., 2].max() + triangles[..., 2].min()) / 2.0
        shape = {
            "kind": "mesh",
            "file": str(tmp_path / "box.obj"),
            "motion": along(path),
        }
        shape["position"] = [0.0, 0.0, low]
    felt = Touched({**shape, "tool_radius": 0.0})
    tops = np.interp(
        np.arange(1000) * T, [row[0] for row in path], [row[3] for row in path]
    )
    for top in tops:
        deflection, is_felt = felt.at((0.0, 0.0, 0.0))
        assert is_felt == (top > 0.0) or abs(top) < 1e-9
        # Corners in a file, and the skin of 0.1 nm.
        assert deflection == pytest.approx([0.0, 0.0, max(top, 0.0)], abs=3e-10)
        assert felt.met[JUMPED] == 0.0
    assert felt.numbers.memory[INSIDE] == 0.0


def test_a_pinched_proxy_is_free_until_it_is_outside() -> None:
    """A piston pushes the device against a fixed wall: then one of them is not felt any more."""
    path = [[0.0, 0.0, 0.0, -0.01], [0.1, 0.0, 0.0, 0.01], [0.2, 0.0, 0.0, -0.01]]
    wall = {"kind": "box", "position": [0.0, 0.0, 0.055], "size": [0.2, 0.2, 0.1]}
    felt = Touched(
        {"kind": "union", "tool_radius": 0.0, "shapes": [tile(along(path)), wall]}
    )
    told = []
    for k in range(250):
        deflection, _ = felt.at((0.0, 0.0, 0.004))
        # It is never pushed into both: until one is free, it is outside of each.
        top = float(
            np.interp(k * T, [row[0] for row in path], [row[3] for row in path])
        )
        if not felt.numbers.memory[INSIDE]:
            assert top - 1e-9 <= 0.004 + deflection[2] <= 0.005 + 1e-9
        assert abs(deflection[2]) < 0.011
        told.append((felt.numbers.memory[INSIDE], felt.met[JUMPED]))
    assert max(inside for inside, _ in told) == 1.0
    assert sum(jumped for _, jumped in told) == 1.0  # the coupling eases it
    assert told[-1][0] == 0.0


@pytest.mark.parametrize("radius", [0.0, 0.002])
def test_a_sheet_that_passes_a_held_proxy_is_a_jump(
    radius: float, tmp_path: Any
) -> None:
    """A device held below the sheet goes through it at a wall: the coupling eases its force."""
    corners = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n"
    (tmp_path / "sheet.obj").write_text(corners, encoding="ascii")
    path = [[0.0, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.02]]
    sheet = {
        "kind": "mesh",
        "file": str(tmp_path / "sheet.obj"),
        "sides": "both",
        "scale": 0.1,
    }
    wall = {"kind": "box", "position": [0.0, 0.0, 0.06], "size": [0.2, 0.2, 0.1]}
    shapes = [{**sheet, "motion": along(path)}, wall]
    felt = Touched({"kind": "union", "tool_radius": radius, "shapes": shapes})
    felt.at((0.0, 0.0, 0.005))
    last, jumps = 0.0, 0.0
    for k in range(220):
        deflection, _ = felt.at((0.0, 0.0, -0.004))
        jumps += felt.met[JUMPED]
        if not felt.met[JUMPED] and k > 0:
            # otherwise the deflection changes as fast as the sheet moves
            assert abs(deflection[2] - last) <= 0.1 * T + 1e-9
        last = deflection[2]
    assert jumps == 1.0


def test_after_missing_ticks_a_shape_is_no_faster() -> None:
    """Half a second without a position: it makes up 10 ms at once, and lags behind its path."""
    path = [[0.0, 0.0, 0.0, -0.01], [2.0, 0.0, 0.0, 0.19]]
    felt = Touched(tile(along(path)))
    for _ in range(50):
        felt.at((0.0, 0.0, 0.0))
    felt.seq += 500
    deflection, _ = felt.at((0.0, 0.0, 0.0))
    # The motion of this test may be as fast as 1 m/s: 1 cm, in place of 5.
    assert felt.numbers.table[ROWS + SHIFT + 2] == pytest.approx(
        -0.01 + 0.0049 + 0.01, abs=1e-12
    )
    assert deflection[2] == pytest.approx(0.0049, abs=1.1e-5)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 1.0))
def test_no_proxy_is_inside_of_what_moves_or_stands(seed: int, friction: float) -> None:
    """A ball wanders through a corner of two walls, and a device with it: never pinched here."""
    random = np.random.default_rng(seed)
    way = np.cumsum(random.uniform(-0.4, 0.4, (30, 3)) * 0.01, axis=0) + 0.06
    way = np.clip(way, 0.0551, 0.09)
    path = [[0.01 * k, *row] for k, row in enumerate(way.tolist())]
    rough = {"friction": {"static": friction}}
    shapes = [
        {"kind": "oriented_plane", "normal": [1, 0, 0], **rough},
        {"kind": "oriented_plane", "normal": [0, 0, 1], **rough},
        {"kind": "sphere", "radius": 0.05, "motion": along(path), **rough},
    ]
    felt = Touched({"kind": "union", "tool_radius": 0.0, "shapes": shapes})
    at = np.array([0.001, 0.0, 0.001])
    for k in range(300):
        at = at + random.uniform(-1.0, 1.0, 3) * 0.001
        deflection, _ = felt.at((float(at[0]), float(at[1]), float(at[2])))
        proxy = at + deflection
        centre = np.array(
            [np.interp(k * T, [row[0] for row in path], way[:, i]) for i in range(3)]
        )
        assert proxy[0] >= -1e-9
        assert proxy[2] >= -1e-9
        if felt.numbers.memory[INSIDE] == 0.0:
            assert np.linalg.norm(proxy - centre) >= 0.05 - 1e-9


def test_the_power_into_the_device_is_bounded() -> None:
    """A force of 10 N against 0.1 m/s would be 1 W: at most 0.2 W, so it moves at 0.02 m/s."""
    path = [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, SPEED]]
    felt = Touched(tile(along(path, power=0.2), friction={}))
    felt.at((0.0, 0.0, -0.0001), (0.0, 0.0, 0.0))
    for _ in range(100):
        felt.at((0.0, 0.0, -0.002), (0.0, 0.0, 10.0))
    memory = felt.numbers.memory
    assert memory[MOST_POWER] == pytest.approx(0.2, rel=1e-9)
    assert memory[ENERGY] == pytest.approx(0.2 * 100 * T, rel=0.02)
    assert felt.numbers.table[ROWS + SHIFT + 2] == pytest.approx(
        0.02 * 100 * T, rel=0.02
    )
    # Without a force it catches up, at its largest speed.
    for _ in range(300):
        felt.at((0.0, 0.0, 0.5))
    assert felt.numbers.table[ROWS + SHIFT + 2] == pytest.approx(
        SPEED * T * 400, rel=1e-9
    )


def test_a_topic_puts_a_shape_somewhere_at_its_speed() -> None:
    surface = parse_surface(tile({"speed": 0.5}), "surface")
    assert surface.movers() == {0: 0}
    place = TouchedSurface(surface, T)
    place.aim(0, (0.0, 0.0, 0.01))
    place.note(0, (0.0, 0.0, 0.0))
    place.meet((0.0, 0.0, 0.1))
    place.aim(0, (0.0, 0.0, 0.0))
    assert place.numbers is not None
    heights = []
    for k in range(1, 30):
        place.note(k, (0.0, 0.0, 0.0))
        place.meet((0.0, 0.0, 0.1))
        heights.append(place.numbers.table[ROWS + SHIFT + 2])
    assert heights == pytest.approx(
        np.maximum(0.01 - 0.5 * T * np.arange(1, 30), 0.0), abs=1e-15
    )
    # A changed friction keeps it where it is.
    other = TouchedSurface(
        parse_surface(tile({"speed": 0.5}, friction={"static": 0.5}), "s"), T
    )
    place.aim(0, (0.0, 0.0, 0.01))
    place.note(30, (0.0, 0.0, 0.0))
    place.meet((0.0, 0.0, 0.1))
    assert not place.take(other)
    assert other.numbers is not None
    assert other.numbers.table[ROWS + SHIFT + 2] == pytest.approx(0.5 * T)


@pytest.mark.parametrize(
    ("motion", "why"),
    [
        ({"path": [[0, 0, 0, 0], [1, 0.2, 0, 0]], "speed": 0.1}, "asks for 0.2 m/s"),
        ({"path": [[0, 0, 0, 0], [0, 0, 0, 0]]}, "expected later"),
        ({"path": [[0, 0, 0, 0], [1, 0, 0, 0]], "repeat": 0.5}, "ends at 1 s"),
        ({"path": [[0, math.nan, 0, 0]]}, "not a finite number"),
        ({"speed": 2.0}, "speed"),
    ],
)
def test_a_motion_that_cannot_be_made_is_refused(
    motion: dict[str, Any], why: str
) -> None:
    with pytest.raises(ParameterError, match=why):
        parse_surface(tile(motion), "surface")


SCENE = """summary: all that a union can have
run: {rate: 1000.0, duration: 1.0}
nodes:
  driver:
    kind: sim_driver
    parameters:
      device:
        mass: 0.1
        damping: 1.0
        hand: {mass: 0.05, damping: 2.0, stiffness: 150.0, path: [[0.1, 0.0], [0.8, 0.05]]}
  environment:
    kind: environment
    parameters:
      surface:
        kind: union
        shapes:
          - {kind: box, position: [0.05, 0, -0.052], size: [0.2, 0.2, 0.1], stiffness: 0.4,
             damping: 0.9, friction: {static: 0.3},
             motion: {path: [[0, 0, 0, 0], [0.5, 0, 0, 0.012], [1.0, 0.02, 0, 0]], speed: 0.1}}
          - {kind: viscosity, within: {kind: sphere, position: [0.03, 0, 0], radius: 0.02},
             time: 0.01}
          - {kind: magnetic_line, start: [0, 0.003, 0.004], end: [0.1, 0.003, 0.004], reach: 0.01,
             stiffness: 0.5}
          - {kind: sphere, position: [0.06, 0, 0], radius: 0.01,
             motion: {path: [[0, 0, 0, 0], [1, -0.03, 0, 0]], speed: 0.1}}
  coupling:
    kind: coupling
    parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 800.0, damping: 1.5}}}
  logger: {kind: logger, required: false}
"""


def test_all_of_it_is_felt_in_one_process(tmp_path: Any) -> None:
    (tmp_path / "own.yaml").write_text(SCENE, encoding="ascii")
    found = play(launch_file.read(str(tmp_path / "own.yaml"), {}))
    pressed = np.abs(found.force).max(axis=0)
    assert (pressed > 0.1).all()
    assert pressed.max() < 20.0


@pytest.mark.process
@pytest.mark.slow
def test_interpreted_compiled_and_one_process_have_the_same_bits(tmp_path: Any) -> None:
    from messages.topics import DEVICE_STATE, PROXY, event
    from nodes.recording.reader import Recording
    from tests.support.launching import launch_json

    (tmp_path / "own.yaml").write_text(SCENE, encoding="ascii")
    one = play(launch_file.read(str(tmp_path / "own.yaml"), {}))
    for tick in ("plain", "compiled"):
        figures = launch_json(
            tmp_path, "./own.yaml", "run.pace:=lockstep", "--tick", tick
        )
        recording = Recording(tmp_path / figures["recording"])
        proxies, states = recording.messages(PROXY), recording.messages(DEVICE_STATE)
        assert np.array_equal([proxy.proxy for proxy in proxies[:1000]], one.proxy)
        assert np.array_equal([state.force for state in states[1:1000]], one.force[:-1])
        assert {proxy.stiffness for proxy in proxies} >= {1.0, 0.4}
        told = [
            one.reason
            for one in recording.messages(event("coupling"))
            if one.kind == "world"
        ]
        assert any(
            "shapes[0]: the law is felt with K 320 N/m, B 1.35 N s/m" in one
            for one in told
        )
        assert figures["moved"]["environment"]["power_w"] > 0.0
