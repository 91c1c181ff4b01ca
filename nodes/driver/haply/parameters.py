"""Parameters of a Haply Inverse3 and of its driver node."""

from __future__ import annotations

from typing import Annotated

import msgspec

from nodes.driver.device import Workspace
from nodes.driver.hardware.mailbox import HardwareParameters, ServoParameters


class Inverse3Parameters(
    ServoParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the device.

    serial: Its identifier in the service (``device_id``); empty for the first one.
    host: Host of the service.
    port, events_port: Port of its WebSocket, and of its events; 0 for no events.
    start_time: Longest wait for the service and the device [s]: a cold start takes up to 25.
    peak_force: Largest force along an axis [N], which the service does not report.
    continuous_force: Largest lasting force [N].
    workspace: Workspace along its own axes [m].
    """

    serial: str = ""
    host: str = "localhost"
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 10001
    events_port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 10020
    start_time: Annotated[float, msgspec.Meta(ge=0.0, le=120.0)] = 30.0
    peak_force: Annotated[float, msgspec.Meta(gt=0.0, le=20.0)] = 8.0
    continuous_force: Annotated[float, msgspec.Meta(gt=0.0, le=20.0)] = 3.0
    workspace: Workspace = ((-0.35, 0.35), (-0.35, 0.35), (-0.35, 0.35))


class Inverse3DriverParameters(
    HardwareParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the driver node.

    inverse3: The device.
    """

    inverse3: Inverse3Parameters = Inverse3Parameters()
