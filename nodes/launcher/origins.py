"""Origins of a launch's parameters (file, line and argument), for error messages."""

import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from nodes.parameters.interface_words import interface
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import lines_of

# last step of a path: a name, or an index
_LAST = re.compile(r"(?:^|\.)[^.\[\]]*$|\[\d+\]$")


class Origins:
    """Origins of one launch file's values."""

    def __init__(
        self, path: Path, given: Mapping[str, Any], nodes: Mapping[str, Any]
    ) -> None:
        self.folder = str(path.resolve().parent)  # folder of the launch file
        self._name = path.name
        self._given = given
        self._nodes = set(nodes)
        self._path = path
        # Lines of parameters that override the launch file.
        self._over: dict[str, tuple[str, int]] = {}
        self._arguments: dict[str, str] = {}

    @cached_property
    def _lines(self) -> dict[str, tuple[str, int]]:
        """Return file and line of each value; computed only for an error, as it costs a read."""
        return {
            place: (self._path.name, line)
            for place, line in lines_of(self._path).items()
        } | self._over

    def laid_over(self, path: Path) -> None:
        """Add a file of parameters, by node, that overrides the launch file."""
        for place, line in lines_of(path).items():
            node, _, rest = place.partition(".")
            self._over[f"nodes.{node}.parameters.{rest}"] = (str(path), line)
            self._arguments.pop(f"nodes.{node}.parameters.{rest}", None)

    def filled_in(self, place: str, argument: str) -> None:
        """Record that `argument` was substituted at `place`."""
        self._arguments[place.removeprefix(f"{self._name}.")] = argument

    def _argument_of(self, place: str) -> str | None:
        """Return the argument substituted at a place, or at one above it; None without any."""
        while place not in self._arguments:
            place, whole = _LAST.sub("", place, count=1), place
            if place == whole:
                return None
        return self._arguments[place]

    def located(self, error: ParameterError) -> str:
        """Return an error's text with file, line and argument of the value it names."""
        path = error.path.removeprefix(f"{self._name}.")
        place = path
        node, dot, rest = place.partition(".")
        if node in self._nodes:
            place = f"nodes.{node}.parameters{dot}{rest}"
        argument = self._argument_of(place)
        if argument is None and place.startswith("arguments."):
            argument = place.removeprefix("arguments.")
        behind = ""
        if argument is not None:
            given = argument in self._given
            behind = (
                f" (given as {interface.get().argument(argument, self._given[argument])})"
                if given
                else f" (the default of {argument})"
            )
        while place not in self._lines:
            place, whole = _LAST.sub("", place, count=1), place
            if place == whole:
                return str(error)
        file, line = self._lines[place]
        return f"{file}:{line}: {path}: {error.text}{behind}"
