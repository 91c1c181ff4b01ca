"""Parameters that every driver has, whatever its device."""

from __future__ import annotations

import msgspec

from nodes.driver.device import Workspace
from nodes.driver.limits import SafetyParameters
from nodes.driver.passivity import PassivityParameters
from nodes.parameters.store import ParameterError


class DriverParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters that every driver has.

    Attributes
    ----------
    safety : SafetyParameters
        Limits; see nodes/driver/limits.py.
    passivity : PassivityParameters or None
        Passivity observer and controller after the law; see nodes/driver/passivity.py. None for none.
    """

    safety: SafetyParameters = SafetyParameters()
    passivity: PassivityParameters | None = None


def check_workspace(workspace: Workspace | None, name: str) -> None:
    """Check the workspace of a launch file before anything is started.

    Parameters
    ----------
    workspace : tuple of tuple of float, shape (3, 2), or None
        Smallest and largest coordinate of each axis [m].
    name : str
        Of the driver, for the error.

    Raises
    ------
    ParameterError
        When an axis has no inside.
    """
    for axis, (low, high) in enumerate(workspace or ()):
        if not low < high:
            raise ParameterError(
                f"{name}.safety.workspace[{axis}]: {low:g} to {high:g} m, expected low to high: outside it there is no force"
            )
