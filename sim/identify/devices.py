"""Which devices can be driven from here: their libraries, where those were looked for, and what was checked on hardware."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from nodes.driver.touch.driver import TouchParameters

FOLDERS = ("/usr/lib", "/usr/lib64", "/usr/lib/x86_64-linux-gnu", "/usr/local/lib", "/opt/OpenHaptics")
"""Where vendors put their libraries, beside what the dynamic linker knows."""


@dataclass(frozen=True)
class Kind:
    """A kind of device.

    Attributes
    ----------
    kind : str
        Kind of node that drives it.
    found : bool
        Whether its library is here.
    library : str or None
        The library; None for a device that needs none.
    searched : tuple of str
        Where it was looked for.
    checked : str
        What its driver was tested against.
    """

    kind: str
    found: bool
    library: str | None
    searched: tuple[str, ...]
    checked: str


def devices() -> list[Kind]:
    """Look for every kind of device."""
    return [Kind("sim_driver", True, None, (), "closed forms and lockstep runs (no hardware)"), _touch()]


def _touch() -> Kind:
    name = TouchParameters().library
    folders = [*os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep), *FOLDERS]
    places = [str(Path(folder) / name) for folder in folders if folder]
    library = next((place for place in places if Path(place).exists()), None)
    if library is None:
        library = ctypes.util.find_library(name.removeprefix("lib").partition(".")[0])
    searched = ("the dynamic linker's cache", *places)
    return Kind("touch_driver", library is not None, library or name, searched, "a stand-in library; not on hardware")


def figures() -> list[dict[str, Any]]:
    """Give all kinds as figures."""
    return [{**asdict(kind), "searched": list(kind.searched)} for kind in devices()]


def text() -> str:
    """Give all kinds as lines."""
    lines = []
    for kind in devices():
        state = "ready" if kind.found else f"{kind.library} not found"
        lines.append(f"{kind.kind:14} {state}; tested against {kind.checked}")
        if not kind.found:
            lines += [f"{'':14} looked in {place}" for place in kind.searched]
    return "\n".join(lines)
