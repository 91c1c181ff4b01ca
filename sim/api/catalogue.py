"""What is installed: scenarios and laws."""

from __future__ import annotations

from typing import Any

from nodes.launcher import launch_file
from nodes.laws import law_names
from nodes.laws.presets import preset_names


def scenarios() -> dict[str, dict[str, Any]]:
    """List the scenarios that can be launched.

    Returns
    -------
    dict of str to dict
        Name to ``summary`` and ``arguments`` with their defaults.

    Examples
    --------
    >>> scenarios()["floor_drop"]["arguments"]["stiffness"]
    1000.0
    """
    found = {}
    for name, path in launch_file.scenarios().items():
        summary, arguments = launch_file.read_arguments(path)
        found[name] = {"summary": summary, "arguments": {key: value.default for key, value in arguments.items()}}
    return found


def laws() -> list[str]:
    """List the kinds of law and the presets that `law` takes.

    Returns
    -------
    list of str
        Names.

    Examples
    --------
    >>> "pd_alpha" in laws()
    True
    """
    return [*law_names(), *preset_names()]
