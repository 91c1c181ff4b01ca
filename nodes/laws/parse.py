"""Parsing, checking and describing laws; errors name path, value, limit and remedy.

Every change of a law (launch file, ``haptic param``, ``haptic law``) uses these functions, so they
all reject the same laws.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec.structs import replace

from messages.errors import AT_LEAST, Remedy
from nodes.laws import CompiledLaw, Law, law_names, load_law, with_gain
from nodes.laws.own_code_reads import reads_outside
from nodes.laws.presets import PRESETS, expand, preset_names
from nodes.laws.suggested import rounded_towards
from nodes.parameters.refusals import choices, short
from nodes.parameters.registry import NotInstalledError
from nodes.parameters.store import ParameterError, convert


class LawRefusedError(ParameterError):
    """A law that must not be rendered; the text has path, value, limit and remedy."""


def parse_law(data: object, path: str = "law") -> Law:
    """Return the law of a mapping or of a preset's name; each parameter is checked by itself.

    Raises LawRefusedError with the path of what is invalid.
    """
    if isinstance(data, str) and data in PRESETS:
        data = {"kind": data}
    if not isinstance(data, Mapping):
        raise LawRefusedError(
            f"expected a mapping with kind and parameters, got {short(data)}", path=path
        )
    named = data.get("kind")
    whole = expand(data)
    kind = whole.pop("kind", None)
    if not isinstance(kind, str) or kind not in law_names():
        known = [*law_names(), *preset_names()]
        raise LawRefusedError(
            f"{short(named)} is not an installed law or preset; {choices(named, known)}",
            path=f"{path}.kind",
        )
    try:
        law = load_law(kind)
    except NotInstalledError as error:
        raise LawRefusedError(str(error), path=f"{path}.kind") from error
    parameters = law.__struct_fields__
    whole = with_gain(law, whole)
    unknown = [key for key in whole if key not in parameters]
    if unknown:
        raise LawRefusedError(
            f"law kind {kind} has no such parameter; it takes {', '.join(parameters)}",
            path=f"{path}.{unknown[0]}",
        )
    try:
        made: Law = convert(whole, law, path)
        return made
    except ParameterError as error:
        raise LawRefusedError(
            f"{error.text} (law kind {kind})", path=error.path
        ) from error
    except Exception as error:  # a law of another package may raise anything
        raise LawRefusedError(
            f"cannot be made: {type(error).__name__}: {error} (law kind {kind})",
            path=path,
        ) from error


def law_to_dict(law: Law) -> dict[str, Any]:
    """Return a law as a mapping that `parse_law` reads; parameters that are None are left out."""
    # JSON turns tuples into lists and preserves every bit of a float.
    try:
        values: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(law))
    except Exception as error:  # a law of another package may have a field of any type
        raise LawRefusedError(
            f"law kind {law.kind}: cannot be written down: {type(error).__name__}: {error}"
        ) from error
    return {
        "kind": law.kind,
        **{key: value for key, value in values.items() if value is not None},
    }


def compile_law(law: Law, period: float, path: str = "law") -> CompiledLaw:
    """Compile a law for a sampling period [s].

    Raises LawRefusedError if the law cannot be realised, is not finite, has an unstable section or
    H(1) ≤ 0.
    """
    compiled = _realised(law, period, path)
    if _pushes(compiled):
        return compiled
    raise LawRefusedError(
        f"renders H(1) = {compiled.h1:.6g} N/m to a held deflection"
        f" (limit: > {_rounding(compiled):.2g}),"
        " it would pull into the wall; raise the stiffness, lower the damping or use more taps",
        path=path,
    ).with_remedies(*_stiff_enough(law, compiled.h1, period, path))


def _rounding(compiled: CompiledLaw) -> float:
    """Return how exact the sum of the taps is; the sign of less than that is undefined."""
    return 2.0**-52 * sum(map(abs, compiled.taps))


def _pushes(compiled: CompiledLaw) -> bool:
    """Return whether a held deflection is pushed out, as far as the taps tell.

    A force of its own code appears in no transfer function; the coupling monitors it at run time.
    """
    return compiled.evaluate is not None or compiled.h1 > _rounding(compiled)


def _realised(law: Law, period: float, path: str) -> CompiledLaw:
    """Compile a law that may pull into the wall."""
    if not (math.isfinite(period) and period > 0.0):
        raise LawRefusedError(
            f"sampling period {period!r} s is not a positive number", path=path
        )
    try:
        compiled = law.compile(period)
    except OverflowError as error:
        raise LawRefusedError(
            f"taps overflow at T = {period:g} s; lower the gains or the order",
            path=path,
        ) from error
    except ParameterError as error:
        where = f"{path}.{error.path}" if error.path else path
        raise LawRefusedError(error.text, path=where) from error
    except ValueError as error:
        raise LawRefusedError(str(error), path=path) from error
    except Exception as error:  # a law of another package may raise anything
        raise LawRefusedError(
            f"cannot be compiled: {type(error).__name__}: {error}", path=path
        ) from error
    if not isinstance(compiled, CompiledLaw):
        raise LawRefusedError(
            f"compiles to {type(compiled).__name__}, expected CompiledLaw (law kind {law.kind})",
            path=path,
        )
    if not (compiled.finite and math.isfinite(_rounding(compiled))):
        raise LawRefusedError(
            f"taps or their sum are not finite at T = {period:g} s (limit: below 1.8e308);"
            " lower the gains or the order",
            path=path,
        )
    if not compiled.stable_sections():
        raise LawRefusedError(
            "a recursive section has a pole on or outside the unit circle (limit: radius <"
            " 1); choose another derivative or order",
            path=path,
        )
    if compiled.evaluate is not None:
        try:
            own = compiled.own_code()
        except Exception as error:  # as above
            raise LawRefusedError(
                f"its own code cannot be made for an axis: {type(error).__name__}: {error}",
                path=path,
            ) from error
        count = len(compiled.taps)
        if own is not None and (place := reads_outside(own, count)):
            raise LawRefusedError(
                f"its own code reads {place}, but with {count} tap{'s' if count > 1 else ''} it"
                f" may read ring[head] to ring[head + {count - 1}]; fill up the taps with zeros",
                path=path,
            )
    return compiled


def _stiff_enough(law: Law, h1: float, period: float, path: str) -> list[Remedy]:
    """Return the smallest stiffness at which a law pushes, if it has one to raise."""
    stiffness = getattr(law, "stiffness", None)
    if not isinstance(stiffness, float):
        return []
    # H(1) grows with K, and by as much, for the laws of this package; another one may differ.
    wanted = rounded_towards(stiffness - h1, math.inf)
    for value in (wanted, rounded_towards(1.001 * wanted, math.inf)):
        try:
            raised = _realised(replace(law, stiffness=value), period, path)
        except ParameterError:
            continue
        if _pushes(raised):
            return [Remedy.end(AT_LEAST, f"{path}.stiffness", value)]
    return []
