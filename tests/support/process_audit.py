"""Write down which tests start a process, and in which fixture: what a partition of the suite by cost begins with.

Loaded where ``HAPTIC_PROCESS_LOG`` names a file; each line of it is a test and the fixture that was
being set up, if any.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from typing import Any, Final

import pytest

STARTS: Final = ("subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn")
LOG: Final = os.environ["HAPTIC_PROCESS_LOG"]

_test: pytest.Item | None = None
_fixtures: list[str] = []
_installed = False


def _watch(event: str, arguments: Any) -> None:
    del arguments
    if _test is None or event not in STARTS:
        return
    with open(LOG, "a", encoding="utf-8") as log:
        log.write(f"{_test.nodeid}\t{_fixtures[-1] if _fixtures else ''}\n")


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
