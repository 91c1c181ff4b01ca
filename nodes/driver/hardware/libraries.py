"""Finding and loading a vendor's library: what is missing is named, and where it was looked for."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

# of each function that is used: what it gives, and what it takes
Functions = Mapping[str, tuple[Any, Sequence[Any]]]


class Search(NamedTuple):
    """Where a library was looked for."""

    library: str | None  # where it is; None where it is not found
    searched: tuple[str, ...]  # where it was looked for


def find(name: str, folders: Sequence[str]) -> Search:
    """Look for a library: a path, or a name in what the dynamic linker knows and in the vendor's folders."""
    if "/" in name:
        return Search(name if Path(name).exists() else None, (name,))
    loader = [
        folder for folder in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if folder
    ]
    places = [str(Path(folder) / name) for folder in (*loader, *folders)]
    library = next((place for place in places if Path(place).exists()), None)
    if library is None:
        library = ctypes.util.find_library(name.removeprefix("lib").partition(".")[0])
    return Search(library, ("the dynamic linker's cache", *places))


def load(name: str, folders: Sequence[str], remedy: str, what: str, functions: Functions) -> Any:
    """Load a library and declare what is used of it; OSError when it cannot be loaded, or is another one."""
    found = find(name, folders)
    try:
        library: Any = ctypes.CDLL(found.library or name)
    except OSError as error:
        searched = "; looked in " + ", ".join(found.searched) if found.library is None else ""
        raise OSError(
            f"{name} cannot be loaded ({error}{searched}): {remedy}; without a device, use kind"
            " sim_driver"
        ) from error
    return declared(library, name, what, functions)


def declared(library: Any, name: str, what: str, functions: Functions) -> Any:
    """Declare what is used of a library."""
    for function_name, (result, arguments) in functions.items():
        try:
            function = getattr(library, function_name)
        except AttributeError as error:
            raise OSError(f"{name} has no {function_name}: it is not {what}") from error
        function.restype, function.argtypes = result, list(arguments)
    return library
