"""Haptic virtual coupling from Python: ``import haptic``, then tab.

``haptic.launch("floor_drop", stiffness=1500)`` starts the loop in its own processes,
``haptic.play`` plays it in this one, ``haptic.k_max`` and ``haptic.poles`` analyse its stability.
``haptic.PD(stiffness=1500, damping=3)`` is a law; every installed kind has such a class.
Everything is loaded on first use.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # typing's own takes longer to import than this module
if TYPE_CHECKING:
    from typing import Any

    from messages.errors import HapticError
    from nodes.laws.fir import FIR, RecursiveSection
    from nodes.laws.fractional_sls import FractionalSLS
    from nodes.laws.multi_term import MultiTerm, Term
    from nodes.laws.parse import LawRefusedError
    from nodes.laws.pd import PD
    from nodes.laws.pd_alpha import PDAlpha
    from nodes.laws.pd_filtered import PDFiltered
    from nodes.laws.pd_windowed import PDWindowed
    from nodes.stability.plant import Plant
    from sim.api.compared_laws import LawTable, compare
    from sim.api.launching import connect, launch
    from sim.api.laws import law, laws, scenarios
    from sim.api.linear import OpenLoop, loop
    from sim.api.loops import k_max, poles
    from sim.api.own_data import hand_path
    from sim.api.played import drop, play
    from sim.api.python_runs import LaunchError, Run
    from sim.api.recordings import plot, read
    from sim.api.responses import bode, response, z_width
    from sim.api.run_summary import LaunchWarning, RunSummary
    from sim.api.staircase import Staircase
    from sim.api.trials import TrialTable, trials
    from sim.api.verbs import design, identify, lab, study, tune
    from sim.measure.cancelling import StudyCancelledError

__all__ = [
    "FIR",
    "PD",
    "FractionalSLS",
    "HapticError",
    "LaunchError",
    "LaunchWarning",
    "LawRefusedError",
    "LawTable",
    "MultiTerm",
    "OpenLoop",
    "PDAlpha",
    "PDFiltered",
    "PDWindowed",
    "Plant",
    "RecursiveSection",
    "Run",
    "RunSummary",
    "Staircase",
    "StudyCancelledError",
    "Term",
    "TrialTable",
    "bode",
    "compare",
    "connect",
    "design",
    "drop",
    "hand_path",
    "identify",
    "k_max",
    "lab",
    "launch",
    "law",
    "laws",
    "loop",
    "play",
    "plot",
    "poles",
    "read",
    "response",
    "scenarios",
    "study",
    "trials",
    "tune",
    "z_width",
]

_NAMES = {
    "messages.errors": ("HapticError",),
    "nodes.laws.fir": ("FIR", "RecursiveSection"),
    "nodes.laws.fractional_sls": ("FractionalSLS",),
    "nodes.laws.multi_term": ("MultiTerm", "Term"),
    "nodes.laws.parse": ("LawRefusedError",),
    "nodes.laws.pd": ("PD",),
    "nodes.laws.pd_alpha": ("PDAlpha",),
    "nodes.laws.pd_filtered": ("PDFiltered",),
    "nodes.laws.pd_windowed": ("PDWindowed",),
    "nodes.stability.plant": ("Plant",),
    "sim.api.compared_laws": ("LawTable", "compare"),
    "sim.api.linear": ("OpenLoop", "loop"),
    "sim.api.laws": ("law", "laws", "scenarios"),
    "sim.api.loops": ("k_max", "poles"),
    "sim.api.own_data": ("hand_path",),
    "sim.api.played": ("drop", "play"),
    "sim.api.launching": ("connect", "launch"),
    "sim.api.python_runs": ("LaunchError", "Run"),
    "sim.api.recordings": ("plot", "read"),
    "sim.api.run_summary": ("LaunchWarning", "RunSummary"),
    "sim.api.responses": ("bode", "response", "z_width"),
    "sim.api.staircase": ("Staircase",),
    "sim.api.trials": ("TrialTable", "trials"),
    "sim.api.verbs": ("design", "identify", "lab", "study", "tune"),
    "sim.measure.cancelling": ("StudyCancelledError",),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        found = getattr(importlib.import_module(_HOME[name]), name)
    elif name[:1].isupper() and (
        law := importlib.import_module("sim.api.laws").law_class(name)
    ):
        # a law of another package
        found = law
    else:
        raise AttributeError(
            f"module 'haptic' has no attribute {name!r}; it has {', '.join(__all__)}"
        )
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
