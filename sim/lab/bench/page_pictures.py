"""Pictures of the real page for the documentation: haptic bench view --pictures FOLDER."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sim.measure.haptic_commands import wait_for
from sim.measure.measured_launch import Running
from sim.results import fresh
from sim.static_page.site import write_site

# In the page: turn the dial to a fraction of its range.
TURN = """part => { const dial = document.getElementById("dial");
  dial.value = 1000 * part;
  for (const kind of ["input", "change"]) dial.dispatchEvent(new Event(kind)); }"""
READY = (
    "document.body.dataset.bins > 100 && haptic.dial.stiffness !== null && haptic.dial.edge !=="
    " null"
)


def _url(launch: Running) -> str:
    """Return the URL from the first line of a launch with --view --json."""

    def first() -> str:
        lines = (launch.folder / "stdout.txt").read_text(encoding="utf-8").splitlines()
        return str(json.loads(lines[0])["url"]) if lines else ""

    return str(wait_for(first, "the URL"))


@contextmanager
def _page(
    browser: Any, url: str, width: int = 1366, height: int = 768, **context: Any
) -> Iterator[Any]:
    opened = browser.new_context(viewport={"width": width, "height": height}, **context)
    try:
        page = opened.new_page()
        page.goto(url)
        wait_for(lambda: page.evaluate(READY), "the page")
        yield page
    finally:
        opened.close()


def _hold(page: Any, far: float) -> None:
    """Drag the handle into the wall and leave the mouse button pressed."""
    box = page.locator("#scene").bounding_box()
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(
        box["x"] + far * box["width"], box["y"] + 0.5 * box["height"], steps=8
    )


def _touch(page: Any) -> None:
    page.evaluate("haptic.beside.choose('')")
    _hold(page, 0.9)
    wait_for(lambda: page.evaluate("haptic.scene.now.force[0] < -0.5"), "a touch")
    page.wait_for_timeout(800.0)


def _past_the_edge(page: Any) -> None:
    page.locator("#beyond").check()
    page.evaluate(TURN, 1.0)
    deadline = time.monotonic() + 60.0
    while page.evaluate("!haptic.slow.on") and time.monotonic() < deadline:
        _hold(page, 0.9)
        page.wait_for_timeout(300.0)
        page.mouse.up()
        page.wait_for_timeout(100.0)
    wait_for(
        lambda: page.evaluate(
            "haptic.slow.window()?.at > haptic.slow.window()?.sight[0] + 0.15"
        ),
        "slow motion",
    )


def _beside(page: Any) -> None:
    page.evaluate("haptic.beside.choose('multi_term')")
    wait_for(lambda: page.evaluate("haptic.beside.times.length > 300"), "B", 180.0)
    _hold(page, 0.9)
    page.wait_for_timeout(1500.0)


def _lab(page: Any) -> None:
    page.evaluate("document.getElementById('lab').open = true")
    _touch(page)
    page.locator("#lab").scroll_into_view_if_needed()


def _sing(page: Any) -> None:
    """Press "Make it sing" and wait until one law sings and the other one rests."""
    page.locator("#sing").click()
    said = "document.getElementById('sung').textContent"
    both = f"{said}.includes('sings at') && {said}.includes('rests')"
    wait_for(lambda: page.evaluate(both), "one sings and one rests")
    # Until the strip of four seconds shows both.
    page.wait_for_timeout(1500.0)
    wait_for(lambda: page.evaluate(both), "one sings and one rests")


# By file name: actions before the picture, and window size.
PICTURES: dict[str, tuple[Callable[[Any], None], dict[str, Any]]] = {
    "page_beside": (_beside, {}),
    "page_lab": (_lab, {"height": 1400}),
    "page_phone": (_touch, {"width": 390, "height": 844, "device_scale_factor": 2.0}),
    "page_dark": (_touch, {"color_scheme": "dark"}),
    "page_past_the_edge": (_past_the_edge, {}),
}


def take(browser: Any, folder: Path, step: Callable[[str], None]) -> list[Path]:
    """Capture all pictures of the page from real launches."""
    folder.mkdir(parents=True, exist_ok=True)
    taken = []

    def shot(page: Any, name: str) -> None:
        taken.append(fresh(folder / f"{name}.png"))
        page.screenshot(path=taken[-1])
        page.mouse.up()
        step(name)

    with TemporaryDirectory() as site:
        write_site(Path(site))
        with _page(browser, f"file://{site}/index.html", height=900) as page:
            _sing(page)
            shot(page, "page")
    with Running("touch_wall", "--view", "--without", "logger") as launch:
        url = _url(launch)
        for name, (act, window) in PICTURES.items():
            with _page(browser, url, **window) as page:
                act(page)
                shot(page, name)
    with Running(
        "sphere_feel", "--view", "--without", "logger", "duration:=0", "friction:=0.3"
    ) as launch:
        opened = browser.new_page(viewport={"width": 1366, "height": 768})
        opened.goto(_url(launch))
        # The page is frozen first: on a busy machine the hand would leave before the
        # picture is taken.
        touched = "haptic.space?.now?.contact === 1 && Math.hypot(...haptic.space.now.force) > 0.3"
        hold = f"{touched} && (haptic.space.show = () => {{}}, true)"
        wait_for(lambda: opened.evaluate(hold), "a touch of the ball")
        shot(opened, "page_space")
        opened.close()
    return taken
