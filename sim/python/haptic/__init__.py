"""Haptic virtual coupling, from Python: ``import haptic``, then tab.

``haptic.launch("floor_drop", stiffness=1500)`` starts the loop in processes of its own, ``haptic.play`` plays it in this one,
``haptic.k_max`` and ``haptic.poles`` tell what is stable. Everything is loaded when it is first used.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # As typing has it, which takes longer to load than all of this.
if TYPE_CHECKING:
    from typing import Any

    from messages.errors import HapticError
    from nodes.laws.parse import LawRefusedError
    from nodes.stability.plant import Plant
    from sim.api.catalogue import laws, scenarios
    from sim.api.laws import law
    from sim.api.loops import drop, k_max, play, poles
    from sim.api.python_runs import LaunchError, Run, connect, launch
    from sim.api.recordings import plot, read
    from sim.api.verbs import design, identify, study, tune

__all__ = [
    "HapticError",
    "LaunchError",
    "LawRefusedError",
    "Plant",
    "Run",
    "connect",
    "design",
    "drop",
    "identify",
    "k_max",
    "launch",
    "law",
    "laws",
    "play",
    "plot",
    "poles",
    "read",
    "scenarios",
    "study",
    "tune",
]

_HOME = {
    "HapticError": "messages.errors",
    "LaunchError": "sim.api.python_runs",
    "LawRefusedError": "nodes.laws.parse",
    "Plant": "nodes.stability.plant",
    "Run": "sim.api.python_runs",
    "connect": "sim.api.python_runs",
    "design": "sim.api.verbs",
    "drop": "sim.api.loops",
    "identify": "sim.api.verbs",
    "k_max": "sim.api.loops",
    "launch": "sim.api.python_runs",
    "law": "sim.api.laws",
    "laws": "sim.api.catalogue",
    "play": "sim.api.loops",
    "plot": "sim.api.recordings",
    "poles": "sim.api.loops",
    "read": "sim.api.recordings",
    "scenarios": "sim.api.catalogue",
    "study": "sim.api.verbs",
    "tune": "sim.api.verbs",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'haptic' has no attribute {name!r}; it has {', '.join(__all__)}")
    found = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
