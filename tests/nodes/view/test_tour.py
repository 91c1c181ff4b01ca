"""The tour in a real browser: sentences, each followed by the next when done."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from sim.measure.haptic_commands import within
from tests.support.browser import OpenPage, needs_browser, shown, url_of
from tests.support.launching import Running, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = needs_browser


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Running]:
    with running(tmp_path, "touch_wall", "--view", "--without", "logger") as found:
        yield found


@pytest.fixture
def page(browser: Browser, launch: Running) -> Iterator[Page]:
    """Open an untouched page."""
    with OpenPage(browser, url_of(launch)) as found:
        yield found


def _pull(page: Page, by: str) -> None:
    """Push the hand into the wall, from where it is grabbed."""
    if by == "keyboard":
        page.locator("#scene").focus()
        for _ in range(6):
            page.keyboard.press("Shift+ArrowRight")
        return
    box: Any = page.locator("#scene").bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.3 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.95 * box["width"], y, steps=3)


def _act(page: Page, by: str) -> None:
    """Perform the action that a sentence asks for."""
    if by == "keyboard":
        page.locator("#tour-act").focus()
        page.keyboard.press("Enter")
    else:
        page.mouse.up()
        page.locator("#tour-act").click()


@pytest.mark.slow
def test_the_tour_goes_on_when_what_it_asks_for_is_done(
    page: Page, launch: Running
) -> None:
    """By keyboard up to the limit, by mouse beyond it, and by keyboard to the end."""
    launch.call("driver", "param.set", values={"device.delay": 0.0})
    launch.call(
        "coupling",
        "param.set",
        values={"plant.device_delay": 0.0, "laws.pd.stiffness": 1000.0},
    )
    launch.call("coupling", "law.switch", law="pd")
    wait_for(
        lambda: page.evaluate(
            "haptic.dial.edge !== null && haptic.dial.stiffness === 1000"
        ),
        "the dial",
    )
    page.locator("#tour-begin").focus()
    page.keyboard.press("Enter")

    def stands(words: str, step: int) -> bool:
        return shown(page, "#sentence").startswith(f"{step} of 6") and words in shown(
            page, "#sentence"
        )

    assert stands("Touch it", 1)

    def touched() -> bool:
        _pull(page, "keyboard")
        return stands("Make it harder", 2)

    wait_for(touched, "a touch is seen")
    # The edge moves with the delay that is measured: what counts is the one at which the button was
    # pressed.
    page.evaluate("""document.getElementById("tour-act").addEventListener(
      "click", () => { window.edge = haptic.dial.edge; }, { capture: true, once: true })""")
    _act(page, "keyboard")
    wait_for(lambda: stands("Go past the edge", 3), "it is harder")
    assert page.evaluate("haptic.dial.stiffness < window.edge"), "it is stable still"
    assert not page.locator("#beyond").is_checked(), "nobody has allowed to go past it"
    page.locator("#scene").focus()
    page.keyboard.press("Escape")
    _act(page, "mouse")

    def sang() -> bool:
        # Pushed into the wall and drawn out of it, until it rings or is stopped.
        page.mouse.up()
        _pull(page, "mouse")
        return stands("Go back below it", 4)

    wait_for(sang, "it sings")
    page.mouse.up()

    def acted(wanted: str) -> bool:
        # Pressed at once where it is wanted still: what was pressed before may come true meanwhile,
        # and the tour go on.
        page.evaluate(f"({wanted}) || document.getElementById('tour-act').click()")
        return bool(within(lambda: page.evaluate(wanted), 2.0))

    def calm() -> bool:
        # What rings may be stopped a moment later, and is then started again.
        return page.locator("#again").is_enabled() and acted(
            "!haptic.slow.on && haptic.dial.stiffness < haptic.dial.edge"
        )

    wait_for(calm, "back below the edge")
    assert not page.locator("#beyond").is_checked(), "and it stays below"

    def later() -> bool:
        # As long as it rings or is stopped, the same button calms it first.
        return acted(
            "document.getElementById('sentence').textContent.startsWith('5 of 6')"
        )

    wait_for(later, "it answers later")
    assert stands("Put one beside yours", 5)
    assert launch.call("driver", "param.get", name="device.delay") > 0.0
    # What the page shows goes into its link, and out of it in another page.
    page.evaluate("navigator.clipboard.writeText = () => Promise.resolve()")
    page.locator("#share").click()
    told = page.evaluate(
        "Object.fromEntries(new URLSearchParams(location.hash.slice(1)))"
    )
    assert (told["law"], float(told["delay"])) == (
        "pd",
        launch.call("driver", "param.get", name="device.delay"),
    )
    _act(page, "keyboard")
    wait_for(lambda: stands("is drawn beside yours now", 6), "what was seen is said")
    _act(page, "keyboard")
    wait_for(lambda: not page.locator("#tour").is_visible(), "the tour is over")
    assert page.evaluate("haptic.beside.law") not in ("", "pd")
