"""Presets of real devices for the virtual one: known values with their sources.

``device:=touch_x`` replaces the scenario's values by the known ones; unpublished values (the delay,
the damping) stay the scenario's. Values marked as remembered were not looked up; they are starting
points that `haptic device identify` measures.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

CHAI3D = "CHAI3D 3.2, device specifications in its sources"
SHEET = "3D Systems, data sheet of the Touch X (formerly PHANTOM Desktop)"
H3D = "H3DAPI wiki, Novint Falcon: 400 counts per inch, 8.9 N"
STYLUS = (
    "Fu & Çavuşoğlu 2012, IEEE Trans. SMC-B, tables II and III, 15 people; ends of the range as"
    " another reader quotes them"
)
YOKOKOHJI = (
    "remembered, not checked: Yokokohji & Yoshikawa 1994,"
    " IEEE Trans. Robotics and Automation"
)
MEMORY = "remembered, not checked"


@dataclass(frozen=True)
class Fact:
    """A value and its source."""

    value: float  # SI units
    source: str  # publication
    remembered: bool = False  # True if the source was not looked up


def _remembered(value: float) -> Fact:
    return Fact(value, MEMORY, remembered=True)


@dataclass(frozen=True)
class Preset:
    """Known values of a device."""

    title: str  # maker and name
    # Fields of `sim.device.model.DeviceModel`: mass [kg], friction [N], resolution [m], peak_force
    # [N].
    model: Mapping[str, Fact]
    # Limits advised by its maker or CHAI3D: ``stiffness`` [N/m], ``damping`` [N s/m],
    # ``continuous_force`` [N]; shown, not applied.
    limits: Mapping[str, Fact]


# By name; values missing here stay the scenario's.
PRESETS: dict[str, Preset] = {
    "touch_x": Preset(
        "3D Systems Touch X (PHANTOM Desktop)",
        {
            "mass": _remembered(0.035),
            "friction": _remembered(0.06),
            "resolution": Fact(2.3e-5, SHEET),
            "peak_force": Fact(7.9, SHEET),
        },
        {"stiffness": Fact(1000.0, CHAI3D), "continuous_force": Fact(1.75, SHEET)},
    ),
    "touch": Preset(
        "3D Systems Touch",
        {
            "mass": _remembered(0.045),
            "friction": _remembered(0.26),
            "peak_force": Fact(3.3, CHAI3D),
        },
        {"stiffness": Fact(400.0, CHAI3D), "damping": Fact(4.0, CHAI3D)},
    ),
    "omni": Preset(
        "SensAble PHANTOM Omni",
        {
            "mass": _remembered(0.045),
            "friction": _remembered(0.26),
            "resolution": _remembered(5.5e-5),
            "peak_force": Fact(3.3, CHAI3D),
        },
        {"stiffness": Fact(700.0, CHAI3D), "damping": Fact(5.0, CHAI3D)},
    ),
    "omega_3": Preset(
        "Force Dimension omega.3",
        {"resolution": _remembered(1e-5), "peak_force": Fact(12.0, CHAI3D)},
        {"stiffness": Fact(5000.0, CHAI3D), "damping": Fact(30.0, CHAI3D)},
    ),
    "falcon": Preset(
        "Novint Falcon",
        {"resolution": Fact(6.35e-5, H3D), "peak_force": Fact(8.9, H3D)},
        {},
    ),
    "delta_3": Preset(
        "Force Dimension delta.3", {"peak_force": Fact(20.0, CHAI3D)}, {}
    ),
}
_ARM = (("mass", 2.0), ("damping", 2.0), ("stiffness", 10.0))
# Published hands and arms: fields of `sim.device.hand.Hand`. Arm and grasp are in series: above
# some 10 Hz, where loops ring, the arm's mass hardly moves and the grasp dominates.
HANDS: dict[str, Preset] = {
    "stylus_soft": Preset(
        "grasp of a stylus, low end",
        {"damping": Fact(0.8, STYLUS), "stiffness": Fact(380.0, STYLUS)},
        {},
    ),
    "stylus_firm": Preset(
        "grasp of a stylus, high end",
        {"damping": Fact(1.8, STYLUS), "stiffness": Fact(770.0, STYLUS)},
        {},
    ),
    "arm_soft": Preset(
        "hand and arm behind that grasp, low end",
        {
            "mass": Fact(0.2, STYLUS),
            "damping": Fact(4.6, STYLUS),
            "stiffness": Fact(79.0, STYLUS),
        },
        {},
    ),
    "arm_firm": Preset(
        "hand and arm behind that grasp, high end",
        {
            "mass": Fact(0.22, STYLUS),
            "damping": Fact(18.0, STYLUS),
            "stiffness": Fact(272.0, STYLUS),
        },
        {},
    ),
    "operator": Preset(
        "arm of an operator",
        {field: Fact(value, YOKOKOHJI, remembered=True) for field, value in _ARM},
        {},
    ),
}


def preset(name: str) -> dict[str, float]:
    """Return the known values of a device."""
    if name not in PRESETS:
        raise ValueError(
            f"preset is {name!r}, expected none or one of {', '.join(PRESETS)} (haptic device"
            " presets)"
        )
    return {field: fact.value for field, fact in PRESETS[name].model.items()}


def provenance(name: str) -> str:
    """Return a line with the sources of a device's values."""
    one = PRESETS[name]
    known = [
        f"{field} {fact.value:g} ({fact.source})" for field, fact in one.model.items()
    ]
    advised = [
        f"{field} {fact.value:g} ({fact.source})" for field, fact in one.limits.items()
    ]
    return f"{one.title}: {', '.join(known)}" + (
        f"; advised, not applied: {', '.join(advised)}" if advised else ""
    )


def figures() -> list[dict[str, Any]]:
    """Return all devices and hands with their sources."""

    def facts(given: Mapping[str, Fact]) -> dict[str, Any]:
        return {field: asdict(fact) for field, fact in given.items()}

    return [
        {
            "name": name,
            "title": one.title,
            "model": facts(one.model),
            "limits": facts(one.limits),
        }
        for name, one in (PRESETS | HANDS).items()
    ]


def text() -> str:
    """Return all devices and hands as text."""
    lines = []
    for name, one in (PRESETS | HANDS).items():
        lines.append(f"{name}: {one.title}")
        for field, fact in one.model.items():
            lines.append(f"  {field:18} {fact.value:<8g} {fact.source}")
        for field, fact in one.limits.items():
            lines.append(f"  advised {field:10} {fact.value:<8g} {fact.source}")
    return "\n".join(lines)
