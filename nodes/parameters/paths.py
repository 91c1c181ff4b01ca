"""Paths and libraries in parameters, and which of them a remote launcher may set.

A launcher on this machine runs as the same user and may name any file. A remote one may only name
files in the directories that the node's own command line allows (``--allow-path``), because a path
may be a library to load or a file to replace.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
from msgspec import inspect

from messages.topics import message_type
from nodes.parameters.store import ParameterError

_LOCAL = "decided where the node runs"

# type of a parameter that names a file or a library
LocalPath: TypeAlias = Annotated[str, msgspec.Meta(extra={_LOCAL: True})]

# type of a switch that decides what happens to a file
LocalChoice: TypeAlias = Annotated[bool, msgspec.Meta(extra={_LOCAL: True})]


def check_paths(
    parameters: msgspec.Struct, allowed: Sequence[Path], where: str
) -> None:
    """Reject parameters that name files outside the allowed folders.

    A path is a parameter declared as one, or any text with a slash.
    """
    folders = [folder.resolve() for folder in allowed]
    # covers also kinds of node that do not declare their paths
    for path, value, is_declared in _local(parameters, where):
        if isinstance(value, str):
            # Links are resolved: their target counts.
            refused = "\0" in value or not any(
                Path(value).resolve().is_relative_to(folder) for folder in folders
            )
        else:
            refused = is_declared and not folders
        if refused:
            folder = Path(value).parent if isinstance(value, str) else "DIR"
            raise ParameterError(
                f"{value!r} comes from another machine and is not allowed here; where the"
                f" node is started: haptic node start ... --allow-path {folder}",
                path=path,
            )


def _local(value: Any, where: str) -> Iterator[tuple[str, Any, bool]]:
    """Yield path, value and whether declared as a path, of all parameters that may name files.

    Parameters with their default value are skipped.
    """
    if isinstance(value, msgspec.Struct):
        info = inspect.type_info(type(value))
        assert isinstance(info, inspect.StructType)  # noqa: S101  # the type info of a struct
        for field in info.fields:
            found = getattr(value, field.name)
            place = f"{where}.{field.name}"
            kind = field.type
            if isinstance(kind, inspect.Metadata) and (kind.extra or {}).get(_LOCAL):
                if found != field.default:
                    yield place, found, True
            else:
                yield from _local(found, place)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _local(inner, f"{where}.{key}")
    elif isinstance(value, (list, tuple)):
        for i, inner in enumerate(value):
            yield from _local(inner, f"{where}[{i}]")
    elif (
        isinstance(value, str)
        and ("/" in value or "\0" in value)
        and message_type(value) is None
    ):
        yield where, value, False


def needed(parameters: msgspec.Struct) -> list[str]:
    """Return the directories that a remote node must allow for these parameters."""
    found = [
        str(Path(value).parent) if isinstance(value, str) else "."
        for _, value, _ in _local(parameters, "")
    ]
    return list(dict.fromkeys(found))
