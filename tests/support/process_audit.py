"""Check the marker ``process``: a test has it if and only if it starts a process.

A process costs a second of processor time where a call costs a millisecond, so README's line runs
the tests without ``process``, and of those with it the ``smoke`` ones. An audit hook of the
interpreter notices every start; a fixture's start counts for every test that uses the fixture. If
``HAPTIC_TEST_COSTS`` names a file, each test appends a line: its name, the processor time of this
process and of its children [s], and what it started.
"""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator
from multiprocessing import util
from pathlib import Path
from typing import Any, Final

import pytest

STARTS: Final = frozenset(
    {"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn"}
)
ASIDE: Final = frozenset({"git", "uname", "ldconfig", "cc", "gcc", "clang", "ar", "nm"})
"""Programs of some milliseconds whose results are cached: the first caller is random."""
CACHED: Final = (
    "nodes.compiled.build",
    "nodes.compiled.machine_code",
    "nodes.driver.hardware.compile",
    "glfw.library",  # MuJoCo's first import asks its version in a process
)
"""Modules whose processes run on a cold cache only: a test needs no marker for them."""
KEPT: Final = "once: "
COSTS: Final = os.environ.get("HAPTIC_TEST_COSTS")


class Watch:
    """Processes started by the running test, and fixtures set up.

    Parameters
    ----------
    fixtures : dict of int to list of str
        What each fixture definition started when it was last set up, by its id.
    """

    def __init__(self) -> None:
        self.started: list[str] | None = None
        self.fixtures: dict[int, list[str]] = {}

    def __call__(self, event: str, arguments: Any) -> None:
        """Record a start; called as the interpreter's audit hook."""
        if event not in STARTS or self.started is None:
            return
        program = _program(event, arguments)
        if Path(program).name not in ASIDE:
            self.started.append(f"{KEPT}{program}" if _in_cache() else program)

    def of(self, item: pytest.Item) -> list[str]:
        """Return what a test and its fixtures started."""
        definitions = getattr(item, "_fixtureinfo").name2fixturedefs.values()  # noqa: B009
        shared = [
            program
            for several in definitions
            for definition in several
            for program in self.fixtures.get(id(definition), [])
        ]
        return [*(self.started or []), *shared]


def _program(event: str, arguments: Any) -> str:
    if event in {"os.fork", "os.forkpty"}:
        return "fork"
    if event == "os.posix_spawn":
        return os.fsdecode(arguments[0])
    executable, words = arguments[0], arguments[1]
    if executable is not None:
        return os.fsdecode(executable)
    return os.fsdecode(words if isinstance(words, (str, bytes)) else words[0])


def _in_cache() -> bool:
    frame = sys._getframe()
    while frame is not None:
        if frame.f_globals.get("__name__") in CACHED:
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


watch: Final = Watch()


def _spawn_is_told() -> None:
    """Make multiprocessing report its spawned processes, which the interpreter does not."""
    spawn = util.spawnv_passfds

    def told(path: Any, arguments: Any, descriptors: Any) -> Any:
        sys.audit("os.posix_spawn", path, arguments, os.environ)
        return spawn(path, arguments, descriptors)

    setattr(util, "spawnv_passfds", told)  # noqa: B010  # its stub has no variable there


def pytest_configure() -> None:
    """Install the watch, once per interpreter, as an audit hook cannot be removed."""
    sys.addaudithook(watch)
    _spawn_is_told()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Restrict ``smoke`` to the parameters it names, ``smoke("a-b", "c")``, or to all."""
    named: dict[str, set[str]] = {}
    for item in items:
        names = {name for mark in item.iter_markers("smoke") for name in mark.args}
        test, _, parameters = item.nodeid.partition("[")
        parameters = parameters.removesuffix("]")
        if names:
            named.setdefault(test, set(names)).discard(parameters)
        if names and parameters not in names:
            item.own_markers[:] = [
                mark for mark in item.own_markers if mark.name != "smoke"
            ]
            item.keywords._markers.pop("smoke", None)  # type: ignore[attr-defined]
    gone = [f"{test}: {sorted(left)}" for test, left in named.items() if left]
    if gone and not any("::" in argument for argument in config.args):
        raise pytest.UsageError(
            f"smoke names parameters that there are not: {'; '.join(gone)}"
        )


def _cost() -> tuple[float, float]:
    """Return the processor time of this process and of its ended children [s]."""
    own, children = (
        resource.getrusage(who)
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return own.ru_utime + own.ru_stime, children.ru_utime + children.ru_stime


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Watch a test from before its fixtures until they are gone."""
    watch.started = []
    before = _cost()
    try:
        return (yield)
    finally:
        if COSTS:
            own, children = (
                now - then for now, then in zip(_cost(), before, strict=True)
            )
            programs = ",".join(
                sorted({Path(program).name for program in watch.of(item)})
            )
            with open(COSTS, "a", encoding="utf-8") as log:
                log.write(f"{item.nodeid}\t{own:.3f}\t{children:.3f}\t{programs}\n")
        watch.started = None


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[Any]:
    """Record what the fixture starts, for all tests that use it."""
    outer, watch.started = watch.started, []
    try:
        return (yield)
    finally:
        watch.fixtures[id(fixturedef)] = watch.started
        watch.started = outer


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[Any]:
    """Fail a test whose marker contradicts what it did; slow tests need none."""
    result = yield
    started = watch.of(item)
    if item.get_closest_marker("slow") is None:
        marked = item.get_closest_marker("process") is not None
        needed = [program for program in started if not program.startswith(KEPT)]
        if needed and not marked:
            pytest.fail(
                f"starts {needed[0]}, which needs @pytest.mark.process (README's line leaves it"
                " out unless it is marked smoke too); or run it in this process: `typed_in` of"
                " tests/support/launching.py types a verb in, `haptic.play` makes a recording"
            )
        if marked and not started:
            pytest.fail(
                "is marked process and starts none: remove the marker, and it runs by default"
            )
    return result
