"""The lit picture by WebGL 2 in a real browser: light, occlusion, shadows, meshes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import nodes.view
from nodes.environment.shapes.mesh_edges import first_of_equal
from nodes.view.bundle import bundle
from nodes.view.shape import _part, shape_of
from nodes.view.tessellation import Patch
from sim.lab.proxy_shapes import icosphere
from tests.support.ball_picture import CENTRE, COLOURS, RADIUS, Camera, shade
from tests.support.browser import SOFTWARE_GL, chromium, needs_browser
from tests.support.launching import wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [needs_browser, pytest.mark.process]

WIDTH, HEIGHT = 600, 400
_MAIN = """import { Lit } from "./lit.js";
import { Space } from "./space.js";
import { startTheme } from "./theme.js";
startTheme(document.createElement("button"));
globalThis.made = (shape) => {
  globalThis.space = new Space(document.getElementById("space"), () => {});
  space.start({ shape, hand: true, axes: ["x", "y", "z"] });
};
// As on a graphics card, by whatever draws here.
globalThis.carded = () => {
  space.lit = space.picture = new Lit(Lit.made().gl, "a graphics card");
  Object.assign(space, { still: space.lit.canvas, loaded: null, drawn: "" });
};
globalThis.shown = ({ yaw, pitch, position = [0, 0, 1], contact = 0, ...now }) => {
  Object.assign(space.turn, { yaw, pitch, scale: 1 });
  const zero = [0, 0, 0], none = { proxy: position, normal: zero, force: zero, asked: zero };
  space.show({ t: 1, position, ...none, target: [0, 0, 1], distance: NaN, contact, ...now });
  space.draw();
};
// Colours of points of the solids' picture, right and down from the middle.
globalThis.colours = (points) => {
  const { still } = space, copy = document.createElement("canvas");
  [copy.width, copy.height] = [still.width, still.height];
  space.draw();
  const g = copy.getContext("2d");
  g.drawImage(still, 0, 0);
  const { data } = g.getImageData(0, 0, copy.width, copy.height);
  return points.map(([u, v]) => {
    const at = 4 * (Math.round(v + copy.height / 2) * copy.width + Math.round(u + copy.width / 2));
    return [...data.subarray(at, at + 4)];
  });
};
"""


@pytest.fixture(scope="module")
def lit() -> Iterator[Browser]:
    """Return a browser whose WebGL 2 is drawn by a processor."""
    with chromium(SOFTWARE_GL) as found:
        yield found


def opened(browser: Browser, shape: dict[str, Any]) -> Page:
    """Return a page with nothing but the scene in 3D, without a server."""
    web = Path(nodes.view.__file__).with_name("web")
    modules = {path.name: path.read_text(encoding="utf-8") for path in web.glob("*.js")}
    script = bundle({**modules, "alone.js": _MAIN}, "alone")
    style = (web / "style.css").read_text(encoding="utf-8")
    page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    size = f"width: {WIDTH}px; height: {HEIGHT}px"
    page.set_content(
        f'<style>{style}</style><canvas id="space" tabindex="0" style="{size}"></canvas>'
        f"<script>{script}</script>"
    )
    page.evaluate("shape => made(shape)", shape)
    return page


def ball(tool_radius: float = 0.0) -> dict[str, Any]:
    surface = {"kind": "sphere", "position": CENTRE, "radius": RADIUS}
    return shape_of({"surface": {**surface, "tool_radius": tool_radius}})


@pytest.fixture(scope="module")
def page(lit: Browser) -> Iterator[Page]:
    found = opened(lit, ball())
    yield found
    found.close()


@pytest.fixture(scope="module", params=["processor", "card"])
def either(request: pytest.FixtureRequest, lit: Browser, page: Page) -> Iterator[Page]:
    """Return a page that keeps the solids' picture, and one that presents it each time."""
    if request.param == "processor":
        yield page
        return
    found = opened(lit, ball())
    found.evaluate("carded()")
    yield found
    found.close()


YAW, PITCH = -0.4, 0.6


def seen(page: Page, now: dict[str, Any], points: Any) -> Any:
    page.evaluate("now => shown(now)", {"yaw": YAW, "pitch": PITCH, **now})
    return page.evaluate("points => colours(points)", points)


