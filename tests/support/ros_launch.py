"""The part of ROS 2's package ``launch`` that the project's launch file uses, without ROS.

The package is on no index for this Python. Signatures and meaning are those of its documentation
(Humble to Lyrical): arguments by name, text in place of substitutions.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch


class Configuration:
    """``launch.substitutions.LaunchConfiguration``."""

    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of an argument; KeyError if it is not declared."""
        return context[self.name]


class Declared:
    """``launch.actions.DeclareLaunchArgument``."""

    def __init__(self, name: str, *, default_value: str, description: str) -> None:
        self.name, self.default, self.description = name, default_value, description


class Shutdown:
    """``launch.actions.Shutdown``."""

    def __init__(self, *, reason: str) -> None:
        self.reason = reason


class Process:
    """``launch.actions.ExecuteProcess``."""

    def __init__(
        self,
        *,
        cmd: list[str],
        name: str,
        output: str,
        sigterm_timeout: str = "5",
        on_exit: Shutdown | None = None,
    ) -> None:
        self.cmd, self.name, self.output = cmd, name, output
        self.sigterm_timeout, self.on_exit = sigterm_timeout, on_exit


class Opaque:
    """``launch.actions.OpaqueFunction``."""

    def __init__(self, *, function: Callable[..., list[Process]]) -> None:
        self.function = function


class Description:
    """``launch.LaunchDescription``."""

    def __init__(self, entities: list[Any]) -> None:
        self.entities = entities


def processes(file: Path, **given: str) -> list[Process]:
    """Return the processes that ``ros2 launch FILE name:=value …`` starts."""
    package, actions, substitutions = (
        ModuleType(name)
        for name in ("launch", "launch.actions", "launch.substitutions")
    )
    package.LaunchDescription = Description  # type: ignore[attr-defined]
    actions.DeclareLaunchArgument = Declared  # type: ignore[attr-defined]
    actions.ExecuteProcess = Process  # type: ignore[attr-defined]
    actions.OpaqueFunction = Opaque  # type: ignore[attr-defined]
    actions.Shutdown = Shutdown  # type: ignore[attr-defined]
    substitutions.LaunchConfiguration = Configuration  # type: ignore[attr-defined]
    modules = {one.__name__: one for one in (package, actions, substitutions)}
    with patch.dict(sys.modules, modules):
        described = runpy.run_path(str(file))["generate_launch_description"]()
    declared = [one for one in described.entities if isinstance(one, Declared)]
    context = {one.name: one.default for one in declared} | given
    (begun,) = (one for one in described.entities if isinstance(one, Opaque))
    return begun.function(context)
