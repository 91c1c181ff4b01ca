"""The page in a real browser, over real processes: drag, swap, refusals, crash, end."""

from __future__ import annotations

import functools
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml

from nodes.launcher import scenario_files
from tests.support.browser import OpenPage, bins, needs_browser, shown, url_of
from tests.support.launching import Running, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = needs_browser


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(
        tmp_path_factory.mktemp("view"), "touch_wall", "--view", "--without", "logger"
    ) as found:
        yield found


@pytest.fixture(scope="module")
def opened(browser: Browser, launch: Running) -> Iterator[Page]:
    with lab(browser, launch) as found:
        yield found


@pytest.fixture
def page(opened: Page) -> Page:
    """Return the shared page as first seen, scrolled to the top."""
    opened.evaluate("scrollTo(0, 0)")
    return opened


def lab(browser: Browser, launch: Running) -> OpenPage:
    return OpenPage(browser, url_of(launch) + "#lab")


def state(launch: Running) -> dict[str, float]:
    found = launch.call("driver", "progress")
    return {"x": float(found["position_m"][0]), "f": float(found["force_n"][0])}


def drag_into_the_wall(page: Page) -> None:
    box = page.locator("#scene").bounding_box()
    assert box is not None
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 8.0, y, steps=10)


# Tests with a launch of their own come first: the one that is shared, and its page, would only go
# on beside them.


