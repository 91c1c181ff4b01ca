"""Parameters of nodes given to a launch: ``driver.device.mass:=0.2``.

A name with a dot is a node and the path of its parameter, as in ``haptic param set``; ``run.NAME``
is a setting of the loop. What is given replaces what the launch file, files of parameters and a
real device's known values say, and is checked as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from nodes.launcher.launch_spec import NodeSpec
from nodes.parameters.refusals import STEP, choices, short
from nodes.parameters.store import ParameterError

RUN = "run."


def is_node_parameter(name: str) -> bool:
    """Return whether the name of an assignment is a node with the path of a parameter."""
    return "." in name and not name.startswith(RUN)


def places(given: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield name, node and path of each parameter of a node among a launch's assignments."""
    for name in given:
        if is_node_parameter(name):
            node, _, path = name.partition(".")
            yield name, node, path


def with_parameters(
    nodes: Mapping[str, NodeSpec], given: Mapping[str, Any], where: str
) -> dict[str, NodeSpec]:
    """Return the nodes with the parameters that were given.

    Raises ParameterError if there is no such node, or no such place for a parameter. The node's own
    check refuses unknown names and invalid values.
    """
    found = dict(nodes)
    for name, node, path in places(given):
        if node not in found:
            raise ParameterError(
                f"{name}: no node {node!r}; {choices(node, found)}", path=where
            )
        steps = [key or int(index) for key, index in STEP.findall(path)]
        if not steps or "".join(_written(steps)) != f".{path}":
            raise ParameterError(
                f"is not a parameter's name, e.g. {node}.device.mass or {node}.axes[0]",
                path=name,
            )
        changed = _set(found[node].parameters, steps, given[name], node)
        found[node] = msgspec.structs.replace(found[node], parameters=changed)
    return found


def _written(steps: list[str | int]) -> Iterator[str]:
    for step in steps:
        yield f"[{step}]" if isinstance(step, int) else f".{step}"


def _set(tree: Any, steps: list[str | int], value: Any, where: str) -> Any:
    """Return a copy of `tree` with `value` at a place; mappings on the way there are made."""
    if not steps:
        return value
    step, *rest = steps
    here = f"{where}{''.join(_written([step]))}"
    if isinstance(step, int):
        if not isinstance(tree, list) or step >= len(tree):
            has = (
                f"has {len(tree)} entries"
                if isinstance(tree, list)
                else "is no list here"
            )
            raise ParameterError(f"{where} {has}; give it as a whole", path=here)
        return [*tree[:step], _set(tree[step], rest, value, here), *tree[step + 1 :]]
    if isinstance(tree, str) and where.rpartition(".")[0].endswith(".laws"):
        tree = {"kind": tree}  # a law by the name of a preset
    if tree is not None and not isinstance(tree, Mapping):
        raise ParameterError(
            f"{where} is {short(tree)}, which has no names below", path=here
        )
    tree = tree or {}
    return {**tree, step: _set(tree.get(step), rest, value, here)}
