"""What a node is started with, right in everything but what a test gives."""

from __future__ import annotations

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
    """Make a node's setup."""
    return Setup(**{**_USUAL, **given})
