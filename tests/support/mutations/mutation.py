"""A mutation, and how it is tried: in a copy of the sources, whose tests must fail.

Tests in one process are tried first; what survives them is tried by tests that start processes, if
that is asked for. Real-time tests judge the machine as well and take no part.
"""

from __future__ import annotations

import itertools
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple

from tests.support import ROOT
from tests.support.mutations import first_failure
from tests.support.mutations.forked import Forks

LONGEST: Final = 900
"""Processor time after which a mutation's tests have failed: a loop without end [s].

What waits without end fails by pytest's own timeout.
"""
NOTHING_COLLECTED: Final = 5
"""Exit code of pytest where a file has only tests that are slow or start processes."""

WAITING: Final = 300
"""Time after which a test that starts processes has failed, waiting for a lost one [s]."""


class Stage(IntEnum):
    """Which tests try a mutation; a survivor of one goes on to the next."""

    IN_PROCESS = 1
    LAUNCHED = 2  # tests that start processes


_SELECTED: Final = {
    Stage.IN_PROCESS: ("-m", "not slow and not process"),
    Stage.LAUNCHED: (
        *("-m", "process and not slow and not realtime"),
        f"--timeout={WAITING}",
    ),
}

_dates = itertools.count(int(time.time()) - 10**6)


class Mutation(NamedTuple):
    """A change of a rule, and the tests that it must fail."""

    name: str
    file: str
    old: str  # stands there once, or `place` says where
    new: str
    tests: tuple[str, ...]
    # index of `old` in the text; None where it stands there once
    place: int | None = None
    # files with tests that start processes, for what survives `tests`
    launched: tuple[str, ...] = ()

    def tests_of(self, stage: Stage) -> tuple[str, ...]:
        """Return the files and folders that try it at a stage."""
        return self.tests if stage is Stage.IN_PROCESS else self.launched


class Outcome(NamedTuple):
    """What is known of a mutation: the first test that fails, and how far it was tried."""

    noticed_by: str | None  # None if it survives every stage up to `stage`
    stage: Stage


def mutated(text: str, mutation: Mutation) -> str:
    """Return a file's text with the mutation; ValueError if the original text is missing."""
    old, place = mutation.old, mutation.place
    if place is None:
        if text.count(old) != 1:
            raise ValueError(
                f"{mutation.name}: {old!r} stands {text.count(old)} times in {mutation.file},"
                " not once"
            )
        place = text.index(old)
    if not text.startswith(old, place):
        raise ValueError(
            f"{mutation.name}: {old!r} does not stand at {place} of {mutation.file}"
        )
    return text[:place] + mutation.new + text[place + len(old) :]


def noticed_by(
    mutation: Mutation,
    folder: Path,
    without: frozenset[str] = frozenset(),
    stage: Stage = Stage.IN_PROCESS,
    forks: Forks | None = None,
) -> str | None:
    """Apply a mutation in a copy of the sources; return the first test that fails, or None.

    Parameters
    ----------
    mutation : Mutation
        What to change, and the tests to run.
    folder : Path
        A copy of the sources, as they were again at the end.
    without : frozenset of str
        Test functions that fail without any mutation, which are not run.
    stage : Stage
        Which of its tests are run. One that starts processes must fail twice, because a busy
        machine alone may fail it once.
    forks : Forks, optional
        What tries a change inside a function without another start of pytest.
    """
    path = folder / mutation.file
    text = path.read_text(encoding="utf-8")
    changed = mutated(text, mutation)
    _write(path, changed)
    try:
        if forks and stage is Stage.IN_PROCESS:
            was_tried, failed = forks.first_failure(
                mutation.file, (text, changed), list(mutation.tests), without, LONGEST
            )
            if was_tried:
                return failed
        for tests in stages(mutation.tests_of(stage)):
            left_out = set(without)
            while failed := _first_failure(folder, (*tests, *_but(left_out)), stage):
                if stage is Stage.IN_PROCESS or not failed.startswith("tests/"):
                    return failed
                again = (function_of(failed), *_but(without))
                if _first_failure(folder, again, stage):
                    return failed
                left_out.add(function_of(failed))
        return None
    finally:
        _write(path, text)


