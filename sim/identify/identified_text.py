"""An identified device as figures, as a table and as launch parameters."""

import math
from collections.abc import Mapping
from typing import Any

from sim.identify.altered import as_record, from_record
from sim.identify.identified import Estimate, Identified

# Key, attribute, name and unit of each parameter.
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
    ("quadratic_damping_n_s2_per_m2", "quadratic", "quadratic damping", "N s²/m²"),
    ("lag_s", "lag", "lag of the actuator", "s"),
    ("sensor_average", "average", "part of the sample before", "1"),
    ("mode_hz", "frequency", "second mode", "Hz"),
    ("mode_mass_share", "share", "  mass beyond its joint, part", "1"),
    ("mode_damping_ratio", "loss", "  its damping ratio", "1"),
)


USUAL_MASS = (0.001, 10.0)
"""Moving mass of haptic devices, beyond which other units were probably meant [kg]."""


def _estimate(estimate: Estimate) -> dict[str, Any]:
    record: dict[str, Any] = {
        "value": estimate.value,
        "low": estimate.low,
        "high": estimate.high,
    }
    return record | ({"why": estimate.why} if estimate.why else {})


def figures(found: Identified) -> dict[str, Any]:
    """Return an identified device as figures."""
    return {
        "axis": found.axis,
        "rate_hz": 1.0 / found.period,
        **{key: _estimate(getattr(found, name)) for key, name, _, _ in ROWS},
        "delay_range_ticks": list(found.delay_range),
        **{
            name: getattr(found, name) for name in ("held", "refuted", "why", "windows")
        },
        "residual_steps": found.steps(found.residual),
        "residual_m": None if math.isnan(found.residual) else found.residual,
        "terms": list(found.terms),
        "remainder": {
            "cause": found.remainder,
            "k_max_change": found.remainder_k_max
            if math.isfinite(found.remainder_k_max)
            else None,
            "devices": [as_record(device) for device in found.altered],
        },
        "unbelieved": {
            key: _estimate(found.unbelieved[name])
            for key, name, _, _ in ROWS
            if name in found.unbelieved
        },
        "held_out": {
            "residual_steps": found.steps(found.held_out),
            "residual_m": found.held_out,
            "whiteness": found.whiteness,
        },
        "windows_dropped": found.dropped,
        "window_ticks": found.ticks,
    }


def from_figures(record: Mapping[str, Any]) -> Identified:
    """Return the device of given figures, the inverse of `figures`."""
    estimates: dict[str, Any] = {
        name: Estimate(**record[key]) for key, name, _, _ in ROWS if key in record
    }
    low, high = record["delay_range_ticks"]
    return Identified(
        **estimates,
        **{
            name: record[name] for name in ("held", "windows", "axis", "refuted", "why")
        },
        delay_range=(low, high),
        residual=math.nan if record["residual_m"] is None else record["residual_m"],
        held_out=record["held_out"]["residual_m"],
        whiteness=record["held_out"]["whiteness"],
        dropped=record["windows_dropped"],
        ticks=record["window_ticks"],
        period=1.0 / record["rate_hz"],
        terms=tuple(record["terms"]),
        **_remainder(record.get("remainder")),
        unbelieved={
            name: Estimate(**record["unbelieved"][key])
            for key, name, _, _ in ROWS
            if key in record["unbelieved"]
        },
    )


def _remainder(record: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the fields of the remainder; none for a record of an earlier version."""
    if record is None:
        return {}
    change = record["k_max_change"]
    return {
        "remainder": record["cause"],
        "remainder_k_max": math.inf if change is None else change,
        "altered": tuple(from_record(device) for device in record.get("devices", ())),
    }


def verdict(found: Identified) -> str:
    """Return one line on whether the model holds."""
    if found.refuted:
        return f"REFUTED, nothing to design on: {found.why}"
    if found.mass.value is None:
        return f"unknown: {found.mass.why}"
    unit = unit_doubt(found.mass.value)
    model = " with ".join(
        ["a rigid device", *(" and ".join(found.terms) for _ in found.terms[:1])]
    )
    if found.remainder:
        return (
            f"holds for a design: {model}; the recording also shows {found.remainder}, which the"
            " model does not have and which may change K_max by"
            f" {100.0 * found.remainder_k_max:.2g} %{unit}"
        )
    return f"holds: {model} leaves only noise in held-out windows{unit}"


def unit_doubt(mass: float) -> str:
    """Return a question about units for a mass [kg] that no haptic device has, or nothing.

    Another unit changes every figure alike, so that the model holds all the same.
    """
    low, high = USUAL_MASS
    if low <= mass <= high:
        return ""
    return (
        f"; but its mass of {mass:.3g} kg is none of a haptic device ({low:g} to {high:g} kg): are"
        " the positions in metres, the forces in newtons, and the rate right?"
    )


def text(found: Identified) -> str:
    """Return an identified device as a table, the verdict first."""
    lines = [
        verdict(found),
        f"axis {found.axis}, {'held by a hand' if found.held else 'free'}; 95 % intervals",
    ]
    for _, name, label, unit in ROWS:
        estimate: Estimate = getattr(found, name)
        if (
            name in ("share", "loss", *(("frequency",) if found.refuted else ()))
            and estimate.value is None
        ):
            continue
        if name in found.unbelieved:
            fitted = found.unbelieved[name].value
            by = "" if fitted is None else f" ({fitted:.5g} by the refuted model)"
            lines.append(f"  {label:30} not believed{by}")
        elif estimate.value is None:
            lines.append(f"  {label:30} unknown: {estimate.why}")
        elif name == "average" and estimate.value == 0.0:
            continue
        elif name in ("quadratic", "lag") and estimate.value == 0.0:
            lines.append(
                f"  {label:30} none seen; below {estimate.high:.2g} {unit} it would not show"
            )
        else:
            lines.append(
                f"  {label:30} {estimate.value:10.5g}  ({estimate.low:.5g} to {estimate.high:.5g})"
                f" {unit}"
            )
    steps, unseen = found.steps(found.residual), found.held_out
    residual = f"{found.residual * 1e6:.3g} µm" + (
        "" if steps is None else f" = {steps:.3g} encoder steps (rounding: 0.29)"
    )
    held_out = "none" if unseen is None else f"{unseen * 1e6:.3g} µm"
    left_out = (
        f", {found.dropped} left out: disturbed by a stall or a knock"
        if found.dropped
        else ""
    )
    windows = f"{found.windows} windows of {found.ticks} ticks{left_out}"
    lines.append(f"  residual {residual}; in held-out windows {held_out}; {windows}")
    return "\n".join(lines)


def device_parameters(found: Identified) -> dict[str, Any]:
    """Return the parameter ``device`` of a sim driver for an identified device."""
    mass, _, _ = found.mass.known()
    optional = {
        "damping": found.damping,
        "friction": found.friction,
        "resolution": found.encoder,
        "delay": found.device_delay,
    }
    return {
        "mass": mass,
        **{name: one.value for name, one in optional.items() if one.value is not None},
    }
