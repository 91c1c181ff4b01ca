"""Registries of installed laws, derivatives, surfaces, node kinds and verbs.

Nothing is imported until requested by name; an import error makes only that name unavailable.
"""

from collections.abc import Callable
from typing import Any

import msgspec

from nodes.parameters import installed
from nodes.parameters.refusals import choices, short
from nodes.parameters.store import ParameterError


class NotInstalledError(ParameterError):
    """No object of that name is installed or importable; the text names its package."""


class Registry:
    """One group of entry points; `wrong` returns why an object is not of its kind, or ""."""

    def __init__(
        self,
        group: str,
        noun: str,
        wrong: Callable[[str, Any], str] = lambda _name, _found: "",
    ) -> None:
        self.group = group
        self._noun = noun
        self._wrong = wrong

    def names(self) -> list[str]:
        """Return the installed names without importing any."""
        return sorted(self.points())

    def points(self) -> dict[str, installed.EntryPoint]:
        """Return the entry points."""
        return installed.points(self.group)

    def load(self, name: str) -> Any:
        """Import an object by name, or raise NotInstalledError with the reason."""
        point = self.points().get(name) if isinstance(name, str) else None
        if point is None:
            raise NotInstalledError(
                f"{short(name)} is not an installed {self._noun}; {choices(name, self.names())}"
            )
        try:
            found = point.load()
            if isinstance(found, type) and issubclass(found, msgspec.Struct):
                # The first decoder resolves the types of the fields: done here, where an error can
                # name the owner.
                msgspec.msgpack.Decoder(found)
            wrong = self._wrong(name, found)
        # another package's module may raise anything on import
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
        """Import all. Return the imported by name, sorted, and why the rest failed."""
        found: dict[str, Any] = {}
        broken: dict[str, str] = {}
        for name in self.names():
            try:
                found[name] = self.load(name)
            except NotInstalledError as error:
                broken[name] = str(error)
        return found, broken
