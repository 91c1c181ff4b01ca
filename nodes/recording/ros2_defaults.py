"""Constructors of ROS 2 messages whose missing fields are zero or empty, as in ROS.

From the definitions that rosbags has; the classes may be those of rosbags or of Cyclone DDS.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any


class Constructors:
    """Constructors by the name of their type, e.g. ``geometry_msgs/msg/Pose``.

    Parameters
    ----------
    store : Any
        Store of types of rosbags.
    class_of : callable
        Return the class of a type.
    numbers : callable
        Return an empty sequence of a base type, e.g. ``uint8``.
    """

    def __init__(
        self,
        store: Any,
        class_of: Callable[[str], Any],
        numbers: Callable[[str], Any] = lambda _: [],
    ) -> None:
        self._store, self._class_of, self._numbers = store, class_of, numbers

    def look_up(self, name: str) -> Any:
        """Return a constructor; missing fields are zero or empty."""
        return partial(self._build, name)

    def _build(self, name: str, /, **given: Any) -> Any:
        (constants, fields) = self._store.fielddefs[name]
        del constants
        filled = {
            field: given[field] if field in given else self._empty(kind)
            for field, kind in fields
        }
        return self._class_of(name)(**filled)

    def _empty(self, description: Any) -> Any:
        kind, inner = description
        if kind.name == "NAME":
            return self._build(inner)
        if kind.name == "ARRAY":
            return [self._empty(inner[0]) for _ in range(inner[1])]
        if kind.name == "SEQUENCE":
            (of, name), _ = inner
            of_numbers = of.name == "BASE" and name[0] != "string"
            return self._numbers(name[0]) if of_numbers else []
        zero = 0.0 if inner[0].startswith("float") else 0
        return {"string": "", "bool": False}.get(inner[0], zero)