def test_the_picture_is_the_one_that_a_ray_through_each_pixel_gives(
    either: Page,
) -> None:
    assert either.evaluate("space.lit !== null"), "no WebGL 2"
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    at, reach = camera.seen(CENTRE), camera.pixels * RADIUS
    grid = np.arange(-9, 10) / 10.0
    points = [(at[0] + reach * x, at[1] + reach * y) for x in grid for y in grid]
    checked = 0
    for (u, v), (*colour, alpha) in zip(points, seen(either, {}, points), strict=True):
        if math.dist((u, v), at) < 0.97 * reach - 2.0:
            normal = camera.met(round(u), round(v))
            assert normal is not None
            # Normals of the corners, mixed in between, are off by (pi / 48)² / 2 at most, those of
            # a pixel by half of one; two for rounding.
            off = 0.6 * ((math.pi / 48.0) ** 2 + 2.0 / reach) * max(COLOURS["solid"])
            assert colour == pytest.approx(shade(normal), abs=off + 2.0)
            assert alpha == 255
            checked += 1
    assert checked > 200


def test_an_edge_at_rest_is_smooth_where_a_processor_draws_it(page: Page) -> None:
    """Seen along the ground, nothing is behind the ball: its edge covers pixels in part."""
    level = {"yaw": YAW, "pitch": 0.0}
    camera = Camera(YAW, 0.0, WIDTH, HEIGHT)
    (u, v), reach = camera.seen(CENTRE), camera.pixels * RADIUS
    around = math.ceil(reach) + 3
    box = [
        (u + x, v + y)
        for x in range(-around, around + 1)
        for y in range(-around, around + 1)
        if abs(math.hypot(x, y) - reach) < 3.0
    ]

    def covered_in_part() -> int:
        alphas = [each[3] for each in seen(page, level, box)]
        return sum(0 < alpha < 255 for alpha in alphas)

    # A circle crosses about 8 r pixels; of those, samples at four places see a part in most.
    wait_for(lambda: covered_in_part() > 4.0 * reach, "a smooth edge")


def test_a_device_behind_the_ball_shines_through_it(page: Page) -> None:
    """In front it hides the ball; behind, four tenths of its colour are seen."""
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    found = []
    for side in (-1.0, 1.0):
        place = [
            c + side * 2.0 * RADIUS * a
            for c, a in zip(CENTRE, camera.away, strict=True)
        ]
        found.append(seen(page, {"position": place}, [camera.seen(CENTRE)])[0])
    (bare,) = seen(page, {}, [camera.seen(CENTRE)])
    front = shade([-a for a in camera.away], "device")
    # Its radius is 8 pixels, so half a pixel turns its normal by 1/16 along and across.
    off = 0.6 * math.hypot(1.0 / 16.0, 1.0 / 16.0) * max(COLOURS["device"]) + 2.0
    assert found[0][:3] == pytest.approx(front, abs=off)
    mixed = [0.4 * a + 0.6 * b for a, b in zip(front, bare[:3], strict=True)]
    assert found[1][:3] == pytest.approx(mixed, abs=off)


def test_the_ball_and_the_device_cast_shadows_straight_down(either: Page) -> None:
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    ground = either.evaluate("space.ground.at")
    low = CENTRE[2] - RADIUS
    assert ground == pytest.approx(low, abs=1e-3)
    # Within the ball's circle on the side that is seen, and well outside.
    under, aside = (
        [c + k * RADIUS * a for c, a in zip(CENTRE[:2], toward, strict=True)]
        for k, toward in (
            (0.9, (-camera.away[0], -camera.away[1])),
            (1.6, (-camera.away[0], -camera.away[1])),
        )
    )
    points = [camera.seen([*each, ground]) for each in (under, aside)]
    shaded, bare = seen(either, {}, points)
    # 0.72 of the light, of a ground that is at most 18 % darker on its lines.
    assert shaded[0] < 0.85 * bare[0]
    # The device, above that place: its shadow halves what is there, and a line leads to it.
    (below,) = seen(either, {"position": [*aside, 0.03]}, points[1:])
    assert below[0] < 0.7 * bare[0]
    # On the ball it falls on the ball.
    top = [*CENTRE[:2], CENTRE[2] + RADIUS]
    lit, dark = (
        seen(either, {"position": [*at, 0.06]}, [camera.seen(top)])[0]
        for at in (aside, CENTRE[:2])
    )
    assert dark[0] < 0.7 * lit[0]


