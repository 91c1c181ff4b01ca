"""Units of position, force and time in tables of other programs."""

from __future__ import annotations

import math
import re

UNITS: dict[str, dict[str, float]] = {
    "position": {
        "m": 1.0,
        "cm": 1e-2,
        "mm": 1e-3,
        "um": 1e-6,
        "nm": 1e-9,
        "in": 0.0254,
    },
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "day": 86400.0},
}
"""SI value of each unit that is known by name, by role."""

_OTHER_NAMES: dict[str, dict[str, str | float]] = {
    "position": {
        "meter": "m",
        "metre": "m",
        "centimeter": "cm",
        "centimetre": "cm",
        "millimeter": "mm",
        "millimetre": "mm",
        "micrometer": "um",
        "micrometre": "um",
        "micron": "um",
        "nanometer": "nm",
        "nanometre": "nm",
        "inch": "in",
        "inches": "in",
        "ft": 0.3048,
        "feet": 0.3048,
    },
    # The pound and the gram as forces, at standard gravity (CGPM 1901): 9.80665 m/s².
    "force": {
        "n": "N",
        "newton": "N",
        "millinewton": "mN",
        "kilonewton": "kN",
        "lbf": 0.45359237 * 9.80665,
        "kgf": 9.80665,
        "gf": 9.80665e-3,
    },
    "time": {
        "sec": "s",
        "second": "s",
        "msec": "ms",
        "millisecond": "ms",
        "usec": "us",
        "microsecond": "us",
        "nsec": "ns",
        "nanosecond": "ns",
        "day": "day",
        "minute": 60.0,
        "hour": 3600.0,
    },
}
_IN_NAME = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]$")
# as in a quantity over its unit (ISO 80000-1), or after a comma
_AFTER = re.compile(r"^(?P<name>.*\S)\s*[/,]\s*(?P<unit>\S+)$")


def unit_of(role: str, text: str) -> float | None:
    """Return the SI value of a unit by its name; None for a name that is unknown."""
    plain = text.strip().replace("µ", "u").replace("μ", "u")
    if plain in UNITS[role]:
        return UNITS[role][plain]
    others = _OTHER_NAMES[role]
    name = plain.lower()
    found = others.get(name, others.get(name.removesuffix("s")))
    return UNITS[role][found] if isinstance(found, str) else found


def factor_of(role: str, text: str) -> float | None:
    """Return the SI value of a unit, given by name or as a number; None if it is neither."""
    if (known := unit_of(role, text)) is not None:
        return known
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0.0 < value < math.inf else None


def is_unit(text: str) -> bool:
    """Whether a text is the name of a unit of any role."""
    return any(unit_of(role, text) is not None for role in UNITS)


def split_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a header: ``x [mm]``, ``x (mm)``, ``x / mm``, ``x, mm``."""
    if found := _IN_NAME.match(header):
        return found["name"], found["unit"].strip()
    found = _AFTER.match(header)
    # A name may have a slash or a comma of its own.
    return (
        (found["name"], found["unit"])
        if found and is_unit(found["unit"])
        else (header, "")
    )


def suffix_unit(role: str, name: str) -> str:
    """Return the unit at the end of a name as in ``x_mm``; empty without one."""
    stem, _, unit = name.rpartition("_")
    return unit if stem and unit_of(role, unit) is not None else ""


def plain_name(name: str) -> str:
    """Return a column's name without its unit and the structures around it, in lower case."""
    name = name.rpartition(".")[2]
    stem, _, unit = name.rpartition("_")
    if stem and is_unit(unit):
        name = stem
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
