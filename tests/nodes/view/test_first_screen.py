"""The first screen in a real browser: question, dial, hand, and beyond the limit."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from sim.measure.haptic_commands import within
from tests.support.browser import OpenPage, bins, needs_browser, shown, url_of
from tests.support.launching import Running, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = needs_browser

SIZES = [
    (1366, 768),
    (390, 844),
    (844, 390),
    (320, 568),
    (568, 320),
    (1024, 768),
    (1920, 1080),
    (683, 384),
    (3840, 2160),
]
"""A laptop, two phones in both orientations, a tablet, a large screen, 200 %, 4K."""


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(
        tmp_path_factory.mktemp("first"), "touch_wall", "--view", "--without", "logger"
    ) as found:
        yield found


@pytest.fixture(scope="module")
def opened(browser: Browser, launch: Running) -> Iterator[Page]:
    with OpenPage(browser, url_of(launch)) as found:
        yield found


@pytest.fixture
def page(opened: Page) -> Page:
    """Return the shared page as first seen, with the lab closed and no refusal."""
    opened.evaluate(
        "document.getElementById('lab').open = false; document.getElementById('refusal').hidden ="
        " true; scrollTo(0, 0)"
    )
    return opened


def target(launch_page: Page) -> float:
    return float(launch_page.evaluate("haptic.scene.now.target[haptic.scene.axis]"))


def turn(page: Page, part: float) -> None:
    """Turn the dial to a fraction, like a finger."""
    script = """part => { const dial = document.getElementById("dial");
      dial.value = 1000 * part;
      for (const kind of ["input", "change"]) dial.dispatchEvent(new Event(kind)); }"""
    page.evaluate(script, part)


def handle(page: Page) -> tuple[float, float]:
    """Return the handle's position on the screen."""
    box: Any = page.locator("#scene").bounding_box()
    u = float(
        page.evaluate(
            "(haptic.scene.now.target[0] - haptic.scene.middle) * haptic.scene.scale()"
        )
    )
    return box["x"] + box["width"] / 2 + u, box["y"] + box["height"] / 2 + 30.0


# A test with a launch of its own comes first: the one that is shared, and its page, would only go
# on beside it.


@pytest.mark.slow
def test_a_page_past_the_edge_needs_a_virtual_device_that_allows_it(
    browser: Browser, tmp_path: Path
) -> None:
    words = ("wall_press", "duration:=0", "--view", "--without", "logger")
    with running(tmp_path, *words) as launch, OpenPage(browser, url_of(launch)) as page:
        wait_for(lambda: page.evaluate("haptic.dial.edge") is not None, "the edge")
        assert not page.locator("#beyond").is_visible()
        assert page.evaluate("haptic.dial.ends()[1] < haptic.dial.edge"), (
            "the dial ends at the edge"
        )
        before = launch.call("coupling", "law.show")["stiffness"]
        # The page is not asked whether it may: the node's side decides.
        page.evaluate("haptic.laws.change('stiffness', 1e6, true)")
        wait_for(
            lambda: "only a virtual device may" in shown(page, "#refusal"),
            "the refusal",
        )
        assert launch.call("coupling", "law.show")["stiffness"] == before


@pytest.mark.slow
def test_scene_and_force_share_the_first_screen(page: Page) -> None:
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("document.getElementById('refusal').hidden = true")

        def is_narrow(width: int = width) -> bool:
            return bool(page.evaluate("document.documentElement.scrollWidth") <= width)

        # Its pictures get the new width with the next frame.
        wait_for(is_narrow, f"all of it is as wide as the screen of {width} × {height}")
        scene: Any = page.locator("#scene").bounding_box()
        assert scene["height"] >= 150.0, (width, height)

        def fits(height: int = height) -> bool:
            strip: Any = page.locator("#strip").bounding_box()
            return bool(strip["y"] + strip["height"] <= height)

        # On a busy machine the sentence above tells of late forces for a moment, in a line more.
        wait_for(fits, f"the force is on the screen of {width} × {height}")
        assert not page.locator("#laws").is_visible(), "the rest is folded away"
        assert page.locator("#lens").is_visible(), (width, height)
        dial: Any = page.locator("#dial").bounding_box()
        assert dial["y"] + dial["height"] <= height, (width, height)
        # However long a refusal is, it lies over nothing, and what it is about stays in sight.
        page.evaluate(
            "haptic.laws.refuse({ error: 'a reason that takes many lines, '.repeat(12) })"
        )
        told: Any = page.locator("#refusal").bounding_box()
        moved: Any = page.locator("#dial").bounding_box()
        assert told["y"] + told["height"] <= moved["y"], (width, height)
        assert moved["y"] + moved["height"] <= height, (width, height)
    page.evaluate("document.getElementById('refusal').hidden = true")
    page.set_viewport_size({"width": 1366, "height": 768})