def fine_ball(halvings: int) -> dict[str, Any]:
    """Return a ball of 20·4ⁿ triangles as a page reads a mesh."""
    corners = np.round(icosphere(halvings, RADIUS) + CENTRE, 9).reshape(-1, 3)
    first, which = first_of_equal(corners)
    patch = Patch(corners[first], which.reshape(-1, 3), flat=True, closed=True)
    return {"parts": [_part(patch)], "tool_radius": 0.0, "friction": 0.0}


def test_a_fine_mesh_is_closed_uploaded_once_and_drawn_in_one_call(
    lit: Browser,
) -> None:
    """81 920 triangles were drawn as confetti of every fifth."""
    shape = fine_ball(6)
    page = opened(lit, shape)
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    at, reach = camera.seen(CENTRE), camera.pixels * RADIUS
    inside = [
        (at[0] + u, at[1] + v)
        for u in range(-int(reach), int(reach), 2)
        for v in range(-int(reach), int(reach), 2)
        if math.hypot(u, v) < 0.99 * reach - 1.5
    ]
    assert all(alpha == 255 for *_, alpha in seen(page, {}, inside))
    calls = page.evaluate("""() => {
      const { gl } = space.lit, found = { uploads: 0, calls: [] };
      const { bufferData, drawElements } = gl;
      gl.bufferData = (...given) => { found.uploads++; bufferData.apply(gl, given); };
      gl.drawElements = (...given) => {
        found.calls.push(given[1] / 3);
        drawElements.apply(gl, given);
      };
      space.drawn = "";
      for (let k = 0; k < 3; k++) space.draw();
      Object.assign(gl, { bufferData, drawElements });
      return found; }""")
    # The mesh and the ground, once, though the device was drawn three times.
    assert calls == {"uploads": 0, "calls": [20 * 4**6, 2]}
    page.close()


def test_a_standing_camera_draws_no_solids_again_and_turning_ones_are_whole_at_rest(
    lit: Browser,
) -> None:
    """A processor drew and presented the whole picture for each move of the device."""
    page = opened(lit, fine_ball(6))
    places = [[0.01, 0.04, 0.05], [0.02, 0.03, 0.04], [CENTRE[0], CENTRE[1], 0.06]]
    found = page.evaluate(
        """places => {
      const { gl } = space.lit, found = { calls: 0, times: [] };
      const step = (position) => shown({ yaw: -0.4, pitch: 0.6, position });
      const pixels = () => {
        const copy = document.createElement("canvas"), g = copy.getContext("2d");
        [copy.width, copy.height] = [space.still.width, space.still.height];
        g.drawImage(space.still, 0, 0);
        return g.getImageData(0, 0, copy.width, copy.height).data;
      };
      step(places[0]);
      const drawn = ["drawElements", "drawArrays", "readPixels", "blitFramebuffer"];
      for (const name of drawn) gl[name] = (...given) => {
        found.calls++;
        Object.getPrototypeOf(gl)[name].apply(gl, given);
      };
      for (const position of places) step(position);
      found.standing = found.calls;
      const kept = pixels();
      space.drawn = "";
      step(places.at(-1));
      found.again = found.calls - found.standing;
      found.different = pixels().filter((each, k) => each !== kept[k]).length;
      return found; }""",
        places,
    )
    assert found["standing"] == 0
    assert found["again"] > 0
    assert found["different"] == 0
    # While it turns, less detail and fewer pixels; whole again once it rests.
    page.evaluate("shown({ yaw: -0.3, pitch: 0.6 })")
    assert page.evaluate("space.rough && space.lit.drawn !== space.lit.whole")
    assert page.evaluate("space.lit.into.width < space.still.width")
    page.evaluate("space.turned = -Infinity; space.draw()")
    assert not page.evaluate("space.rough || space.lit.drawn !== space.lit.whole")
    assert page.evaluate("space.lit.into.width === space.still.width")
    page.close()


