"""What is installed beside us: laws, realisations of D^α, surfaces, kinds of node and verbs, found through entry points.

Nothing is imported until it is asked for by name, and of what cannot be imported only the name becomes unavailable.
"""

from typing import Any

import msgspec

from nodes.parameters import installed
from nodes.parameters.refusals import choices
from nodes.parameters.store import ParameterError


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

    def points(self) -> dict[str, installed.EntryPoint]:
        """Find the entry points."""
        return installed.points(self.group)

    def load(self, name: str) -> Any:
        """Import one, or say in NotInstalledError why not."""
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
            raise NotInstalledError(
                f"{name!r}: the {self._noun} cannot be imported: {type(error).__name__}: {error} "
                f"({point.value}, of the package {point.package})"
            ) from error

    def all(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Import all: those that could be, by name and sorted, and why the rest could not."""
        found: dict[str, Any] = {}
        broken: dict[str, str] = {}
        for name in self.names():
            try:
                found[name] = self.load(name)
            except NotInstalledError as error:
                broken[name] = str(error)
        return found, broken
