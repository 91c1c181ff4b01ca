"""Contradictions between a declared device and what the nodes of the chain know of it."""

from __future__ import annotations

from collections.abc import Mapping

from messages.schema import attributes, unit_of
from nodes.coupling.parameters import CouplingParameters, PlantParameters
from nodes.parameters.store import ParameterError

# relative difference up to which a written value equals the known one, because of rounding
_CLOSE = 0.01
_MOVABLE = ("device_delay", "scale")  # fields that a driver may change while it runs
_WHOSE = {
    "tool_mass": "the tool of the scene weighs",
    "tool_damping": "the tool of the scene is damped to ground by",
    "tool_stiffness": "the body that is felt is on a spring of",
    "tool_lag": "what is felt answers later by",
    "tool_step": "the scene is stepped by",
    **dict.fromkeys(
        ("partner_mass", "partner_damping", "partner_stiffness"),
        "the second device has",
    ),
    "scale": "the driver maps at a scale of",
}


def contradictions(
    plant: PlantParameters, known: Mapping[str, float]
) -> dict[str, str]:
    """Return the fields of a plant with which a loop looks more stable than it is.

    Less mass or damping, a stiffer hand, a lighter tool and a longer delay make a worse device,
    which a user may ask for.

    Parameters
    ----------
    plant : PlantParameters
        The plant as written.
    known : mapping of str to float
        What the nodes of the chain know of it.

    Returns
    -------
    dict of str to str
        Field to the known value, in the field's unit.
    """
    limits = dict(known)
    if "mass" in known:
        limits.setdefault("heaviest", known["mass"])
    found = {}
    for field, limit in limits.items():
        value = getattr(plant, field)
        low = limit * (1.0 - _CLOSE)
        high = limit * (1.0 + _CLOSE)
        if field in ("scale", "tool_stiffness", "tool_lag"):
            kept = value is not None and low <= value <= high
        elif field == "tool_step":
            # A shorter step, or none, promises less.
            kept = value is None or value <= high
        elif field == "heaviest":
            kept = value is None or value >= low
        elif field == "partner_later":
            kept = True  # no value shows whether earlier or later is worse
        elif field in ("stiffness", "partner_stiffness", "device_delay"):
            kept = value >= low
        else:
            kept = value is not None and value <= high
        if not kept:
            found[field] = f"{limit:g}"
    return found


def refuse_contradiction(
    node: str,
    known: Mapping[str, float],
    parameters: CouplingParameters,
    now: CouplingParameters | None = None,
) -> None:
    """Check that a plant does not make laws look more stable than the known device does.

    Parameters
    ----------
    node : str
        Name of the coupling.
    known : mapping of str to float
        What other nodes of the chain know of the plant (`nodes.base.node.Node.plant`).
    parameters : CouplingParameters
        The plant, and what is done with an unstable law.
    now : CouplingParameters or None
        The parameters before a change; values accepted earlier may stay. A change does not compare
        a device's delay, because it may have changed since the start.

    Raises
    ------
    ParameterError
        With the field, its value and the known one.
    """
    plant = parameters.plant
    before = None if now is None else now.plant
    if plant is None or parameters.stability in ("warn", "off") or plant == before:
        return
    for field, limit in contradictions(plant, known).items():
        written = getattr(plant, field)
        live = now is not None and field in _MOVABLE
        if live or (before is not None and written == getattr(before, field)):
            continue
        where = f"{node}.plant.{field}"
        unit = unit_of(attributes(PlantParameters.__doc__ or "")[field])
        raise ParameterError(
            f"{_shown(written, unit)}, but {_WHOSE.get(field, 'the device has')}"
            f" {limit} {unit}: laws would be judged on another device. Leave {where} out, which"
            f" fills it in, or set {node}.stability to warn",
            path=where,
        )


def _shown(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{value:g} {unit}".strip()
