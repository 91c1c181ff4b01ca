"""Fields of a declared device with which a loop looks more stable than it is."""

from __future__ import annotations

from collections.abc import Mapping

from nodes.coupling.parameters import PlantParameters

# relative difference up to which a written value equals the known one, because of rounding
_CLOSE = 0.01


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