@pytest.mark.slow
def test_a_killed_node_is_told_and_a_killed_view_is_found_again(
    browser: Browser, tmp_path: Path
) -> None:
    """The view keeps port and token, so the page reconnects; a dead node is named."""
    content = yaml.safe_load(
        scenario_files.find("touch_wall").read_text(encoding="utf-8")
    )
    content["nodes"]["environment"] |= {"respawn": True, "respawn_delay": 0.0}
    # Not a demo, whose nodes are all started again.
    del content["nodes"]["driver"]["parameters"]["pointer"]["beyond"]
    (tmp_path / "touch.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    words = (str(tmp_path / "touch.yaml"), "--view", "--without", "logger")
    with running(tmp_path, *words) as launch, lab(browser, launch) as page:
        wait_for(lambda: "nothing is touched" in shown(page, "#words"), "the loop runs")
        environment = launch.pid("environment")
        os.kill(environment, signal.SIGSTOP)
        wait_for(
            lambda: "the force is zero until a fresh one" in shown(page, "#words"),
            "the page tells why there is no force",
        )
        os.kill(environment, signal.SIGKILL)
        wait_for(
            lambda: "nothing is touched" in shown(page, "#words"),
            "the new environment is seen to answer",
        )
        view = int(launch.call("view", "status")["pid"])
        os.kill(view, signal.SIGKILL)
        wait_for(
            lambda: "lost its connection" in shown(page, "#notice"),
            "the page tells that it is alone",
        )
        wait_for(lambda: not page.locator("#notice").is_visible(), "the page is back")
        before = bins(page)
        wait_for(lambda: bins(page) != before, "and sees again")
        # Nodes say twice a second how they are; a new view has heard nothing of them yet.
        wait_for(
            lambda: "coupling" in shown(page, "#nodes"),
            "the new view has heard of the coupling",
        )
        os.kill(int(launch.call("coupling", "status")["pid"]), signal.SIGKILL)
        wait_for(
            lambda: "coupling: ended with SIGKILL" in shown(page, "#notice"),
            "the end is told, with its reason",
        )
        assert "coupling" in shown(page, "#nodes li.silent")
        assert page.locator("#nodes li.ended").count() == 2
        assert "Hz" not in shown(page, "#figures")
        assert "stays here" in shown(page, "#notice")
        assert page.evaluate("document.getElementById('dial').inert"), (
            "there is no wall to turn any more"
        )
        assert launch.process.wait(60.0) == 1


@pytest.mark.slow
def test_a_scene_of_several_axes_is_looked_at_along_each(
    browser: Browser, tmp_path: Path
) -> None:
    words = ("floor_drop", "--view", "--without", "logger", "duration:=0")
    content = yaml.safe_load(
        scenario_files.find("floor_drop").read_text(encoding="utf-8")
    )
    content.setdefault("run", {})["axes"] = ["x", "z"]
    (tmp_path / "two.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with (
        running(tmp_path, str(tmp_path / "two.yaml"), *words[1:]) as launch,
        lab(browser, launch) as page,
    ):
        page.select_option("#axis", "z")
        wait_for(
            lambda: "0.00 mm" not in shown(page, "#reading"),
            "how far it has come along z",
        )
        page.select_option("#axis", "x")
        wait_for(
            lambda: "0.00 mm" in shown(page, "#reading"), "it does not move along x"
        )


@pytest.mark.slow
def test_after_a_stop_the_page_keeps_what_it_has_and_starts_another_run(
    browser: Browser, tmp_path: Path
) -> None:
    with (
        running(tmp_path, "touch_wall", "--view") as launch,
        lab(browser, launch) as page,
    ):
        page.locator("#stop").click()
        assert shown(page, "#stop") == "End the run?"
        page.locator("#stop").click()
        wait_for(lambda: page.locator("#over").is_visible(), "the end is told")
        assert "The run has ended: stop requested." in shown(page, "#over")
        kept, first = bins(page), page.evaluate("document.body.dataset.ready")
        assert kept > 0
        recorded = f"recordings/{first}.mcap"
        assert f"Recorded: {recorded}" in shown(page, "#over")
        assert (tmp_path / recorded).exists()
        page.locator("#start-again").click()
        wait_for(
            lambda: page.evaluate("document.body.dataset.ready") != first,
            "another run, on the same page",
        )
        wait_for(lambda: "nothing is touched" in shown(page, "#words"), "it runs")
        assert not page.locator("#over").is_visible()


@pytest.mark.process
def test_it_loads_moves_and_tells_the_map(page: Page, launch: Running) -> None:
    assert shown(page, "#scenario") == "touch_wall"
    before, picture = bins(page), page.locator(".plot canvas").first.screenshot()
    wait_for(lambda: bins(page) > before + 100, "bins come in")
    wait_for(
        lambda: page.locator(".plot canvas").first.screenshot() != picture,
        "the plot moves",
    )
    wait_for(lambda: "more delay" in shown(page, "#margin"), "the map of stability")
    # Worlds that move are computed after what the page waits for.
    moving = "any world that answers in the same tick: K up to"
    wait_for(
        lambda: moving in " ".join(shown(page, "#margin").split()), "moving worlds"
    )
    assert page.locator(".plot").count() == 4
    wait_for(lambda: "Hz" in shown(page, "#figures"), "the rate")
    # What is not on this machine is not asked for.
    assert page.evaluate(
        "performance.getEntriesByType('resource').every((e) => e.name.startsWith(location.origin))"
    )
    # Each file is a connection, and a browser on one processor feels thirty of them.
    assert page.evaluate("performance.getEntriesByType('resource').length") <= 6


@pytest.mark.process
def test_the_mouse_is_a_hand(page: Page, launch: Running) -> None:
    # The scenario's own touch at its beginning is over.
    wait_for(
        lambda: launch.ticks() > 1300 and abs(state(launch)["x"]) < 0.003,
        "the hand rests",
    )
    drag_into_the_wall(page)
    # Held still: renewed, not moved.
    wait_for(lambda: state(launch)["f"] < -0.2, "the wall pushes back")
    wait_for(lambda: "pushes back" in shown(page, "#words"), "the words")
    page.mouse.up()
    wait_for(lambda: abs(state(launch)["x"]) < 0.003, "the hand lets go")
    wait_for(lambda: "nothing is touched" in shown(page, "#words"), "the words")


@pytest.mark.process
def test_the_keyboard_is_a_hand_too(page: Page, launch: Running) -> None:
    page.locator("#scene").focus()

    def pressed() -> bool:
        page.keyboard.press("Shift+ArrowRight")
        return state(launch)["x"] > 0.015

    # Several presses: where a busy machine has let go in between, the next one goes on from there.
    wait_for(pressed, "the device follows the keys")
    page.keyboard.press("Escape")
    wait_for(lambda: abs(state(launch)["x"]) < 0.003, "Escape lets go")


@pytest.mark.process
def test_a_slider_is_answered_with_a_receipt_and_undone(
    page: Page, launch: Running
) -> None:
    wait_for(
        lambda: page.locator("input[type=range][aria-label=stiffness]").count() == 1,
        "the sliders",
    )
    launch.call("coupling", "law.switch", law="pd")
    slider = page.locator("input[type=range][aria-label=stiffness]")
    before = launch.call("coupling", "param.get", name="laws.pd.stiffness")
    slider.focus()
    page.keyboard.press("ArrowRight")
    changed = wait_for(
        lambda: (
            (k := launch.call("coupling", "param.get", name="laws.pd.stiffness"))
            != before
            and k
        ),
        "the new stiffness",
    )
    assert before < changed < 1.1 * before
    # A busy machine logs a line of its own in between.
    receipt = "#log li.receipt >> nth=0"
    wait_for(lambda: "pd: stiffness" in shown(page, receipt), "the receipt")
    assert "force step" in shown(page, receipt)
    page.keyboard.press("Control+z")
    wait_for(
        lambda: (
            launch.call("coupling", "param.get", name="laws.pd.stiffness") == before
        ),
        "undone",
    )
    launch.call("coupling", "law.switch", law="pd_alpha")
    taps = page.locator("input[type=range][aria-label=taps]")
    wait_for(lambda: taps.count() == 1, "the sliders of the other law")
    before = launch.call("coupling", "param.get", name="laws.pd_alpha.taps")
    taps.focus()
    page.keyboard.press("ArrowRight")
    wait_for(
        lambda: (
            launch.call("coupling", "param.get", name="laws.pd_alpha.taps")
            == before + 1
        ),
        "one tap more",
    )
    page.locator("#undo").click()
    wait_for(
        lambda: (
            launch.call("coupling", "param.get", name="laws.pd_alpha.taps") == before
        ),
        "undone",
    )


@pytest.mark.process
def test_what_is_refused_is_shown_with_its_reason(page: Page, launch: Running) -> None:
    launch.call("coupling", "law.switch", law="pd")
    wait_for(
        lambda: page.evaluate("haptic.laws.state.active") == "pd",
        "the page to know its law",
    )
    exact = page.locator("input[aria-label='stiffness, exact value']")
    wait_for(lambda: exact.count() == 1, "the sliders")
    before = launch.call("coupling", "param.get", name="laws.pd.stiffness")
    for value, reason in (("-5", "above 0"), ("900000", "unstable")):
        exact.fill(value)
        page.keyboard.press("Enter")
        wait_for(
            functools.partial(lambda reason: reason in shown(page, "#refusal"), reason),
            f"the reason: {reason}",
        )
        assert launch.call("coupling", "param.get", name="laws.pd.stiffness") == before
        # The control goes back to what holds.
        wait_for(
            lambda: float(exact.input_value()) == pytest.approx(before, rel=1e-5),
            "the old value",
        )
    wait_for(
        lambda: page.locator("#log li.refused").count() >= 2, "refusals are in the log"
    )


@pytest.mark.process
def test_what_is_typed_is_not_overwritten_from_elsewhere(
    page: Page, launch: Running
) -> None:
    launch.call("coupling", "law.switch", law="pd")
    exact = page.locator("input[aria-label='stiffness, exact value']")
    wait_for(lambda: exact.count() == 1, "the sliders")
    before = {
        name: launch.call("coupling", "param.get", name=f"laws.pd.{name}")
        for name in ("stiffness", "damping")
    }
    exact.fill("321")
    launch.call(
        "coupling", "param.set", values={"laws.pd.damping": 1.1 * before["damping"]}
    )
    other = page.locator("input[aria-label='damping, exact value']")
    wait_for(
        lambda: (
            float(other.input_value())
            == pytest.approx(1.1 * before["damping"], rel=1e-5)
        ),
        "the other's value",
    )
    assert exact.input_value() == "321"
    page.keyboard.press("Enter")
    wait_for(
        lambda: launch.call("coupling", "param.get", name="laws.pd.stiffness") == 321.0,
        "what was typed",
    )
    launch.call(
        "coupling",
        "param.set",
        values={f"laws.pd.{name}": value for name, value in before.items()},
    )
    wait_for(
        lambda: (
            float(exact.input_value()) == pytest.approx(before["stiffness"], rel=1e-5)
        ),
        "the old value",
    )


@pytest.mark.slow
def test_laws_are_swapped_in_two_tabs(
    page: Page, browser: Browser, launch: Running
) -> None:
    with lab(browser, launch) as other:
        for name in ("multi_term", "pd"):
            wait_for(lambda: other.locator("#laws label").count() >= 3, "the laws")
            other.locator("#laws label").filter(has_text=name).first.click()
            for tab in (page, other):
                checked = tab.locator(f"#laws input[value={name}]")
                wait_for(checked.is_checked, f"{name} is marked")
            assert launch.call("coupling", "law.list")["active"] == name
        wait_for(
            lambda: "→ pd" in shown(page, "#log li.receipt >> nth=0"),
            "the other tab's change is told here",
        )
        # Whoever has the hand has it alone.
        drag_into_the_wall(page)
        other.locator("#scene").focus()
        other.keyboard.press("ArrowLeft")
        wait_for(
            lambda: "another page holds it" in shown(other, "#log li.refused >> nth=0"),
            "the refusal",
        )
        box = other.locator("#scene").bounding_box()
        assert box is not None
        other.mouse.move(box["x"] + 50.0, box["y"] + 100.0)
        other.mouse.down()
        before = bins(other)
        wait_for(lambda: bins(other) > before + 400, "a mouse that goes on asking")
        assert other.locator("#log li.refused").count() == 2, (
            "one refusal for each grab"
        )
        other.mouse.up()
        page.mouse.up()


@pytest.mark.process
def test_a_wrong_token_and_a_foreign_origin_get_nothing(
    page: Page, browser: Browser, launch: Running
) -> None:
    url = url_of(launch)
    script = """url => new Promise((done) => {
      const socket = new WebSocket(url);
      socket.onopen = () => done("open");
      socket.onerror = () => done("refused");
    })"""
    other = browser.new_page()
    answer = other.goto(url[:-2] + "/")
    assert answer is not None
    assert (answer.status, "token" in other.inner_text("body")) == (403, True)
    other.goto("data:text/html,a page from elsewhere, which has the URL")
    assert other.evaluate(script, url.replace("http", "ws") + "live") == "refused"
    other.close()
    assert page.evaluate(script, url.replace("http", "ws") + "live") == "open"


@pytest.mark.slow
def test_a_page_that_is_stopped_costs_the_others_nothing_and_lets_go(
    page: Page, browser: Browser, launch: Running
) -> None:
    context = browser.new_context()
    stopped = context.new_page()
    stopped.goto(url_of(launch))
    wait_for(lambda: bins(stopped) > 10, "the first picture")
    drag_into_the_wall(stopped)
    wait_for(lambda: state(launch)["f"] < -0.2, "the wall pushes back")
    # As a debugger or a sleeping laptop does: no script runs, nothing is read.
    session = context.new_cdp_session(stopped)
    session.send("Debugger.enable")
    session.send("Debugger.pause")
    wait_for(lambda: abs(state(launch)["x"]) < 0.003, "the silent page's hand lets go")
    before = bins(page)
    wait_for(lambda: bins(page) > before + 200, "the other page goes on")
    context.close()


@pytest.mark.slow
def test_record_and_undo_buttons_and_pause(page: Page, launch: Running) -> None:
    page.locator("#record").click()
    wait_for(
        lambda: page.locator("#record").get_attribute("aria-pressed") == "true",
        "recording",
    )
    wait_for(
        lambda: [
            p
            for p in (launch.folder / "recordings").glob("*.mcap")
            if p.stat().st_size > 1000
        ],
        "the file grows",
    )
    page.locator("#record").click()
    wait_for(
        lambda: page.locator("#record").get_attribute("aria-pressed") == "false",
        "recorded",
    )
    page.locator("body").click(position={"x": 2, "y": 400})
    page.keyboard.press(" ")
    assert page.locator("#pause").get_attribute("aria-pressed") == "true"
    page.keyboard.press("+")
    page.keyboard.press("Home")
    assert page.locator("#pause").get_attribute("aria-pressed") == "false"


@pytest.mark.slow
def test_plots_are_read_and_zoomed_by_mouse_and_fingers(
    page: Page, browser: Browser, launch: Running
) -> None:
    wait_for(lambda: bins(page) > 1500, "some seconds")
    plot = page.locator(".plot .u-over").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    assert box is not None
    u, v = box["x"] + 0.5 * box["width"], box["y"] + 40.0
    page.mouse.move(u, v)
    wait_for(
        lambda: all(
            unit in shown(page, "#values") for unit in (" s ", "mm", "N", "mJ", "µs")
        ),
        "all under the pointer",
    )
    before = page.evaluate("haptic.plots.sight()")
    page.mouse.down()
    drawn, newest = page.evaluate(
        "[haptic.plots.panels[0].plot.scales.x.max, haptic.plots.store.end]"
    )
    wait_for(
        lambda: page.evaluate("haptic.plots.store.end") > newest + 0.5,
        "half a second more",
    )
    assert page.evaluate("haptic.plots.panels[0].plot.scales.x.max") == drawn, (
        "what is being chosen holds still"
    )
    page.mouse.move(u + 0.25 * box["width"], v, steps=4)
    page.mouse.up()
    # A quarter of what was in sight, to the pixel.
    low, high = page.evaluate("haptic.plots.sight()")
    assert high - low == pytest.approx(0.25 * (before[1] - before[0]), rel=0.02)
    page.locator("#live").click()
    assert page.evaluate("haptic.plots.window") is None
    wait_for(
        lambda: page.evaluate("haptic.plots.panels[0].plot.scales.x.max") > drawn,
        "the plots run again",
    )
    with OpenPage(
        browser, url_of(launch) + "#lab", has_touch=True, is_mobile=True
    ) as phone:
        wait_for(lambda: bins(phone) > 300, "some of the past")
        plot = phone.locator(".plot .u-over").first
        plot.scroll_into_view_if_needed()
        box = plot.bounding_box()
        assert box is not None
        middle, y, fingers = (
            box["x"] + box["width"] / 2,
            box["y"] + 40.0,
            phone.context.new_cdp_session(phone),
        )

        def touch(kind: str, *along: float) -> None:
            there = [{"x": middle + at, "y": y, "id": k} for k, at in enumerate(along)]
            fingers.send(
                "Input.dispatchTouchEvent", {"type": kind, "touchPoints": there}
            )

        # The plots run until the finger moves.
        phone.evaluate(
            """document.addEventListener(
          "pointermove", () => { window.begun = haptic.plots.sight(); }, { capture: true,
            once: true })"""
        )
        touch("touchStart", 0.0)
        for k in range(1, 8):
            touch("touchMove", 10.0 * k)
        touch("touchEnd")
        begun, moved = phone.evaluate("[window.begun, haptic.plots.sight()]")
        assert moved[0] < begun[0]
        assert moved[1] - moved[0] == pytest.approx(begun[1] - begun[0])
        touch("touchStart", -20.0)
        touch("touchStart", -20.0, 20.0)
        for k in range(1, 8):
            touch("touchMove", -20.0 - 8.0 * k, 20.0 + 8.0 * k)
        touch("touchEnd")
        near = phone.evaluate("haptic.plots.sight()")
        # The browser lets the first move of a finger pass; two move at different times, and the
        # middle of both stays.
        assert 0.2 < (near[1] - near[0]) / (moved[1] - moved[0]) < 0.35
        assert phone.evaluate("[haptic.plots.fingers.size, visualViewport.scale]") == [
            0,
            1,
        ], "the page itself is not zoomed"


@pytest.mark.process
@pytest.mark.parametrize("size", [(390, 844), (1440, 900)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_phone_and_the_dark(
    size: tuple[int, int], scheme: str, page: Page
) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
    wait_for(lambda: page.locator("html").get_attribute("data-theme") == scheme, scheme)
    # Its pictures get the new width with the next frame.
    wait_for(
        lambda: page.evaluate("document.documentElement.scrollWidth") <= size[0],
        "all of it is as wide as the screen",
    )
    red, *_ = page.evaluate(
        "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
    )
    assert (red < 60) == (scheme == "dark")
