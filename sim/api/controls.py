"""Parameters and laws of a running launch: read, list and change them between two ticks."""

from collections.abc import Callable, Sequence
from typing import Any

from sim.api.launch_arguments import launch_arguments
from sim.api.laws import LawLike, plain

# calls a node: (node, operation, arguments) to the answer, `sim.api.python_runs.Run.ask`
AskNode = Callable[..., Any]


class Parameters:
    """Parameters of a running launch: ``run.param["coupling.laws.pd.stiffness"] = 1500``."""

    def __init__(self, ask: AskNode, nodes: Sequence[str]) -> None:
        self._ask, self._nodes = ask, nodes

    def __getitem__(self, name: str) -> Any:
        """Read ``node.path``, or all parameters of ``node``."""
        node, _, path = name.partition(".")
        return (
            self._ask(node, "param.get", name=path)
            if path
            else self._ask(node, "param.dump")
        )

    def _ipython_key_completions_(self) -> list[str]:
        return [f"{node}.{path}" for node in self._nodes for path in self.list(node)]

    def __setitem__(self, name: str, value: Any) -> None:
        """Change one parameter; an unstable value is refused."""
        node, _, path = name.partition(".")
        self.set(node, {path: value})

    def set(
        self, node: str, values: dict[str, Any], force: bool = False
    ) -> dict[str, Any]:
        """Change a node's parameters between two ticks, all or none; return the receipt.

        The receipt holds the tick, the old and new values by path, and the force step [N]. With
        `force` a change that makes the loop unstable is accepted.
        """
        receipt: dict[str, Any] = self._ask(
            node,
            "param.set",
            values=plain(values),
            **({"force": True} if force else {}),
        )
        return receipt

    def list(self, node: str) -> dict[str, Any]:
        """Return a node's parameters by path."""
        found: dict[str, Any] = self._ask(node, "param.list")
        return found


class Laws:
    """Laws of a running launch."""

    def __init__(self, ask: AskNode) -> None:
        self._ask = ask

    def switch(
        self, law: LawLike, ramp: int | None = None, force: bool = False
    ) -> dict[str, Any]:
        """Switch the law between two ticks; return the receipt.

        The receipt holds the tick, the force step [N] and both laws. `law`: a name of `list`, or
        any law, e.g. ``haptic.PD(stiffness=800)``, which joins the list under its kind. `ramp`:
        cross-fade [ticks]; None: the coupling's own. With `force` a law that makes the loop
        unstable is accepted.
        """
        wanted: dict[str, Any] = {"force": True} if force else {}
        if ramp is not None:
            wanted["ramp"] = ramp
        named = law if isinstance(law, str) else launch_arguments({"law": law})["law"]
        receipt: dict[str, Any] = self._ask("law.switch", law=named, **wanted)
        return receipt

    def list(self) -> dict[str, dict[str, Any]]:
        """Return the laws that the coupling can switch to: name to kind and parameters."""
        found: dict[str, dict[str, Any]] = self._ask("law.list")["laws"]
        return found

    @property
    def active(self) -> str:
        """Name of the law that is rendered now."""
        return str(self._ask("law.list")["active"])
