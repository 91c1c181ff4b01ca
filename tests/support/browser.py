"""A real browser for the tests: Debian's chromium through Playwright.

If installed, chromium's headless shell is used: the same engine at less than half the cost.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.launching import DEADLINE, HAPTIC, Running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Playwright

_BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")

CHROMIUM = next(filter(None, map(shutil.which, _BROWSERS)), None)

needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium here: apt install chromium-headless-shell"
)

ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


SOFTWARE_GL = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
"""Arguments for WebGL 2 without a graphics card."""


_drivers: list[Playwright] = []


@contextlib.contextmanager
def _driver() -> Iterator[Playwright]:
    """Yield the process's one Playwright, which allows no second in a thread."""
    if _drivers:
        yield _drivers[0]
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        _drivers.append(started)
        try:
            yield started
        finally:
            _drivers.clear()


@contextlib.contextmanager
def chromium(arguments: Sequence[str] = ARGUMENTS) -> Iterator[Browser]:
    """Start a browser for a with block.

    Parameters
    ----------
    arguments : sequence of str
        Its arguments.

    Yields
    ------
    Browser
        Playwright's.
    """
    with _driver() as playwright:
        # Playwright's process starts it: what tests start is heard of here.
        sys.audit("subprocess.Popen", CHROMIUM, [CHROMIUM], None, None)
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=list(arguments)
        )
        try:
            yield browser
        finally:
            browser.close()


def url_of(launch: Running) -> str:
    """Return the page's URL, the first line that a launch with --view --json prints.

    Parameters
    ----------
    launch : Running
        The launch.

    Returns
    -------
    str
        URL with the token.
    """

    def first() -> str:
        lines = (launch.folder / "stdout.txt").read_text(encoding="utf-8").splitlines()
        return str(json.loads(lines[0])["url"]) if lines else ""

    return str(wait_for(first, "the URL"))


@contextlib.contextmanager
def viewing(
    launch_folder: Path, *words: str, environment: Any = None, stderr: Any = None
) -> Iterator[str]:
    """Run ``haptic view`` for a with block.

    Parameters
    ----------
    launch_folder : Path
        Its working directory.
    *words : str
        Its arguments.
    environment : mapping of str to str, optional
        Its variables.
    stderr : file, optional
        Its standard error.

    Yields
    ------
    str
        The page's URL.
    """
    process = subprocess.Popen(
        [*HAPTIC, "view", "--json", *words],
        cwd=launch_folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )
    assert process.stdout is not None
    try:
        yield json.loads(process.stdout.readline())["url"]
    finally:
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        process.stdout.close()
        assert process.wait(30.0) == 0
        assert json.loads(rest.splitlines()[-1])


def shown(page: Page, selector: str) -> str:
    """Return the text of a page element, with non-breaking spaces as plain ones.

    Parameters
    ----------
    page : Page
        The page.
    selector : str
        CSS.

    Returns
    -------
    str
        Its text.
    """
    return page.locator(selector).inner_text().replace("\u00a0", " ")


def bins(page: Page) -> int:
    """Count the bins that a page has received.

    Parameters
    ----------
    page : Page
        The page.

    Returns
    -------
    int
        0 before the first one.
    """
    return int(page.evaluate("Number(document.body.dataset.bins || 0)"))


class OpenPage:
    """A page for a with block; it must not have thrown any error by its end.

    Parameters
    ----------
    browser : Browser
        Playwright's.
    url : str
        URL with the token.
    **context : object
        Settings of its context; the size is 1366 × 768 unless given.
    """

    def __init__(self, browser: Browser, url: str, **context: Any) -> None:
        self._context = browser.new_context(
            **{"viewport": {"width": 1366, "height": 768}, **context}
        )
        self._context.set_default_timeout(1e3 * DEADLINE)
        self._page = self._context.new_page()
        self._errors: list[str] = []
        self._page.on("pageerror", lambda error: self._errors.append(str(error)))
        self._page.goto(url)

    def __enter__(self) -> Page:
        """Wait for its first picture."""
        wait_for(lambda: bins(self._page) > 10, "the first picture")
        return self._page

    def __exit__(self, *error: object) -> None:
        """Close the page."""
        self._context.close()
        assert self._errors == []
