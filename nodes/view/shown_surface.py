"""Shape and poses of a running launch's environment, whose surface may be replaced."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from nodes.client.launches import roles
from nodes.launcher.runs import RunInfo
from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    from nodes.view.drawn_bodies import RunningBodies, RunningShapes


class ShownSurface:
    """Shape and poses of a run's environment."""

    def __init__(self, run: RunInfo) -> None:
        self.name = roles(run).get("environment", "")  # empty: the run has none
        self._setup = run.nodes.get(self.name)
        self._bodies: RunningBodies | RunningShapes | None = None
        # Parameters of the surface that is drawn; None if the environment has none.
        self.surface = self._setup.parameters.get("surface") if self._setup else None

    def shape(self, stopping: Callable[[], bool]) -> dict[str, Any]:
        """Return the launch's shape with several axes; empty for one axis."""
        setup = self._setup
        if setup is None or len(setup.axes) < 2:
            return {}
        if "scene" in setup.parameters:
            from nodes.view.drawn_bodies import RunningBodies

            # On another machine or without MuJoCo, the flat views remain.
            with contextlib.suppress(OSError, ParameterError):
                self._bodies = RunningBodies(setup, stopping)
                return self._bodies.shape
            return {}
        return self._shape_of(setup.parameters)

    def replaced(self, parameters: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the shape of a surface that replaced the drawn one; None for one axis."""
        self.surface = parameters.get("surface")
        if self._setup is None or len(self._setup.axes) < 2:
            return None
        return self._shape_of(parameters)

    def _shape_of(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Return the shape of a surface, and follow those of its parts that move."""
        from nodes.view.shape import moves, shape_of

        shape = shape_of(parameters)
        self._bodies = None
        if self._setup is not None and moves(shape):
            from nodes.view.drawn_bodies import RunningShapes

            self._bodies = RunningShapes(self._setup)
        return shape

    def poses(self) -> dict[str, Any] | None:
        """Return the present poses; None if nothing moves or they are not known yet."""
        return self._bodies.news() if self._bodies is not None else None
