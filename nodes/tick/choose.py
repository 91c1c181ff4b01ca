"""Which tick a launch takes, and having it compiled before its nodes start."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final, Literal, TypeAlias

from nodes.tick.build import build, find
from nodes.tick.cache import CacheRefusedError
from nodes.tick.fields import NotCompilableError

Wanted: TypeAlias = Literal["auto", "compiled", "plain"]


SCARCE: Final = 1000.0
"""From this rate on a tick by the interpreter fills a good part of the period [Hz]."""


def choose(
    wanted: Wanted, modules: Collection[str], say: Callable[[str], None], scarce: bool = True
) -> Literal["compiled", "plain"]:
    """Settle which tick the nodes of a launch take.

    ``auto`` takes the compiled one wherever it is there already, for it costs nothing then. It does not make a launch wait for
    the compiler; where time is scarce it says what would.
    """
    if wanted == "plain" or not modules:
        return "plain"
    try:
        missing = [module for module in modules if find(module) is None]
    except CacheRefusedError as error:
        say(f"the plain tick runs, for compiled code is not taken from there: {error}")
        return "plain"
    if missing and wanted == "auto":
        if scarce:
            say("the plain tick runs, for the compiled one is not there yet; --tick compiled has it compiled, once")
        return "plain"
    if missing:
        say(f"compiling the tick, once for this version: {len(missing)} kernels, some ten seconds")
        try:
            build(missing)
        except NotCompilableError as error:
            say(f"the plain tick runs, for the compiled one cannot be had: {error}")
            return "plain"
    return "compiled"
