"""Describe a kind of law from its class: formula, parameters, judgement, example.

No law is named here: a newly registered law is described automatically.
"""

from __future__ import annotations

import json
import shlex
from typing import Any

from nodes.laws import Law, law_names, load_law
from nodes.laws.fields import GAINS
from nodes.laws.law_fields import law_fields
from nodes.laws.parse import LawRefusedError, compile_law, parse_law
from nodes.laws.presets import PRESETS, expand
from nodes.parameters.checked import required_fields

_PERIOD = 0.002  # sampling period at which an example is compiled [s]
_FEW = 4  # choices that fit into a table
POLES = "poles"  # judgement of a law that is a sum of taps and sections
SIMULATION = "simulation and launches"  # judgement of a law with code of its own


def public_kinds() -> list[str]:
    """Return the installed kinds, without those that only programs use and broken ones."""
    found = []
    for name in law_names():
        try:
            law = load_law(name)
        # a package that cannot be imported; `haptic doctor` reports it
        except ValueError:
            continue
        if not law.internal:
            found.append(name)
    return found


def describe_law(kind: str) -> dict[str, Any]:
    """Return the description of an installed kind of law, or of a preset's kind.

    Parameters
    ----------
    kind : str
        Name of a kind or of a preset.

    Returns
    -------
    dict
        ``kind``, ``python`` (name of the class), ``formula``, ``parameters`` (each with name, unit,
        default, minimum, maximum, meaning and more), ``gains`` where the law has them,
        ``judged_by``, ``example`` and ``presets``.

    Raises
    ------
    NotInstalledError
        If there is no such law.
    """
    named = PRESETS.get(kind)
    law = load_law(str(named["kind"]) if named is not None else kind)
    example = {"kind": kind} if named is not None else _example(law)
    required = required_fields(law)
    fields = [_parameter(field, required) for field in law_fields(law)]
    described: dict[str, Any] = {
        "kind": law.kind,
        "python": law.__name__,
        "formula": _formula(law),
        "parameters": fields,
        "judged_by": _judged_by(example),
        "example": example,
        "presets": [
            name for name, values in PRESETS.items() if values["kind"] == law.kind
        ],
    }
    if any(field["name"] == "gains" for field in fields):
        described["gains"] = {name: dict(gain) for name, gain in GAINS.items()}
    return described


def _example(law: type[Law]) -> dict[str, Any] | None:
    """Return the example of a law as in YAML; None if its class has none that is complete."""
    whole = set(required_fields(law)) <= set(law.example)
    return {"kind": law.kind, **law.example} if whole else None


def _formula(law: type[Law]) -> str:
    return " ".join((law.__doc__ or "").strip().partition("\n\n")[0].split()).rstrip(
        "."
    )


def _parameter(field: dict[str, Any], required: list[str]) -> dict[str, Any]:
    """Return the description of a field with the keys that are documented."""
    found = {
        "name": field["name"],
        "unit": field["unit"],
        "type": field["type"],
        "required": field["name"] in required,
        "default": field.get("default"),
        "minimum": field.get("gt", field.get("ge")),
        "maximum": field.get("lt", field.get("le")),
        # limits that are themselves refused
        "minimum_excluded": "gt" in field,
        "maximum_excluded": "lt" in field,
        "meaning": field["told"],
    }
    if "choices" in field:
        found["choices"] = field["choices"]
    if "fields" in field:
        names = [inner["name"] for inner in field["fields"] if "default" not in inner]
        found["fields"] = [_parameter(inner, names) for inner in field["fields"]]
    return found


def _judged_by(example: dict[str, Any] | None) -> str | None:
    """Return the method that judges a law's stability; None if nothing tells."""
    if example is None:
        return None
    law = parse_law(example)
    period = getattr(law, "period", None) or expand(example).get("period") or _PERIOD
    try:
        compiled = compile_law(law, float(period))
    except LawRefusedError:
        return None
    return POLES if compiled.evaluate is None else SIMULATION


def limits_text(parameter: dict[str, Any]) -> str:
    """Return the limits of a parameter as text, e.g. ``> 0, ≤ 1``; empty without any."""
    low, high = parameter["minimum"], parameter["maximum"]
    texts = (
        []
        if low is None
        else [f"{'>' if parameter['minimum_excluded'] else '≥'} {low:g}"]
    )
    texts += (
        []
        if high is None
        else [f"{'<' if parameter['maximum_excluded'] else '≤'} {high:g}"]
    )
    if "choices" in parameter:
        few = len(parameter["choices"]) <= _FEW
        texts.append(
            ", ".join(map(str, parameter["choices"])) if few else "one of those below"
        )
    return ", ".join(texts)


def calls(described: dict[str, Any]) -> dict[str, str]:
    """Return the example as typed in: on the command line, and in Python."""
    example = described["example"]
    if example is None:
        return {}
    kind = example["kind"]
    values = {key: example[key] for key in example if key != "kind"}
    in_yaml = ", ".join(f"{key}: {json.dumps(value)}" for key, value in example.items())
    in_python = ", ".join(f"{key}={value!r}" for key, value in values.items())
    made = f"haptic.{described['python']}({in_python})"
    words = [
        shlex.quote(f"{key}:={value if isinstance(value, str) else json.dumps(value)}")
        for key, value in values.items()
    ]
    return {
        "shell": " ".join(["haptic law show", kind, *words]),
        "yaml": "{" + in_yaml.replace('"', "") + "}",
        "python": made if kind == described["kind"] else f"haptic.law({kind!r})",
    }
