"""Decoding a MessagePack map with known fields, in any order; unknown keys are skipped.

Values are decoded exactly as messages/codec.py does. Anything unusual returns False (a wrong type,
a value out of its bounds, text that is not ASCII, an extension, a malformed or truncated payload):
the Python decoder then reads the payload and reports the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from messages.types import Message
from nodes.compiled.kernels.machine import (
    be16,
    be32,
    be64,
    byte,
    compilable,
    real32,
    real64,
)
from nodes.compiled.layout import TEXTS
from nodes.compiled.message_fields import (
    FLAG,
    REAL,
    TEXT,
    VECTOR,
    WHOLE,
    Field,
    fields_of,
)

# arrays and maps skipped under unknown keys; deeper ones may be refused
MOST_SKIPPED = 32


@compilable
def map_size(at: int, end: int) -> tuple[int, int]:
    """Return the number of entries of a map (-1: no map) and their address."""
    if at >= end:
        return -1, at
    first = byte(at)
    if first & 0xF0 == 0x80:
        return first & 0x0F, at + 1
    if first == 0xDE and end - at >= 3:
        return be16(at + 1), at + 3
    if first == 0xDF and end - at >= 5:
        return be32(at + 1), at + 5
    return -1, at


@compilable
def text_size(at: int, end: int) -> tuple[int, int]:
    """Return the length of a text (-1: no text, or truncated) and its address."""
    if at >= end:
        return -1, at
    first = byte(at)
    size = -1
    if first & 0xE0 == 0xA0:
        size = first & 0x1F
        at = at + 1
    elif first == 0xD9 and end - at >= 2:
        size = byte(at + 1)
        at = at + 2
    elif first == 0xDA and end - at >= 3:
        size = be16(at + 1)
        at = at + 3
    elif first == 0xDB and end - at >= 5:
        size = be32(at + 1)
        at = at + 5
    if size > end - at:
        return -1, at
    return size, at


@compilable
def whole_number(at: int, end: int) -> tuple[bool, int, int]:
    """Decode an integer: whether it fits 64 bits with sign, its value, the address after it."""
    if at >= end:
        return False, 0, at
    first = byte(at)
    left = end - at
    if first < 0x80:
        return True, first, at + 1
    if first >= 0xE0:
        return True, first - 0x100, at + 1
    if first == 0xCC and left >= 2:
        return True, byte(at + 1), at + 2
    if first == 0xCD and left >= 3:
        return True, be16(at + 1), at + 3
    if first == 0xCE and left >= 5:
        return True, be32(at + 1), at + 5
    if first == 0xCF and left >= 9:
        value = be64(at + 1)
        return value >= 0, value, at + 9
    if first == 0xD0 and left >= 2:
        value = byte(at + 1)
        return True, value - 0x100 if value >= 0x80 else value, at + 2
    if first == 0xD1 and left >= 3:
        value = be16(at + 1)
        return True, value - 0x10000 if value >= 0x8000 else value, at + 3
    if first == 0xD2 and left >= 5:
        value = be32(at + 1)
        return True, value - 0x100000000 if value >= 0x80000000 else value, at + 5
    if first == 0xD3 and left >= 9:
        return True, be64(at + 1), at + 9
    return False, 0, at


@compilable
def real_number(at: int, end: int) -> tuple[bool, float, int]:
    """Decode a finite float or integer: whether there is one, its value, the address after it."""
    if at >= end:
        return False, 0.0, at
    first = byte(at)
    if first == 0xCB and end - at >= 9:
        value = real64(at + 1)
        return math.isfinite(value), value, at + 9
    if first == 0xCA and end - at >= 5:
        value = real32(at + 1)
        return math.isfinite(value), value, at + 5
    known, whole, at = whole_number(at, end)
    return known, float(whole), at


# Long: one branch a kind of value that msgpack knows.
@compilable
def after_value(at: int, end: int) -> int:  # noqa: C901
    """Return the address after a value of any kind, or -1 if unknown."""
    left = 1
    containers = 0
    while left > 0:
        if at >= end:
            return -1
        left -= 1
        first = byte(at)
        size = 1
        if first < 0x80 or first >= 0xE0 or 0xC2 <= first <= 0xC3 or first == 0xC0:
            pass
        elif first < 0x90:
            left += 2 * (first & 0x0F)
            containers += 1
        elif first < 0xA0:
            left += first & 0x0F
            containers += 1
        elif first < 0xC0:
            size += first & 0x1F
        elif first in (0xCC, 0xD0):
            size = 2
        elif first in (0xCD, 0xD1):
            size = 3
        elif first in (0xCA, 0xCE, 0xD2):
            size = 5
        elif first in (0xCB, 0xCF, 0xD3):
            size = 9
        elif first in (0xC4, 0xD9) and end - at >= 2:
            size = 2 + byte(at + 1)
        elif first in (0xC5, 0xDA) and end - at >= 3:
            size = 3 + be16(at + 1)
        elif first in (0xC6, 0xDB) and end - at >= 5:
            size = 5 + be32(at + 1)
        elif first in (0xDC, 0xDE) and end - at >= 3:
            left += be16(at + 1) * (2 if first == 0xDE else 1)
            size = 3
            containers += 1
        else:
            return -1  # extensions, the largest containers, and invalid MessagePack
        if size > end - at or containers > MOST_SKIPPED:
            return -1
        at += size
    return at


class _Table(NamedTuple):
    """Fields of a message as arrays, one entry a field."""

    names: NDArray[np.uint8]  # bytes of all names
    begins: NDArray[np.int64]  # where a name begins in `names`
    sizes: NDArray[np.int64]  # length of a name
    kinds: NDArray[np.int64]
    slots: NDArray[np.int64]  # where its value is stored
    lows: NDArray[np.int64]  # least whole number
    highs: NDArray[np.int64]  # largest whole number, longest text
    defaults: NDArray[np.float64]


def _table(fields: Sequence[Field]) -> _Table:
    names = [field.name.encode() for field in fields]
    sizes = np.array([len(name) for name in names])
    return _Table(
        names=np.frombuffer(b"".join(names), np.uint8).copy(),
        begins=np.concatenate([[0], np.cumsum(sizes)[:-1]]),
        sizes=sizes,
        kinds=np.array([field.kind for field in fields]),
        slots=np.array([field.slot for field in fields]),
        lows=np.array([field.low for field in fields]),
        highs=np.array([field.high for field in fields]),
        defaults=np.array([field.default or 0.0 for field in fields]),
    )


def make_scan(message: type[Message]) -> Callable[[int, int, Any, Any], bool]:
    """Return the scanner of a message type."""
    fields: tuple[Field, ...] = fields_of(message)
    table = _table(fields)
    find, decode, fill_in = _make_find(table), _make_decode(table), _make_fill_in(table)
    required = sum(1 << k for k, field in enumerate(fields) if field.default is None)

    @compilable
    def scan(at: int, end: int, reals: Any, wholes: Any) -> bool:
        entries, at = map_size(at, end)
        if entries < 0:
            return False
        seen = 0
        guess = 0  # most senders preserve the order of the fields
        for _ in range(entries):
            size, at = text_size(at, end)
            if size < 0:
                return False
            k = find(at, size, guess)
            at += size
            if k < 0:
                at = after_value(at, end)
            else:
                at = decode(k, at, end, reals, wholes)
                seen |= 1 << k
                guess = k + 1
            if at < 0:
                return False
        if at != end or seen & required != required:
            return False
        fill_in(seen, reals, wholes)
        return True

    return scan


def _make_find(table: _Table) -> Callable[[int, int, int], int]:
    """Return a function that finds the field of a name, -1 if there is none."""
    names = table.names
    begins = table.begins
    sizes = table.sizes
    count = len(table.sizes)

    @compilable
    def find(at: int, size: int, guess: int) -> int:
        for n in range(count):
            k = guess + n
            if k >= count:
                k -= count
            if sizes[k] != size:
                continue
            same = True
            for m in range(size):
                if byte(at + m) != names[begins[k] + m]:
                    same = False
                    break
            if same:
                return k
        return -1

    return find


def _make_decode(table: _Table) -> Callable[[int, int, int, Any, Any], int]:
    """Return a function that stores field k, and returns the address after it, or -1."""
    kinds, slots, lows, highs = table.kinds, table.slots, table.lows, table.highs
    real, vector, whole, flag, text, texts = REAL, VECTOR, WHOLE, FLAG, TEXT, TEXTS

    @compilable
    def decode(k: int, at: int, end: int, reals: Any, wholes: Any) -> int:
        kind = kinds[k]
        slot = slots[k]
        known = True
        if kind == real:
            known, reals[slot], at = real_number(at, end)
        elif kind == vector:
            if at >= end or byte(at) != 0x93:
                return -1
            at += 1
            for i in range(3):
                known, reals[slot + i], at = real_number(at, end)
                if not known:
                    return -1
        elif kind == whole:
            known, value, at = whole_number(at, end)
            known = known and lows[k] <= value <= highs[k]
            wholes[slot] = value
        elif kind == flag:
            if at >= end or byte(at) & 0xFE != 0xC2:
                return -1
            wholes[slot] = byte(at) & 1
            at += 1
        elif kind == text:
            size, at = text_size(at, end)
            if size < 0 or size > highs[k]:
                return -1
            for m in range(size):
                if byte(at + m) >= 0x80:
                    return -1
            wholes[texts], wholes[texts + 1] = at, size
            at += size
        return at if known else -1

    return decode


def _make_fill_in(table: _Table) -> Callable[[int, Any, Any], None]:
    """Return a function that stores the defaults of the fields that were not seen."""
    kinds = table.kinds
    slots = table.slots
    defaults = table.defaults
    count = len(table.kinds)
    real, vector, text, texts = REAL, VECTOR, TEXT, TEXTS

    @compilable
    def fill_in(seen: int, reals: Any, wholes: Any) -> None:
        for k in range(count):
            if seen & (1 << k) != 0:
                continue
            if kinds[k] == real:
                reals[slots[k]] = defaults[k]
            elif kinds[k] == vector:
                for i in range(3):
                    reals[slots[k] + i] = 0.0
            elif kinds[k] == text:
                wholes[texts + 1] = -1
            else:
                wholes[slots[k]] = int(defaults[k])

    return fill_in


def make_match(text: str) -> Callable[[Any], bool]:
    """Return a function that compares the text of a scanned message with `text`."""
    letters = np.frombuffer(text.encode(), np.uint8).copy()
    count = len(letters)
    texts = TEXTS

    @compilable
    def match(wholes: Any) -> bool:
        size = wholes[texts + 1]
        if size < 0:
            return True
        if size != count:
            return False
        for m in range(count):  # noqa: SIM110  # numba compiles no generator
            if byte(wholes[texts] + m) != letters[m]:
                return False
        return True

    return match
