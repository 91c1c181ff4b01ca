"""Recordings in a real browser: time slider, two recordings, the map after a delay change."""

from __future__ import annotations

import base64
import re
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from messages.topics import DEVICE_STATE
from nodes.recording.reader import Recording
from tests.support.browser import OpenPage, needs_browser, shown, viewing
from tests.support.launching import launch_json, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [needs_browser, pytest.mark.slow]

PERIOD = 0.002

PULL = """t => { const slider = document.getElementById("seek");
  slider.value = t;
  for (const kind of ["input", "change"]) slider.dispatchEvent(new Event(kind)); }"""
"""Seek the recording's slider to a time, in the page [s]."""

DROP = """([name, text]) => {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const data = new DataTransfer();
  data.items.add(new File([bytes], name));
  document.body.dispatchEvent(
    new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
}"""
"""Drop a file of this name and content (base64) on the page."""

PAUSE = """() => { const play = document.getElementById("play");
  if (play.getAttribute("aria-pressed") === "true") play.click(); }"""
"""Pause in the page itself; a click on a busy machine might restart playback at its end."""


def _at(page: Page) -> float:
    return float(page.evaluate("haptic.scene.now.t"))


def _go(page: Page, t: float) -> None:
    page.evaluate(PULL, t)
    wait_for(lambda: abs(_at(page) - t) < 0.02, "the scene follows the slider")


def _stop(page: Page, t: float) -> None:
    """Pause at a time and wait for its frame, ignoring older ones."""
    page.evaluate(PAUSE)
    wait_for(
        lambda: page.locator("#play").get_attribute("aria-pressed") == "false",
        "it stands",
    )
    _go(page, t)


def test_it_is_pulled_through_with_its_plots_over_another_one(
    browser: Browser, tmp_path: Path
) -> None:
    paths = []
    for law in ("pd", "pd_alpha"):
        (tmp_path / law).mkdir()
        figures = launch_json(
            tmp_path / law, "floor_drop", "pace:=lockstep", f"law:={law}", "--no-plot"
        )
        paths.append(tmp_path / law / figures["recording"])
    # Its logger was killed: what it had written is shown all the same, and that it is cut is said.
    paths[0].write_bytes((whole := paths[0].read_bytes())[: int(0.7 * len(whole))])
    states = {state.seq: state for state in Recording(paths[0]).messages(DEVICE_STATE)}
    words = ("--replay", str(paths[0]), "--over", str(paths[1]))
    with viewing(tmp_path, *words) as url, OpenPage(browser, url + "#lab") as page:
        assert re.fullmatch(
            r"The recording is cut: it ends at [12]\.\d s\.", shown(page, "#notice")
        )
        _stop(page, 0.05)
        page.locator("#play").click()
        wait_for(lambda: _at(page) > 0.1, "it plays on")
        _stop(page, 0.05)
        wait_for(
            lambda: page.evaluate("haptic.plots.panels[0].plot.data[0].length > 100"),
            "the plots",
        )
        before = page.evaluate("haptic.plots.sight()")
        # A moment that is still to come is in the plots already.
        box: Any = page.locator(".plot .u-over").first.bounding_box()
        wanted = float(
            page.evaluate(
                "(part) => haptic.plots.panels[0].plot.posToVal(part, 'x')",
                0.12 * box["width"],
            )
        )
        page.mouse.click(box["x"] + 0.12 * box["width"], box["y"] + 40.0)
        wait_for(
            lambda: abs(_at(page) - wanted) < 0.01,
            "the scene is at the moment that was clicked on",
        )
        assert page.evaluate("haptic.plots.at") == _at(page), (
            "the plots' line is there too"
        )
        assert page.evaluate("haptic.plots.sight()") == before, (
            "the plots stay where they are"
        )
        assert (
            float(page.evaluate("haptic.plots.panels[0].plot.data[0].at(-1)"))
            > wanted + 0.1
        )
        shows = float(page.evaluate("haptic.scene.now.position[2]"))
        # One picture of the scene for 60 in a second.
        near = [
            states[seq].position[2]
            for seq in range(
                max(0, round(wanted / PERIOD) - 10), round(wanted / PERIOD) + 2
            )
        ]
        assert min(near) <= shows <= max(near)
        # Pulled by its slider: the same, and the clock says so.
        _go(page, 0.5)
        wait_for(lambda: shown(page, "#clock").startswith("0.5"), "the clock")
        # Two over each other: the other one's own numbers.
        other = Recording(paths[1]).messages(DEVICE_STATE)
        over = page.evaluate(
            "(({ times, position }) => [times, position.z])(haptic.plots.over())"
        )
        assert len(over[0]) == len(other)
        assert over[1] == pytest.approx(
            [state.position[2] for state in other], abs=1e-8
        )
        # Dropped on the page: another one, and what is none.
        content = base64.b64encode(paths[1].read_bytes()).decode()
        page.evaluate(DROP, ["b.mcap", content])
        run = Recording(paths[1]).manifest["run"]
        ready = "document.body.dataset.ready"
        wait_for(lambda: page.evaluate(ready) == run, "it is opened")
        wait_for(lambda: shown(page, "#notice") == "b.mcap; reload to go back.", "said")
        wait_for(lambda: _at(page) > 0.1, "it plays")
        page.evaluate(DROP, ["c.mcap", base64.b64encode(b"no recording").decode()])
        wait_for(lambda: "c.mcap" in shown(page, "#notice"), "it is refused")
        assert page.evaluate(ready) == run


def test_the_map_is_the_one_of_the_delay_of_its_moment(
    browser: Browser, tmp_path: Path
) -> None:
    with running(tmp_path, "touch_wall", "duration:=0") as launch:
        wait_for(lambda: launch.ticks() > 400, "the loop runs")
        launch.call("coupling", "param.set", values={"plant.device_delay": 1.5})
        launch.call("driver", "param.set", values={"device.delay": 1.5})
        changed = launch.ticks()
        wait_for(lambda: launch.ticks() > changed + 300, "it goes on")
        path = tmp_path / launch.finish(signal.SIGINT)["recording"]
    with (
        viewing(tmp_path, "--replay", str(path)) as url,
        OpenPage(browser, url) as page,
    ):
        _stop(page, 0.2)
        before = float(
            wait_for(lambda: page.evaluate("haptic.map.map?.delay_ticks"), "a map")
        )
        edge = float(page.evaluate("haptic.map.map.k_max_n_per_m"))
        _go(page, (changed + 250) * PERIOD)
        wait_for(
            lambda: page.evaluate("haptic.map.map.delay_ticks") > before + 1.0,
            "the map of the later answer",
        )
        assert float(page.evaluate("haptic.map.map.delay_ticks")) == pytest.approx(
            before + 1.5
        )
        assert page.evaluate("haptic.map.map.k_max_n_per_m") < edge
        _go(page, 0.2)
        wait_for(
            lambda: page.evaluate("haptic.map.map.delay_ticks") == before, "and back"
        )
