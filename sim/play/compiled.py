"""Compile the very functions that the nodes call.

The kernels of `nodes.arithmetic` and `sim.device.model` are registered with numba as they are,
without copies and without fastmath, so compiled and interpreted runs give the same bits. Compiled
code is stored in the cache of compiled code (nodes/compiled/cache.py), each version of a function
with the digests of all its sources.
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

import nodes.arithmetic
import nodes.driver.passivity
import nodes.laws.pd_windowed
import sim.device.friction
import sim.device.model
from nodes.compiled import cache
from nodes.compiled.kernels.sources import kernel
from nodes.laws.excitation import Push, faded, held_back, went_on
from nodes.laws.pd_windowed import WindowedDamper

Function = TypeVar("Function", bound=Callable[..., Any])

KERNELS: tuple[Callable[..., Any], ...] = (
    nodes.arithmetic.plane_distance,
    nodes.arithmetic.deflection,
    nodes.arithmetic.push,
    nodes.arithmetic.fir,
    nodes.arithmetic.one_sided,
    nodes.arithmetic.limit,
    nodes.arithmetic.limit_within_tick,
    nodes.arithmetic.sections,
    nodes.arithmetic.warm_up,
    nodes.arithmetic.settle,
    nodes.arithmetic.cross_fade,
    nodes.arithmetic.eased,
    nodes.laws.pd_windowed.windowed_slope,
    nodes.driver.passivity.observe,
    nodes.driver.passivity.forget,
    nodes.driver.passivity.control,
    nodes.driver.passivity.through,
    nodes.driver.passivity.backlog,
    sim.device.model.decay_mean,
    sim.device.model.coefficients,
    sim.device.model.advance,
    sim.device.friction.halt_time,
    sim.device.friction.slide,
    sim.device.friction.move,
    sim.device.model.end_stop,
    sim.device.model.quantise,
    sim.device.model.saturate,
)


for _kernel in KERNELS:
    kernel(_kernel)


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
    damped: float = own[0] * _slope(history, head, own[1], int(own[2]))
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


_slope = nodes.laws.pd_windowed.windowed_slope
kernel(held_back)
kernel(went_on)
kernel(faded)
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
        self._sources: dict[str, cache.Source] | None = None
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
            self._sources = cache.sources_of(self._function.__module__)
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
        # A type checker knows only the common options of numba. C does not call the function.
        compile_: Any = numba.njit
        made = compile_(nogil=True, no_cfunc_wrapper=True)(function)
        # With NUMBA_DISABLE_JIT the functions stay interpreted.
        if made is not function:
            made._cache = _Kept(function)
        return cast(Function, made)

    return decorate