@pytest.mark.process
def test_numbers_and_names_are_written_one_way(page: Page) -> None:
    found = page.evaluate(
        """async () => {
      const { fixed, figure, rough, count, digits } = await import("./format.js");
      return [fixed(-0.001, 2), fixed(-1.25, 1), figure(4470.4), figure(0.0123),
        figure(3.5e-130), count(1, "tick"), count(2, "tick"), fixed(0.2, digits(0.2)),
        rough(40), rough(39.6), rough(4.04), rough(1), rough(0.05), rough(4893),
        rough(null)]; }"""
    )
    assert found == [
        "0.00",
        "\u22121.3",
        "4\u202f470",
        "0.0123",
        "3.50e\u2212130",
        "1\u00a0tick",
        "2\u00a0ticks",
        "0.2",
        "40",
        "40",
        "4.0",
        "1.0",
        "0.050",
        "4\u202f900",
        "–",
    ]
    # Number and unit stay on one line, here as in every sentence.
    broken = r"/\d (N|mJ|mm|ms|ticks?|s|µs|Hz)\b/.test(document.body.innerText)"
    assert not page.evaluate(broken)
    join = "async (text) => (await import('./format.js')).unbroken(text)"
    sentence = page.evaluate(join, "10 N 6 times within 0.25 s, 31.8 mJ; 3 N/m")
    assert (
        sentence
        == "10\u00a0N 6\u00a0times within 0.25\u00a0s, 31.8\u00a0mJ; 3\u00a0N/m"
    )
    offered = page.evaluate(
        "[...document.querySelectorAll('#laws input, #laws option')].map((e) => e.value)"
    )
    assert "pd" in offered
    assert "excitation" not in offered
    page.evaluate("document.getElementById('lab').open = true")
    page.evaluate("haptic.laws.choose('multi_term')")
    wait_for(
        lambda: "multi" in str(page.evaluate("haptic.laws.state.active")), "the law"
    )
    labels = page.locator("#sliders").inner_text()
    assert "[0]" not in labels
    page.evaluate("haptic.laws.choose('pd')")


@pytest.mark.process
def test_a_frame_without_a_force_costs_no_arrow(page: Page) -> None:
    """The first tick of a run has no force yet, and recordings begin with it."""
    scale = page.evaluate(
        """() => { const { scene } = haptic, none = [NaN, NaN, NaN];
      const nothing = { ...scene.now, asked: none, force: none };
      scene.show(nothing); scene.show({ ...scene.now, asked: [3, 0, 0], force: [3, 0, 0] });
        return scene.forceScale; }"""
    )
    assert scale >= 3.0


@pytest.mark.slow
def test_the_numbers_of_a_plot_are_as_large_on_a_fine_screen(
    browser: Browser, launch: Running
) -> None:
    with OpenPage(browser, url_of(launch) + "#lab", device_scale_factor=2.0) as page:
        # uPlot multiplies the pixels of a font; a part of a pixel it takes for the whole.
        assert page.evaluate("haptic.plots.panels[0].plot.axes[0].font[0]").startswith(
            "24px"
        )


@pytest.mark.process
def test_a_refused_slider_goes_back_to_what_renders(
    page: Page, launch: Running
) -> None:
    launch.call("coupling", "law.switch", law="pd")
    page.evaluate("document.getElementById('lab').open = true")
    slider = page.locator("input[type=range][aria-label=stiffness]")
    wait_for(lambda: slider.count() == 1, "the sliders")
    before = launch.call("coupling", "param.get", name="laws.pd.stiffness")
    script = """element => { element.value = 1000;
      for (const kind of ["input", "change"]) element.dispatchEvent(new Event(kind)); }"""
    wait_for(lambda: page.evaluate("haptic.laws.edge") is not None, "the edge")

    def is_refused() -> bool:
        # A stalled machine may lose the page's connection before the answer.
        slider.evaluate(script)
        told = page.locator("#refusal").is_visible() and shown(page, "#refusal")
        return "largest stiffness that is accepted" in (told or "")

    wait_for(is_refused, "it is refused")
    number = page.locator("input[aria-label='stiffness, exact value']")
    wait_for(
        lambda: float(number.input_value()) == pytest.approx(before, rel=1e-5),
        "what renders",
    )
    wait_for(
        lambda: page.locator(".slider.refused").count() == 0, "a valid value is not red"
    )
    number.fill(str(before * 1.01))
    page.keyboard.press("Enter")
    wait_for(
        lambda: not page.locator("#refusal").is_visible(),
        "nor does a refusal stand beside it",
    )
    launch.call("coupling", "param.set", values={"laws.pd.stiffness": before})


