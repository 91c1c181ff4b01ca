"""Compiling the very functions that the nodes call.

The kernels of `nodes.kernels` and `sim.device.model` are registered with numba as they are, without copies and without
fastmath, so compiled and interpreted runs give the same bits. Compiled code is kept on disk between processes, in a
folder named after the text of all kernels: numba by itself looks only at the file of the outermost function, and
would go on using old kernels.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.extending import overload

import nodes.driver.passivity
import nodes.kernels
import nodes.laws.pd_windowed
import sim.device.friction
import sim.device.model
from nodes.tick.kernels.sources import kernel

# numba's settings are made at run time, out of a type checker's sight.
_CONFIG: Any = numba.config

Function = TypeVar("Function", bound=Callable[..., Any])

KERNELS: tuple[Callable[..., Any], ...] = (
    nodes.kernels.plane_distance,
    nodes.kernels.deflection,
    nodes.kernels.push,
    nodes.kernels.fir,
    nodes.kernels.one_sided,
    nodes.kernels.limit,
    nodes.kernels.sections,
    nodes.kernels.warm_up,
    nodes.kernels.cross_fade,
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


def own_force(own: Callable[[Sequence[float], int], float], history: Any, head: int) -> float:
    """Force of a law's code of its own."""
    return own(history, head)


_slope = nodes.laws.pd_windowed.windowed_slope
# Compiled, the code of its own is the windowed damper's, handed over as its three numbers.
overload(own_force)(
    lambda own, history, head: (  # noqa: ARG005
        lambda own, history, head: own[0] * _slope(history, head, own[1], int(own[2]))
    )
)


def _cache_folder() -> str | None:
    """Folder for compiled code, None where nothing can be written."""
    text = hashlib.sha256()
    for module in (
        nodes.kernels,
        nodes.laws.pd_windowed,
        nodes.driver.passivity,
        sim.device.model,
        sim.device.friction,
    ):
        text.update(Path(str(module.__file__)).read_bytes())
    for path in (Path(__file__), Path(__file__).with_name("tick_loop.py")):
        text.update(path.read_bytes())
    base = _CONFIG.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) / "haptic-nodes" / f"numba-{text.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return None
    return str(folder)


_FOLDER = _cache_folder()


def compiled() -> Callable[[Function], Function]:
    """Decorate a function to be compiled on first use, for each combination of argument types (None is a type).

    Compiled code runs without the interpreter's lock.
    """

    def decorate(function: Function) -> Function:
        before = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = _FOLDER or before
        try:
            result = cast(Function, numba.njit(nogil=True, cache=_FOLDER is not None)(function))
        finally:
            _CONFIG.CACHE_DIR = before
        return result

    return decorate
