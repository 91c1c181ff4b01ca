"""The 3D view in a real browser: geometry, a hand in the camera's plane, the flat view."""

from __future__ import annotations

import json
import math
import signal
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from messages.topics import DEVICE_STATE
from nodes.launcher import scenario_files
from nodes.recording.reader import Recording
from tests.support.ball_picture import CENTRE, COLOURS, RADIUS, Camera, shade
from tests.support.browser import OpenPage, needs_browser, shown, url_of, viewing
from tests.support.launching import HAPTIC, Running, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = needs_browser


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("space")
    content = yaml.safe_load(
        scenario_files.find("touch_wall").read_text(encoding="utf-8")
    )
    content["run"]["axes"] = ["x", "y", "z"]
    ball = {
        "kind": "sphere",
        "position": CENTRE,
        "radius": RADIUS,
        "tool_radius": 0.0,
        "friction": {"static": 0.3},
    }
    content["nodes"]["environment"]["parameters"]["surface"] = ball
    (folder / "ball.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with running(folder, str(folder / "ball.yaml"), "--view") as found:
        yield found


@pytest.fixture(scope="module")
def page(browser: Browser, launch: Running) -> Iterator[Page]:
    """Draw without WebGL 2, whether the browser has it or not; with it: test_lit."""
    with OpenPage(browser, url_of(launch)) as found:
        found.evaluate("haptic.space.newStill(false)")
        wait_for(lambda: found.evaluate("haptic.space.pixels > 0"), "the picture")
        yield found


# A test with a launch of its own comes first: the one that is shared, and its page, would only go
# on beside it.


@pytest.mark.slow
def test_bodies_are_where_the_environment_has_them_and_where_a_replay_finds_them(
    browser: Browser, tmp_path: Path
) -> None:
    """A pushed box, live and in a replay, is at the same place."""
    pytest.importorskip("mujoco")
    with (
        running(tmp_path, "stack_boxes", "--view", "duration:=0") as launch,
        OpenPage(browser, url_of(launch)) as page,
    ):
        wait_for(
            lambda: page.evaluate("haptic.space.solids?.poses?.length === 4"),
            "table, tool and two boxes",
        )
        wait_for(
            lambda: page.evaluate("haptic.space.solids.poses[2][0]") > 0.055,
            "the lower box is pushed",
        )
        wait_for(lambda: page.evaluate("haptic.space.pixels > 0"), "the picture")
        tool = (
            "Math.hypot(...haptic.space.now.proxy.map((each, k) => each -"
            " haptic.space.solids.poses[1][k]))"
        )
        wait_for(lambda: page.evaluate(tool) < 2e-3, "the tool is the proxy")
        figures = launch.finish(signal.SIGINT)
        # A busy page is behind: what came before this line it has drawn.
        wait_for(
            lambda: "The run has ended" in shown(page, "#words"), "the end is told"
        )
        path, poses = (
            tmp_path / figures["recording"],
            "haptic.space.solids.poses.map((pose) => [...pose])",
        )
        with (
            viewing(tmp_path, "--replay", str(path)) as url,
            OpenPage(browser, url) as replayed,
        ):
            end = """() => { const slider = document.getElementById("seek");
                  slider.value = slider.max;
                  slider.dispatchEvent(new Event("input")); }"""
            replayed.evaluate(end)
            pushed = "haptic.space.solids?.poses?.[2][0]"
            wait_for(
                lambda: replayed.evaluate(pushed) > 0.055,
                "the box where it was pushed to",
            )

            def near() -> bool:
                # Poses of moments that are at most some ticks apart, of bodies slower than 0.1 m/s.
                return all(
                    math.dist(a[:3], b[:3]) < 5e-3
                    and max(abs(x - y) for x, y in zip(a[3:], b[3:], strict=True))
                    < 0.05
                    for a, b in zip(
                        replayed.evaluate(poses), page.evaluate(poses), strict=True
                    )
                )

            wait_for(near, "the same poses")


@pytest.mark.slow
def test_the_ball_is_where_and_as_large_as_the_geometry_says(page: Page) -> None:
    """In parallel projection a ball is a disc of its radius about its centre's image."""
    for yaw, pitch in ((-0.7, 0.45), (0.9, -0.8)):
        page.evaluate(
            "([yaw, pitch]) => Object.assign(haptic.space.turn, { yaw, pitch })",
            [yaw, pitch],
        )
        page.evaluate("haptic.space.draw()")
        u, v, _ = page.evaluate("centre => haptic.space.seen(centre)", CENTRE)
        pixels = float(page.evaluate("haptic.space.pixels"))
        # The camera by hand: yaw about z, then pitch.
        right = [math.cos(yaw), math.sin(yaw), 0.0]
        middle = page.evaluate("haptic.space.turn.middle")
        assert u == pytest.approx(
            pixels
            * sum(r * (c - m) for r, c, m in zip(right, CENTRE, middle, strict=True))
        )
        extent = page.evaluate(
            """([u, v]) => {
          const { still } = haptic.space, g = still.getContext("2d"), { width, height } = still;
          const at = (x, y) => g.getImageData(Math.round(x + width / 2),
            Math.round(y + height / 2), 1, 1).data[3] > 128;
          const reach = (du, dv) => { let k = 0; while (k < 2000 && at(u + k * du,
            v + k * dv)) k += 0.5; return k; };
          return [[1, 0], [-1, 0], [0, 1], [0, -1]].map(([du, dv]) => reach(du, dv)); }""",
            [u, v],
        )
        # 48 by 24 parts: the outline of the polygons is up to 1 - cos(pi/48) inside; lines and
        # pixels add two, a step of the search half of one.
        for found in extent:
            assert 0.99 * pixels * RADIUS - 2.5 <= found <= pixels * RADIUS + 2.5


@pytest.mark.process
def test_the_picture_is_the_one_that_a_ray_through_each_pixel_gives(page: Page) -> None:
    """Canvas colours against rays through a ball; the front hides the back."""
    yaw, pitch = -0.4, 0.6
    read = """([yaw, pitch, points]) => { const { space } = haptic;
      Object.assign(space.turn, { yaw, pitch, scale: 1 }); space.draw();
      const { still } = space, g = still.getContext("2d"), { width, height } = still;
      const at = (u, v) => [...g.getImageData(Math.round(u + width / 2),
        Math.round(v + height / 2), 1, 1).data];
      return [width, height, points.map(([u, v]) => at(u, v))]; }"""
    width, height, _ = page.evaluate(read, [yaw, pitch, []])
    camera = Camera(yaw, pitch, width, height)
    reach = camera.pixels * RADIUS
    at = camera.seen(CENTRE)
    points = [
        (at[0] + reach * x / 10.0, at[1] + reach * y / 10.0)
        for x in range(-12, 13)
        for y in range(-12, 13)
    ]
    _, _, found = page.evaluate(read, [yaw, pitch, points])
    # Faces of 2 pi / 48: normals are off by up to half of that along and across, and light by as
    # much of its share; two more for rounding.
    off = 0.6 * math.hypot(math.pi / 48.0, math.pi / 48.0) * max(COLOURS["solid"]) + 2.0
    told_apart = 0
    for (u, v), (*colour, alpha) in zip(points, found, strict=True):
        far = math.dist((u, v), at)
        if far > reach + 2.0:
            assert alpha == 0
        elif far < 0.97 * reach - 2.0:
            front, back = (camera.met(u, v, side) for side in (-1.0, 1.0))
            assert front is not None
            assert back is not None
            assert alpha >= 250, "no gap between faces"
            assert colour == pytest.approx(shade(front), abs=off)
            told_apart += (
                max(abs(a - b) for a, b in zip(shade(front), shade(back), strict=True))
                > 2.0 * off
            )
    # Else a picture that is painted from the front to the back would be as good.
    assert told_apart > 60


@pytest.mark.process
def test_proxy_device_force_and_cone_are_drawn_where_they_are(page: Page) -> None:
    yaw, pitch = -0.4, 0.6
    camera = Camera(
        yaw,
        pitch,
        *page.evaluate(
            "[haptic.space.canvas.clientWidth, haptic.space.canvas.clientHeight]"
        ),
    )
    # Seen from the left of the ball, 15 mm deep; pushed out, and half as much along the surface as
    # into it.
    normal = tuple(-r for r in camera.right)
    proxy, device = (
        [c + k * n for c, n in zip(CENTRE, normal, strict=True)]
        for k in (RADIUS, RADIUS - 0.015)
    )
    target = [d - 0.02 * w for d, w in zip(device, camera.up, strict=True)]
    force = [3.0 * n + 1.5 * w for n, w in zip(normal, camera.up, strict=True)]
    now = {
        "t": 1.0,
        "contact": 1,
        "position": device,
        "proxy": proxy,
        "normal": normal,
        "target": target,
    }
    now |= {"force": force, "asked": force, "distance": -0.015}
    mu = float(page.evaluate("haptic.space.shape.friction"))
    rim = [
        p + 0.012 * n + 0.012 * mu * w
        for p, n, w in zip(proxy, normal, camera.up, strict=True)
    ]
    places = {
        "proxy": camera.seen(proxy),
        "target": camera.seen(target),
        "force": camera.seen(
            [d + 0.006 * f for d, f in zip(device, force, strict=True)]
        ),
        "cone": camera.seen(rim),
        "device": tuple(
            a + b for a, b in zip(camera.seen(device), (-2.0, -4.0), strict=True)
        ),
    }
    read = """([yaw, pitch, now, places]) => { const { space } = haptic;
      Object.assign(space.turn, { yaw, pitch, scale: 1 }); space.trace.length = 0; space.show(now);
        space.draw();
      const g = space.canvas.getContext("2d"), { width, height } = space.canvas;
      const around = ([u, v]) => [...g.getImageData(Math.round(u + width / 2) - 2,
        Math.round(v + height / 2) - 2, 5, 5).data];
      return Object.fromEntries(Object.entries(places).map(([name, at]) => [name, around(at)]));
        }"""

    def nearest(name: str, now: dict[str, Any], wanted: Sequence[float]) -> float:
        """Return the smallest colour distance within 25 pixels of a place."""
        data = page.evaluate(read, [yaw, pitch, now, places])[name]
        apart = (
            max(abs(a - b) for a, b in zip(data[k : k + 3], wanted, strict=True))
            for k in range(0, 100, 4)
        )
        return float(min(apart))

    for name in ("proxy", "target", "force"):
        assert nearest(name, now, COLOURS[name]) <= 2, name
    front = camera.met(*places["device"])
    assert front is not None
    ghost = [
        0.55 * a + 0.45 * b
        for a, b in zip(COLOURS["device"], shade(front), strict=True)
    ]
    assert nearest("device", now, ghost) <= 8, "a ghost: the ball is seen through it"
    # A line 1.5 wide between pixels is at least half its colour, over white or the ball.
    slides, sticks = now, {**now, "force": [3.0 * n for n in normal]}
    for moment, name, other in ((slides, "bad", "good"), (sticks, "good", "bad")):
        assert nearest("cone", moment, COLOURS[name]) < 0.5 * nearest(
            "cone", moment, COLOURS[other]
        )


@pytest.mark.process
def test_the_hand_moves_in_the_plane_that_the_camera_looks_at(
    page: Page, launch: Running
) -> None:
    rests = "haptic.space.now && Math.hypot(...haptic.space.now.target) < 1e-4"
    wait_for(lambda: launch.ticks() > 1300 and page.evaluate(rests), "the hand rests")
    box: Any = page.locator("#space").bounding_box()

    def taken() -> Any:
        # Nobody holds it yet, so it taps by itself every 3 s: it may have moved away under the
        # mouse.
        page.mouse.up()
        u, v, _ = page.evaluate("haptic.space.seen(haptic.space.now.target)")
        page.mouse.move(
            box["x"] + box["width"] / 2 + u, box["y"] + box["height"] / 2 + v
        )
        page.mouse.down()
        return page.evaluate(
            "haptic.space.held && haptic.space.seen(haptic.space.held)"
        )

    u, v, _ = wait_for(taken, "the hand to be taken")
    x, y = box["x"] + box["width"] / 2 + u, box["y"] + box["height"] / 2 + v
    page.mouse.move(x, y)
    began = page.evaluate("[...haptic.space.held]")
    page.mouse.move(x + 30.0, y - 40.0, steps=3)
    right, up, pixels = page.evaluate(
        "[haptic.space.camera.right, haptic.space.camera.up, haptic.space.pixels]"
    )
    wanted = [
        b + (30.0 * r + 40.0 * w) / pixels
        for b, r, w in zip(began, right, up, strict=True)
    ]

    def there() -> bool:
        return math.dist(page.evaluate("[...haptic.space.now.target]"), wanted) < 1e-3

    wait_for(there, "the driver's hand is there, along all three axes")
    # The flat view is of the same moment.
    page.evaluate("haptic.space.letGo()")
    page.mouse.up()
    page.select_option("#axis", "z")
    assert not page.locator("#space").is_visible()
    same = page.evaluate(
        "haptic.scene.now.position[2] === haptic.space.now.position[2]"
    )
    assert same
    wait_for(lambda: "mm" in shown(page, "#reading"), "the flat view's figures")
    page.select_option("#axis", "3-D")


@pytest.mark.slow
def test_a_plane_of_section_cuts_the_ball_and_gives_the_plots(page: Page) -> None:
    assert page.evaluate("haptic.section.plane") == "xz"
    page.evaluate("document.getElementById('lab').open = true")
    for plane, across in (("yz", 0), ("xz", 1)):
        page.select_option("#plane", plane)
        lines = page.evaluate("haptic.plots.panels[0].lines")
        assert [f"device {letter}" in lines for letter in "xyz"] == [
            letter in plane for letter in "xyz"
        ]
        # Through the ball's middle, where the hand need not be.
        at = CENTRE[across] + 0.2 * RADIUS
        cut = page.evaluate(
            "([across, at]) => haptic.space.solids.cut(across, at)", [across, at]
        )
        points = [point for ends in cut for point in ends]
        assert len(cut) > 10
        assert [point[across] for point in points] == pytest.approx([at] * len(points))
        # Of flat faces, so inside the ball by what their number gives at most.
        far = [math.dist(point, CENTRE) / RADIUS for point in points]
        assert 0.97 < min(far) <= max(far) <= 1.0 + 1e-4
    page.evaluate("document.getElementById('lab').open = false")
    assert page.locator("#section").is_visible()
    # On a phone it lies in a corner of the scene, and not under what chooses it.
    page.set_viewport_size({"width": 390, "height": 844})
    axes: Any = page.locator("#axes").bounding_box()
    corner: Any = page.locator("#section").bounding_box()
    assert axes["y"] + axes["height"] <= corner["y"]
    page.set_viewport_size({"width": 1366, "height": 768})
    assert not page.locator("#lens").is_visible()


@pytest.mark.process
def test_a_surface_that_is_replaced_while_it_runs_is_drawn_anew(
    page: Page, launch: Running
) -> None:
    """And drawn at once on a page that is opened later, because both read it from its node."""
    radius = "haptic.space.solids.extent().low"

    def ask(value: float) -> None:
        words = ["param", "set", "environment", "surface.radius", str(value)]
        command = [*HAPTIC, *words, "--run", launch.run.run]
        environment = launch.environment
        subprocess.run(command, env=environment, check=True, capture_output=True)

    for value in (0.7 * RADIUS, RADIUS):
        ask(value)
        wait_for(
            lambda value=value: (
                page.evaluate(radius)  # type: ignore[misc]
                == pytest.approx(CENTRE[2] - value, abs=1e-6)
            ),
            "the ball of another radius",
        )


@pytest.mark.process
def test_keys_move_the_hand_in_three_dimensions_too(page: Page) -> None:
    page.locator("#space").focus()

    def moved() -> bool:
        page.keyboard.press("Shift+PageUp")
        away = page.evaluate("haptic.space.camera.away")
        target = page.evaluate("[...haptic.space.now.target]")
        return math.fsum(a * b for a, b in zip(target, away, strict=True)) > 0.01

    wait_for(moved, "away from the camera")
    page.keyboard.press("Escape")
    assert page.evaluate("haptic.space.held") is None


@pytest.mark.process
def test_the_scene_fills_its_row_when_the_row_becomes_lower(page: Page) -> None:
    """The canvas beside it kept the row as high as its own last picture."""

    def heights() -> list[float]:
        boxes: list[Any] = [
            page.locator(each).bounding_box() for each in ("#space", "#section")
        ]
        return [box["height"] for box in boxes]

    for height in (890, 650, 768):
        page.set_viewport_size({"width": 1366, "height": height})
        page.evaluate("haptic.section.draw(haptic.space.now, haptic.space.turn)")
        scene, beside = heights()
        assert scene == pytest.approx(beside, abs=1.0)
        assert scene == pytest.approx(0.43 * height, abs=1.0)


@pytest.mark.process
def test_a_hand_that_is_kept_where_it_is_costs_no_picture(page: Page) -> None:
    """It was drawn ten times a second as long as it was held."""
    page.locator("#space").focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("haptic.space.held !== null")
    count = """() => new Promise((done) => {
      const { space } = haptic, { draw } = space;
      let drawn = 0;
      space.draw = () => { drawn++; draw.call(space); };
      setTimeout(() => { space.draw = draw; done(drawn); }, 500); })"""
    wait_for(lambda: page.evaluate(count) == 0, "a page at rest")
    assert page.evaluate("haptic.space.held !== null")
    page.keyboard.press("Escape")


@pytest.mark.process
def test_it_touches_with_a_cone_and_a_spring(page: Page) -> None:
    """Drawn while the ball is touched; the hand taps along the first axis, or is pulled."""
    page.evaluate("haptic.space.held = [0.03, 0.012, 0.0]; haptic.space.tell()")
    page.evaluate(
        "window.holding = setInterval(() => { haptic.space.held = [0.03, 0.012, 0.0];"
        " haptic.space.tell(); }, 50)"
    )

    def touched() -> Any:
        contact, proxy, normal = page.evaluate(
            "() => { const { now } = haptic.space; return [now.contact, now.proxy, now.normal]; }"
        )
        # It may bounce at first: where contact ends within a bin, the bin's last proxy is off the
        # ball.
        return (
            contact == 1
            and math.dist(proxy, CENTRE) == pytest.approx(RADIUS, abs=1e-6)
            and (proxy, normal)
        )

    proxy, normal = wait_for(touched, "contact, with the proxy on the ball")
    outward = [(p - c) / RADIUS for p, c in zip(proxy, CENTRE, strict=True)]
    assert normal == pytest.approx(outward, abs=1e-3)
    before = page.locator("#space").screenshot()
    page.evaluate("haptic.space.turn.yaw += 0.5")
    wait_for(lambda: page.locator("#space").screenshot() != before, "the camera turns")
    page.evaluate("clearInterval(window.holding); haptic.space.letGo()")


@pytest.mark.slow
def test_a_recording_is_looked_at_in_three_dimensions_too(
    page: Page, browser: Browser, launch: Running
) -> None:
    """The live shape with the recorded poses, while the run continues."""
    folder = launch.folder
    path = next((folder / "recordings").glob("*.mcap"))
    with (
        viewing(folder, "--replay", str(path)) as url,
        OpenPage(browser, url) as replayed,
    ):
        wait_for(lambda: replayed.evaluate("haptic.space.pixels > 0"), "the picture")
        assert replayed.locator("#space").is_visible()
        same = [
            json.loads(each.evaluate("JSON.stringify(haptic.space.shape)"))
            for each in (page, replayed)
        ]
        assert same[0] == same[1]
        states = {
            state.seq: state.position
            for state in Recording(path).messages(DEVICE_STATE)
        }
        moment = "({ t: haptic.space.now.t, position: [...haptic.space.now.position] })"
        replayed.evaluate("document.getElementById('play').click()")
        now = wait_for(
            lambda: replayed.evaluate(f"haptic.space.now && {moment}"), "a pose"
        )
        # One picture of the scene for 60 in a second: its pose is that of a tick just before, of
        # which some may be lost.
        until = round(now["t"] / 0.002)
        assert tuple(now["position"]) in [
            states.get(seq) for seq in range(until - 20, until + 1)
        ]
