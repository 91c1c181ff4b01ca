"""Trials in forks of a pytest that has collected its tests: it starts once for all.

A change inside a function replaces the code of that function in a fork, whose tests then run.
Whatever else runs a changed line (the body of a module or a class, a kernel of numba) needs an
ordinary run. What was computed while tests were collected is as without the mutation, so a fork may
miss what an ordinary run notices, and what it notices an ordinary run notices too.
"""

from __future__ import annotations

import gc
import inspect
import json
import os
import resource
import signal
import subprocess
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Self

import pytest

from tests.support.mutations import first_failure

PIPES: Final = "HAPTIC_FORKED_PIPES"
"""Variable of the environment: descriptors of requests and of answers."""
MISSING: Final = 77
"""Exit code of a fork that found no function with the code to replace."""
Pairs = list[tuple[types.CodeType, types.CodeType]]
"""Present and new code of functions."""


def replaced_code(text: str, changed: str) -> Pairs | None:
    """Return present and new code of the functions that differ; None if other code does.

    Parameters
    ----------
    text, changed : str
        A module's text without and with a mutation.
    """
    if "numba" in text:
        return None
    pairs: Pairs = []
    old, new = (
        compile(one, "module", "exec", dont_inherit=True) for one in (text, changed)
    )
    return pairs if _compare(old, new, pairs) and pairs else None


def _compare(old: types.CodeType, new: types.CodeType, pairs: Pairs) -> bool:
    """Collect differing functions; return whether all that differs is in functions."""
    is_function = bool(old.co_flags & inspect.CO_OPTIMIZED)
    if is_function:
        if old != new:
            pairs.append((old, new))
        if len(old.co_freevars) != len(new.co_freevars):
            return False
    elif _alone(old) != _alone(new):
        return False
    inner = [_codes(one) for one in (old, new)]
    if len(inner[0]) != len(inner[1]):
        return is_function
    return all(
        one == other or _compare(one, other, pairs)
        for one, other in zip(*inner, strict=True)
    )


def _codes(code: types.CodeType) -> list[types.CodeType]:
    return [one for one in code.co_consts if isinstance(one, types.CodeType)]


def _alone(code: types.CodeType) -> types.CodeType:
    """Return a body without the functions in it."""
    consts = (
        None if isinstance(one, types.CodeType) else one for one in code.co_consts
    )
    return code.replace(co_consts=tuple(consts))


def replace(pairs: Pairs, file: str) -> bool:
    """Replace the code of a file's functions that exist; return whether any did."""
    found = False
    # By type(): isinstance asks a weak proxy, whose object may be gone.
    functions = [one for one in gc.get_objects() if type(one) is types.FunctionType]
    for function in functions:
        if function.__code__.co_filename == file:
            for old, new in pairs:
                if function.__code__ == old:
                    function.__code__ = new.replace(co_filename=file)
                    found = True
                    break
    return found


class Forks:
    """A pytest that collects some files when it is needed and tries mutations in forks.

    Parameters
    ----------
    command : list of str
        pytest with the files and folders to collect.
    folder : Path
        The copy of the sources.
    environment : dict
        Its environment.
    """

    def __init__(
        self, command: list[str], folder: Path, environment: dict[str, str]
    ) -> None:
        self._command, self._folder, self._environment = command, folder, environment
        self._written = Path(environment[first_failure.FILE])
        self._process: subprocess.Popen[bytes] | None = None

    def _start(self) -> None:
        request, self._requests = os.pipe()
        answers, answer = os.pipe()
        self._process = subprocess.Popen(
            [*self._command, "-p", __name__],
            cwd=self._folder,
            env={**self._environment, PIPES: f"{request} {answer}"},
            pass_fds=(request, answer),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(request)
        os.close(answer)
        self._lines = os.fdopen(answers, encoding="utf-8")

    def first_failure(
        self,
        file: str,
        texts: tuple[str, str],
        tests: list[str],
        without: frozenset[str],
        longest: int,
    ) -> tuple[bool, str | None]:
        """Return whether a mutation could be tried, and the first test that fails with it.

        Parameters
        ----------
        file : str
            The changed file.
        texts : tuple of str
            Its text without and with the mutation.
        tests : list of str
            Files and folders of tests, in the order in which they run.
        without : frozenset of str
            Test functions that are not run.
        longest : int
            Processor time after which they have failed [s].
        """
        if not file.endswith(".py") or replaced_code(*texts) is None:
            return False, None
        self._written.unlink(missing_ok=True)
        if self._process is None:
            self._start()
        words = {
            "file": file,
            "texts": texts,
            "tests": tests,
            "without": sorted(without),
            "longest": longest,
        }
        os.write(self._requests, f"{json.dumps(words)}\n".encode())
        line = self._lines.readline()
        if not line:
            raise RuntimeError(
                "pytest could not collect the tests without any mutation"
            )
        code = int(line)
        if code in (0, MISSING):
            return code == 0, None
        if self._written.exists():
            return True, self._written.read_text(encoding="utf-8")
        return True, f"pytest ends with {code}"

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End pytest, if it was started."""
        if self._process is None:
            return
        os.close(self._requests)
        self._process.wait()
        self._lines.close()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool:
    """Try each requested mutation in a fork in place of running the tests."""
    if session.testsfailed:
        return True
    gc.unfreeze()  # functions of frozen objects would not be found
    requests, answers = map(int, os.environ[PIPES].split())
    with os.fdopen(requests, encoding="utf-8") as lines:
        for line in lines:
            child = os.fork()
            if not child:
                os._exit(_try(session.items, json.loads(line)))
            _, status = os.waitpid(child, 0)
            code = os.waitstatus_to_exitcode(status)
            os.write(answers, f"{code}\n".encode())
    return True


def _try(items: list[pytest.Item], words: dict[str, Any]) -> int:
    """Run the tests of a request with its mutation; return an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_CPU, (words["longest"], words["longest"]))
    pairs = replaced_code(*words["texts"])
    if pairs is None or not replace(pairs, str(Path.cwd() / words["file"])):
        return MISSING
    chosen = list(_chosen(items, words["tests"], frozenset(words["without"])))
    written = Path(os.environ[first_failure.FILE])
    for item, following in zip(chosen, [*chosen[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if written.exists():
            return 1
    return 0


def _chosen(
    items: list[pytest.Item], tests: list[str], without: frozenset[str]
) -> Iterator[pytest.Item]:
    """Yield the items of files in their order, then those of folders."""
    seen = set()
    for place in tests:
        for item in items:
            name = item.nodeid.partition("::")[0]
            if name == place or name.startswith(f"{place}/"):
                if (
                    item.nodeid not in seen
                    and item.nodeid.partition("[")[0] not in without
                ):
                    yield item
                seen.add(item.nodeid)
