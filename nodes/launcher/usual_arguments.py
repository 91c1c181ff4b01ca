"""Arguments of most launch files: unit, help and limits; a file states defaults.

``rate: 500.0`` under ``arguments`` declares the argument `USUAL` describes, with that default. A
setting of ``run`` that is declared so needs no line under ``run``.
"""

from collections.abc import Mapping
from typing import Any

USUAL: dict[str, dict[str, Any]] = {
    "rate": {"unit": "Hz", "help": "sampling rate", "min": 50.0, "max": 20_000.0},
    "pace": {
        "help": "realtime or lockstep (deterministic and as fast as possible)",
        "choices": ["realtime", "lockstep"],
    },
    "apply": {
        "help": "when a force takes effect",
        "choices": ["on_arrival", "next_tick"],
    },
    "duration": {"unit": "s", "help": "how long to run", "min": 0.0},
    "law": {
        "help": "law to start with: pd, pd_alpha, multi_term, a preset or any installed law"
    },
    "stiffness": {"unit": "N/m", "help": "nominal stiffness K of every law"},
    "damping": {"unit": "N s/m", "help": "gain B of every law"},
}
RUN = ("rate", "pace", "apply", "duration")  # settings of ``run``


def with_usual(data: Any) -> Any:
    """Return the content of a launch file with its usual arguments written out.

    A bare value under another name stays, and is refused by the file's own check.
    """
    declared = data.get("arguments") if isinstance(data, Mapping) else None
    if not isinstance(declared, Mapping):
        return data
    short = {
        name
        for name, one in declared.items()
        if name in USUAL and not isinstance(one, Mapping)
    }
    if not short:
        return data
    arguments = {
        name: {"default": one, **USUAL[name]} if name in short else one
        for name, one in declared.items()
    }
    run = data.get("run", {})
    if isinstance(run, Mapping):
        run = {**{name: f"$(var {name})" for name in RUN if name in short}, **run}
    return {**data, "arguments": arguments, "run": run}


def with_gain(data: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return assignments with ``gain``, the studies' name of a law's B, as ``damping``.

    Only for a launch file with an argument ``damping`` and none that is named ``gain``.
    """
    declared = data.get("arguments") if isinstance(data, Mapping) else None
    names = set(declared) if isinstance(declared, Mapping) else set()
    found = dict(given)
    if "gain" in found and "gain" not in names and "damping" in names - set(found):
        found["damping"] = found.pop("gain")
    return found
