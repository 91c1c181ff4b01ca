"""Presets: named laws, published and designed, usable wherever a law's kind is.

A preset is a kind with most parameters filled in. Parameters given beside the name replace the
preset's, so ``{kind: paper_optimum, stiffness: 800}`` is the paper's optimum on another spring.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        # Paper, end of its section on the optimum: A = [1.69, 1.32], α = [1.50, 3.47]. The
        # normalisation (f(ω_N) = 1 per term) and n = 3 are inferred from the flatness of f
        # (THEORY.md §2); the paper prints neither. K and B are our choice.
        "paper_optimum": {
            "kind": "multi_term",
            "stiffness": 1000.0,
            "damping": 3.0,
            "terms": [{"gain": 1.69, "order": 1.50}, {"gain": 1.32, "order": 3.47}],
            "taps": 4,
            "gains": "paper",
        },
        # haptic study design --delay 0..0.5: 50 to 200 g, b = 1 N s/m, 500 Hz, pole radius <= 0.99,
        # |H(-1)| <= 1e4 N/m. For apply: on_arrival, where a force arrives within half a tick. H(1)
        # is 3736 N/m; the best PD under the same constraints has 2813 N/m.
        "designed_d0": {
            "kind": "fir",
            "taps": [10007.78, -6048.18, -3158.42, 2934.69],
            "period": 0.002,
        },
        # haptic study design --delay 1: the same for apply: next_tick. H(1) is 2396 N/m; the best
        # PD has 1836 N/m. The search ends within 1 % of the optimum (sim/README.md).
        "designed_d1": {
            "kind": "fir",
            "taps": [9329.46, -7062.28, -3142.96, 3271.69],
            "period": 0.002,
        },
        # haptic study design --for any_hand --delay 0, 1, 1.5, 2 --taps 1, 5, 4, 6: stable for any
        # hand, of any mass, and any passive world that answers within the tick, on a device with b
        # = 1 N s/m at 500 Hz (THEORY.md §20). H(1) is 999.9, 469.4, 383.8 and 310.5 N/m; PD has
        # 1000, 384.9, 305.5 and 241.7, and no causal linear law more than 1000, 500, 400 and 333.3.
        "any_hand_d0": {"kind": "fir", "taps": [999.9], "period": 0.002},
        "any_hand_d1": {
            "kind": "fir",
            "taps": [817.72, -563.45, 318.06, -133.14, 30.19],
            "period": 0.002,
        },
        "any_hand_d1_5": {
            "kind": "fir",
            "taps": [869.87, -745.55, 321.9, -62.46],
            "period": 0.002,
        },
        "any_hand_d2": {
            "kind": "fir",
            "taps": [767.83, -598.83, 1.88, 288.71, -195.69, 46.6],
            "period": 0.002,
        },
    }
)
"""Preset name to parameters, including the law's kind."""


def preset_names() -> list[str]:
    """Return the sorted names of the presets."""
    return sorted(PRESETS)


def expand(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a law's mapping with a preset's name replaced by its parameters."""
    preset = PRESETS.get(data["kind"]) if isinstance(data.get("kind"), str) else None
    if preset is None:
        return dict(data)
    return {**preset, **{key: value for key, value in data.items() if key != "kind"}}
