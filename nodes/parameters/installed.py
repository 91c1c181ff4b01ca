"""What is installed on Python's path: packages, their versions and their entry points, as installers write them down.

``importlib.metadata`` reads the same files, but importing it and reading five groups with it takes
40 ms: a tenth of the time from `haptic launch` to the first tick. Here the path is read once for
all groups.
"""

import importlib
import os
import sys
from functools import cache, reduce
from pathlib import Path
from typing import Any, NamedTuple

OURS = "haptic-nodes"  # the name of this project's package


class EntryPoint(NamedTuple):
    """One entry point: ``name = module:attribute`` of a package."""

    name: str
    value: str
    package: str

    @property
    def module(self) -> str:
        """The module it is in."""
        return self.value.partition(":")[0].strip()

    def load(self) -> Any:
        """Import what it names: an attribute of a module, or the module."""
        attributes = self.value.partition(":")[2].strip()
        return reduce(
            getattr, filter(None, attributes.split(".")), importlib.import_module(self.module)
        )


def groups() -> list[str]:
    """List the groups of entry points that are of this project's kinds."""
    return sorted(_points(tuple(sys.path)))


def points(group: str) -> dict[str, EntryPoint]:
    """List the entry points of a group, by name."""
    return _points(tuple(sys.path)).get(group, {})


def version(package: str) -> str | None:
    """Tell the version of a package; None for one that is not installed as one."""
    folder = _folders(tuple(sys.path)).get(_same(package))
    return None if folder is None else _header(folder, "Version")


def _same(name: str) -> str:
    """Bring a package's name into the one form that tells whether two are the same."""
    return name.lower().replace("-", "_").replace(".", "_")


@cache
def _folders(path: tuple[str, ...]) -> dict[str, Path]:
    """Find each package's folder of metadata; the first on the path counts, as for imports."""
    found: dict[str, Path] = {}
    for place in path:
        try:
            names = os.listdir(place or ".")
        except OSError:
            # No folder: an archive, or one that is not there.
            continue
        for name in names:
            stem, _, kind = name.rpartition(".")
            if kind in ("dist-info", "egg-info"):
                found.setdefault(_same(stem.partition("-")[0]), Path(place, name))
    return found


@cache
def _points(path: tuple[str, ...]) -> dict[str, dict[str, EntryPoint]]:
    """Read the entry points of all groups: that takes milliseconds, and a running loop asks at every change."""
    groups: dict[str, dict[str, EntryPoint]] = {}
    for folder in _folders(path).values():
        try:
            with open(folder / "entry_points.txt", encoding="utf-8", errors="replace") as file:
                lines = [line.strip() for line in file]
        except OSError:
            continue
        package, group = "", ""
        for line in lines:
            if line.startswith("["):
                group = line.strip("[]").strip()
            elif group.startswith("haptic.") and line and not line.startswith("#"):
                name, _, value = (word.strip() for word in line.partition("="))
                package = package or _header(folder, "Name") or folder.stem.partition("-")[0]
                # What stands in brackets are extras, which nothing here asks for.
                groups.setdefault(group, {})[name] = EntryPoint(
                    name, value.partition("[")[0].strip(), package
                )
    return groups


def _header(folder: Path, field: str) -> str | None:
    """Read one field of a package's metadata."""
    for name in ("METADATA", "PKG-INFO"):
        try:
            with open(folder / name, encoding="utf-8", errors="replace") as file:
                for line in file:
                    if line.startswith(f"{field}:"):
                        return line.partition(":")[2].strip()
                    if not line.strip():
                        # Here the description begins.
                        break
        except OSError:
            continue
    return None
