"""``haptic`` commands as processes: run to the end, or interrupted as Ctrl-C does."""

import contextlib
import functools
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from messages.errors import HapticError
from nodes.base.log_line import COMMAND, read_lines
from nodes.base.log_line import VARIABLE as LINES
from nodes.base.realtime import die_with_parent
from nodes.launcher.child import PYTHON
from nodes.parameters.interface_words import VARIABLE

HAPTIC = (
    *PYTHON,
    "-m",
    "nodes.cli.command",
)  # the command ``haptic`` with this interpreter
# Time limit of every wait: detects hangs, measures nothing [s].
DEADLINE = 180.0
# Time limit of a command that first compiles its loop, on a busy machine [s].
COMPILE_TIMEOUT = 3.0 * DEADLINE


class MeasurementError(HapticError):
    """A launch or a yardstick to be measured failed; the text contains its output."""


def within(condition: Callable[[], Any], timeout: float) -> Any:
    """Poll a condition until it is true or `timeout` has passed [s]; return its last result."""
    until = time.monotonic() + timeout
    while not (found := condition()) and time.monotonic() < until:
        time.sleep(0.02)
    return found


def wait_for(
    condition: Callable[[], Any], what: str, deadline: float = DEADLINE
) -> Any:
    """Poll a condition until it is true; return its first true result."""
    found = within(condition, deadline)
    if not found:
        raise MeasurementError(f"{what}: not within {deadline:g} s")
    return found


def haptic(
    folder: Path,
    *words: str,
    code: int | None = 0,
    environment: Mapping[str, str] | None = None,
    timeout: float = COMPILE_TIMEOUT,
) -> subprocess.CompletedProcess[str]:
    """Run a ``haptic`` command in a folder; raise if its exit code is not `code`.

    With `code` None any exit code is accepted.
    """
    done = subprocess.run(
        [*HAPTIC, *words],
        cwd=folder,
        env=None if environment is None else dict(environment),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    if code is not None and done.returncode != code:
        output = (
            f"haptic {' '.join(words)}: exit code {done.returncode}, expected {code}"
        )
        raise MeasurementError(
            f"{output}\n{done.stdout[-1000:]}\n{done.stderr[-2000:]}"
        )
    return done


# starts processes for threads that may end before them
_STARTER = ThreadPoolExecutor(1, "starter")


def start_command(*words: str, **options: Any) -> subprocess.Popen[Any]:
    """Start a ``haptic`` command in its own process group.

    It is killed when this process dies, even by SIGKILL.
    """
    options.setdefault("stdin", subprocess.DEVNULL)
    start = functools.partial(
        subprocess.Popen, [*HAPTIC, *words], process_group=0, **options
    )
    start.keywords["preexec_fn"] = functools.partial(die_with_parent, os.getpid())
    # The kernel treats the end of the starting thread as the parent's death.
    return (
        start()
        if threading.current_thread() is threading.main_thread()
        else _STARTER.submit(start).result()
    )


def run_beside(*words: str) -> None:
    """Run a command to its end; its errors are in Python's words.

    An interrupt ends it as Ctrl-C does, output complete.
    """
    process = start_command(
        *words,
        env={**os.environ, VARIABLE: "python", LINES: "json"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        printed = process.communicate()[1]
    except BaseException:
        end(process)
        raise
    if process.returncode:
        lines = read_lines(printed)
        own = [line for line in lines if line.node == COMMAND]
        said = "\n".join(line.text for line in own or lines)
        raise MeasurementError(
            f"{' '.join(words[:2])} ended with exit code {process.returncode}: {said}"
        )


def end(process: subprocess.Popen[Any], timeout: float = DEADLINE) -> None:
    """Interrupt a command that leads its process group; kill the group after `timeout` [s]."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout)
        except BaseException as error:
            # Clean up even if a notebook cell is interrupted twice.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
