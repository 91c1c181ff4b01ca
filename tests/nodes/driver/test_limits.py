"""The driver's limits: the lower of device and launch file; invalid parameters."""

from __future__ import annotations

import math
from typing import Any

import pytest

from nodes.base.setup import Setup
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import STOP_TIME, SafetyParameters, lower
from nodes.driver.node import Driver
from nodes.parameters.store import ParameterError, convert
from tests.support.safety import Port, T
from tests.support.setups import setup_of

# -- the device's limits
# ----------------------------------------------------------------------------------------------

TOUCH = DeviceLimits(
    peak_force=7.9,
    continuous_force=1.75,
    slew=2000.0,
    silence=0.05,
    workspace=((-0.08, 0.08), (-0.06, 0.06), (-0.06, 0.06)),
)


def test_no_launch_file_raises_a_limit_of_the_device_and_each_attempt_is_told() -> None:
    greedy = SafetyParameters(
        peak_force=20.0,
        continuous_force=10.0,
        slew=1e6,
        watchdog=10_000,
        damping_ticks=1000,
        max_age=500,
        workspace=((-1.0, 1.0), (-0.01, 0.01), (-0.06, 0.07)),
    )
    limits = lower(greedy, TOUCH, T, "driver.safety")
    assert (limits.peak, limits.continuous, limits.slew) == (7.9, 1.75, 2000.0 * T)
    assert (limits.watchdog, limits.damping_ticks, limits.max_age) == (25, 25, 25)
    assert limits.workspace == ((-0.08, 0.08), (-0.01, 0.01), (-0.06, 0.06))
    assert [
        text.split(":")[0].removeprefix("driver.safety.") for text in limits.overruled
    ] == [
        "peak_force",
        "slew",
        "watchdog",
        "damping_ticks",
        "max_age",
        "workspace[0]",
        "workspace[2]",
        "continuous_force",
    ]
    assert (
        limits.overruled[0]
        == "driver.safety.peak_force: 20 N, limit 7.9 N of the device, which holds"
    )
    assert Port(TOUCH, peak_force=20.0).limits.overruled == (
        "safety.peak_force: 20 N, limit 7.9 N of the device, which holds",
    )


def test_a_modest_launch_file_lowers_the_limits_and_nothing_is_told() -> None:
    modest = SafetyParameters(
        peak_force=7.9, continuous_force=1.0, slew=2000.0, watchdog=25, damping_ticks=5
    )
    limits = lower(modest, TOUCH, T)
    assert (limits.peak, limits.continuous, limits.watchdog, limits.overruled) == (
        7.9,
        1.0,
        25,
        (),
    )
    # Left out, the device's own limits hold.
    limits = lower(SafetyParameters(damping_ticks=25), TOUCH, T)
    assert (limits.peak, limits.continuous, limits.slew) == (7.9, 1.75, 2000.0 * T)


def test_a_slew_too_slow_to_stop_in_time_lowers_the_peak() -> None:
    limits = lower(SafetyParameters(slew=2.0, peak_force=3.0), DeviceLimits(), T)
    assert (limits.peak, limits.overruled) == (
        3.0,
        (),
    )  # 3 N at 2 N/s is exactly STOP_TIME
    limits = lower(SafetyParameters(slew=2.0, peak_force=3.01), DeviceLimits(), T)
    assert limits.peak == 2.0 * STOP_TIME
    assert limits.overruled[0].startswith("safety.slew: 2 N/s takes")


@pytest.mark.parametrize(
    ("data", "path"),
    [
        ({"watchdog": 0}, "driver.safety.watchdog"),
        ({"peak_force": 0.0}, "driver.safety.peak_force"),
        ({"peak_force": -1.0}, "driver.safety.peak_force"),
        ({"slew": math.inf}, "driver.safety.slew"),
        ({"ramp": math.nan}, "driver.safety.ramp"),
        ({"workspace": [[0, 1], [0, 1]]}, "driver.safety.workspace"),
        ({"max_peak": 3.0}, "driver.safety"),
        # More than there is room for was cut, and nothing said so.
        ({"stop_after": 65}, "driver.safety.stop_after"),
    ],
)
def test_parameters_that_make_no_sense_are_refused_by_path(
    data: dict[str, Any], path: str
) -> None:
    with pytest.raises(ParameterError, match=rf"^{path}".replace(".", r"\.")):
        convert(data, SafetyParameters, "driver.safety")


def test_an_empty_workspace_is_refused_before_anything_is_started() -> None:
    def setup(high: float) -> Setup:
        return setup_of(
            name="arm",
            kind="driver",
            factory="nodes.driver.node:Driver",
            period=T,
            parameters={
                "safety": {"workspace": [[-1.0, 1.0], [-1.0, 1.0], [0.0, high]]}
            },
        )

    Driver.check(setup(1e-3))
    with pytest.raises(
        ParameterError, match=r"^arm\.safety\.workspace\[2\]: 0 to 0 m, .*low to high"
    ):
        Driver.check(setup(0.0))


def test_a_device_that_exists_is_not_made_to_wait() -> None:
    setup = setup_of(name="arm", kind="driver", period=T, pace="lockstep")
    with pytest.raises(
        ParameterError, match=r"^arm: pace lockstep waits for each force, however long"
    ):
        Driver.check(setup)
