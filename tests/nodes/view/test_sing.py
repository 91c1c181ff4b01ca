"""Make it sing, on a running launch in a real browser: A rings, B rests, in words."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.support.browser import OpenPage, needs_browser, shown, url_of
from tests.support.launching import running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.process]

_TOLD = re.compile(
    r"A, pd at ([\d ]+) N/m \(edge ([\d ]+)\), sings at (\d+) Hz, up to [\d.]+ N\."
    r" B, (\w+) at ([\d ]+) N/m \(edge ([\d ]+)\), three times as stiff, rests\."
)


def test_one_button_lets_a_law_sing_beside_a_stiffer_one_that_rests(
    browser: Browser, tmp_path: Path
) -> None:
    words = ("touch_wall", "--view", "--without", "logger")
    with running(tmp_path, *words) as launch, OpenPage(browser, url_of(launch)) as page:
        # The dial is in its place with the first documents: its edge came with them.
        wait_for(lambda: page.evaluate("haptic.dial.edge !== null"), "the edge")
        page.locator("#sing").click()

        def told() -> re.Match[str] | None:
            return _TOLD.search(shown(page, "#sung").replace("\u202f", ""))

        a, edge, _, other, b, farthest = wait_for(told, "both are told").groups()
        assert float(edge) < float(a) < float(b) < float(farthest)
        assert float(b) == pytest.approx(3.0 * float(a), rel=0.01)
        assert page.locator("#beyond").is_checked()
        # The launch renders what is told, and B is drawn apart from A.
        assert launch.call("coupling", "param.get", name="laws.pd.stiffness") == float(
            a
        )
        assert page.evaluate("haptic.beside.law") == other
        force = "haptic.beside.force.slice(-100)"
        swing = f"Math.max(...{force}) - Math.min(...{force})"
        # Below what counts as a stroke of a ring [N].
        wait_for(lambda: page.evaluate(swing) < 0.1, "B rests")
        # A visitor takes the hand over.
        page.locator("#scene").focus()
        page.keyboard.press("ArrowLeft")
        assert page.evaluate("haptic.sing.pressing") is None
