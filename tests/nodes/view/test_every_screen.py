"""Pages without a server on every screen, by keyboard and touch, in light and dark."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from nodes.view.replay_file import export_html
from sim.static_page.site import write_site
from tests.support.browser import OpenPage, needs_browser, url_of
from tests.support.launching import running, wait_for
from tests.support.recorded import PERIOD, PUBLISHES, drop

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.process]

SCREENS: dict[str, dict[str, Any]] = {
    "a large screen": {"viewport": {"width": 1920, "height": 1080}},
    "a laptop": {"viewport": {"width": 1366, "height": 768}},
    "a laptop at 200 %": {
        "viewport": {"width": 683, "height": 384},
        "device_scale_factor": 2,
    },
    "a tablet": {"viewport": {"width": 820, "height": 1180}, "has_touch": True},
    "a phone": {
        "viewport": {"width": 390, "height": 780},
        "has_touch": True,
        "is_mobile": True,
    },
    "a phone on its side": {
        "viewport": {"width": 780, "height": 360},
        "has_touch": True,
        "is_mobile": True,
    },
}

WRONG = """() => {
  const coarse = matchMedia("(pointer: coarse)").matches, found = [];
  for (const each of document.querySelectorAll("button, select, summary, input, output, h2")) {
    if (!each.checkVisibility({ visibilityProperty: true })) continue;
    const name = each.id || each.outerHTML.slice(0, 80), button = each.matches("button, output");
    const place = each.matches("[type=checkbox], [type=radio]") ? each.closest("label") : each;
    const { left, right, width, height } = place.getBoundingClientRect();
    if (left < -0.5 || right > innerWidth + 0.5) found.push(`${name} lies beside the screen`);
    if (button && each.clientWidth && each.scrollWidth > each.clientWidth + 1)
      found.push(`${name} is cut`);
    if (coarse && !each.matches("output, h2") && Math.min(width, height) < 39.9)
      found.push(`${name} is small: ${width} × ${height}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push("it scrolls sideways");
  return found;
}"""
"""Controls of a page that lie beside the screen, are cut, or are too small for a finger."""

CONTRASTS = """() => {
  const linear = (c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const brush = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    brush.clearRect(0, 0, 1, 1);
    brush.fillStyle = colour;
    brush.fillRect(0, 0, 1, 1);
    return Array.from(brush.getImageData(0, 0, 1, 1).data, (part) => part / 255);
  };
  const over = ([r, g, b, a], under) => [r, g, b].map((x, i) => a * x + (1 - a) * under[i]);
  const contrast = (each) => {
    const above = [];
    for (let at = each; at; at = at.parentElement) above.unshift(getComputedStyle(at));
    let ground = [1, 1, 1], opacity = 1;
    for (const style of above) {
      opacity *= Number(style.opacity);
      ground = over(rgba(style.backgroundColor), ground);
    }
    const [r, g, b, a] = rgba(above.at(-1).color);
    const pair = [light(over([r, g, b, a * opacity], ground)), light(ground)];
    const [bright, dark] = pair.sort((x, y) => y - x);
    return (bright + 0.05) / (dark + 0.05);
  };
  const texts = new Set(document.querySelectorAll("select, [type=number], [type=text]"));
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    if (walker.currentNode.textContent.trim()) texts.add(walker.currentNode.parentElement);
  }
  return [...texts]
    .filter((each) => each.checkVisibility() && !each.closest("script, option, .unseen"))
    .filter((each) => !each.closest("[inert], :disabled"))
    .map((each) => [each.id || each.textContent.trim().slice(0, 30), contrast(each)])
    .filter(([, found]) => found < 4.5);
}"""
"""All texts whose contrast is below 4.5, the least for their size (WCAG 2.1, 1.4.3)."""

EVERY_STATE = """() => {
  document.querySelector("#tour-begin").click();
  document.querySelector("#lab").open = true;
  const remedies = [{ kind: "at_most", values: { "laws.pd.stiffness": 5797 } }];
  haptic.laws.refuse({ error: "pd: the loop would be unstable", remedies }, { error: "No." });
  for (const id of ["notice", "over", "again", "once-more", "record", "stop", "sung", "live"]) {
    const each = document.getElementById(id);
    each.hidden = false;
    if (!each.textContent.trim()) each.textContent = "Said here";
  }
  document.querySelector("#over-told").textContent = "It has ended. Recorded: /a/b/c.mcap.";
  document.querySelector("#stop").classList.add("sure");
  document.querySelector("#record").setAttribute("aria-pressed", "true");
  document.querySelector("#hardness").classList.add("bad");
  document.querySelector("#figures dd").classList.add("bad");
  const row = (kind) =>
    `<li class="${kind}"><time>1.0 s</time><span>${kind} <small>why</small></span>`;
  const kinds = ["refused", "fallback", "event", "receipt"];
  document.querySelector("#log").innerHTML += kinds.map(row).join("");
  document.querySelector("#nodes").innerHTML +=
    '<li class="silent">one</li><li class="ended">two</li>';
}"""
"""Shows what a page says only now and then."""

LIVE_SCREENS: dict[str, dict[str, Any]] = {
    "360": {
        "viewport": {"width": 360, "height": 740},
        "has_touch": True,
        "is_mobile": True,
    },
    "768": {"viewport": {"width": 768, "height": 1024}, "has_touch": True},
    "1280": {"viewport": {"width": 1280, "height": 800}},
    "1280 at 200 %": {
        "viewport": {"width": 640, "height": 400},
        "device_scale_factor": 2,
    },
    "1920": {"viewport": {"width": 1920, "height": 1080}},
}


@pytest.fixture(scope="module")
def urls(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("pages")
    write_site(folder / "site", ["touch_wall", "sphere_feel"])
    path = folder / "drop.mcap"
    manifest = {"scenario": "drop", "axes": "z", "rate_hz": str(1.0 / PERIOD)}
    with RecordWriter(path, {**manifest, "publishes": PUBLISHES}) as writer:
        for topic, message in drop(3000, switch=1200):
            writer.write(topic, message, message.stamp + 1e-4)
    (page,) = export_html(Recording(path), folder / "drop.html")
    return {
        "scenario": f"file://{folder}/site/index.html",
        "recording": f"file://{page}",
    }


@pytest.fixture(params=["scenario", "recording"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def _open_lab(page: Page) -> None:
    page.locator("#lab > summary").click()
    wait_for(lambda: page.evaluate("haptic.plots.panels.length > 0"), "the plots")


@pytest.mark.parametrize("screen", SCREENS)
def test_all_of_it_can_be_reached_on_every_screen(
    browser: Browser, urls: dict[str, str], kind: str, screen: str
) -> None:
    for scheme in ("light", "dark"):
        context = {**SCREENS[screen], "color_scheme": scheme}
        with OpenPage(browser, urls[kind], **context) as page:
            assert page.evaluate(WRONG) == []
            # Without scrolling: the scene, its force, and what turns the wall or the time.
            seen = ["#scene", "#strip", "#dial"]
            if kind == "recording":
                seen = ["#scene", "#play"]
            height = page.evaluate("innerHeight")
            for name in seen:
                box: Any = page.locator(name).bounding_box()
                assert box["y"] >= 0.0, name
                assert box["y"] + box["height"] <= height + 1.0, name
            _open_lab(page)
            assert page.evaluate(WRONG) == []
            assert page.evaluate(CONTRASTS) == []


def test_every_text_and_control_of_a_live_page_suits_eyes_and_fingers(
    browser: Browser, tmp_path: Path
) -> None:
    """Also what it says now and then: a refusal, an end, a pressed button, a silent node."""
    with running(tmp_path, "touch_wall", "--view", "--without", "logger") as launch:
        for screen, scheme in product(LIVE_SCREENS, ("light", "dark")):
            context = {**LIVE_SCREENS[screen], "color_scheme": scheme}
            with OpenPage(browser, url_of(launch), **context) as page:
                wait_for(partial(page.evaluate, "haptic.dial.edge"), "the edge")
                for state in ("", EVERY_STATE):
                    if state:
                        page.evaluate(state)
                    found = page.evaluate(WRONG) + page.evaluate(CONTRASTS)
                    assert found == [], (screen, scheme, bool(state))


def test_the_keyboard_reaches_all_and_shows_where_it_is(
    browser: Browser, urls: dict[str, str], kind: str
) -> None:
    with OpenPage(browser, urls[kind]) as page:
        reached: list[str] = []
        for _ in range(40):
            page.keyboard.press("Tab")
            found = page.evaluate(
                "(() => { const e = document.activeElement, s = getComputedStyle(e),"
                " t = getComputedStyle(e.closest('.track') ?? e);"
                " return [e.id, s.outlineStyle !== 'none' || t.outlineStyle !== 'none']; })()"
            )
            if found[0] in reached:
                break
            assert found[1] or found[0] == "", found
            reached.append(found[0])
        wanted = {
            "scenario": {
                "dial",
                "beyond",
                "sing",
                "scene",
                "python",
                "restart",
                "delay",
            },
            "recording": {"play", "seek", "speed", "share", "sound"},
        }
        assert wanted[kind] <= set(reached)


def test_the_keyboard_plays_a_recording(browser: Browser, urls: dict[str, str]) -> None:
    with OpenPage(browser, urls["recording"]) as page:
        page.keyboard.press("Space")
        wait_for(lambda: page.locator("#play").text_content() == "Play", "it stands")
        page.keyboard.press("End")
        page.wait_for_function("Math.abs(haptic.scene.now.t - 5.998) < 1e-9")
        page.keyboard.press("ArrowLeft")
        page.wait_for_function("Math.abs(haptic.scene.now.t - 4.998) < 1e-9")
        page.keyboard.press("Home")
        page.wait_for_function("haptic.scene.now.t === 0")
        # On the slider itself one press is one tick, and it stays there.
        page.locator("#seek").focus()
        page.keyboard.press("ArrowRight")
        page.wait_for_function("haptic.scene.now.t === 0.002")
        assert page.locator("#play").text_content() == "Play"


def test_time_does_not_run_away_from_the_slider(
    browser: Browser, urls: dict[str, str]
) -> None:
    """While it is pulled, time stands; let go, it plays on from there, but not past the end."""
    with OpenPage(browser, urls["recording"]) as page:
        box: Any = page.locator("#seek").bounding_box()
        y = box["y"] + box["height"] / 2

        def at(part: float) -> float:
            return float(box["x"] + part * box["width"])

        page.mouse.move(at(0.3), y)
        page.mouse.down()
        page.mouse.move(at(0.5), y, steps=12)
        value = "Number(document.getElementById('seek').value)"
        page.wait_for_function(f"Math.abs(haptic.scene.now.t - {value}) < 1e-9")
        t = float(page.evaluate("haptic.scene.now.t"))
        assert t == pytest.approx(3.0, abs=0.05)
        # Twenty pictures later it is still there.
        page.evaluate(
            "() => new Promise((done) => { let n = 0;"
            " const next = () => ++n > 20 ? done() : requestAnimationFrame(next); next(); })"
        )
        assert page.evaluate("haptic.scene.now.t") == t
        page.mouse.up()
        page.wait_for_function(f"haptic.scene.now.t > {t} + 0.1")
        page.mouse.move(at(0.6), y)
        page.mouse.down()
        page.mouse.move(at(1.2), y, steps=4)
        page.mouse.up()
        page.wait_for_function("Math.abs(haptic.scene.now.t - 5.998) < 1e-9")
        wait_for(lambda: page.locator("#play").text_content() == "Play", "it stands")
        assert page.evaluate("haptic.scene.now.t") == pytest.approx(5.998)


def test_all_of_a_recording_is_seen_at_once(
    browser: Browser, urls: dict[str, str]
) -> None:
    with OpenPage(browser, urls["recording"] + "#t=0") as page:
        _open_lab(page)
        assert page.evaluate("haptic.plots.sight()") == [0, 5.998]
        times = "haptic.plots.panels[0].plot.data[0]"
        page.wait_for_function(f"{times}.at(-1) > 5.9 && {times}[0] < 0.1")
        # Both behind the slider: force and position, from end to end.
        drawn = page.evaluate(
            "(() => { const c = document.getElementById('whole');"
            " const { data } = c.getContext('2d').getImageData(0, 0, c.width, c.height);"
            " const has = (from, to) => data.some((a, i) => i % 4 === 3 && a > 0"
            " && (i >> 2) % c.width >= from * c.width && (i >> 2) % c.width < to * c.width);"
            " return [has(0, 0.05), has(0.95, 1)]; })()"
        )
        assert drawn == [True, True]


DROP = """([name, text]) => {
  const data = new DataTransfer();
  data.items.add(new File([text], name));
  const drop = new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true });
  document.body.dispatchEvent(drop);
  return drop.defaultPrevented;
}"""
"""Drop a file of this name and text; returns whether the page takes it from the browser."""


def test_a_page_without_a_server_says_how_a_dropped_recording_is_opened(
    browser: Browser, urls: dict[str, str], kind: str
) -> None:
    with OpenPage(browser, urls[kind]) as page:
        assert page.evaluate(DROP, ["mine.mcap", "x"])
        said = str(page.locator("#notice").text_content()).replace("\u00a0", " ")
        assert "haptic view --replay mine.mcap" in said
        # The browser itself opens pages.
        assert not page.evaluate(DROP, ["mine.html", "x"])


@pytest.fixture
def still(browser: Browser, urls: dict[str, str], kind: str) -> Iterator[Page]:
    with OpenPage(browser, urls[kind], reduced_motion="reduce") as page:
        yield page


def test_nothing_moves_that_need_not_where_motion_is_reduced(still: Page) -> None:
    moving = (
        "[...document.querySelectorAll('*')].filter((each) => {"
        " const { transitionDuration: t, animationName: a } = getComputedStyle(each);"
        " return a !== 'none' || t.split(',').some((one) => parseFloat(one) > 0); }).length"
    )
    assert still.evaluate(moving) == 0
