"""A message as compiled code reads it, held against msgspec."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import msgspec
import numpy as np

from messages.codec import Decoder
from messages.types import Message
from nodes.compiled.kernels.scan import make_scan
from nodes.compiled.message_fields import FLAG, TEXT, VECTOR, WHOLE, fields_of
from sim.play.compiled import compiled


def kept(function: Callable[..., Any], name: str) -> Any:
    """Compile a function once a machine: its code stays in the cache, by its sources.

    The cache knows a function by its module and its name.
    """
    function.__qualname__ = name
    return compiled()(function)


@cache
def scanner(message: type[Message]) -> Callable[[bytes], dict[str, Any] | None]:
    """Return a compiled reader of payloads."""
    scan: Any = make_scan(message)
    compiled_scan = kept(
        lambda at, end, reals, wholes: scan(at, end, reals, wholes),
        f"scan_{message.__name__}",
    )

    def read(payload: bytes) -> dict[str, Any] | None:
        # What stood there before must not be taken for what was read.
        reals, wholes = np.full(32, 77.0), np.full(16, 77)
        at = ctypes.create_string_buffer(payload, len(payload) + 16)
        begin = ctypes.addressof(at)
        if not compiled_scan(begin, begin + len(payload), reals, wholes):
            return None
        found: dict[str, Any] = {}
        for field in fields_of(message):
            if field.kind == VECTOR:
                found[field.name] = tuple(
                    float(v) for v in reals[field.slot : field.slot + 3]
                )
            elif field.kind in (WHOLE, FLAG):
                found[field.name] = int(wholes[field.slot])
            elif field.kind != TEXT:
                found[field.name] = float(reals[field.slot])
        return found

    return read


def numbers(message: Message) -> dict[str, Any]:
    """Return what the plain tick reads, without texts."""
    return {
        name: value
        for name, value in msgspec.structs.asdict(message).items()
        if not isinstance(value, str)
    }


def assert_read_alike(message: type[Message], payload: bytes) -> bool:
    """Check that what is read compiled, msgspec reads too, and the same; tell whether it was."""
    found = scanner(message)(payload)
    if found is None:
        return False
    expected = numbers(Decoder(message).decode(payload))
    assert found == expected
    # Equality does not know the sign of zero.
    assert repr(found) == repr(
        {name: int(v) if isinstance(v, bool) else v for name, v in expected.items()}
    )
    return True
