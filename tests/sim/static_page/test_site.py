"""The folder of `haptic view --static`: plain files, nothing from elsewhere; a visit."""

from __future__ import annotations

import contextlib
import functools
import json
import re
import subprocess
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from messages.errors import UsageError
from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError
from sim.static_page import site as site_module
from sim.static_page.site import LARGEST, data_script, smaller, worker, write_site
from tests.support.browser import chromium, needs_browser
from tests.support.in_node import PLAYED, node
from tests.support.launching import typed_in, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Page


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "page"
    done = typed_in(
        folder.parent,
        "view",
        "--static",
        str(folder),
        "touch_wall",
        "sphere_feel",
        "--json",
    )
    assert json.loads(done.stdout.splitlines()[-1])["scenarios"] == [
        "touch_wall",
        "sphere_feel",
    ]
    return folder


def test_the_folder_is_small_and_loads_nothing_from_elsewhere(site: Path) -> None:
    files = [path for path in site.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < LARGEST
    html = (site / "index.html").read_text()
    linked = re.findall(r'(?:src|href)="([^"]+)"', html)
    assert linked
    assert all((site / name).is_file() for name in linked), linked
    for path in files:
        text = path.read_text(errors="replace")
        elsewhere = set(re.findall(r"https?://[\w.]+", text))
        assert elsewhere <= {"http://www.w3.org", "https://github.com"}, (
            path,
            elsewhere,
        )


def test_a_page_is_written_again_and_never_over_anything_else(tmp_path: Path) -> None:
    folder = tmp_path / "page"
    written = [write_site(folder), (folder / "static.js").read_bytes()]
    # The same page of the same scenario, to the byte.
    assert [write_site(folder), (folder / "static.js").read_bytes()] == written
    (folder / "thesis.tex").write_text("mine")
    with pytest.raises(
        UsageError, match=r"page: contains 'thesis\.tex', which is no file of a"
    ):
        write_site(folder)
    assert (folder / "thesis.tex").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.process
@needs_browser
def test_all_scenarios_that_a_browser_plays_fit_in_one_folder_and_play(
    tmp_path: Path,
) -> None:
    """They are those whose bits test_bits.py compares."""
    written = write_site(tmp_path / "page", PLAYED)
    assert written["scenarios"] == list(PLAYED)
    assert written["bytes"] < LARGEST
    wrong: list[str] = []
    with chromium() as browser:
        page = browser.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        for name in PLAYED:
            page.goto("about:blank")
            page.goto(f"file://{tmp_path}/page/index.html#scenario={name}")
            page.wait_for_function("Number(document.body.dataset.bins) > 50")
            assert page.locator("#scenarios").input_value() == name
            assert page.evaluate("haptic.laws.state.active") in page.evaluate(
                "Object.keys(haptic.laws.state.laws)"
            )
    assert wrong == []


def test_a_folder_that_would_be_too_large_is_refused_with_the_size_of_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = ["touch_wall", "box_edges", "mesh_pebble"]
    found = write_site(tmp_path / "fits", every)["bytes"]
    monkeypatch.setattr(site_module, "LARGEST", found - 1)
    why = (
        r"page: (\d+) kB, limit \d+ kB: the page itself (\d+) kB, mesh_pebble (\d+) kB,"
        r" touch_wall (\d+) kB, box_edges (\d+) kB; leave out mesh_pebble, or give it"
    )
    with pytest.raises(UsageError, match=why) as refused:
        write_site(tmp_path / "page", every)
    assert not (tmp_path / "page").exists()
    kilobytes = re.search(why, str(refused.value))
    assert kilobytes is not None
    whole, page, *each = map(int, kilobytes.groups())
    # Apart, each carries what they share.
    assert page < whole <= page + sum(each)
    monkeypatch.setattr(site_module, "LARGEST", found)
    assert write_site(tmp_path / "page", every)["bytes"] == found


_UNPACK = """
const fs = require("fs"), [, , file, scenario, out] = process.argv;
globalThis.location = { hash: `#scenario=${scenario}` };
const unpacked = (0, eval)(
  `${fs.readFileSync(file, "utf8")} workerText(staticPage.scenario)`);
unpacked.then((text) => fs.writeFileSync(out, text));
"""


@pytest.mark.process
@pytest.mark.smoke
def test_the_page_unpacks_what_the_build_packed(site: Path, tmp_path: Path) -> None:
    script, out = tmp_path / "unpack.js", tmp_path / "worker.js"
    script.write_text(_UNPACK)
    words = [node(), str(script), str(site / "static.js"), "sphere_feel", str(out)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (
        out.read_text() == data_script(launch_file.read("sphere_feel", {})) + worker()
    )


def test_what_a_browser_cannot_play_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    with pytest.raises(ParameterError, match="drives two devices"):
        write_site(tmp_path / "page", ["hands_coupled"])
    assert not (tmp_path / "page").exists()


def test_a_smaller_script_is_the_same_without_comments_and_indentation() -> None:
    assert smaller("  a();\n\n  // why\n  b(); // c\n") == "a();\nb(); // c\n"


SMALL_TARGETS = """[...document.querySelectorAll("button, select, input, summary")]
  .filter((each) => each.offsetParent)
  .map((each) => [each, (each.matches("[type=checkbox], [type=radio]") ? each.closest("label")
    : each).getBoundingClientRect()])
  .filter(([, { width, height }]) => Math.min(width, height) < 39.9)
  .map(([each, { width, height }]) => [each.id || each.outerHTML, width, height])"""
"""What a finger would miss: below 40 px."""


@contextlib.contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder as any static host does."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=folder)
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/index.html"
    finally:
        server.shutdown()
        server.server_close()


def _visit(page: Page) -> None:
    page.wait_for_function("document.body.dataset.ready === 'static'")
    page.wait_for_function("haptic.laws.edge > 5000")
    box: Any = page.locator("#scene").bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.3 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.9 * box["width"], y, steps=4)
    page.wait_for_function(
        "document.querySelector('#words').textContent.includes('pushes back')"
    )
    page.locator("#other").select_option("pd_alpha")
    page.wait_for_function("haptic.beside.on")
    page.mouse.up()
    page.locator("#python").click()
    page.wait_for_function("document.querySelector('#python').textContent === 'Copied'")


@pytest.mark.slow
@pytest.mark.process
@needs_browser
@pytest.mark.parametrize("by", ["http", "file"])
def test_a_visitor_touches_the_wall_without_any_process_of_ours(
    site: Path, by: str
) -> None:
    wrong: list[str] = []
    with served(site) as url, chromium() as browser:
        page = browser.new_page()
        page.on(
            "console",
            lambda said: wrong.append(said.text) if said.type == "error" else None,
        )
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(url if by == "http" else f"file://{site}/index.html")
        _visit(page)
        link = page.evaluate("location.href")
        # Past the edge, the stop, and again.
        page.locator("#beyond").check()
        page.evaluate("haptic.dial.let(3)")
        page.locator("#scene").focus()
        for _ in range(8):
            page.keyboard.press("Shift+ArrowRight")
        page.wait_for_function("document.querySelector('#again').hidden === false")
        page.locator("#again").click()
        page.wait_for_function("document.querySelector('#again').hidden === true")
        # A link brings anybody to the same law.
        page.goto("about:blank")
        page.goto(f"{link.split('#')[0]}#law=multi_term&k=1500&delay=0.4")
        page.wait_for_function("haptic.laws.state?.active === 'multi_term'")
        page.wait_for_function("haptic.laws.state.laws.multi_term.stiffness === 1500")
        page.wait_for_function("haptic.laws.state.device_delay === 0.4")
        # Another scenario, in three axes.
        page.locator("#scenarios").select_option("sphere_feel")
        page.wait_for_function(
            "haptic.space.shape !== null && !document.querySelector('#space').hidden"
        )
        wait_for(
            lambda: page.evaluate("Number(document.body.dataset.bins) > 300"),
            "it plays",
        )
    assert wrong == []


_MOVING = """
summary: a ball goes to and fro while the hand rests
include:
  - launch: sphere_feel
    parameters:
      driver: {device: {hand: {path: [[0, 0], [1, 0]]}}}
      environment:
        surface:
          kind: sphere
          position: [0.07, 0.01, -0.05]
          radius: 0.015
          motion: {path: [[0, 0, 0, 0], [1, -0.03, 0, 0], [2, 0, 0, 0]], repeat: 2}
"""


@pytest.mark.slow
@pytest.mark.process
@needs_browser
def test_a_shape_that_moves_is_drawn_while_the_hand_rests(tmp_path: Path) -> None:
    """It stood still from 4.5 s on."""
    (tmp_path / "moving.yaml").write_text(_MOVING)
    write_site(tmp_path / "page", (str(tmp_path / "moving.yaml"),))
    with chromium() as browser:
        page = browser.new_page()
        page.goto(f"file://{tmp_path}/page/index.html")
        # Longer than what rests is drawn.
        page.wait_for_function("haptic.space.now?.t > 6")
        drawn = page.evaluate("haptic.space.drawn")
        page.wait_for_function("drawn => haptic.space.drawn !== drawn", arg=drawn)


@pytest.mark.slow
@pytest.mark.process
@needs_browser
def test_the_page_goes_on_offline_and_by_touch(site: Path) -> None:
    with served(site) as url, chromium() as browser:
        phone = browser.new_context(
            viewport={"width": 390, "height": 780}, has_touch=True, is_mobile=True
        )
        page = phone.new_page()
        page.goto(url)
        page.wait_for_function("document.body.dataset.ready === 'static'")
        phone.set_offline(True)
        box: Any = page.locator("#scene").bounding_box()
        touch = phone.new_cdp_session(page)
        x, y = box["x"] + box["width"] / 2, box["y"] + 0.2 * box["height"]
        for kind, at in (
            ("touchStart", y),
            ("touchMove", y + 40),
            ("touchMove", y + 0.7 * box["height"]),
        ):
            touch.send(
                "Input.dispatchTouchEvent",
                {
                    "type": kind,
                    "touchPoints": [
                        {
                            "x": x + (0 if box["height"] > box["width"] else at - y),
                            "y": at,
                        }
                    ],
                },
            )
            page.wait_for_timeout(50)
        page.wait_for_function("haptic.scene.grip.used")
        before = int(page.evaluate("Number(document.body.dataset.bins)"))
        wait_for(
            lambda: page.evaluate("Number(document.body.dataset.bins)") > before + 200,
            "it plays",
        )
        width = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
        assert width[0] <= width[1]
        page.evaluate("document.querySelector('#lab').open = true")
        assert page.evaluate(SMALL_TARGETS) == []


@pytest.mark.slow
@pytest.mark.process
@needs_browser
def test_a_link_sets_h1_and_make_it_sing_shows_what_lies_past_the_edge(
    site: Path,
) -> None:
    """Also a link pasted into the open page."""
    stiffness = "haptic.dial.stiffness"
    with chromium() as browser:
        page = browser.new_page()
        page.goto(f"file://{site}/index.html#law=designed_d1&k=9000")
        page.wait_for_function(f"Math.abs({stiffness} - 9000) < 1")
        page.evaluate("location.hash = '#law=pd&k=1500'")
        page.wait_for_function(
            f"haptic.laws.state.active === 'pd' && {stiffness} === 1500"
        )
        # Past the edge, with its delay; its copy is of the session from its begin.
        page.evaluate("location.hash = '#law=pd&k=3000&delay=2'")
        page.wait_for_function(
            f"haptic.laws.state.device_delay === 2 && {stiffness} === 3000"
        )
        page.wait_for_function("document.querySelector('#beyond').checked")
        page.locator("#python").click()
        page.wait_for_function(
            "document.querySelector('#python').textContent === 'Copied'"
        )
        page.locator("#sing").click()
        page.wait_for_function("haptic.dial.isPast(haptic.dial.stiffness)")
        page.wait_for_function(
            "document.querySelector('#sung').textContent.includes('sings')"
        )
        # Both dials show where the edge is: their ends are red.
        for dial in ("dial", "delay"):
            part = f"getComputedStyle({dial}).getPropertyValue('--safe-part')"
            page.wait_for_function(f"parseFloat({part}) < 99")
        page.wait_for_function(
            "document.querySelector('#sung').textContent.includes('rests')"
        )
