"""Checks of the contract of devices, compared with the table in nodes/driver/DEVICES.md."""

from __future__ import annotations

import ast
from pathlib import Path

CALLS = {
    "touch_driver": (
        *(
            "hdInitDevice",
            "hdEnable",
            "hdDisable",
            "hdGetDoublev",
            "hdGetIntegerv",
            "hdGetString",
            "hdSetDoublev",
        ),
        *(
            "hdSetSchedulerRate",
            "hdScheduleAsynchronous",
            "hdStartScheduler",
            "hdCheckCalibration",
            "hdUpdateCalibration",
        ),
    ),
    "force_dimension_driver": (
        *(
            "dhdOpenID",
            "dhdClose",
            "dhdStop",
            "dhdGetSerialNumber",
            "dhdGetSystemName",
            "dhdGetVersionStr",
            "dhdGetStatus",
        ),
        *(
            "dhdEnableForce",
            "dhdSetGravityCompensation",
            "dhdSetEffectorMass",
            "dhdSetBaseAngleXDeg",
            "dhdGetMaxForce",
        ),
        *(
            "dhdEnableExpertMode",
            "dhdSetWatchdog",
            "dhdGetPosition",
            "dhdGetLinearVelocity",
            "dhdGetOrientationFrame",
        ),
        *("dhdGetGripperGap", "dhdHasWrist", "dhdGetButtonMask", "dhdSetForce"),
    ),
    "inverse3_driver": ("session", "state"),
}
"""What of the vendor's may fail, each by itself."""


def checks(path: Path) -> set[str]:
    """Name what a file of tests checks of a device, as the page does."""
    return {
        one.name.removeprefix("test_").replace("_", " ")
        for one in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(one, ast.FunctionDef)
        and one.name.startswith("test_")
        and [argument.arg for argument in one.args.args][:1] in (["stand"], ["virtual"])
    }
