"""Fill in the plant of each coupling from the parameters of the other nodes.

A coupling judges its laws on ``plant``. Facts that other nodes of its chain know
(`nodes.base.node.Node.plant`: the mass of a virtual device, a driver's scale, the mass of a scene's
tool) are filled in if the launch file omits them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Effect
from nodes.coupling.parameters import LONGEST_DELAY
from nodes.launcher.launch_spec import Launch
from nodes.parameters.store import ParameterError

_PLANT = "plant"
# Default values of the fields.
_OF_PARTNERS = (
    "tool_damping",
    "tool_stiffness",
    "partner_damping",
    "partner_stiffness",
    "partner_later",
)
_USUAL = {
    "damping": 0.0,
    "stiffness": 0.0,
    "device_delay": 0.0,
    "scale": 1.0,
    **dict.fromkeys(_OF_PARTNERS, 0.0),
}
# significant digits, so that 0.1 kg plus a hand of 0.05 kg is exactly 0.15 kg
_DIGITS = 12


def has_plant(kind: type[Node]) -> bool:
    """Whether nodes of a kind judge their output on a plant."""
    return _PLANT in kind.Parameters.__struct_fields__


def known_plant(launch: Launch, namespace: str) -> dict[str, float]:
    """Return the plant's fields known to a chain's nodes; later nodes take precedence."""
    kinds = node_kinds()
    axes = launch.axes.get(namespace) or launch.run.axes
    found: dict[str, float] = {}
    for name, spec in launch.nodes.items():
        if name.rpartition("/")[0] == namespace:
            found |= load(kinds[spec.kind]).plant(spec.parameters, name, axes)
    return {field: float(f"{value:.{_DIGITS}g}") for field, value in found.items()}


def known_effects(launch: Launch, namespace: str) -> list[Effect]:
    """Return what a chain's environment does to a law (`nodes.base.node.Node.effects`)."""
    kinds = node_kinds()
    return [
        effect
        for name, spec in launch.nodes.items()
        if name.rpartition("/")[0] == namespace
        for effect in load(kinds[spec.kind]).effects(spec.parameters, name)
    ]


def known_peak(launch: Launch, namespace: str) -> float | None:
    """Return a chain's largest force along an axis [N]; None if no parameter limits it."""
    kinds = node_kinds()
    period = launch.run.period
    inside = [
        (name, spec)
        for name, spec in launch.nodes.items()
        if name.rpartition("/")[0] == namespace
    ]
    found = [
        load(kinds[spec.kind]).largest_force(spec.parameters, name, period)
        for name, spec in inside
    ]
    return min((peak for peak in found if peak is not None), default=None)


def with_plants(launch: Launch) -> Launch:
    """Return the launch with each coupling's plant filled in; ``plant: null`` is unchanged.

    Raises ParameterError if a node's parameters describe no device, or one with a delay beyond the
    range in which laws are judged.
    """
    kinds = node_kinds()
    nodes = dict(launch.nodes)
    for name, spec in launch.nodes.items():
        written: Any = spec.parameters.get(_PLANT, {})
        if not (has_plant(load(kinds[spec.kind])) and isinstance(written, Mapping)):
            continue
        known = known_plant(launch, name.rpartition("/")[0])
        if (late := known.get("device_delay", 0.0)) > LONGEST_DELAY:
            raise ParameterError(
                f"the device answers {late:g} ticks late, limit"
                f" {LONGEST_DELAY:g}; laws cannot be judged beyond it. Shorten the device's delay,"
                f" or set {name}.plant to null",
                path=f"{name}.plant.device_delay",
            )
        telling = {
            field: value for field, value in known.items() if value != _USUAL.get(field)
        }
        whole = {**telling, **written}
        if written or "mass" in whole:
            nodes[name] = msgspec.structs.replace(
                spec, parameters={**spec.parameters, _PLANT: whole}
            )
    return msgspec.structs.replace(launch, nodes=nodes)
