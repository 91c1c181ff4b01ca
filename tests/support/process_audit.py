"""Which tests start a process: each of them is marked ``process``, and one that is not fails.

A launch, a browser or a command of its own costs more than a hundred tests in this process, so the default run leaves most
of them to CI (`pytest -m "not slow"`). An audit hook keeps that partition honest.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from typing import Any, Final

import pytest

STARTS: Final = ("subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn")
LOG: Final = os.environ.get("HAPTIC_PROCESS_LOG", "")  # where to write which test and fixture started one, in place of failing

_test: pytest.Item | None = None
_fixtures: list[str] = []
_installed = False


def _watch(event: str, arguments: Any) -> None:
    del arguments
    if _test is None or event not in STARTS:
        return
    if LOG:
        with open(LOG, "a", encoding="utf-8") as log:
            log.write(f"{_test.nodeid}\t{_fixtures[-1] if _fixtures else ''}\n")
        return
    if _test.get_closest_marker("process") is None:
        raise RuntimeError(f"{_test.nodeid} starts a process: mark it with pytest.mark.process (.github/CONTRIBUTING.md)")


def install() -> None:
    """Watch from now on; once a process."""
    global _installed
    if not _installed:
        _installed = True
        sys.addaudithook(_watch)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Remember whose processes are started."""
    global _test
    install()
    _test = item
    try:
        return (yield)
    finally:
        _test = None


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[Any]:
    """Remember which fixture starts them."""
    _fixtures.append(fixturedef.argname)
    try:
        return (yield)
    finally:
        _fixtures.pop()