def test_a_picture_that_stays_has_the_pixels_of_the_shader(page: Page) -> None:
    """Device, proxy, line and shadow of compose.js, against COMPOSE drawn by WebGL 2."""
    ball = [*CENTRE[:2], CENTRE[2] + RADIUS]
    places = [
        {"position": [*CENTRE[:2], 0.06]},
        {"position": CENTRE, "contact": 1, "proxy": ball, "normal": [0.0, 0.0, 1.0]},
        {"position": [CENTRE[0] - 0.05, CENTRE[1] - 0.05, 0.03]},
        {"position": [c + 3.0 * RADIUS for c in CENTRE]},
    ]
    for now in places:
        far, changed = page.evaluate(
            """now => {
          shown({ yaw: -0.4, pitch: 0.6, ...now });
          const { lit, still } = space, { kept, gl } = lit, { width, height } = still;
          const pixels = (from) => {
            const copy = document.createElement("canvas"), g = copy.getContext("2d");
            Object.assign(copy, { width, height });
            g.drawImage(from, 0, 0);
            // Colours times alpha: a faint one is known to fewer bits.
            const { data } = g.getImageData(0, 0, width, height);
            return Float32Array.from(data, (each, k) => (each * data[k | 3]) / 255);
          };
          const ours = pixels(still);
          lit.finish({ ...space.balls(true), device: null });
          const bare = pixels(still);
          Object.assign(gl.canvas, { width, height });
          Object.assign(lit, { kept: null, canvas: gl.canvas });
          lit.finish(space.balls(true));
          const theirs = pixels(gl.canvas), far = [];
          Object.assign(lit, { kept, canvas: still });
          space.draw();
          let changed = 0;
          theirs.forEach((each, k) => {
            if (Math.abs(each - ours[k]) > 3) far.push([k, each, ours[k]]);
            if (Math.abs(each - bare[k]) > 3) changed++;
          });
          return [far, changed]; }""",
            now,
        )
        # An edge that a pixel's middle hits may round to either side: one pixel of four bytes in a
        # hundred of those that changed.
        assert len(far) <= 0.01 * changed, far[:8]
        assert changed > 400


def test_a_surface_that_is_replaced_is_drawn_and_the_camera_stays_if_it_sees_it(
    lit: Browser,
) -> None:
    page = opened(lit, ball())
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    state = "[space.turn.reach, ...space.turn.middle]"
    seen(page, {}, [(0.0, 0.0)])
    before = page.evaluate(state)

    # The middle of the ball, and beside it.
    aside = [c - 0.8 * RADIUS * r for c, r in zip(CENTRE, camera.right, strict=True)]
    places = [camera.seen(CENTRE), camera.seen(aside)]
    page.evaluate("space.reshape({})")
    bare = seen(page, {}, places)
    assert page.evaluate(state) == before

    def covers(**given: Any) -> Any:
        surface = {"kind": "sphere", "position": CENTRE, "radius": RADIUS, **given}
        page.evaluate("shape => space.reshape(shape)", shape_of({"surface": surface}))
        # The shadow on the ground differs, too, but by less.
        colours = zip(seen(page, {}, places), bare, strict=True)
        return [math.dist(found, before) for found, before in colours]

    assert min(covers()) > 60.0
    within, beside = covers(radius=0.6 * RADIUS)
    assert within > 60.0 > beside
    assert page.evaluate(state) == before
    # Another place altogether.
    covers(position=[1.0, 0.0, 0.0])
    assert page.evaluate(state) != before
    page.close()


def test_a_replaced_shape_that_moves_keeps_the_camera_and_says_what_is_seen(
    lit: Browser,
) -> None:
    """Its first poses fitted the camera anew."""
    shape = ball()
    shape["parts"][0]["pose"] = 0
    page = opened(lit, shape)
    found = page.evaluate(
        """shape => {
      const upright = [1, 0, 0, 0, 1, 0, 0, 0, 1], found = { seen: [] };
      const pose = (x) => found.seen.push(space.pose([[x, 0, 0, ...upright]]));
      pose(0);
      shown({ yaw: -0.4, pitch: 0.6 });
      const sight = () => [space.turn.reach, ...space.turn.middle];
      found.before = sight();
      space.reshape(shape);
      found.between = sight();
      pose(0.001);
      found.after = sight();
      pose(0.001 + 0.1 / space.pixels);
      pose(0.002);
      space.reshape(shape);
      pose(1);
      found.far = sight();
      return found; }""",
        shape,
    )
    assert found["before"] == found["between"] == found["after"]
    assert found["far"] != found["before"]
    assert found["seen"] == [True, True, False, True, True]
    page.close()


