"""Parameters and laws of a chain for a ROS 2 graph, by their names in the project.

The graph may read all of them. It sets one, or switches the law, through the node that has it,
with that node's judgement: never in place of it, and only where the launch file allows it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from messages.errors import FORCE, HapticError
from nodes.base.node_kinds import load
from nodes.client.launches import ask
from nodes.launcher.runs import RunInfo
from nodes.laws.base import LAWS
from nodes.laws.presets import PRESETS
from nodes.parameters.describe import Description, described
from nodes.parameters.store import ParameterError, flattened
from nodes.ros2.graph import Graph, Trigger

# a service's name: ROS takes letters, digits and single underscores
_SERVICE = re.compile(r"(?!.*__)[A-Za-z][A-Za-z0-9_]*")
_BY_FORCE = "to study it anyway, use haptic param set --force"
_INT64 = 1 << 63


class ChainControl:
    """Shows a chain's parameters on a graph, and carries out what the graph asks for.

    Parameters
    ----------
    graph : Graph
        The graph.
    run : RunInfo
        The chain.
    roles : mapping
        Names of its driver, environment and coupling.
    dump : callable
        Return a node's parameters by its name, without a long wait; or raise HapticError.
    refusal : str
        Why the graph may not change anything; empty if it may.
    """

    def __init__(
        self,
        graph: Graph,
        run: RunInfo,
        roles: Mapping[str, str],
        dump: Callable[[str], Mapping[str, Any]],
        refusal: str = "",
    ) -> None:
        self._graph, self._run, self._roles = graph, run, roles
        self._dump, self._refusal = dump, refusal
        # parameters of each node, as far as it answered
        self.trees: dict[str, Any] = {}
        self._serves = graph.serve(self.change)

    def refresh(self) -> bool:
        """Read the parameters anew and show them. Return whether any is different."""
        before = dict(self.trees)
        for node in self._roles.values():
            try:
                self.trees[node] = dict(self._dump(node))
            except HapticError:
                # A node that is being restarted keeps what it had until it answers again.
                continue
        if self.trees == before:
            return False
        if self._serves:
            values = {
                # A law's numbers are as they were written; ROS tells 700 from 700.0.
                name: float(value) if self._is_number(name, value) else value
                for name, value in ros_values(self.trees).items()
            }
            self._graph.show(values, self.about)
        return True

    def offer_laws(self) -> None:
        """Offer a service for each law of the coupling; ImportError without ``std_srvs``."""
        coupling = self._roles.get("coupling", "")
        laws = self.trees.get(coupling, {}).get("laws") or {}
        if self._serves:
            self._graph.offer(
                {
                    f"law/{law}": self._switch_to(law)
                    for law in laws
                    if _SERVICE.fullmatch(law)
                }
            )

    def about(self, name: str) -> str:
        """Return meaning with unit, limits and type of a parameter."""
        found = self._described(name)
        told = found.meaning.removesuffix("."), found.limits, found.type
        return "; ".join(filter(None, told))

    def _described(self, name: str) -> Description:
        node, _, path = name.partition(".")
        target = load(self._run.nodes[node].factory).Parameters
        try:
            return described(target, self.trees[node], path, _struct_of)
        except ParameterError:  # of a kind that is not described
            return Description(type="")

    def _is_number(self, name: str, value: Any) -> bool:
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        return is_whole and self._described(name).type.startswith("number")

    def change(self, values: Mapping[str, Any]) -> str:
        """Set parameters of one node, all or none. Return why they were refused, or ""."""
        if self._refusal:
            return self._refusal
        nodes = {name.partition(".")[0] for name in values}
        if len(nodes) > 1:
            return (
                f"parameters of {' and '.join(sorted(nodes))} cannot be set at once, all or"
                " none; set those of one node at a time"
            )
        for name, value in values.items():
            if value is None:
                return f"{name}: a parameter of a node cannot be removed; set a value"
        paths = {name.partition(".")[2]: value for name, value in values.items()}
        try:
            ask(self._run, nodes.pop(), "param.set", values=paths)
        except HapticError as error:
            return _in_words_of_ros(error)
        return ""

    def _switch_to(self, law: str) -> Trigger:
        def switch() -> tuple[bool, str]:
            if self._refusal:
                return False, self._refusal
            try:
                receipt = ask(self._run, self._roles["coupling"], "law.switch", law=law)
            except HapticError as error:
                return False, _in_words_of_ros(error)
            step = receipt.get("force_step_n", 0.0)
            return True, f"{law} from tick {receipt['seq']} on, force step {step:.3g} N"

        return switch


def _in_words_of_ros(error: HapticError) -> str:
    """Return a refusal; a change by force is not for the graph."""
    ways = (_BY_FORCE if one.kind == FORCE else one.text for one in error.remedies)
    return "; ".join((error.fault, *ways))


def _struct_of(kind: str) -> type[Any] | None:
    """Return the struct of an installed law or preset; None for anything else."""
    kind = str(PRESETS.get(kind, {"kind": kind})["kind"])
    return LAWS.load(kind) if kind in LAWS.names() else None


def ros_values(trees: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters that have a ROS type, by full name.

    ROS has booleans, integers of 64 bits, numbers, texts, and lists of one of them. It has no
    empty value, and an empty list has no type.
    """
    found: dict[str, Any] = {}
    for node, tree in trees.items():
        for name, value in flattened(tree, node).items():
            given = _ros_value(value)
            if given is not None:
                found[name] = given
    return found


def _ros_value(value: Any) -> Any:
    if isinstance(value, bool | float | str):
        return value
    if isinstance(value, int):
        return value if -_INT64 <= value < _INT64 else float(value)
    if not isinstance(value, list) or not value:
        return None
    items = [_ros_value(item) for item in value]
    kinds = {type(item) for item in items}
    if kinds == {int, float}:
        return [float(item) for item in items]
    return items if len(kinds) == 1 and kinds <= {bool, int, float, str} else None
