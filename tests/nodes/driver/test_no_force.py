"""Why no force is felt: in the device's words, in events, node info, and on the page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from messages.types import DeviceState
from nodes.cli.status_line import ORDER, fitted
from nodes.driver.force_words import explain, why_no_force
from nodes.driver.state import ACTIVE, FAULT, IDLE, STOPPED, DriverState
from tests.support.devices import SOFT, bench, needs_cc, through
from tests.support.launching import running, wait_for


@pytest.mark.slow
@needs_cc
def test_a_force_button_that_is_off_is_told_while_the_law_pushes(
    tmp_path: Path,
) -> None:
    with bench("force_dimension_driver", tmp_path) as stand:
        stand.world.state.position[2] = -0.002  # held in the floor
        with running(
            tmp_path, through(stand, tmp_path), *SOFT, "duration:=0"
        ) as launch:

            def told() -> str:
                info = json.loads(
                    launch.haptic(
                        "node", "info", "driver", "--json"
                    ).stdout.splitlines()[-1]
                )
                return str(info["force"]["why"])

            wait_for(lambda: "N are handed to the device" in told(), "a force")
            # A clutch of buttons, and the handle's orientation, go beside the loop.
            stand.world.state.buttons = 5
            stand.world.state.cause = 1
            wait_for(
                lambda: "FORCE button is off: press it" in told(),
                "the device's own reason",
            )
            wait_for(
                lambda: (
                    "device_force: the device's FORCE button is off" in launch.errors
                ),
                "the event",
            )
            # What a launch's status line is made of.
            assert (
                "FORCE button is off" in launch.call("driver", "progress")["condition"]
            )
            stand.world.state.cause = 0
            wait_for(
                lambda: "the device applies forces again" in launch.errors,
                "the end of it",
            )
            echoed = launch.haptic(
                "topic", "echo", "/device/handle", "--once", "--json"
            ).stdout
            assert '"buttons":5' in echoed.replace(" ", "")


@pytest.mark.parametrize(
    ("safety", "words"),
    [
        (IDLE, "does it run"),
        (FAULT, "outside its workspace"),
        (STOPPED, "rearm"),
        (ACTIVE, "nothing is touched"),
    ],
)
def test_every_state_of_the_driver_has_words(safety: int, words: str) -> None:
    s = DriverState()
    s.ticks, s.safety, s.axes = 1, safety, 1
    assert words in why_no_force(s)
    assert why_no_force(s, "press it") == "press it"


CAUSES = {
    1: "FORCE button is off",
    2: "moved faster than the device allows and it braked",
    3: "its watchdog cut the forces",
    4: "forces are not enabled",
    5: "the USB connection was cut",
    6: "nobody holds its dead-man's switch",
    9: "forces are off (cause 9)",
}


@pytest.mark.parametrize("cause", CAUSES)
def test_every_cause_of_a_device_is_told_in_the_same_words_everywhere(
    cause: int, tmp_path: Path
) -> None:
    with bench("force_dimension_driver", tmp_path) as stand:
        device = stand.device()
        device.connect()
        device.open()
        wait_for(lambda: device.condition() == "", "nothing keeps forces off")
        stand.world.state.cause = cause
        wait_for(lambda: CAUSES[cause] in device.condition(), "its own status")
        words = device.condition()
        # Of these, `haptic node info`, the page and a launch's status line are made.
        s = DriverState()
        s.ticks, s.safety, s.axes = 1, ACTIVE, 1
        assert why_no_force(s, words) == words
        state = DeviceState(
            seq=1, stamp=0.0, position=(0.0, 0.0, 0.0), force=(0.0, 0.0, 1.0)
        )
        assert words in explain(state, None, None, 0.0, device=words)[1]
        parts = dict.fromkeys(ORDER, "x" * 10) | {"device": words}
        assert "device" in fitted(parts, 120)
        assert "device" not in fitted(parts | {"device": ""}, 120)


def test_limits_and_axes_that_keep_a_force_away_are_told() -> None:
    s = DriverState()
    s.ticks, s.safety, s.axes, s.axis[:] = 1, ACTIVE, 1, (2, 0, 0)
    assert "along x and y the scene computes nothing" in why_no_force(s)
    assert "needs a mapping, or the device a re-centre" in why_no_force(s)
    s.force[2], s.limited_by[0] = 1.0, 7
    assert (
        why_no_force(s)
        == "(0, 0, 1) N are handed to the device; its limits held 7 of them back"
    )


def test_the_page_says_what_the_device_says() -> None:
    state = DeviceState(
        seq=1, stamp=0.0, position=(0.0, 0.0, 0.0), force=(0.0, 0.0, 1.0)
    )
    assert explain(state, None, None, 0.0, device="nobody holds it") == (
        "stop",
        "No force, or another one: nobody holds it.",
    )
