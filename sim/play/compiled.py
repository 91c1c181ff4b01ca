"""Compile the very functions that the nodes call.

The rules of the nodes and of the virtual device are registered with numba as they are, without
copies and without fastmath, so compiled and interpreted runs give the same bits. Compiled code is
stored in the cache of compiled code (nodes/compiled/cache.py), each version of a function with the
digests of all its sources.
"""

import contextlib
import hashlib
import pickle
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numba.core import serialize
from numba.core.compiler import CompileResult
from numba.extending import overload

from nodes.arithmetic import settle, warm_up
from nodes.compiled import cache
from nodes.compiled.kernels.sources import kernel, register_rules
from nodes.compiled.source_files import Source, sources_of
from nodes.laws.excitation import Push, faded, held_back, went_on
from nodes.laws.pd_windowed import WindowedDamper, windowed_slope

Function = TypeVar("Function", bound=Callable[..., Any])

# What compiled functions call, and is no rule of a node's tick.
for _function in (warm_up, settle, windowed_slope, held_back, went_on, faded):
    kernel(_function)


class Pushing(NamedTuple):
    """The push of `nodes.laws.excitation` as arrays: its forces per tick [N] and its state."""

    signal: Any
    shares: Any
    state: Any
    reach: float
    load: float
    fade: int


def numbers_of(own: Callable[[Sequence[float], int], float], ticks: int) -> Any:
    """Convert a law's own code to numbers for compiled code; None if it must be interpreted."""
    if isinstance(own, WindowedDamper):
        return own.gain, own.error, float(own.window)
    if isinstance(own, Push):
        pushed = min(ticks, own.ticks)
        signal = own.signal(0)
        shares = [
            (k + 1) / own.growing if k + 1 < own.growing else 1.0 for k in range(pushed)
        ]
        drawn = np.array([signal.next() for _ in range(pushed)])
        return Pushing(
            drawn,
            np.array(shares),
            np.zeros(2, dtype=np.int64),
            own.law.reach,
            own.law.load,
            own.fade,
        )
    return None


def own_force(
    own: Callable[[Sequence[float], int], float], history: Any, head: int
) -> float:
    """Return the force [N] of a law's own code."""
    return own(history, head)


def windowed_force(own: Any, history: Any, head: int) -> float:
    """Return the force of a windowed damper [N]; `own` is gain, error and window."""
    damped: float = own[0] * windowed_slope(history, head, own[1], int(own[2]))
    return damped


def pushed_force(own: Any, history: Any, head: int) -> float:
    """Return the force of a push [N]; `own` is a `Pushing`, whose state changes."""
    load: float = own.load
    ticks = len(own.signal)
    k = own.state[0]
    if k >= ticks:
        own.state[0] = min(k + 1, ticks + own.fade)
        lowered: float = faded(load, own.state[0] - ticks, own.fade)
        return lowered
    own.state[0], own.state[1] = went_on(
        k, own.state[1], history[head], own.reach, ticks
    )
    force: float = load + own.shares[k] * held_back(
        own.signal[k], history[head], own.reach
    )
    return force


# Compiled, a law's own code is passed as its numbers. Not strict: numba takes annotations for part
# of an argument's name.
overload(own_force, strict=False)(
    lambda own, history, head: (  # noqa: ARG005
        pushed_force
        if getattr(own, "instance_class", None) is Pushing
        else windowed_force
    )
)


_dumps: Any = serialize.dumps


class _Making(threading.local):
    """Compilations of a thread for which other processes wait."""

    def __init__(self) -> None:
        self.held = contextlib.ExitStack()


class _Kept:
    """Numba's cache of one function; unpickles only what our cache has verified."""

    _warned = False

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._sources: dict[str, Source] | None = None
        self._making = _Making()

    def _name(self, types: Any, codegen: Any) -> str:
        which = f"{self._function.__qualname__}{types}{codegen.magic_tuple()}"
        digest = hashlib.sha256(which.encode()).hexdigest()[:24]
        return f"{self._function.__module__}.{digest}.numba"

    def load_overload(self, types: Any, target: Any) -> Any:
        """Load machine code; None if it must be compiled."""
        target.refresh()
        name = self._name(types, target.codegen())
        # Left over from a function that could not be compiled.
        self._making.held.close()
        try:
            entry = cache.read(name)
            if entry is None:
                # If several processes start together, only one compiles.
                self._making.held.enter_context(cache.making(name))
                entry = cache.read(name)
                if entry is not None:
                    self._making.held.close()
        except cache.CacheRefusedError as error:
            self._refused(error)
            return None
        if entry is None:
            # Before compiling, because later changes of the sources are not compiled in.
            self._sources = sources_of(self._function.__module__)
            return None
        rebuild: Any = CompileResult._rebuild
        return rebuild(target, *pickle.loads(entry.content))  # noqa: S301  # of this user's own making

    def save_overload(self, types: Any, result: Any) -> None:
        """Store machine code."""
        with self._making.held:
            if (
                self._sources is None
                or result.lifted
                or result.library.has_dynamic_globals
            ):
                return
            try:
                entry = cache.CacheEntry(kind="numba", content=_dumps(result._reduce()))
                cache.write(self._name(types, result.codegen), entry, self._sources)
            except cache.CacheRefusedError as error:
                self._refused(error)

    def flush(self) -> None:
        """Do nothing, because every entry is written at once."""

    def _refused(self, error: cache.CacheRefusedError) -> None:
        if not _Kept._warned:
            _Kept._warned = True
            sys.stderr.write(
                f"compiled again in each process, because nothing can be kept: {error}\n"
            )


def compiled() -> Callable[[Function], Function]:
    """Decorate a function to be compiled on first use, once per combination of types.

    None is a type of its own.
    """

    def decorate(function: Function) -> Function:
        # Its module has imported the rules that it calls.
        register_rules()
        # A type checker knows only the common options of numba. C does not call the function.
        compile_: Any = numba.njit
        made = compile_(nogil=True, no_cfunc_wrapper=True)(function)
        # With NUMBA_DISABLE_JIT the functions stay interpreted.
        if made is not function:
            made._cache = _Kept(function)
        return cast(Function, made)

    return decorate
