"""Which tick a launch takes, and having it compiled: before its nodes start when it is asked for, else after its end."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from typing import Final, Literal, TypeAlias

from nodes.compiled.build import build, build_in_background, expected_seconds, find, reason
from nodes.compiled.cache import CacheRefusedError
from nodes.compiled.message_fields import NotCompilableError

WantedTick: TypeAlias = Literal["auto", "compiled", "plain"]


# from this rate on a tick by the interpreter fills a good part of the period [Hz]
SCARCE: Final = 1000.0


def choose(
    wanted: WantedTick, modules: Collection[str], say: Callable[[str], None], scarce: bool = True
) -> Literal["compiled", "plain"]:
    """Settle which tick the nodes of a launch take.

    ``auto`` takes the compiled one where it is there already, and makes no launch wait for the
    compiler. It always says that one cannot be compiled, and where time is scarce that one is
    missing, which is compiled after the
    launch: `compile_later`.
    """
    if wanted == "plain" or not modules:
        return "plain"
    try:
        found = {module: find(module) for module in modules}
    except CacheRefusedError as error:
        say(f"using the plain tick; compiled code is not taken from there: {error}")
        return "plain"
    failed = next(filter(None, map(reason, found.values())), "")
    missing = [
        module
        for module, entry in found.items()
        if entry is None or (reason(entry) and wanted == "compiled")
    ]
    if wanted == "auto":
        if failed:
            say(f"using the plain tick; the compiled one is not available: {failed}")
        elif scarce and missing:
            say(
                "using the plain tick; the compiled one is not built yet (--tick compiled builds it"
                " once)"
            )
        return "plain" if failed or missing else "compiled"
    if missing:
        seconds, is_measured = expected_seconds(missing)
        source = (
            "as it took here last time" if is_measured else "an estimate: it is the first time here"
        )
        kernels = f"{len(missing)} kernel{'s' if len(missing) > 1 else ''}"
        say(f"compiling {kernels}, once for this version: about {seconds:.0f} s ({source})")
        try:
            build(missing)
        except NotCompilableError as error:
            say(f"using the plain tick; the compiled one is not available: {error}")
            return "plain"
    return "compiled"


def compile_later(modules: Collection[str], say: Callable[[str], None]) -> None:
    """Have what is missing compiled for the next launch, on this thread's processors; not with ``HAPTIC_COMPILE=asked``."""
    if os.environ.get("HAPTIC_COMPILE", "background") == "asked":
        return
    try:
        missing = sorted(module for module in modules if find(module) is None)
    except CacheRefusedError:
        return  # the launch has said so
    if missing:
        build_in_background(missing)
        say(
            "the plain tick ran; the compiled one is being made in the background, for the next"
            " launch"
        )
