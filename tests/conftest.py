"""Shared fixtures: a ZeroMQ context, a socket path, keys, and shares of the machine."""

from __future__ import annotations

import gc
import os
import signal
import statistics
import sys
import time
import tomllib
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

# As ``haptic`` does for its own processes, before numpy is there.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest

from messages.transport import keys
from messages.transport.context import new_context
from messages.transport.keys import Identity
from tests.support import ROOT
from tests.support.launching import private_runtime_dir
from tests.support.machine import machine

if TYPE_CHECKING:
    from messages.transport.endpoints import Context

# Launches of tests that take the plain tick leave nothing behind that goes on.
os.environ.setdefault("HAPTIC_COMPILE", "asked")
# Every launch is five processes: without its bytecode each of them compiles the project anew, a
# quarter of what it costs.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# A shell that runs the suite in the background leaves SIGINT ignored, for all that tests start and
# interrupt too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Nor are the tests themselves rewritten by every worker of every run.
sys.dont_write_bytecode = False
# No test asserts an absolute time, as hypothesis does unasked: 200 ms for an example. Examples may
# share their test's folder.
UNCHECKED = [
    hypothesis.HealthCheck.too_slow,
    hypothesis.HealthCheck.function_scoped_fixture,
]
hypothesis.settings.register_profile(
    "untimed", deadline=None, suppress_health_check=UNCHECKED
)
hypothesis.settings.load_profile("untimed")


LONG_FILES = (
    "tests/test_pages.py",
    "tests/test_extending.py",
    "tests/sim/tune",
    "tests/nodes/launcher/test_machines.py",
    "tests/nodes/view",
    "tests/sim/lab/paper",
    "tests/sim/drill",
    "tests/sim/identify",
    "tests/sim/lab/charts",
    "tests/sim/api",
    "tests/nodes/launcher",
    "tests/nodes/compiled/test_second_launch.py",
    "tests/sim/play",
    "tests/sim/cli",
    "tests/sim/device_check/test_device_check.py",
    "tests/nodes/cli",
    "tests/test_package.py",
    "tests/test_house.py",
    "tests/test_fuzz.py",
)
"""Files that take minutes run first: started last, one would keep a single processor busy."""


def _asks_for_all(config: pytest.Config) -> bool:
    """Whether folders, files or tests are named without markers: then all but slow ones run."""
    named = config.args_source is pytest.Config.ArgsSource.ARGS
    return named and not any(
        word.startswith("-m") for word in config.invocation_params.args
    )


def pytest_configure(config: pytest.Config) -> None:
    """Refuse an installation older than pyproject.toml; include process tests if named."""
    if not hasattr(config, "workerinput") and _asks_for_all(config):
        config.option.markexpr = "not slow"
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]["entry-points"]
    for group, wanted in groups.items():
        found = {point.name: point.value for point in entry_points(group=group)}
        if not wanted.items() <= found.items():
            raise pytest.UsageError(
                f"pyproject.toml has other entry points than are installed ({group}): pip install"
                " -e ."
            )


# Last: what is not selected is gone by then, and its file needs no machine of its own.
@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest files first, browser tests apart, and real-time tests last.

    A real-time test waits for what the other workers are running, which at the end is nothing long.
    A browser draws with both processors of a small machine: two at once, each beside a real-time
    launch, would only test the load.
    """
    alone = {
        item.path for item in items if item.get_closest_marker("realtime") is not None
    }
    for item in items:
        # Whatever stands in a file of theirs would hold up those of all files: it needs the whole
        # machine, each of them half.
        if item.path in alone:
            item.add_marker("realtime")
    drawn = {
        item.path for item in items if "browser" in getattr(item, "fixturenames", ())
    } - alone

    def length(item: pytest.Item) -> int:
        return next(
            (i for i, start in enumerate(LONG_FILES) if item.nodeid.startswith(start)),
            len(LONG_FILES),
        )

    items.sort(key=length)
    order = {
        path: float(i)
        for i, path in enumerate(
            dict.fromkeys(item.path for item in items if item.path not in drawn)
        )
    }
    for i, path in enumerate(
        dict.fromkeys(item.path for item in items if item.path in drawn)
    ):
        # So far apart that one is done before the next begins.
        order[path] = 2 * WORKERS * i - 0.5
    items.sort(key=lambda item: (item.path in alone, order[item.path]))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection() -> Iterator[None]:
    """Collect tests without garbage collection, a fifth of what collection takes.

    What is made lives until the end, and is exempt from then on: each full garbage collection
    would go through all modules and tests again, for 0.7 s.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
        # as in the commands themselves (nodes/cli/command.py), but large arrays in cycles pass
        gc.set_threshold(10_000, 10, 10)


WORKERS = len(os.sched_getaffinity(0)) + 2
"""Two more than the processors: many tests wait for processes and for real time."""


SLOW = 0.04
"""Time of a million additions above which a machine counts as slow [s].

Usual are 0.025 s. At 0.05 to 0.11 s, four workers on two processors were slower than two, and 21
tests missed deadlines that they keep by a factor of two.
"""


def _million_additions() -> float:
    """Measure the time of a million additions [s]."""
    begun, total = time.process_time(), 0
    for number in range(1_000_000):
        total += number
    return time.process_time() - begun


def pytest_xdist_auto_num_workers() -> int:
    """Return the workers for `-n auto`: WORKERS, or one per processor on a slow machine."""
    return (
        WORKERS
        if statistics.median(_million_additions() for _ in range(7)) < SLOW
        else WORKERS - 2
    )


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Reserve the machine from before a test's fixtures are set up until they are gone."""
    worker = getattr(item.config, "workerinput", None)
    # What will be skipped needs no machine, and must not wait until it has one.
    if worker is None or any(all(mark.args) for mark in item.iter_markers("skipif")):
        return (yield)
    with machine(
        worker["testrunuid"], alone=item.get_closest_marker("realtime") is not None
    ):
        return (yield)


@pytest.fixture
def context() -> Iterator[Context]:
    made = new_context()
    yield made
    made.destroy(linger=0)


@pytest.fixture
def place() -> Iterator[str]:
    with private_runtime_dir() as folder:
        yield f"ipc://{folder}/p"


@pytest.fixture
def me(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Identity:
    monkeypatch.setenv("HAPTIC_KEYS", str(tmp_path / "keys"))
    return keys.new_identity()


pytest_plugins = (
    "tests.support.process_audit",
    "tests.support.examples",
    "tests.support.thorough",
)
