"""Compiling the ticks once into the cache of compiled code, so that nodes need no numba.

numba makes a kernel from the functions that the plain tick calls, and LLVM writes it as an object
file (machine_code.py). If the machine has a linker it becomes a shared library, which loads
fastest; otherwise llvmlite loads the object file. Each kernel is compiled in a process of its own,
as many in parallel as there are processors; with ``--idle`` only missing ones, when nothing else
has to be done::

    python -m nodes.compiled.build [--idle] MODULE...
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from nodes.compiled import cache
from nodes.compiled.machine_code import ENTRY as ENTRY
from nodes.compiled.machine_code import linked, object_file
from nodes.compiled.message_fields import NotCompilableError
from nodes.compiled.source_files import sources_of

TIMEOUT: Final = 300.0  # longest time to compile one kernel [s]
# assumed processor time of a kernel that was never compiled here [s]
USUAL: Final = 10.0
_FAILED: Final = "Failed in nopython mode pipeline"


def find(module: str) -> cache.CacheEntry | None:
    """Return a kernel compiled from the installed sources, or None.

    Raises CacheRefusedError if another user could have written it.
    """
    return cache.read(f"{module}.tick")


def reason(entry: cache.CacheEntry | None) -> str:
    """Return why a kernel could not be compiled in the background, or ""."""
    return (
        entry.content.decode() if entry is not None and entry.kind == "failed" else ""
    )


def expected_seconds(modules: Sequence[str]) -> tuple[float, bool]:
    """Return how long compiling takes here [s], and whether that was measured for each kernel.

    It is the processor time of the last compilation, in parallel on this machine's processors;
    `USUAL` for a kernel that was never compiled here.
    """
    took = []
    for module in modules:
        entry = cache.read(f"{module}.seconds")
        with contextlib.suppress(ValueError):
            if entry is not None:
                took.append(float(entry.content))
    is_measured = len(took) == len(modules)
    took += [USUAL] * (len(modules) - len(took))
    return max(max(took, default=0.0), sum(took) / _processors()), is_measured


def build_in_background(modules: Sequence[str]) -> bool:
    """Compile kernels at idle priority, in processes that outlive this one.

    Returns False, and does nothing, if other processes are at it. Raises CacheRefusedError if
    nothing can be written to the cache.
    """
    lock = cache.alone()
    if lock is None:
        return False
    try:
        # inherited, so that it is held until the last kernel is made
        os.set_inheritable(lock, True)
        nothing = [
            (os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_RDWR, 0)
            for stream in range(3)
        ]
        command = [sys.executable, "-m", "nodes.compiled.build", "--idle", *modules]
        os.posix_spawn(
            sys.executable, command, os.environ, file_actions=nothing, setsid=True
        )
    finally:
        os.close(lock)
    return True


def build(modules: Sequence[str]) -> None:
    """Compile kernels in parallel, each in a process of its own."""
    with ThreadPoolExecutor(max_workers=_processors()) as pool:
        failed = [failure for failure in pool.map(_build_one, modules) if failure]
    if failed:
        raise NotCompilableError(failed[0])


def _processors() -> int:
    """Return the number of processors for compiling."""
    return os.cpu_count() or 1


def _build_one(module: str) -> str:
    """Compile a kernel in a process of its own. Return why it failed, or ""."""
    process = subprocess.Popen(
        [sys.executable, "-m", "nodes.compiled.build", module],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _, errors = process.communicate(timeout=TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return f"{module}: not compiled within {TIMEOUT:g} s"
    if not process.returncode:
        return ""
    lines = errors.strip().splitlines() or [
        f"the compiler ended with exit code {process.returncode}"
    ]
    return f"{module}: {lines[-1]}"


# -- in the process that compiles --


def _cause(error: Exception) -> str:
    """Return in a line why a kernel could not be compiled, and where; numba's innermost cause.

    numba makes one text of nested failures: the error has no ``__cause__``, and its ``loc`` is
    that of the outermost call. A slow test (test_choose.py) fails if its words change.
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [
        type(error).__name__
    ]
    failed = [n for n, line in enumerate(lines[:-1]) if _FAILED in line]
    if not failed:
        return lines[-1]
    cause = lines[failed[-1] + 1]
    where = next(
        (
            line.removeprefix("File ").rstrip(":")
            for line in lines[failed[-1] :]
            if line.startswith("File ")
        ),
        "",
    )
    if cause.startswith("Untyped global name"):
        cause += "; a function that a tick calls must be named in its kernel"
    return f"{cause} ({where})" if where else cause


def _compile(module: str, keep_failure: bool) -> None:
    # before compiling: later changes were not compiled
    sources = {**sources_of(module), **sources_of("nodes.compiled.machine_code")}
    begin = time.process_time()
    try:
        kind, content = linked(object_file(module))
        entry = cache.CacheEntry(kind=kind, content=content)
    except Exception as error:
        # What the machine lacks, an installation that is being replaced, may be there next time.
        is_lasting = not isinstance(error, ImportError | OSError | MemoryError)
        if not (keep_failure and is_lasting):
            raise NotCompilableError(_cause(error)) from error
        # it would fail at each launch
        entry = cache.CacheEntry(
            kind="failed", content=f"{module}: {_cause(error)}".encode()
        )
    cache.write(f"{module}.tick", entry, sources)
    if entry.kind != "failed":
        took = f"{time.process_time() - begin:.1f}".encode()
        cache.write(
            f"{module}.seconds", cache.CacheEntry(kind="seconds", content=took), {}
        )


def _idle(modules: Sequence[str]) -> None:
    """Compile missing kernels in parallel, when nothing else wants a processor.

    The caller passes on the lock of background compilation.
    """
    os.nice(19)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.chdir("/")
    running = 0
    for module in modules:
        if find(module) is not None:
            continue
        if running == len(os.sched_getaffinity(0)):
            os.wait()
            running -= 1
        # forked: inherits the idle priority, and the lock of the compiling process
        if os.fork() == 0:
            failed = 1
            try:
                _compile(module, keep_failure=True)
                failed = 0
            finally:
                os._exit(failed)
        running += 1
    for _ in range(running):
        os.wait()


def _main(words: Sequence[str]) -> None:
    try:
        if words[:1] == ["--idle"]:
            _idle(words[1:])
            return
        # the node of a loop would pass on its processor and priority
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        # refused if this container has others
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
        for module in words:
            with cache.making(f"{module}.tick"):
                found = find(module)
                if found is None or reason(found):
                    _compile(module, keep_failure=False)
    except NotCompilableError as error:
        # the compiler's full output, then the result
        traceback.print_exc()
        sys.exit(str(error))
    except cache.CacheRefusedError as error:
        sys.exit(f"not kept: {error}")


if __name__ == "__main__":
    _main(sys.argv[1:])
