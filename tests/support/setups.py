"""Set-ups of nodes, valid except for what a test changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nodes.base.setup import Setup

_USUAL: dict[str, Any] = {
    "run": "r",
    "run_dir": "",
    "name": "driver",
    "kind": "sim_driver",
    "factory": "",
    "period": 0.002,
    "pace": "realtime",
    "apply": "on_arrival",
    "axes": ["z"],
    "ticks": 0,
    "publish": "",
    "control": "",
    "sources": {},
}


def setup_of(**given: Any) -> Setup:
    """Return a node's set-up."""
    return Setup(**{**_USUAL, **given})


class MadeLater:
    """A file that another node creates later, first empty; `asked` counts the checks."""

    def __init__(self, path: Path, make: Callable[[], None]) -> None:
        self._path, self._make, self.asked = path, make, 0

    def __call__(self) -> bool:
        """Return False: the waiting node never gives up."""
        self.asked += 1
        if self.asked == 2:
            self._path.touch()
        elif self.asked == 3:
            self._make()
        return False