def _but(left_out: Iterable[str]) -> tuple[str, ...]:
    return tuple(f"--deselect={test}" for test in sorted(left_out))


def failing_anyway(
    tests: Iterable[str], folder: Path, stage: Stage = Stage.IN_PROCESS
) -> frozenset[str]:
    """Return which tests fail without any mutation: they notice nothing.

    Parameters
    ----------
    tests : iterable of str
        Ids of test functions, and files that cannot be collected.
    folder : Path
        A copy of the sources without a mutation.
    stage : Stage
        The stage at which they noticed one.
    """
    left, failing = set(tests), set[str]()
    while left:
        files = sorted(test for test in left if "::" not in test)
        functions = sorted(left.difference(files))
        failed = None
        if files:
            failed = _first_failure(folder, ("--collect-only", *files), stage)
        if functions and not failed:
            failed = _first_failure(folder, tuple(functions), stage)
        if not failed:
            break
        if function_of(failed) not in left:
            raise RuntimeError(f"without any mutation: {failed}")
        failing.add(function_of(failed))
        left.remove(function_of(failed))
    return frozenset(failing)


def function_of(test: str) -> str:
    """Return the id of a test without its parameters."""
    return test.partition("[")[0]


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
    # Bytecode is known by date and size of its source: two versions of one second are two dates.
    date = next(_dates)
    os.utime(path, (date, date))


def stages(tests: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return what runs one after the other: files, which fail most, then their folders."""
    files = tuple(test for test in tests if test.endswith(".py"))
    folders = tuple(test for test in tests if not test.endswith(".py"))
    rest = (*folders, *(f"--ignore={file}" for file in files)) if folders else ()
    return [stage for stage in (files, rest) if stage]


def near(tests: tuple[str, ...]) -> tuple[str, ...]:
    """Return the files among tests if they are more than two, else all tests."""
    files = stages(tests)[0]
    return files if len(files) > 2 else tests


def _first_failure(folder: Path, words: tuple[str, ...], stage: Stage) -> str | None:
    """Run tests up to the first that fails; return its id, or how pytest ended without one."""
    environment = _environment(folder)
    written = Path(environment[first_failure.FILE])
    written.unlink(missing_ok=True)
    with subprocess.Popen(
        _pytest(words, stage),
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (LONGEST, LONGEST))
        code = process.wait()
    if code in (0, NOTHING_COLLECTED):
        return None
    if written.exists():
        return written.read_text(encoding="utf-8")
    return f"pytest ends with {code}"


def _pytest(words: tuple[str, ...], stage: Stage) -> list[str]:
    return [
        *(sys.executable, "-m", "pytest", "-n", "0", "-q", "-x"),
        *("-p", "no:cacheprovider", "-p", first_failure.__name__),
        *(*_SELECTED[stage], *words),
    ]


def _environment(folder: Path) -> dict[str, str]:
    # Compiled code belongs to the path of its sources: it is of no use when the copy is gone.
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "NUMBA_CACHE_DIR": f"{folder}/cache",
        first_failure.FILE: str(folder / "first_failure"),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def forks(mutations: Iterable[Mutation], folder: Path) -> Forks:
    """Return a pytest that collects once what tries some mutations in one process."""
    places = {test for one in mutations for test in one.tests}
    folders = {place for place in places if not place.endswith(".py")}
    # A file that stands in a folder is collected with it.
    files = {place for place in places if str(Path(place).parent) not in folders}
    words = tuple(sorted(folders | files))
    return Forks(_pytest(words, Stage.IN_PROCESS), folder, _environment(folder))


def copy_sources(folder: Path) -> None:
    """Copy everything that the tests of rules need."""
    for name in ("messages", "nodes", "sim", "tests", "launch"):
        shutil.copytree(
            ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, folder)
