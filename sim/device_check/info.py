"""Facts of a device: its own data, limits in the scene, and its inertia's limit of a wall."""

import math
from typing import Any

import msgspec

from messages.errors import RefusedError
from nodes.driver.hardware.inertia import masses_along
from nodes.driver.hardware.mailbox import MailboxDevice
from nodes.laws.parse import parse_law
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant


def info(
    device: MailboxDevice, rate: float, delay: float, damping: float
) -> dict[str, Any]:
    """Connect to a device without forces; return facts, limits, inertia and PD's K_max."""
    try:
        device.connect()
        device.identify()
        inertia = device.inertia()
    except OSError as error:
        raise RefusedError(str(error)) from error
    finally:
        device.close()
    report: dict[str, Any] = {
        "facts": device.facts,
        "limits": {
            name: value
            if not isinstance(value, float) or math.isfinite(value)
            else None
            for name, value in msgspec.to_builtins(device.limits).items()
        },
        "inertia_kg": inertia and [list(row) for row in inertia],
        "edge": None,
    }
    if inertia is not None:
        law = without_spring(
            parse_law({"kind": "pd", "stiffness": 1.0, "damping": damping}, "pd"),
            1.0 / rate,
        )
        edges = []
        try:
            masses, (least, greatest) = masses_along(inertia)
        except ValueError as error:
            raise RefusedError(f"{device.TITLE}: {error}") from error
        for mass in masses:
            plant = Plant(period=1.0 / rate, mass=mass, damping=0.0, delay=delay)
            edges.append(
                {"mass_kg": mass, "k_max_n_per_m": k_max(law, plant).k_max_n_per_m}
            )
        report["edge"] = {
            "rate_hz": rate,
            "delay_ticks": delay,
            "damping_n_s_per_m": damping,
            "axes": edges,
        }
        report["edge"] |= {
            "least_kg": least,
            "greatest_kg": greatest,
            "scale": device.parameters.mapping.scale,
        }
    return report


def text(report: dict[str, Any]) -> str:
    """Return the report as text."""
    lines = [f"  {name}: {value}" for name, value in report["facts"].items()]
    limits = report["limits"]
    lines.append(
        f"  peak force {limits['peak_force']} N, {limits['continuous_force']} N continuous; "
        f"holds a force for {limits['hold']} s"
    )
    lines += [
        f"  {axis}: {low:.3g} to {high:.3g} m"
        for axis, (low, high) in zip("xyz", limits["workspace"], strict=True)
    ]
    if (edge := report["edge"]) is not None:
        lines.append(
            "  inertia at its position, and the largest stable stiffness of PD, B ="
            f" {edge['damping_n_s_per_m']:g} N s/m, at {edge['rate_hz']:g} Hz, delay"
            f" {edge['delay_ticks']:g} ticks, without damping of the device:"
        )
        lines += [
            f"    {axis}: {one['mass_kg']:.4g} kg, "
            + (
                "no stable stiffness"
                if one["k_max_n_per_m"] is None
                else f"{one['k_max_n_per_m']:.4g} N/m"
            )
            for axis, one in zip("xyz", edge["axes"], strict=True)
        ]
        lines.append(
            f"    any direction: {edge['least_kg']:.4g} to {edge['greatest_kg']:.4g} kg here; other"
            " poses have others"
        )
        # The scene moves the device's own mass divided by the square of the scale.
        least, greatest = (
            edge[name] * edge["scale"] ** 2 for name in ("least_kg", "greatest_kg")
        )
        heaviest = f", heaviest: {greatest:.4g}" if greatest > least else ""
        lines.append(
            f"  for a launch file: plant: {{mass: {least:.4g}{heaviest}, damping: 0.0}}"
        )
    return "\n".join(lines)
