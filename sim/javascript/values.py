"""Numbers and states of a run as JavaScript values."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sim.javascript.names import literal

_SHORT: Final = 16  # an array of more zeros than this is written as their number


@dataclass(frozen=True)
class Plain:
    """Data that stays JSON: bools, lists of numbers and None keep their meaning."""

    data: Any


def value(given: Any) -> str:
    """Return data as a JavaScript expression; a sequence of numbers becomes a Float64Array.

    Bools become 1 and 0, as in the structs of the nodes.

    Raises
    ------
    NotEmittedError
        For a number that is no double, and for any other type.
    """
    if isinstance(given, Plain):
        return _json(given.data)
    if isinstance(given, bool | np.bool_):
        return "1" if given else "0"
    if isinstance(given, str):
        return _json(given)
    if isinstance(given, Mapping):
        pairs = ", ".join(
            f"{json.dumps(str(key))}: {value(one)}" for key, one in given.items()
        )
        return f"{{{pairs}}}"
    if isinstance(given, np.generic):
        return literal(given.item())
    if isinstance(given, Sequence | np.ndarray):
        return _sequence(given)
    if hasattr(given, "__len__"):  # an array of a struct
        return _sequence(list(given))
    return literal(given)


def _json(given: Any) -> str:
    # "</" would end a script element.
    return json.dumps(given, allow_nan=False, separators=(",", ":")).replace(
        "</", "<\\/"
    )


def _sequence(given: Any) -> str:
    numbers = [one for one in given if isinstance(one, int | float | np.number)]
    if len(numbers) < len(given):
        return f"[{', '.join(map(value, given))}]"
    if len(numbers) > _SHORT and not any(numbers):
        return f"new Float64Array({len(numbers)})"
    return f"new Float64Array([{', '.join(map(value, numbers))}])"


def fields_of(state: Any) -> dict[str, Any]:
    """Return the fields of a state of nodes/compiled/layout.py by name."""
    return {name: getattr(state, name) for name, *_ in type(state)._fields_}
