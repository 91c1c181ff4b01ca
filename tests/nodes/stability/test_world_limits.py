"""Which worlds are asked for, and their figures as data."""

from __future__ import annotations

import math

from nodes.stability.world_limits import Moving, WorldLimits, finite
from nodes.stability.worlds import (
    AnyWorld,
    EulerTool,
    OtherDevice,
    Springs,
    SteppedTool,
)
from nodes.stability.worst_world import WorstWorld


def test_each_kind_of_world_is_asked_for_by_its_name() -> None:
    """A figure with any hand says so; a wall is an infinitely stiff spring."""
    always = {
        "wall": (Springs(math.inf, math.inf), False),
        "any_world": (AnyWorld(), False),
        "any_hand_any_world": (AnyWorld(), True),
    }
    assert Moving().asked() == always
    other = OtherDevice(1.0, 0.5)
    assert Moving((10.0, 20.0), 2.0, 0.3, other).asked() == {
        **always,
        "springs": (Springs(10.0, 20.0), False),
        "tool_any_world": (SteppedTool(2.0), False),
        "any_hand_tool_any_world": (SteppedTool(2.0), True),
        "euler_tool_any_world": (EulerTool(0.3), False),
        "two_hands": (other, True),
    }


def test_what_is_unlimited_or_not_certified_has_no_number() -> None:
    worst = WorstWorld(0.5, None, None, 12.0, "lossless", 100.0)
    limits = WorldLimits(
        {"wall": 900.0, "any_world": math.inf, "springs": None}, {"wall": "a"}, worst
    )
    assert limits.as_json() == {
        "k_max_wall_n_per_m": 900.0,
        "k_max_any_world_n_per_m": None,
        "k_max_springs_n_per_m": None,
        "worst_world": {
            "mass_kg": 0.5,
            "stiffness_n_per_m": None,
            "damping_n_s_per_m": None,
            "frequency_hz": 12.0,
            "integrator": "lossless",
        },
        "about": {"wall": "a"},
        "unlimited": ["any_world"],
    }
    nothing = WorldLimits({}, {})
    assert nothing.as_json() == {"worst_world": None, "about": {}, "unlimited": []}
    assert [finite(one) for one in (1.5, None, math.inf, math.nan)] == [
        1.5,
        *[None] * 3,
    ]
