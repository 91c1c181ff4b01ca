"""Changing a running device: the coupling judges its law first, then the driver changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from messages.errors import SIDES, HapticError, Remedy
from nodes.base.node_kinds import drives, load
from nodes.launcher.plants import has_plant
from nodes.launcher.runs import RunInfo

# driver parameter to parameter of the plant
FIELDS: Final = {"device.delay": "device_delay", "mapping.scale": "scale"}


def is_moved(run: RunInfo, node: str, values: object) -> bool:
    """Return whether setting `values` of a `node` changes a device on which laws are judged."""
    if not (isinstance(values, Mapping) and FIELDS.keys() & values.keys()):
        return False
    return drives(load(run.nodes[node].factory)) and bool(_coupling(run, node))


def _coupling(run: RunInfo, driver: str) -> str:
    """Return the node of the driver's chain that judges laws on a plant, or ""."""
    namespace = driver.rpartition("/")[0]
    inside = (
        name
        for name, setup in run.nodes.items()
        if name.rpartition("/")[0] == namespace and has_plant(load(setup.factory))
    )
    return next(inside, "")


def moved_delay(declared: float, new: float, before: float) -> float:
    """Return a plant's ``device_delay`` after the device's own delay changed [ticks].

    What the plant adds to the device's own delay is kept.
    """
    return max(0.0, round(declared + new - before, 9))


def _of_driver(
    one: Remedy, driver: str, named: Mapping[str, str], added: Mapping[str, float]
) -> Remedy:
    """Return a way out that names a plant's parameter as one of the driver's.

    `named` has the driver's parameter for each of the plant; `added`, by which the plant's value is
    larger.
    """
    if one.kind not in SIDES or not one.values.keys() <= named.keys():
        return one
    ((path, value),) = one.values.items()
    name = named[path]
    own = max(0.0, round(value - added.get(name, 0.0), 9))
    return Remedy.end(one.kind, f"{driver}.{name}", own)


def set_moved(
    run: RunInfo,
    driver: str,
    values: Mapping[str, Any],
    ask: Callable[..., Any],
    force: bool,
) -> Any:
    """Set `values` of a driver as `set_device` does, with the coupling of its chain."""
    return set_device(_coupling(run, driver), driver, values, ask, force)


def set_device(
    coupling: str,
    driver: str,
    values: Mapping[str, Any],
    ask: Callable[..., Any],
    force: bool,
) -> Any:
    """Set `values` of a driver and return its receipt; `ask` sends a request to a node.

    Raises
    ------
    HapticError
        Raised by `ask`, if the law would be unstable on that device or the driver refuses; then
        both are unchanged.
    """
    plant = ask(coupling, "param.get", name="plant")
    forced = {"force": True} if force else {}
    if plant is None:
        return ask(driver, "param.set", values=values, **forced)
    wanted = {}
    for name in FIELDS.keys() & values.keys():
        field, new = FIELDS[name], values[name]
        if not isinstance(new, int | float):
            continue
        if field == "device_delay":
            new = moved_delay(
                plant[field], new, before=ask(driver, "param.get", name=name)
            )
        wanted[f"plant.{field}"] = max(0.0, round(new, 9))
    declared = {path: plant[path.removeprefix("plant.")] for path in wanted}
    if wanted:
        try:
            ask(coupling, "param.set", values=wanted, **forced)
        except HapticError as error:
            named = {f"{coupling}.plant.{FIELDS[name]}": name for name in FIELDS}
            added = {
                name: wanted[f"plant.{FIELDS[name]}"] - values[name]
                for name in values
                if f"plant.{FIELDS.get(name)}" in wanted
            }
            error.remedies = tuple(
                _of_driver(one, driver, named, added) for one in error.remedies
            )
            raise
    try:
        return ask(driver, "param.set", values=values, **forced)
    except HapticError:
        if wanted:
            ask(coupling, "param.set", values=declared, force=True)
        raise
