"""Hypothesis strategies for the messages, built from their types."""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import strategies as st

from messages.types import (
    DeviceState,
    Event,
    Force,
    Handle,
    Message,
    NodeStatus,
    Proxy,
    Receipt,
)

TYPES: tuple[type[Message], ...] = (
    DeviceState,
    Handle,
    Proxy,
    Force,
    NodeStatus,
    Receipt,
    Event,
)

_SPAN = 1e15
"""Finite floats far beyond anything physical; ten of them still have a finite sum."""


def _values(info: msgspec.inspect.Type) -> st.SearchStrategy[Any]:
    if isinstance(info, msgspec.inspect.FloatType):
        return st.floats(-_SPAN, _SPAN)
    if isinstance(info, msgspec.inspect.IntType):
        return st.integers(
            -(2**63) if info.ge is None else info.ge,
            2**63 - 1 if info.le is None else info.le,
        )
    if isinstance(info, msgspec.inspect.StrType):
        return st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
    if isinstance(info, msgspec.inspect.BoolType):
        return st.booleans()
    if isinstance(info, msgspec.inspect.DictType):
        return st.dictionaries(
            _values(info.key_type),
            _values(info.value_type),
            max_size=info.max_length or 8,
        )
    assert isinstance(info, msgspec.inspect.TupleType)
    return st.tuples(*map(_values, info.item_types))


def messages(message_type: type[Message]) -> st.SearchStrategy[Any]:
    """Return a strategy for messages of one type with any valid content.

    Parameters
    ----------
    message_type : type of Message
        The type.

    Returns
    -------
    hypothesis strategy
        Of messages.
    """
    info = msgspec.inspect.type_info(message_type)
    assert isinstance(info, msgspec.inspect.StructType)
    return st.builds(
        message_type, **{field.name: _values(field.type) for field in info.fields}
    )
