"""Parameters and laws of a running launch: read, listed, changed between two ticks."""

from collections.abc import Callable, Sequence
from typing import Any

from sim.api.laws import plain

# from a node, an operation and its arguments to the answer: `sim.api.python_runs.Run.ask`
AskNode = Callable[..., Any]


class Parameters:
    """Parameters of a running launch: ``run.param["coupling.laws.pd.stiffness"] = 1500``."""

    def __init__(self, ask: AskNode, nodes: Sequence[str]) -> None:
        self._ask, self._nodes = ask, nodes

    def __getitem__(self, name: str) -> Any:
        """Read ``node.path``, or all parameters of ``node``."""
        node, _, path = name.partition(".")
        return self._ask(node, "param.get", name=path) if path else self._ask(node, "param.dump")

    def _ipython_key_completions_(self) -> list[str]:
        return [f"{node}.{path}" for node in self._nodes for path in self.list(node)]

    def __setitem__(self, name: str, value: Any) -> None:
        """Change one; what would be unstable is refused."""
        node, _, path = name.partition(".")
        self.set(node, {path: value})

    def set(self, node: str, values: dict[str, Any], force: bool = False) -> dict[str, Any]:
        """Change several parameters of a node between two ticks, all or nothing; gives the receipt.

        The receipt has the tick, old and new values by their path, and the force step. `force`
        takes a change with which the loop becomes unstable.
        """
        receipt: dict[str, Any] = self._ask(
            node, "param.set", values=plain(values), **({"force": True} if force else {})
        )
        return receipt

    def list(self, node: str) -> dict[str, Any]:
        """List a node's parameters: path to value."""
        found: dict[str, Any] = self._ask(node, "param.list")
        return found


class Laws:
    """Laws of a running launch."""

    def __init__(self, ask: AskNode) -> None:
        self._ask = ask

    def switch(self, law: str, ramp: int | None = None, force: bool = False) -> dict[str, Any]:
        """Switch the law between two ticks; gives the receipt: tick, force step, what was and what is rendered.

        `law`: one of `list`. `ramp`: cross-fade [ticks]; the coupling's own when left out. `force`
        takes a law with which the loop becomes unstable.
        """
        wanted: dict[str, Any] = {"force": True} if force else {}
        if ramp is not None:
            wanted["ramp"] = ramp
        receipt: dict[str, Any] = self._ask("law.switch", law=law, **wanted)
        return receipt

    def list(self) -> dict[str, dict[str, Any]]:
        """List the laws that the coupling can switch to: name to kind and parameters."""
        found: dict[str, dict[str, Any]] = self._ask("law.list")["laws"]
        return found

    @property
    def active(self) -> str:
        """Name of the law that renders now."""
        return str(self._ask("law.list")["active"])
