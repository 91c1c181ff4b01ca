"""Measure the cost of the page to the loop, open in a browser while the hand is dragged.

Half of each round runs without a page; the page's own delays are measured as well.
"""

import argparse
import contextlib
import json
import math
import os
import shutil
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.types import DeviceState, Force, Message, Proxy
from nodes.base.realtime import memory_bytes, off
from nodes.parameters.quantities import ROUNDS, SECONDS, declare, positive
from nodes.recording.accounts import overruns
from nodes.recording.reader import Recording
from nodes.view.live import Facts, LiveRun
from sim.cli.answers import add_answer, idle, report
from sim.measure.haptic_commands import HAPTIC
from sim.measure.measured_launch import Running, machine, responses_in
from sim.measure.stopwatch import Progress

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chromium-headless-shell")
OPTIONS = [
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-sync",
]
# WebGL 2 without a graphics card, for pictures of the 3D view; the page itself is drawn without,
# which costs a tenth
WITH_WEBGL = [
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
]

COMPILED = 180.0  # longest wait until another law plays beside the launch [s]
# In the page: time from navigation until scene, plots and laws, and until the map are shown [ms].
FIRST = """function look() {
  if (document.body?.dataset.bins > 0 && document.querySelector("#laws input"))\
 window.shown ??= performance.now();
  if (window.shown && globalThis.haptic?.map.map) window.mapped = performance.now();
  else requestAnimationFrame(look);
}
look();"""
# In the page: choose a law and wait until its receipt is in the log [ms].
SWITCH = """name => new Promise((done) => {
  const begun = performance.now(), before = document.querySelectorAll("#log li.receipt").length;
  new MutationObserver((_, observer) => {
    if (document.querySelectorAll("#log li.receipt").length === before) return;
    observer.disconnect();
    done(performance.now() - begun);
  }).observe(document.getElementById("log"), { childList: true });
  document.querySelector(`#laws input[value=${name}]`).click();
})"""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--rounds",
        type=ROUNDS,
        default=4,
        help="rounds of without and with (default 4)",
    )
    parser.add_argument(
        "--seconds",
        type=SECONDS,
        default=4.0,
        help="length of each half of a round (default 4 s)",
    )
    declare(parser, rate=500.0)
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="take one of the page while the wall is pushed (PNG)",
    )
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="FOLDER",
        help="take those of the project's pages instead of measuring (PNG)",
    )
    parser.add_argument(
        "--minutes",
        type=positive,
        default=30.0,
        help="of ticks for the memory (default 30)",
    )
    add_answer(parser, run, files=False)


def _drag(page: Any, seconds: float, picture: Path | None = None) -> None:
    """Drag the hand into the wall and out of it at 60 Hz; stop for a screenshot."""
    box = page.locator("#scene").bounding_box()
    middle, y, until = (
        box["x"] + box["width"] / 2,
        box["y"] + box["height"] / 2,
        time.monotonic() + seconds,
    )
    page.mouse.move(middle, y)
    page.mouse.down()
    while (now := time.monotonic()) < until:
        page.mouse.move(middle + 0.49 * box["width"] * math.sin(4.0 * now), y)
        page.wait_for_timeout(1000.0 / 60.0)
    if picture is not None:
        page.mouse.move(middle + 0.42 * box["width"], y)
        page.wait_for_timeout(2000.0)
        page.screenshot(path=picture)
    page.mouse.up()


FIRST_S = {"shown": "first_picture_s", "mapped": "map_s"}


def _opened(browser: Any, url: str) -> Any:
    """Open a page that notes when its first picture and its map are shown."""
    page = browser.new_page(viewport={"width": 1280, "height": 960}, bypass_csp=True)
    page.add_init_script(FIRST)
    page.goto(url)
    return page


def _since_navigation(page: Any, name: str) -> float:
    """Wait for what the page notes; return when it was, from the navigation [s]."""
    return float(page.wait_for_function(f"window.{name}").json_value()) / 1e3


