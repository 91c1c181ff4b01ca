"""The question why no force is felt is answered: in the device's words, in events, in `haptic node info`, and on the page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from messages.types import DeviceState
from nodes.driver.no_force import why_no_force
from nodes.driver.state import ACTIVE, FAULT, IDLE, STOPPED, DriverState
from nodes.view.why_force import explain
from tests.nodes.driver.test_touch import needs_cc
from tests.sim.test_stand_ins import SOFT, through
from tests.support.devices import bench
from tests.support.launching import running, wait_for


@needs_cc
def test_a_force_button_that_is_off_is_told_while_the_law_pushes(tmp_path: Path) -> None:
    with bench("force_dimension_driver", tmp_path) as stand:
        stand.world.state.position[2] = -0.002  # held in the floor
        with running(tmp_path, through(stand, tmp_path), *SOFT, "duration:=0") as launch:

            def told() -> str:
                info = json.loads(launch.haptic("node", "info", "driver", "--json").stdout.splitlines()[-1])
                return str(info["force"]["why"])

            wait_for(lambda: "N are handed to the device" in told(), "a force")
            # A clutch of buttons, and the handle's orientation, go beside the loop.
            stand.world.state.buttons = 5
            stand.world.state.cause = 1
            wait_for(lambda: "FORCE button is off: press it" in told(), "the device's own reason")
            wait_for(lambda: "device_force: the device's FORCE button is off" in launch.errors, "the event")
            stand.world.state.cause = 0
            wait_for(lambda: "nothing keeps forces off any more" in launch.errors, "the end of it")
            echoed = launch.haptic("topic", "echo", "/device/handle", "--once", "--json").stdout
            assert '"buttons":5' in echoed.replace(" ", "")


@pytest.mark.parametrize(
    ("safety", "words"),
    [(IDLE, "does it run"), (FAULT, "outside the workspace"), (STOPPED, "rearm"), (ACTIVE, "nothing is touched")],
)
def test_every_state_of_the_driver_has_words(safety: int, words: str) -> None:
    s = DriverState()
    s.ticks, s.safety, s.axes = 1, safety, 1
    assert words in why_no_force(s)
    assert why_no_force(s, "press it") == "press it"


def test_the_page_says_what_the_device_says() -> None:
    state = DeviceState(seq=1, stamp=0.0, position=(0.0, 0.0, 0.0), force=(0.0, 0.0, 1.0))
    assert explain(state, None, None, 0.0, device="nobody holds it") == (
        "stop",
        "No force, or another one: nobody holds it.",
    )