# The launch file's own touch is over by now; whoever takes the hand comes after the test of the one
# that nobody took.


@pytest.mark.slow
def test_until_somebody_takes_it_the_hand_taps_and_asks_to_be_pulled(
    page: Page, launch: Running
) -> None:
    assert page.evaluate("haptic.scene.hand"), "the first picture has a hand"
    begun = launch.ticks()
    seen: list[int] = []

    def tapped() -> bool:
        if float(launch.call("driver", "progress")["force_n"][0]) < -0.2:
            seen.append(launch.ticks())
        # Beside the launch file's own touch at its beginning, which is over by then.
        return seen != [] and seen[-1] > max(begun, 1300) + 1500

    wait_for(tapped, "it taps, and taps again")
    assert page.evaluate("!haptic.scene.grip.used")


@pytest.mark.process
def test_the_handle_does_not_jump_and_stays_in_the_hand(
    page: Page, launch: Running
) -> None:
    x, y, held = 0.0, 0.0, math.inf
    # On a slow machine it taps once more between where it was seen and where it is taken.
    for _ in range(5):
        page.mouse.up()
        wait_for(
            lambda: abs(target(page)) < 1e-4 and launch.ticks() > 1300, "the hand rests"
        )
        x, y = handle(page)
        page.mouse.move(x + 20.0, y)
        page.mouse.down()
        wait_for(lambda: page.evaluate("haptic.scene.held !== null"), "it is taken")
        held = abs(float(page.evaluate("haptic.scene.held")))
        if held < 5e-4:
            break
    assert held < 5e-4, "taken beside its middle it stays where it is"
    page.mouse.move(x + 60.0, y)

    def arrived() -> float:
        found, before = target(page), bins(page)
        wait_for(lambda: bins(page) > before + 50, "some time passes")
        return found if found > 5e-4 and abs(target(page) - found) < 1e-5 else 0.0

    # It comes at a limited speed, a millimetre a tick.
    moved = wait_for(arrived, "it follows")
    wait_for(
        lambda: page.evaluate("haptic.lag.forces.length > 0"),
        "hand to force is measured",
    )
    assert (
        0.0 <= page.evaluate("haptic.lag.force") <= page.evaluate("haptic.lag.median")
    ), "the force is there before the picture"
    # Keys to another place let go of the keyboard's hand, not of the mouse's.
    page.keyboard.press("Tab")
    before = bins(page)
    wait_for(lambda: bins(page) > before + 300, "some time passes")
    assert target(page) == pytest.approx(moved, abs=2e-3)
    assert page.evaluate("haptic.scene.held !== null")
    page.mouse.up()
    wait_for(lambda: abs(target(page)) < 1e-4, "it is let go")
    # From afar it comes gliding: a step per frame, no jump.
    box: Any = page.locator("#scene").bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.75, y)
    page.evaluate(
        "addEventListener('pointerdown', () => { window.taken = haptic.scene.held; }, { once:"
        " true })"
    )
    page.mouse.down()
    assert abs(float(page.evaluate("window.taken"))) < 0.016
    wait_for(lambda: not page.evaluate("haptic.scene.grip.gliding"), "it arrives")
    page.mouse.up()


