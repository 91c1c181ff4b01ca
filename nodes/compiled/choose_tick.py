"""Choice of a launch's tick, and its compilation before or after the launch."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from typing import Final, Literal, TypeAlias

from nodes.compiled.build import (
    build,
    build_in_background,
    expected_seconds,
    find,
    reason,
)
from nodes.compiled.cache import CacheRefusedError
from nodes.compiled.message_fields import NotCompilableError
from nodes.parameters.interface_words import interface

WantedTick: TypeAlias = Literal["auto", "compiled", "plain"]


# rate from which an interpreted tick takes a large part of the period [Hz]
SCARCE: Final = 1000.0


def choose(
    wanted: WantedTick,
    modules: Collection[str],
    say: Callable[[str], None],
    scarce: bool = True,
    warn: Callable[[str], None] | None = None,
) -> Literal["compiled", "plain"]:
    """Return which tick the nodes of a launch use.

    ``auto`` uses the compiled one if it is built, and makes no launch wait for the compiler. It
    always reports a tick that cannot be compiled, and at high rates (`scarce`) a missing one, which
    is compiled after the launch (`compile_later`). `warn` reports them; by default `say` does.
    """
    warn = warn or say
    if wanted == "plain" or not modules:
        return "plain"
    try:
        found = {module: find(module) for module in modules}
    except CacheRefusedError as error:
        warn(f"using the plain tick; compiled code is not taken from there: {error}")
        return "plain"
    failed = next(filter(None, map(reason, found.values())), "")
    missing = [
        module
        for module, entry in found.items()
        if entry is None or (reason(entry) and wanted == "compiled")
    ]
    if wanted == "auto":
        if failed:
            warn(f"using the plain tick; the compiled one is not available: {failed}")
        elif scarce and missing:
            warn(
                "using the plain tick; the compiled one is not built yet"
                f" ({interface.get().tick('compiled')} builds it once)"
            )
        return "plain" if failed or missing else "compiled"
    if missing:
        seconds, is_measured = expected_seconds(missing)
        source = (
            "as it took here last time"
            if is_measured
            else "an estimate: it is the first time here"
        )
        kernels = f"{len(missing)} kernel{'s' if len(missing) > 1 else ''}"
        say(
            f"compiling {kernels}, once for this version: about {seconds:.0f} s ({source})"
        )
        try:
            build(missing)
        except NotCompilableError as error:
            warn(f"using the plain tick; the compiled one is not available: {error}")
            return "plain"
    return "compiled"


def compile_later(modules: Collection[str], say: Callable[[str], None]) -> None:
    """Compile missing ticks in the background, for the next launch.

    Not with ``HAPTIC_COMPILE=asked``. The processes inherit this thread's processors.
    """
    if os.environ.get("HAPTIC_COMPILE", "background") == "asked":
        return
    try:
        missing = sorted(module for module in modules if find(module) is None)
    except CacheRefusedError:
        return  # the launch has reported it
    if not missing:
        return
    try:
        begun = build_in_background(missing)
    except CacheRefusedError as error:
        say(f"the plain tick ran; a compiled one cannot be kept: {error}")
        return
    what = (
        "the compiled one is being made in the background, for the next launch"
        if begun
        else "a compilation is under way in the background already"
    )
    say(f"the plain tick ran; {what}")