def test_a_body_is_drawn_again_when_it_has_moved_by_what_a_picture_shows(
    lit: Browser,
) -> None:
    """Bodies at rest tremble by a micrometre, and each tremble drew the whole scene."""
    shape = ball()
    shape["parts"][0]["pose"] = 0
    page = opened(lit, shape)
    found = page.evaluate("""() => {
      const upright = [1, 0, 0, 0, 1, 0, 0, 0, 1], calls = [];
      let at = 0;
      const drawn = (pixels) => {
        at += pixels / space.pixels;
        space.pose([[at, 0, 0, ...upright]]);
        const { version } = space.solids;
        shown({ yaw: -0.4, pitch: 0.6 });
        return version;
      };
      space.pose([[0, 0, 0, ...upright]]);
      shown({ yaw: -0.4, pitch: 0.6 });
      // As coarse as turning was last.
      space.lit.kept.step = 4;
      const first = space.solids.version, steps = [0.1, 0.1, 0.1, 20].map(drawn);
      const share = space.lit.into.width / space.still.width;
      shown({ yaw: -0.3, pitch: 0.6 });
      return [steps.map((each) => each - first), share, space.solids.poses[0][0] / at,
        space.lit.into.width / space.still.width]; }""")
    # Tenths of a pixel count together, and what is felt is where it is.
    assert found[0] == [0, 0, 1, 2]
    assert found[2] == 1.0
    # Looked at, it is at most half as fine; a camera that turns may be coarser.
    assert found[1] >= 0.5 > found[3]
    page.close()


def test_without_webgl_a_fine_mesh_is_drawn_coarser_and_closed(lit: Browser) -> None:
    """Also when a browser takes WebGL away in the middle."""
    shape = fine_ball(5)
    page = opened(lit, shape)
    seen(page, {}, [(0.0, 0.0)])
    page.evaluate("space.lit.gl.getExtension('WEBGL_lose_context').loseContext()")
    page.wait_for_function("space.lit === null")
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    at, reach = camera.seen(CENTRE), camera.pixels * RADIUS
    # A cell of the grid is 1/77 of the width; corners move by half of it at most, inwards.
    inside = [
        (at[0] + reach * x, at[1] + reach * y)
        for x in np.linspace(-0.9, 0.9, 37)
        for y in np.linspace(-0.9, 0.9, 37)
        if math.hypot(x, y) < 0.93
    ]
    found = seen(page, {}, inside)
    # A hair between two polygons with smooth edges is no hole.
    assert all(alpha >= 245 for *_, alpha in found)
    count = page.evaluate(
        "[...space.picture.coarse.values()].map(({ faces }) => faces.length / 3)"
    )
    assert 1000 < count[0] <= 6000
    page.close()


def test_the_theme_and_a_parts_own_colour_are_seen(lit: Browser) -> None:
    shape = ball()
    shape["parts"][0]["colour"] = [1.0, 0.0, 0.5]
    page = opened(lit, shape)
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    (found,) = seen(page, {}, [camera.seen(CENTRE)])
    assert found[1] == 0
    assert found[2] == pytest.approx(0.5 * found[0], abs=1.0)
    ground = camera.seen([CENTRE[0] - 2.0 * RADIUS, CENTRE[1], CENTRE[2] - RADIUS])
    (day,) = seen(page, {}, [ground])
    page.evaluate("document.documentElement.dataset.theme = 'dark'")
    page.emulate_media(color_scheme="dark")
    page.wait_for_function("getComputedStyle(document.body).colorScheme === 'dark'")
    # The page hears of it by an event.
    wait_for(
        lambda: sum(seen(page, {}, [ground])[0][:3]) < 0.4 * sum(day[:3]),
        "the picture is as dark as the page",
    )
    page.close()