@pytest.mark.slow
def test_the_delay_is_turned_and_the_way_to_the_edge_is_drawn(
    page: Page, launch: Running
) -> None:
    launch.call("coupling", "law.switch", law="pd")
    wait_for(
        lambda: page.evaluate("haptic.delay.edge !== null && haptic.delay.ticks === 0"),
        "the edge over the delay",
    )
    script = """part => { const slider = document.getElementById("delay");
      slider.value = 400 * part;
      for (const kind of ["input", "change"]) slider.dispatchEvent(new Event(kind)); }"""
    before = float(page.evaluate("haptic.dial.edge"))
    # The device's own delay is a part of the one that each map was drawn for, of one that comes
    # late too.
    page.evaluate(
        """() => { const { map } = haptic, draw = map.draw; window.rest = [];
      map.draw = function () { window.rest.push(this.map.delay_ticks - this.own);
        return draw.call(this); }; }"""
    )
    page.evaluate(script, 0.4)
    turned = wait_for(
        lambda: float(launch.call("driver", "param.get", name="device.delay")),
        "the device answers later",
    )
    wait_for(
        lambda: page.evaluate("haptic.map.own") == turned, "the map for that delay"
    )
    wait_for(
        lambda: page.evaluate("haptic.dial.edge") < before, "the edge to come down"
    )
    assert "ticks of" in shown(page, "#delay-told")
    # The dot of the right-hand panel stands at the delay of the whole loop, and is a handle.
    wait_for(
        lambda: (
            page.evaluate("haptic.map.frame.far")
            > page.evaluate("haptic.map.map.delay_ticks")
        ),
        "it is inside",
    )
    box: Any = page.locator("#map").bounding_box()
    at = """() => { const { map: { delay_ticks: d, k_n_per_m: k }, frame } = haptic.map;
      const { begin, last, far, bottom, top, most } = frame;
      return [begin + d / far * (last - begin), bottom - k / most * (bottom - top),
        haptic.map.own * (last - begin) / far]; }"""
    u, v, own = page.evaluate(at)
    page.mouse.move(box["x"] + u, box["y"] + v)
    page.mouse.down()
    page.mouse.move(box["x"] + u - own, box["y"] + v, steps=3)
    page.mouse.up()
    wait_for(
        lambda: (
            float(launch.call("driver", "param.get", name="device.delay"))
            < 0.3 * turned
        ),
        "dragged back",
    )
    page.evaluate("delete haptic.map.draw")
    assert min(page.evaluate("window.rest")) >= 0.0
    # The other dot, along stiffness and damping: a trail stays where one was.
    k, begun = page.evaluate("[haptic.map.map.k_n_per_m, haptic.map.trail.length]")

    def softer() -> bool:
        # The map of the delay that was dragged back may come meanwhile, and has another scale.
        dot = """() => { const { map, frame } = haptic.map, { left, end, right, bottom, top,
          most } = frame;
          return [left + map.b_n_s_per_m / right * (end - left),
            bottom - map.k_n_per_m / most * (bottom - top)]; }"""
        box: Any = page.locator("#map").bounding_box()
        u, v = page.evaluate(dot)
        page.mouse.move(box["x"] + u, box["y"] + v)
        page.mouse.down()
        page.mouse.move(
            box["x"] + u, box["y"] + v + 0.4 * (box["height"] - 30.0 - v), steps=3
        )
        page.mouse.up()
        return bool(
            within(
                lambda: float(page.evaluate("haptic.map.map.k_n_per_m")) < 0.8 * k, 5.0
            )
        )

    wait_for(softer, "softer")
    trail = page.evaluate("haptic.map.trail")
    assert len(trail) > begun
    left = [each for each in trail[begun:] if each == pytest.approx([3.0, k], rel=0.02)]
    assert left, "where it was"
    # Drawn with the trail and without it, and the dot out of the way, which may be near.
    drawn = """([b, k]) => { const it = haptic.map, { canvas, trail, map } = it;
      const seen = (trail) => {
        Object.assign(it, { trail, map: { ...map, b_n_s_per_m: 0 } }).draw();
        const { left, end, right, bottom, top, most } = it.frame;
        const place = [left + b / right * (end - left), bottom - k / most * (bottom - top)];
        const [u, v] = place.map((each) => Math.round(each * devicePixelRatio));
        return [...canvas.getContext("2d").getImageData(u, v, 1, 1).data];
      };
      const both = [[], trail].map(seen);
      Object.assign(it, { map }).draw();
      return both; }"""
    (red_below, _, blue_below, _), (red, _, blue, _) = page.evaluate(drawn, left[0])
    assert blue - red > blue_below - red_below + 5, "in the device's colour"
    launch.call("driver", "param.set", values={"device.delay": 0.0})
    launch.call(
        "coupling",
        "param.set",
        values={"plant.device_delay": 0.0, "laws.pd.stiffness": 1000.0},
    )


