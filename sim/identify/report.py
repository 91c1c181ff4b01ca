"""An identified device told: as figures with units in the keys, as a table, and as parameters of a launch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sim.identify.identified import Estimate, HeldOut, Identified

ROWS = (
    ("mass_kg", "mass", "moving mass", "kg"),
    ("damping_n_s_per_m", "damping", "viscous damping", "N s/m"),
    ("friction_n", "friction", "Coulomb friction", "N"),
    ("delay_ticks", "delay", "delay of the loop, median", "ticks"),
    ("device_delay_ticks", "device_delay", "  of which the device's own", "ticks"),
    ("jitter_ticks", "jitter", "  its jitter (0.1 % to 99.9 %)", "ticks"),
    ("encoder_m", "encoder", "encoder step", "m"),
    ("hand_stiffness_n_per_m", "stiffness", "stiffness of a hand", "N/m"),
    ("load_n", "load", "constant load", "N"),
)
"""Key, attribute, name and unit of each parameter."""


def _told(estimate: Estimate) -> dict[str, Any]:
    told: dict[str, Any] = {"value": estimate.value, "low": estimate.low, "high": estimate.high}
    return told | ({"why": estimate.why} if estimate.why else {})


def figures(found: Identified) -> dict[str, Any]:
    """Give an identified device as figures."""
    return {
        "axis": found.axis,
        "rate_hz": 1.0 / found.period,
        **{key: _told(getattr(found, name)) for key, name, _, _ in ROWS},
        "delay_range_ticks": list(found.delay_range),
        "held": found.held,
        "residual_steps": found.residual_steps,
        "residual_m": None if math.isnan(found.residual) else found.residual,
        "refuted": found.refuted,
        "why": found.why,
        "terms": list(found.terms),
        "held_out": {
            "residual_steps": found.held_out_steps,
            "residual_m": found.held_out.residual,
            "whiteness": found.held_out.whiteness,
        },
        "windows": found.windows,
        "windows_dropped": found.dropped,
        "window_ticks": found.ticks,
    }


def from_figures(told: Mapping[str, Any]) -> Identified:
    """Read back what `figures` gave: the inverse, for a step that is run alone."""
    estimates = {
        name: Estimate(told[key]["value"], told[key]["low"], told[key]["high"], told[key].get("why", ""))
        for key, name, _, _ in ROWS
    }
    low, high = told["delay_range_ticks"]
    return Identified(
        **estimates,
        delay_range=(low, high),
        held=told["held"],
        residual=math.nan if told["residual_m"] is None else told["residual_m"],
        held_out=HeldOut(told["held_out"]["residual_m"], told["held_out"]["whiteness"]),
        dropped=told["windows_dropped"],
        windows=told["windows"],
        ticks=told["window_ticks"],
        axis=told["axis"],
        period=1.0 / told["rate_hz"],
        terms=tuple(told["terms"]),
        refuted=told["refuted"],
        why=told["why"],
    )


def text(found: Identified) -> str:
    """Give an identified device as a table."""
    lines = [f"REFUTED: {found.why}"] if found.refuted else []
    lines.append(f"axis {found.axis}, {'held by a hand' if found.held else 'free'}; 95 % intervals")
    for _, name, label, unit in ROWS:
        estimate: Estimate = getattr(found, name)
        if estimate.value is None:
            lines.append(f"  {label:30} cannot tell: {estimate.why}")
        else:
            lines.append(f"  {label:30} {estimate.value:10.5g}  ({estimate.low:.5g} to {estimate.high:.5g}) {unit}")
    steps, unseen = found.residual_steps, found.held_out.residual
    residual = f"{found.residual * 1e6:.3g} µm" + (
        "" if steps is None else f" = {steps:.3g} encoder steps (rounding: 0.29)"
    )
    held_out = "none" if unseen is None else f"{unseen * 1e6:.3g} µm"
    lines.append(
        f"  residual {residual}; in held-out windows {held_out}; {found.windows} windows of {found.ticks} ticks"
    )
    return "\n".join(lines)


def device_parameters(found: Identified) -> dict[str, Any]:
    """Describe an identified device as the sim driver's parameter ``device``."""
    mass, _, _ = found.mass.known()
    optional = {
        "damping": found.damping.value,
        "friction": found.friction.value,
        "resolution": found.encoder.value,
        "delay": found.device_delay.value,
    }
    return {"mass": mass, **{name: value for name, value in optional.items() if value is not None}}
