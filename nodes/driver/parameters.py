"""Parameters of every driver, and their check before the launch."""

from __future__ import annotations

from typing import Any

import msgspec

from nodes.base.setup import Setup
from nodes.driver.external import ExternalParameters
from nodes.driver.limits import SafetyParameters
from nodes.driver.passivity import PassivityParameters
from nodes.parameters.store import ParameterError


class DriverParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of every driver.

    safety: Limits; see nodes/driver/limits.py.
    passivity: Passivity observer and controller after the law; see nodes/driver/passivity.py. None
        for none.
    external: Forces from outside the loop that are accepted; see nodes/driver/external.py. None for
        none.
    """

    safety: SafetyParameters = SafetyParameters()
    passivity: PassivityParameters | None = None
    external: ExternalParameters | None = None


def check(setup: Setup, parameters: Any, virtual: bool) -> None:
    """Check pace and workspace."""
    if setup.pace == "lockstep" and not virtual:
        raise ParameterError(
            "pace lockstep waits for each force, however long, which no device but a"
            " virtual one can; use realtime",
            path=setup.name,
        )
    for axis, (low, high) in enumerate(parameters.safety.workspace or ()):
        if not low < high:
            raise ParameterError(
                f"{low:g} to {high:g} m, expected low to high: outside it there is no force",
                path=f"{setup.name}.safety.workspace[{axis}]",
            )
