"""Finding and loading a vendor's library; errors name what is missing and where it was."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

# result type and argument types of each function used
Functions = Mapping[str, tuple[Any, Sequence[Any]]]


class Search(NamedTuple):
    """Result of a search for a library."""

    library: str | None  # its path; None if not found
    searched: tuple[str, ...]  # places searched


def find(name: str, folders: Sequence[str]) -> Search:
    """Search for a library, by path or name, as the dynamic linker and in vendor folders."""
    if "/" in name:
        return Search(name if Path(name).exists() else None, (name,))
    loader = [
        folder
        for folder in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        if folder
    ]
    places = [str(Path(folder) / name) for folder in (*loader, *folders)]
    library = next((place for place in places if Path(place).exists()), None)
    if library is None:
        library = ctypes.util.find_library(name.removeprefix("lib").partition(".")[0])
    return Search(library, ("the dynamic linker's cache", *places))


def load(
    name: str, folders: Sequence[str], remedy: str, what: str, functions: Functions
) -> Any:
    """Load a library and declare its functions; OSError if it is missing or another one."""
    found = find(name, folders)
    try:
        library: Any = ctypes.CDLL(found.library or name)
    except OSError as error:
        searched = (
            "; looked in " + ", ".join(found.searched) if found.library is None else ""
        )
        raise OSError(
            f"{name} cannot be loaded ({error}{searched}): {remedy}; without a device, use kind"
            " sim_driver"
        ) from error
    return declared(library, name, what, functions)


def declared(library: Any, name: str, what: str, functions: Functions) -> Any:
    """Declare the functions of a library, and return it."""
    for function_name, (result, arguments) in functions.items():
        try:
            function = getattr(library, function_name)
        except AttributeError as error:
            raise OSError(f"{name} has no {function_name}: it is not {what}") from error
        function.restype, function.argtypes = result, list(arguments)
    return library