@pytest.mark.parametrize("key", ["s", "g", "v"])
def test_a_real_mouse_drags_along_what_was_chosen(page: Page, key: str) -> None:
    """A hand 4 mm deep in a ball without friction; its proxy is the nearest point of it."""
    page.evaluate(
        """([centre, radius]) => {
      space.letGo();
      Object.assign(globalThis, { moved: [], fed: () => {
        const at = space.held ?? globalThis.from, off = at.map((each, k) => each - centre[k]);
        const normal = off.map((each) => each / Math.hypot(...off));
        const proxy = centre.map((each, k) => each + radius * normal[k]);
        const distance = Math.hypot(...off) - radius;
        const now = { position: at, proxy, normal, target: at, distance };
        shown({ yaw: -0.4, pitch: 0.6, contact: Number(distance < 0), ...now });
      } });
    }""",
        [CENTRE, RADIUS],
    )
    camera = Camera(YAW, PITCH, WIDTH, HEIGHT)
    deep = RADIUS - 0.004
    # Towards the viewer and up, so that ground and surface are both seen from above.
    start = [c - deep * a for c, a in zip(CENTRE, camera.away, strict=True)]
    page.evaluate("from => { globalThis.from = from; fed(); }", start)
    page.locator("#space").focus()
    page.keyboard.press(key)
    u, v = camera.seen(start)
    page.mouse.move(WIDTH / 2 + u, HEIGHT / 2 + v)
    page.mouse.down()
    for _ in range(20):
        u, v = u + 2.0, v + 1.0
        page.mouse.move(WIDTH / 2 + u, HEIGHT / 2 + v)
        # As frames come: the proxy follows, and the target with it.
        page.evaluate("() => { for (let k = 0; k < 20; k++) fed(); }")
    held = page.evaluate("space.held")
    across = [h - s for h, s in zip(held, start, strict=True)]
    if key == "s":
        assert math.dist(held, CENTRE) == pytest.approx(deep, abs=1e-6)
        assert math.dist(held, start) > 0.2 * RADIUS
    else:
        assert camera.seen(held) == pytest.approx((u, v), abs=1.1)
        normal = (0.0, 0.0, 1.0) if key == "g" else camera.away
        assert sum(a * b for a, b in zip(across, normal, strict=True)) == pytest.approx(
            0.0, abs=1e-12
        )
    # The wheel moves it in depth: into the surface, down, or away.
    before = page.evaluate("[...space.held]")
    page.mouse.wheel(0.0, -100.0)
    page.wait_for_function(
        "before => Math.hypot(...space.held.map((each, k) => each - before[k])) > 1e-6",
        arg=before,
    )
    page.evaluate("fed()")
    pushed = page.evaluate("space.held")
    step = [p - b for p, b in zip(pushed, before, strict=True)]
    inward = [
        (c - b) / math.dist(CENTRE, before) for c, b in zip(CENTRE, before, strict=True)
    ]
    way = {"s": inward, "g": (0.0, 0.0, -1.0), "v": camera.away}[key]
    assert step == pytest.approx([100.0 * 2e-5 * w for w in way], abs=1e-9)
    page.mouse.up()
    assert page.evaluate("space.held") is None


@pytest.mark.process
def test_a_handle_that_moves_is_taken_where_it_was_seen(page: Page) -> None:
    """Half a second ago at most; a press elsewhere, or later, turns the camera."""
    page.evaluate(
        """() => {
      space.letGo();
      globalThis.fed = (t, position) =>
        shown({ yaw: -0.4, pitch: 0.6, t, position, target: position });
    }"""
    )
    camera, start, on = Camera(YAW, PITCH, WIDTH, HEIGHT), CENTRE, [0.03, 0.0, 0.0]
    gone = [c + step for c, step in zip(start, on, strict=True)]
    u, v = camera.seen(start)
    assert math.dist((u, v), camera.seen(gone)) > 40.0
    for late, taken in ((0.499, "hand"), (0.501, "camera")):
        page.evaluate("from => fed(10, from)", start)
        page.evaluate("([late, to]) => fed(10 + late, to)", [late, gone])
        page.mouse.move(WIDTH / 2 + u, HEIGHT / 2 + v)
        page.mouse.down()
        assert page.evaluate("space.by") == taken
        # It is held where it is, not where it was.
        assert page.evaluate("space.held") == (gone if taken == "hand" else None)
        page.mouse.up()
        page.evaluate("space.trace.length = 0")