@pytest.mark.process
def test_a_finger_is_a_hand(browser: Browser, launch: Running) -> None:
    phone = {
        "viewport": {"width": 390, "height": 844},
        "has_touch": True,
        "is_mobile": True,
    }
    with OpenPage(browser, url_of(launch), **phone) as page:
        wait_for(
            lambda: abs(target(page)) < 1e-4 and launch.ticks() > 1300, "the hand rests"
        )
        x, y = handle(page)
        finger = page.context.new_cdp_session(page)

        def touch(kind: str, *points: tuple[float, float]) -> None:
            there = [{"x": u, "y": v} for u, v in points]
            finger.send(
                "Input.dispatchTouchEvent", {"type": kind, "touchPoints": there}
            )

        touch("touchStart", (x, y))
        for k in range(1, 9):
            touch("touchMove", (x + 15.0 * k, y))
        wait_for(lambda: target(page) > 5e-3, "it follows the finger")
        assert page.evaluate("scrollY") == 0
        touch("touchEnd")
        wait_for(lambda: abs(target(page)) < 1e-4, "it is let go")


@pytest.mark.process
def test_past_the_edge_it_rings_is_stopped_shown_slowly_and_goes_on(
    page: Page, launch: Running
) -> None:
    launch.call("driver", "param.set", values={"device.delay": 0.0})
    launch.call(
        "coupling",
        "param.set",
        values={"plant.device_delay": 0.0, "laws.pd.stiffness": 1000.0},
    )
    launch.call("coupling", "law.switch", law="pd")
    wait_for(lambda: page.evaluate("haptic.dial.edge") is not None, "the edge")

    def at_the_end() -> bool:
        # The edge comes down with the delay of a busy machine, and the coupling refuses what was
        # below it a moment ago.
        turn(page, 1.0)
        return bool(
            within(
                lambda: (
                    0.8
                    < page.evaluate("haptic.dial.stiffness / haptic.dial.edge")
                    < 1.0
                ),
                2.0,
            )
        )

    wait_for(at_the_end, "as far as it is stable, and no further")
    page.locator("#beyond").check()
    x, y = handle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    for part in [0.8] + 40 * [1.0]:
        turn(page, part)
        page.mouse.move(x + 450.0, y, steps=2)
        page.mouse.move(x + 700.0, y, steps=2)
        if "Too hard" in shown(page, "#words"):
            break
        time.sleep(0.1)
    wait_for(
        lambda: "6 strokes to the limit of 10 N" in shown(page, "#words"),
        "the driver stops it, and says why",
    )
    page.mouse.up()
    # A page that has lost its connection meanwhile has none until the bins of the stop have come
    # again.
    begun = "(({ sight, at } = {}) => sight && [sight, at])(haptic.slow.window() ?? undefined)"
    sight, at = wait_for(lambda: page.evaluate(begun), "slow motion")
    assert 0.3 <= sight[1] - sight[0] < 2.0
    assert sight[0] <= at <= sight[1]
    wait_for(
        lambda: page.evaluate("haptic.slow.window()?.at ?? 0") > at,
        "it goes on, slowly",
    )
    forces = page.evaluate(
        "[...Array(300).keys()].map((k) => haptic.slow.now(haptic.slow.window().sight[0] + k /"
        " 1000).force[0])"
    )
    assert max(map(abs, forces)) == pytest.approx(10.0), (
        "the moments at the limit are in it"
    )
    assert "driver stopped it" in shown(page, "#margin")
    page.locator("#again").click()
    wait_for(lambda: "No force: nothing is touched" in shown(page, "#words"), "again")
    assert (
        float(launch.call("coupling", "param.get", name="laws.pd.stiffness")) < 4000.0
    )
    # Whoever takes the permission back beyond the edge is brought below it: the page has heard that
    # it is below already.
    wait_for(
        lambda: page.evaluate("!haptic.dial.isPast(haptic.dial.stiffness)"),
        "the dial is below the edge",
    )
    page.locator("#beyond").uncheck()


@pytest.mark.process
def test_what_is_changed_while_the_driver_is_started_again_comes_to_the_page(
    page: Page, launch: Running
) -> None:
    """A driver that died during the request cost the page all later changes."""
    launch.call("coupling", "law.switch", law="pd")
    driver = launch.call("driver", "status")["pid"]
    os.kill(driver, signal.SIGSTOP)
    told = page.locator("#log li").count()
    launch.call("coupling", "param.set", values={"laws.pd.stiffness": 950.0})
    wait_for(
        lambda: page.locator("#log li").count() > told, "the page to hear of the change"
    )
    os.kill(driver, signal.SIGKILL)
    wait_for(
        lambda: page.evaluate("haptic.dial.stiffness") == 950.0, "the new stiffness"
    )
    wait_for(
        lambda: "No force: nothing is touched" in shown(page, "#words"),
        "the driver is back",
    )
    # It answers before it ticks, and takes up what it is asked when it does.
    launch.wait_ticks(20)