def _with_page(
    launch: Running,
    browser: Any,
    seconds: float,
    delays: dict[str, list[float]],
    picture: Path | None,
) -> tuple[float, float]:
    """Open a page, drag, switch the law twice; return start and end of the dragging [s]."""
    view = subprocess.Popen(
        [*HAPTIC, "view", "--json"],
        cwd=launch.folder,
        env=launch.environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert view.stdout is not None  # noqa: S101  # it is a pipe
        url = json.loads(view.stdout.readline())["url"]
        page = _opened(browser, url)
        for name in ("shown", "mapped"):
            delays[FIRST_S[name]].append(_since_navigation(page, name))
        # As somebody finds it who opens the page again: the last map was kept.
        again = _opened(browser, url)
        delays["kept_map_s"].append(_since_navigation(again, "mapped"))
        again.close()
        # The full load of a page: dragging, sound, and another law played beside the launch.
        page.locator("#sound").click()
        page.evaluate("haptic.beside.choose('multi_term')")
        # The first run on a machine compiles the one-process loop.
        page.wait_for_function(
            "haptic.beside.times.length > 100", timeout=1e3 * COMPILED
        )
        began = time.monotonic()
        _drag(page, seconds)
        ended = time.monotonic()
        delays["hand_to_picture_s"] += [
            ms / 1e3 for ms in page.evaluate("haptic.lag.all")
        ]
        delays["hand_to_force_s"] += [
            ms / 1e3 for ms in page.evaluate("haptic.lag.forces")
        ]
        delays["switch_s"] += [
            page.evaluate(SWITCH, name) / 1e3 for name in ("multi_term", "pd")
        ]
        if picture is not None:
            _drag(page, 1.0, picture)
        page.close()
        return began, ended
    finally:
        view.send_signal(signal.SIGINT)
        view.communicate(timeout=30.0)


def loop_cost(
    rounds: int,
    seconds: float,
    rate: float,
    progress: Progress,
    picture: Path | None = None,
) -> dict[str, Any]:
    """Run one launch, with a page open in every second half of a round."""
    halves: dict[str, list[tuple[float, float]]] = {"without": [], "with": []}
    delays: dict[str, list[float]] = {
        "first_picture_s": [],
        "map_s": [],
        "kept_map_s": [],
        "switch_s": [],
        "hand_to_picture_s": [],
        "hand_to_force_s": [],
    }
    # As ``haptic view`` opens it: the browser too avoids the processor of the loop.
    with (
        Running("touch_wall", f"rate:={rate}") as launch,
        off(launch.run.processors),
        browsing() as browser,
    ):
        for _ in range(rounds):
            began = time.monotonic()
            time.sleep(seconds)
            halves["without"].append((began, time.monotonic()))
            progress.step("no page")
            halves["with"].append(_with_page(launch, browser, seconds, delays, picture))
            progress.step("a page, somebody dragging")
        figures = launch.finish(signal.SIGINT)
        recording = Recording(launch.folder / figures["recording"])
        states = recording.messages(DEVICE_STATE)
        lost = recording.topics[DEVICE_STATE].gaps - (overruns(recording) or 0)
    found: dict[str, Any] = {"rate_hz": rate, "lost": lost}
    without, with_ = (
        found.setdefault(label, responses_in(states, halves[label]))
        for label in ("without", "with")
    )
    for name in ("p50", "p99"):
        pairs = zip(with_[f"{name}_us"], without[f"{name}_us"], strict=True)
        found[f"{name}_ratio"] = statistics.median(a / b for a, b in pairs)
        found[f"{name}_spread"] = max(without[f"{name}_us"]) / min(
            without[f"{name}_us"]
        )
    return found | {name: statistics.median(values) for name, values in delays.items()}


def memory(minutes: float, rate: float) -> dict[str, float]:
    """Feed a view with minutes of ticks as fast as possible; return its memory [MB]."""
    live = LiveRun(
        Facts(
            "run", "scenario", "", 1.0 / rate, "realtime", "on_arrival", ["x"], "driver"
        )
    )
    live.tick(0.0)
    after = 0.0
    for seq in range(round(60.0 * minutes * rate)):
        x = 0.02 * math.sin(0.01 * seq)
        stamp = seq / rate
        messages: tuple[tuple[str, Message], ...] = (
            (
                DEVICE_STATE,
                DeviceState(
                    seq=seq, stamp=stamp, position=(x, 0.0, 0.0), response=1.5e-4
                ),
            ),
            (
                PROXY,
                Proxy(
                    seq=seq, stamp=stamp, position=(x, 0.0, 0.0), proxy=(x, 0.0, 0.0)
                ),
            ),
            (FORCE, Force(seq=seq, stamp=stamp, force=(-x, 0.0, 0.0))),
        )
        for topic, message in messages:
            live.keep(topic, message, stamp)
        if seq % 16 == 0:
            live.tick(stamp)
        if seq == round(60.0 * rate):
            after = memory_bytes() / 1e6
    return {
        "after_one_minute_mb": after or memory_bytes() / 1e6,
        "at_the_end_mb": memory_bytes() / 1e6,
    }


@contextlib.contextmanager
def browsing(options: Sequence[str] = OPTIONS) -> Iterator[Any]:
    """Run a browser for the length of a with block."""
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise UsageError(
            "bench view: needs playwright; pip install playwright"
        ) from error
    if path is None:
        raise UsageError("bench view: needs a browser; apt install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(options))
        try:
            yield browser
        finally:
            browser.close()


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    if arguments.pictures is not None:
        # Its player's rules, and numba with them, would count in the memory of the view.
        from sim.lab.bench.page_pictures import take

        unused = ("rounds", "seconds", "rate", "picture", "minutes")
        idle(arguments, "--pictures measures nothing", *unused)
        drawn = [option for option in OPTIONS if option != "--disable-gpu"]
        with browsing([*drawn, *WITH_WEBGL]) as browser:
            taken = take(
                browser,
                arguments.pictures,
                lambda name: print(name, file=sys.stderr, flush=True),
            )
        paths = [str(path) for path in taken]
        return report(arguments, {"pictures": paths}, paths)
    progress, load = Progress(2 * arguments.rounds), [os.getloadavg()[0]]
    figures = loop_cost(
        arguments.rounds, arguments.seconds, arguments.rate, progress, arguments.picture
    )
    load.append(os.getloadavg()[0])
    figures |= {
        "memory": memory(arguments.minutes, arguments.rate),
        "machine": machine(),
        "load_1min": load,
    }
    return report(arguments, figures, _text(figures, arguments.minutes))


def _text(figures: dict[str, Any], minutes: float) -> list[str]:
    before, after = figures["load_1min"]
    lines = [
        f"{figures['machine']}; load {before:.1f} before, {after:.1f} after, this one's own"
        " included"
    ]
    for label, text in (
        ("without", "no page"),
        ("with", "page open, dragged, with sound and A | B"),
    ):
        half = figures[label]
        lines.append(
            f"{text}: response p50 {statistics.median(half['p50_us']):.0f} µs, p99"
            f" {statistics.median(half['p99_us']):.0f} µs, missed {half['missed']} of"
            f" {half['ticks']}"
        )
    lines.append(
        f"with/without: p50 {figures['p50_ratio']:.2f} (rounds without differ by"
        f" {figures['p50_spread']:.2f}), p99 {figures['p99_ratio']:.2f}"
        f" ({figures['p99_spread']:.2f}); messages lost by the recording {figures['lost']}"
    )
    kept = figures["memory"]
    switch, hand, force = (
        1e3 * figures[name]
        for name in ("switch_s", "hand_to_picture_s", "hand_to_force_s")
    )
    lines.append(
        f"first picture {figures['first_picture_s']:.2f} s after the URL, the map after"
        f" {figures['map_s']:.2f} s, in a page opened later after"
        f" {figures['kept_map_s']:.2f} s; from the hand to the"
        f" force {force:.0f} ms, to the picture {hand:.0f} ms; a switch is shown in {switch:.0f}"
        f" ms; memory {kept['after_one_minute_mb']:.1f} MB after one minute,"
        f" {kept['at_the_end_mb']:.1f} MB after {minutes:g}"
    )
    return lines
