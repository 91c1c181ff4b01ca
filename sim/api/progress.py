"""Progress bars in a notebook or on a terminal; silent elsewhere."""

import contextlib
import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

from nodes.parameters.options import ProgressOf, ProgressStep

_WIDE = 40


@contextlib.contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """Show a bar during the block; the yielded function sets the amount done."""
    handle = _notebook_handle(title)
    terminal = handle is None and sys.stderr.isatty()

    def step(done: int) -> None:
        if handle is not None:
            handle.update(_html(title, done, total))
        elif terminal:
            bar = "#" * (_WIDE * done // total if total else 0)
            sys.stderr.write(f"\r{title} [{bar:{_WIDE}}] {done}")

    try:
        yield step
    finally:
        if terminal:
            sys.stderr.write("\r\033[K")


@contextlib.contextmanager
def bars_of(title: str) -> Iterator[ProgressOf]:
    """Show a bar per job; the block yields the function that starts a job's bar."""
    with contextlib.ExitStack() as shown:

        def begin(total: int) -> ProgressStep:
            show, done = shown.enter_context(progress(title, total)), 0

            def step(_what: str, count: int = 1) -> None:
                nonlocal done
                done += count
                show(done)

            return step

        yield begin


def _notebook_handle(title: str) -> Any:
    """Return an updatable display of a running notebook; None elsewhere."""
    if "IPython" not in sys.modules:
        return None
    shell = importlib.import_module("IPython").get_ipython()
    if shell is None or type(shell).__name__ != "ZMQInteractiveShell":
        return None
    return importlib.import_module("IPython.display").display(
        _html(title, 0, None), display_id=True
    )


def _html(title: str, done: int, total: int | None) -> Any:
    share = f"value='{done}' max='{total}'" if total else ""
    return importlib.import_module("IPython.display").HTML(
        f"{title} <progress {share}></progress> {done}"
    )
