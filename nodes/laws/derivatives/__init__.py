"""Realisations of D^α tick by tick; a law names the one it uses.

The paper uses the Grünwald–Letnikov sum, but a dozen others are known, each with its own cost,
phase, leak and gain at Nyquist. All of them compile to a `CompiledLaw` (taps and parallel sections,
unit gain), so the loop renders any of them with the same kernels. Each realisation has a file of
its own; other packages add theirs through the entry points ``haptic.derivatives``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from nodes.laws import CompiledLaw
from nodes.parameters.registry import NotInstalledError, Registry

DERIVATIVES = Registry(
    "haptic.derivatives",
    "realisation of D^α",
    lambda _, found: "" if callable(found) else f"{found!r} cannot be called",
)
MAX_ORDER = 4.0
MAX_TAPS = 1_000_000

Realise = Callable[[float, int, float], CompiledLaw]


def derivative_kinds() -> dict[str, Realise]:
    """Return all installed realisations of D^α that can be imported, sorted by name."""
    return DERIVATIVES.all()[0]


def realise(kind: str, order: float, taps: int, period: float) -> CompiledLaw:
    """Realise D^α with unit gain and check that the result can run.

    `order` is α in (0, 4). `taps` is the length n + 1, at least 2: the number of taps of a finite
    realisation, the memory [ticks] of a long-memory one, the degree n plus one of a recursive one.
    Raises ValueError if the realisation does not exist, or not for this order, length and period
    [s]; the text names the parameter, its value, the limit and a remedy.
    """
    if not 0.0 < order < MAX_ORDER:
        raise ValueError(
            f"order = {order!r}: must lie in (0, 4); for a plain damper use order 1"
        )
    if not 2 <= taps <= MAX_TAPS:
        raise ValueError(
            f"taps = {taps!r}: must lie in [2, {MAX_TAPS}]; a derivative needs at least two samples"
        )
    if not (period > 0.0 and math.isfinite(period)):
        raise ValueError(
            f"period = {period!r} s: must be positive and finite; give 1/rate in seconds"
        )
    try:
        function: Realise = DERIVATIVES.load(kind)
    except NotInstalledError as error:
        raise ValueError(f"derivative = {error}") from error
    overflow = ValueError(
        f"period = {period!r} s at order = {order!r}: the coefficients of {kind!r} overflow (they"
        " grow as T^-α); take a longer period or a lower order"
    )
    try:
        compiled = function(order, taps, period)
    except OverflowError:
        raise overflow from None
    if not compiled.finite:
        raise overflow
    if not compiled.stable_sections():
        raise ValueError(
            f"taps = {taps!r} at order = {order!r}: {kind!r} has a pole on or outside the unit"
            " circle; take fewer taps"
        )
    return compiled
