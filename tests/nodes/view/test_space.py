"""Three dimensions in a real browser: the picture against the geometry, a hand in the plane of the camera, the flat view."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from messages.topics import DEVICE_STATE
from nodes.launcher import launch_file
from nodes.recording.reader import Recording
from tests.support.browser import OpenPage, needs_browser, shown, url_of, viewing
from tests.support.launching import Running, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = needs_browser

CENTRE, RADIUS = [0.045, 0.012, -0.02], 0.03


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("space")
    content = yaml.safe_load(launch_file.find("touch_wall").read_text(encoding="utf-8"))
    content["run"]["axes"] = ["x", "y", "z"]
    ball = {"kind": "sphere", "position": CENTRE, "radius": RADIUS, "friction": {"static": 0.3}}
    content["nodes"]["environment"]["parameters"]["surface"] = ball
    (folder / "ball.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with running(folder, str(folder / "ball.yaml"), "--view") as found:
        yield found


@pytest.fixture(scope="module")
def page(browser: Browser, launch: Running) -> Iterator[Page]:
    with OpenPage(browser, url_of(launch)) as found:
        wait_for(lambda: found.evaluate("haptic.space.pixels > 0"), "the picture")
        yield found


def test_the_ball_is_where_and_as_large_as_the_geometry_says(page: Page) -> None:
    """Parallel projection: a ball is a disc of its radius about the image of its centre, whatever the camera."""
    for yaw, pitch in ((-0.7, 0.45), (0.9, -0.8)):
        page.evaluate("([yaw, pitch]) => Object.assign(haptic.space.turn, { yaw, pitch })", [yaw, pitch])
        page.evaluate("haptic.space.draw()")
        u, v, _ = page.evaluate("centre => haptic.space.seen(centre)", CENTRE)
        pixels = float(page.evaluate("haptic.space.pixels"))
        # The camera by hand: yaw about z, then pitch.
        right = [math.cos(yaw), math.sin(yaw), 0.0]
        middle = page.evaluate("haptic.space.turn.middle")
        assert u == pytest.approx(pixels * sum(r * (c - m) for r, c, m in zip(right, CENTRE, middle, strict=True)))
        extent = page.evaluate(
            """([u, v]) => {
          const { still } = haptic.space, g = still.getContext("2d"), { width, height } = still;
          const at = (x, y) => g.getImageData(Math.round(x + width / 2), Math.round(y + height / 2), 1, 1).data[3] > 128;
          const reach = (du, dv) => { let k = 0; while (k < 2000 && at(u + k * du, v + k * dv)) k += 0.5; return k; };
          return [[1, 0], [-1, 0], [0, 1], [0, -1]].map(([du, dv]) => reach(du, dv)); }""",
            [u, v],
        )
        # 28 by 14 parts: the outline of the polygons is up to 1 - cos(pi/28) inside; lines and pixels add two.
        for found in extent:
            assert 0.98 * pixels * RADIUS - 2.0 <= found <= pixels * RADIUS + 2.0


def test_the_hand_moves_in_the_plane_that_the_camera_looks_at(page: Page, launch: Running) -> None:
    rests = "haptic.space.now && Math.hypot(...haptic.space.now.target) < 1e-4"
    wait_for(lambda: launch.ticks() > 1300 and page.evaluate(rests), "the hand rests")
    box: Any = page.locator("#space").bounding_box()

    def taken() -> Any:
        # Nobody holds it yet, so it taps by itself every 3 s: it may have moved away under the mouse.
        page.mouse.up()
        u, v, _ = page.evaluate("haptic.space.seen(haptic.space.now.target)")
        page.mouse.move(box["x"] + box["width"] / 2 + u, box["y"] + box["height"] / 2 + v)
        page.mouse.down()
        return page.evaluate("haptic.space.held && haptic.space.seen(haptic.space.held)")

    u, v, _ = wait_for(taken, "the hand to be taken")
    x, y = box["x"] + box["width"] / 2 + u, box["y"] + box["height"] / 2 + v
    page.mouse.move(x, y)
    began = page.evaluate("[...haptic.space.held]")
    page.mouse.move(x + 30.0, y - 40.0, steps=3)
    right, up, pixels = page.evaluate("[haptic.space.camera.right, haptic.space.camera.up, haptic.space.pixels]")
    wanted = [b + (30.0 * r + 40.0 * w) / pixels for b, r, w in zip(began, right, up, strict=True)]

    def there() -> bool:
        return math.dist(page.evaluate("[...haptic.space.now.target]"), wanted) < 1e-3

    wait_for(there, "the driver's hand is there, along all three axes")
    # The flat view is of the same moment.
    page.evaluate("haptic.space.letGo()")
    page.mouse.up()
    page.select_option("#axis", "z")
    assert not page.locator("#space").is_visible()
    same = page.evaluate("haptic.scene.now.position[2] === haptic.space.now.position[2]")
    assert same
    wait_for(lambda: "mm" in shown(page, "#reading"), "the flat view's figures")
    page.select_option("#axis", "3-D")


def test_a_plane_of_section_cuts_the_ball_and_gives_the_plots(page: Page) -> None:
    assert page.evaluate("haptic.section.plane") == "xz"
    page.evaluate("document.getElementById('lab').open = true")
    for plane, across in (("yz", 0), ("xz", 1)):
        page.select_option("#plane", plane)
        lines = page.evaluate("haptic.plots.panels[0].lines")
        assert [f"device {letter}" in lines for letter in "xyz"] == [letter in plane for letter in "xyz"]
        # Through the ball's middle, where the hand need not be.
        at = CENTRE[across] + 0.2 * RADIUS
        cut = page.evaluate("([across, at]) => haptic.space.solids.cut(across, at)", [across, at])
        points = [point for ends in cut for point in ends]
        assert len(cut) > 10
        assert [point[across] for point in points] == pytest.approx([at] * len(points))
        # Of flat faces, so inside the ball by what their number gives at most.
        far = [math.dist(point, CENTRE) / RADIUS for point in points]
        assert 0.97 < min(far) <= max(far) <= 1.0 + 1e-4
    page.evaluate("document.getElementById('lab').open = false")
    assert page.locator("#section").is_visible()
    assert not page.locator("#lens").is_visible()


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


def test_it_touches_with_a_cone_and_a_spring(page: Page) -> None:
    """What is drawn when the ball is touched; the hand taps by itself along the first axis, or is pulled there."""
    page.evaluate("haptic.space.held = [0.03, 0.012, 0.0]; haptic.space.tell()")
    page.evaluate("setInterval(() => { haptic.space.held = [0.03, 0.012, 0.0]; haptic.space.tell(); }, 50)")
    wait_for(lambda: page.evaluate("haptic.space.now.contact === 1"), "contact")
    found = page.evaluate("""() => { const { now } = haptic.space; return [now.proxy, now.normal]; }""")
    assert math.dist(found[0], CENTRE) == pytest.approx(RADIUS, abs=1e-6)
    outward = [(p - c) / RADIUS for p, c in zip(found[0], CENTRE, strict=True)]
    assert found[1] == pytest.approx(outward, abs=1e-3)
    before = page.locator("#space").screenshot()
    page.evaluate("haptic.space.turn.yaw += 0.5")
    wait_for(lambda: page.locator("#space").screenshot() != before, "the camera turns")


def test_a_recording_is_looked_at_in_three_dimensions_too(browser: Browser, launch: Running) -> None:
    """The same shape as over the launch, and the poses that were recorded; the run goes on meanwhile."""
    folder = launch.folder
    path = next((folder / "recordings").glob("*.mcap"))
    with viewing(folder, "--replay", str(path)) as url, OpenPage(browser, url) as page:
        wait_for(lambda: page.evaluate("haptic.space.pixels > 0"), "the picture")
        assert page.locator("#space").is_visible()
        with OpenPage(browser, url_of(launch)) as running_page:
            wait_for(lambda: running_page.evaluate("haptic.space.pixels > 0"), "the picture")
            same = [each.evaluate("JSON.stringify(haptic.space.shape)") for each in (page, running_page)]
        assert same[0] == same[1]
        states = {state.seq: state.position for state in Recording(path).messages(DEVICE_STATE)}
        moment = "({ t: haptic.space.now.t, position: [...haptic.space.now.position] })"
        page.evaluate("document.getElementById('play').click()")
        now = wait_for(lambda: page.evaluate(f"haptic.space.now && {moment}"), "a pose")
        # One picture of the scene for 60 in a second: its pose is that of one of the ticks just before.
        near = [states[seq] for seq in range(max(0, round(now["t"] / 0.002) - 20), round(now["t"] / 0.002) + 1)]
        assert tuple(now["position"]) in near


def test_bodies_are_where_the_environment_has_them_and_where_a_replay_finds_them(
    browser: Browser, tmp_path: Path
) -> None:
    """A box that is pushed: live from the environment, in a replay from the scene stepped again, which is the same."""
    pytest.importorskip("mujoco")
    with running(tmp_path, "stack_boxes", "--view", "duration:=0") as launch:
        with OpenPage(browser, url_of(launch)) as page:
            wait_for(lambda: page.evaluate("haptic.space.solids?.poses?.length === 4"), "table, tool and two boxes")
            wait_for(lambda: page.evaluate("haptic.space.solids.poses[2][0]") > 0.055, "the lower box is pushed")
            wait_for(lambda: page.evaluate("haptic.space.pixels > 0"), "the picture")
            tool = "Math.hypot(...haptic.space.now.proxy.map((each, k) => each - haptic.space.solids.poses[1][k]))"
            wait_for(lambda: page.evaluate(tool) < 2e-3, "the tool is the proxy")
            figures = launch.finish(signal.SIGINT)
            last = page.evaluate("haptic.space.solids.poses.map((pose) => [...pose])")
        path = tmp_path / figures["recording"]
    with viewing(tmp_path, "--replay", str(path)) as url, OpenPage(browser, url) as page:
        end = """() => { const slider = document.getElementById("seek");
          slider.value = slider.max;
          slider.dispatchEvent(new Event("input")); }"""
        page.evaluate(end)
        wait_for(lambda: page.evaluate("haptic.space.solids?.poses?.[2][0]") > 0.055, "the box where it was pushed to")

        def near() -> bool:
            found = page.evaluate("haptic.space.solids.poses.map((pose) => [...pose])")
            # Poses of moments that are at most some ticks apart, of bodies slower than 0.1 m/s.
            return all(
                math.dist(a[:3], b[:3]) < 5e-3 and max(abs(x - y) for x, y in zip(a[3:], b[3:], strict=True)) < 0.05
                for a, b in zip(found, last, strict=True)
            )

        wait_for(near, "the same poses")
