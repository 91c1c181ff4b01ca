"""What is installed beside us: laws, realisations of D^α, surfaces, kinds of node and verbs, found through entry points.

Nothing is imported until it is asked for by name, and of what cannot be imported only the name becomes unavailable.
"""

from __future__ import annotations

import sys
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec

from nodes.parameters.refusals import choices
from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


class NotInstalledError(ParameterError):
    """Nothing of that name is installed, or it cannot be imported; the text says which package it comes from."""


class Registry:
    """One group of entry points."""

    def __init__(self, group: str, noun: str) -> None:
        self.group = group
        self._noun = noun

    def names(self) -> list[str]:
        """List what is installed, without importing any."""
        return sorted(self.points())

    def points(self) -> dict[str, EntryPoint]:
        """Find the entry points."""
        return _installed(self.group, tuple(sys.path))

    def load(self, name: str) -> Any:
        """Import one.

        Returns: what is registered under that name. Raises NotInstalledError when there is none of that name, or it cannot be
        imported.
        """
        point = self.points().get(name)
        if point is None:
            raise NotInstalledError(f"{name!r} is not an installed {self._noun}; {choices(name, self.names())}")
        try:
            found = point.load()
            if isinstance(found, type) and issubclass(found, msgspec.Struct):
                # Its first decoder looks up the types of its fields: made here, where it can be said whose they are.
                msgspec.msgpack.Decoder(found)
            return found
        except (Exception, SystemExit) as error:  # another package's module may raise anything while it is imported
            package = point.dist.name if point.dist is not None else "?"
            raise NotInstalledError(
                f"{name!r}: the {self._noun} cannot be imported: {type(error).__name__}: {error} "
                f"({point.value}, of the package {package})"
            ) from error

    def all(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Import all.

        Returns: what could be imported, by name and sorted; and why the rest could not.
        """
        found: dict[str, Any] = {}
        broken: dict[str, str] = {}
        for name in self.names():
            try:
                found[name] = self.load(name)
            except NotInstalledError as error:
                broken[name] = str(error)
        return found, broken


@cache
def _installed(group: str, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Read a group once per search path: that takes milliseconds, and a running loop asks at every change."""
    # Later: a node that looks up nothing starts without it.
    from importlib.metadata import entry_points

    del path
    return {point.name: point for point in entry_points(group=group)}
