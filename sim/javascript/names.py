"""Names, constants and helpers of emitted JavaScript.

An expression of the rules means the same in both languages, with these exceptions: `min` and `max`
of NaN and −0, remainder and quotient, `int` of −0 and of what is not finite, rounding to whole
numbers, and `&` beyond 32 bits. The helpers of `PRELUDE` follow CPython there.
"""

from __future__ import annotations

import math
from typing import Any, Final

from messages.errors import HapticError

RESERVED: Final = frozenset(
    (
        *(
            "arguments",
            "await",
            "case",
            "catch",
            "class",
            "const",
            "debugger",
            "default",
            "delete",
        ),
        *(
            "do",
            "enum",
            "eval",
            "export",
            "extends",
            "false",
            "finally",
            "function",
            "implements",
        ),
        *(
            "import",
            "in",
            "instanceof",
            "interface",
            "let",
            "new",
            "null",
            "package",
            "private",
        ),
        *(
            "protected",
            "public",
            "static",
            "super",
            "switch",
            "this",
            "throw",
            "true",
            "try",
        ),
        *("typeof", "var", "void", "with", "yield"),
    )
)

PRELUDE: Final = """\
const min_ = (a, b) => (b < a ? b : a), max_ = (a, b) => (b > a ? b : a);
const mod_ = (a, b) => {
  let r = a % b;
  if (r !== 0) { if (r < 0 !== b < 0) r += b; } else r = b < 0 ? -0 : 0;
  return r;
};
const div_ = (a, b) => {
  const r = a % b;
  let q = (a - r) / b;
  if (r !== 0 && r < 0 !== b < 0) q -= 1;
  if (q === 0) return copysign_(0, a / b);
  const whole = Math.floor(q);
  return q - whole > 0.5 ? whole + 1 : whole;
};
const whole_ = (a) => {
  if (!Number.isFinite(a)) throw new RangeError("no whole number of " + a);
  return a + 0;
};
const int_ = (a) => whole_(Math.trunc(a));
const and_ = (a, b) => {
  const high = (Math.floor(a / 4294967296) & Math.floor(b / 4294967296)) >>> 0;
  return high * 4294967296 + ((a & b) >>> 0);
};
const copysign_ = (a, b) => {
  a = Math.abs(a);
  return b < 0 || Object.is(b, -0) ? -a : a;
};
const named_ = (names, values) => {
  names.forEach((name, i) => { values[name] = values[i]; });
  return values;
};
"""
"""Helpers that emitted code calls.

`mod_` and `div_` follow float_divmod of CPython; `named_` makes a named tuple.
"""

INEXACT: Final = frozenset(
    (
        "acos",
        "asin",
        "atan",
        "atan2",
        "cos",
        "exp",
        "expm1",
        "hypot",
        "log",
        "log1p",
        "sin",
        "tan",
    )
)
"""Functions of `math` that engines round differently from the C library."""


class NotEmittedError(HapticError):
    """Python that has no form in JavaScript with the same bits; the text has file and line."""


def identifier(name: str) -> str:
    """Return a Python name as a JavaScript one."""
    return name + "$" if name in RESERVED else name


def literal(value: Any) -> str:
    """Return a constant as JavaScript.

    Raises
    ------
    NotEmittedError
        For an int that is no double, and for any other type than numbers, bools, strings, None
        and tuples of these.
    """
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int):
        if int(float(value)) != value:
            raise NotEmittedError(f"{value} is no double")
        return repr(value) if value >= 0 else f"({value})"
    if isinstance(value, float):
        if math.isnan(value):
            return "NaN"
        text = repr(abs(value)) if math.isfinite(value) else "Infinity"
        return text if math.copysign(1.0, value) > 0.0 else f"(-{text})"
    if isinstance(value, str):
        return repr(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(literal, value))}]"
    raise NotEmittedError(f"a constant of type {type(value).__name__}")


def unwrapped(text: str) -> str:
    """Return an expression without parentheses around the whole of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for i, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and i < len(text) - 1:
            return text
    return text[1:-1]
