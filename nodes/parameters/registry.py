"""What is installed beside us: laws, realisations of D^α, surfaces, kinds of node and verbs, found through entry points.

Nothing is imported until it is asked for by name, and of what cannot be imported only the name
becomes unavailable.
"""

from collections.abc import Callable
from typing import Any

import msgspec

from nodes.parameters import installed
from nodes.parameters.refusals import choices, short
from nodes.parameters.store import ParameterError


class NotInstalledError(ParameterError):
    """Nothing of that name is installed, or it cannot be imported; the text says which package it comes from."""


class Registry:
    """One group of entry points; `wrong` says why what is registered under a name is not of its kind, or nothing."""

    def __init__(
        self, group: str, noun: str, wrong: Callable[[str, Any], str] = lambda _name, _found: ""
    ) -> None:
        self.group = group
        self._noun = noun
        self._wrong = wrong

    def names(self) -> list[str]:
        """List what is installed, without importing any."""
        return sorted(self.points())

    def points(self) -> dict[str, installed.EntryPoint]:
        """Find the entry points."""
        return installed.points(self.group)

    def load(self, name: str) -> Any:
        """Import one, or say in NotInstalledError why not."""
        point = self.points().get(name) if isinstance(name, str) else None
        if point is None:
            raise NotInstalledError(
                f"{short(name)} is not an installed {self._noun}; {choices(name, self.names())}"
            )
        try:
            found = point.load()
            if isinstance(found, type) and issubclass(found, msgspec.Struct):
                # Its first decoder looks up the types of its fields: made here, where it can be
                # said whose they are.
                msgspec.msgpack.Decoder(found)
            wrong = self._wrong(name, found)
        # another package's module may raise anything while it is imported
        except (Exception, SystemExit) as error:
            raise NotInstalledError(
                f"{name!r}: the {self._noun} cannot be imported: {type(error).__name__}: {error} "
                f"({point.value}, of the package {point.package})"
            ) from error
        if wrong:
            raise NotInstalledError(
                f"{name!r}: {wrong} ({point.value}, registered in {self.group} by the package"
                f" {point.package})"
            )
        return found

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
