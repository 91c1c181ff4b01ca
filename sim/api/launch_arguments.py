"""Arguments and parameters of a launch from Python, as YAML has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from messages.errors import UsageError
from nodes.laws import CompiledLaw
from sim.api.laws import law, plain


def launch_arguments(
    given: Mapping[str, Any], params: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the arguments of a launch file as YAML has them.

    Parameters
    ----------
    given : mapping of str to object
        Arguments; ``law`` may be any law, a text is the name of one.
    params : mapping of str to object, optional
        Parameters of nodes: ``{"driver.device.mass": 0.2}`` or ``{"driver": {"device": {"mass":
        0.2}}}``. A mapping with a ``kind`` replaces a surface or law as a whole.

    Returns
    -------
    dict of str to object
        Name to value, e.g. ``stiffness`` or ``driver.device.mass``.
    """
    if not isinstance(params, Mapping | None):
        raise UsageError(
            f"params: expected a mapping, e.g. {{'driver.device.mass': 0.2}}, got {params!r:.80}"
        )
    found = {**given, **dict(_flat(params or {}, ""))}
    if not isinstance(named := found.get("law", ""), str | CompiledLaw):
        found["law"] = law(named)
    return plain(found)


def _flat(tree: Mapping[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        place = f"{path}.{name}" if path else str(name)
        if isinstance(value, Mapping) and value and "kind" not in value:
            yield from _flat(value, place)
        else:
            yield place, value


def left_out(without: str | Sequence[str]) -> list[str]:
    """Return the names of the nodes to leave out; a text is one name."""
    names = [without] if isinstance(without, str) else list(without)
    for name in names:
        if not isinstance(name, str):
            raise UsageError(
                f"without: expected names of nodes, e.g. ['logger'], got {name!r:.80}"
            )
    return names
