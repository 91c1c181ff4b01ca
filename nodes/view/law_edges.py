"""Edges of all laws of a launch, and laws at another stiffness: what a page's dial turns.

A law without a nominal stiffness is scaled as a whole; its stiffness at rest H(1) is the dial.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from messages.errors import AT_MOST, HapticError, Remedy
from nodes.laws import CompiledLaw, Law
from nodes.laws.fir import FIR, RecursiveSection
from nodes.laws.parse import law_to_dict, parse_law
from nodes.laws.suggested import rounded_towards
from nodes.parameters.store import ParameterError
from nodes.stability.closed_loop import pole_radius
from nodes.stability.judge import last_inside
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant

_FACTORS = np.geomspace(1e-3, 1e9, 241)  # scales searched for the first instability
_HALVINGS = 30


def with_hardness(
    described: Mapping[str, Any], hardness: float, period: float
) -> dict[str, Any]:
    """Return the description of a law scaled as a whole, so that its H(1) is `hardness`.

    Raises
    ------
    ParameterError
        If the law has a stiffness of its own, or coefficients that cannot be scaled.
    """
    law = parse_law(described, "law")
    if not isinstance(law, FIR):
        raise ParameterError(
            f"a law of kind {described.get('kind')} is not scaled as a whole; change"
            " its own parameters",
            path="hardness",
        )
    rest = law.compile(period).h1
    if not (math.isfinite(hardness) and hardness > 0.0 < rest):
        raise ParameterError(
            f"{hardness} N/m, expected a stiffness above 0 N/m", path="hardness"
        )
    by = hardness / rest
    recursive = law.recursive and tuple(
        RecursiveSection(b0=by * one.b0, b1=by * one.b1, a1=one.a1, a2=one.a2)
        for one in law.recursive
    )
    taps = tuple(by * tap for tap in law.taps)
    return law_to_dict(msgspec.structs.replace(law, taps=taps, recursive=recursive))


def in_hardness(
    remedies: Iterable[Remedy], scaled: Mapping[str, Any], hardness: float
) -> tuple[Remedy, ...]:
    """Return ways out of a refusal of a law scaled to an H(1): the largest H(1), not its taps.

    Parameters
    ----------
    remedies : iterable of Remedy
        They have the taps that would be accepted.
    scaled : mapping
        The law that was refused.
    hardness : float
        Its H(1) [N/m].
    """
    asked = {f"taps[{k}]": tap for k, tap in enumerate(scaled["taps"])}
    return tuple(_in_hardness(one, asked, hardness) for one in remedies)


def _in_hardness(one: Remedy, asked: Mapping[str, float], hardness: float) -> Remedy:
    # All taps are in one proportion; the largest one is the most exact.
    shares = {
        abs(tap): value / tap
        for path, value in one.values.items()
        if (tap := asked.get(path.rpartition(".")[2])) is not None
    }
    if not shares:
        return one
    most = rounded_towards(hardness * shares[max(shares)], 0.0)
    text = f"the largest hardness that is accepted is {most:g}"
    return Remedy(AT_MOST, text, {"hardness": most})


def rest_stiffness(law: Law, period: float) -> float | None:
    """Return H(1) of a law that is scaled as a whole [N/m]; None for any other."""
    return law.compile(period).h1 if isinstance(law, FIR) else None


def _scaled(law: CompiledLaw, by: float) -> CompiledLaw:
    """Return a law of taps and sections, multiplied."""
    sections = tuple((by * b0, by * b1, a1, a2) for b0, b1, a1, a2 in law.sections)
    return CompiledLaw(tuple(by * tap for tap in law.taps), sections)


def stable_interval(law: Law, devices: Sequence[Plant]) -> tuple[float, float] | None:
    """Return the first interval of K that is stable with all devices; None if there is none."""
    low = -math.inf
    high = math.inf
    for device in devices:
        edge = k_max(without_spring(law, device.period), device)
        if not edge.stable:
            return None
        low = max(low, edge.stable[0][0])
        high = min(high, edge.stable[0][1])
    return (low, high) if low < high else None


def edge_of_law(law: Law, devices: Sequence[Plant]) -> float | None:
    """Return the stiffness up to which a law is stable with all devices [N/m].

    None if no stiffness is stable, if all are, or if the law has neither a stiffness nor taps.
    """
    compiled = law.compile(devices[0].period)
    if compiled.evaluate is not None:
        return None
    if hasattr(law, "stiffness"):
        interval = stable_interval(law, devices)
        high = math.inf if interval is None else interval[1]
        return high if math.isfinite(high) else None
    if not isinstance(law, FIR):
        return None

    def stable(by: float) -> bool:
        scaled = _scaled(compiled, by)
        return all(pole_radius(scaled, device) < 1.0 for device in devices)

    inside = None
    for by in _FACTORS.tolist():
        if stable(by):
            inside = by
        elif inside is not None:
            return last_inside(stable, inside, by, _HALVINGS) * compiled.h1
        else:
            return None
    return None


def edges_of_laws(
    laws: Mapping[str, Mapping[str, Any]], devices: Sequence[Plant]
) -> dict[str, float | None]:
    """Return the edge of each law by name [N/m]; None where it is not known."""
    found = {}
    for name, described in laws.items():
        try:
            found[name] = edge_of_law(parse_law(described, name), devices)
        except (HapticError, ValueError, ArithmeticError):
            # A law that these devices have no poles with, e.g. too many taps for its memory.
            found[name] = None
    return found


def rests_of_laws(
    laws: Mapping[str, Mapping[str, Any]], period: float
) -> dict[str, float | None]:
    """Return H(1) of each law that is scaled as a whole [N/m]; None for any other."""
    found = {}
    for name, described in laws.items():
        try:
            found[name] = rest_stiffness(parse_law(described, name), period)
        except (HapticError, ValueError, ArithmeticError):
            found[name] = None
    return found
