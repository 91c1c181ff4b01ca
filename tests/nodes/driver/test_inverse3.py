"""The Inverse3's driver on its emulated service: cold start, versions, sessions, events."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nodes.driver.haply.driver import FORCELESS_AFTER
from nodes.driver.haply.surplus import SURPLUS_BURST
from tests.support.devices import SOFT, Bench, bench, through
from tests.support.launching import running, wait_for

COLD = 1.0
"""Cold start of the emulator [s]; the vendor's takes up to 25."""


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Bench]:
    with bench("inverse3_driver", tmp_path) as made:
        yield made


@pytest.mark.process
def test_a_cold_start_is_waited_for_and_says_why(tmp_path: Path) -> None:
    with bench("inverse3_driver", tmp_path, "--cold", str(COLD)) as stand:
        device = stand.device(start_time=30.0)
        said: list[str] = []
        device.say = said.append
        device.connect()
        begun = time.monotonic()
        device.open()
        assert device.facts["serial"] == "04BA"
        # As long as it is cold one line stands for all attempts; another says that the wait is
        # over.
        assert len(said) == 2, said
        assert said[0].startswith(
            "Inverse3: waits up to 30 s for the Inverse Service at ws://localhost:"
        )
        assert "no Inverse3 is connected; a cold start takes up to 25 s" in said[0]
        assert said[1].startswith("Inverse3: is there after ")
        # It was there not before the service had it, whose clock began before ours.
        # the line gives tenths
        assert 0.0 < float(said[1].split()[-2]) <= time.monotonic() - begun + 0.05
        device.close()


@pytest.mark.process
@pytest.mark.smoke
def test_a_service_that_does_not_answer_is_told_as_that(stand: Bench) -> None:
    """It accepts the connection but stays silent: the error must say so."""
    said: list[str] = []

    def heard(text: str) -> None:
        said.append(text)
        stand.world.state.slow_ms = 0

    stand.world.state.slow_ms = 5000
    device = stand.device(start_time=60.0)
    device.say = heard
    device.connect()
    device.open()
    assert "timed out in 2.0s; a cold start" in said[0]
    assert said[1].startswith("Inverse3: is there after ")


@pytest.mark.process
def test_a_launch_waits_for_a_cold_start(stand: Bench, tmp_path: Path) -> None:
    scene = through(stand, tmp_path, start_time=100.0)
    stand.world.state.position[2] = -0.002
    stand.world.state.unplugged = 1
    with running(tmp_path, scene, *SOFT, "duration:=0", ready=False) as launch:
        wait_for(
            lambda: (
                "[driver] device_waits: Inverse3: waits up to 100 s" in launch.errors
            ),
            "why it waits",
        )
        stand.world.state.unplugged = 0
        wait_for(
            lambda: stand.world.force()[2] == pytest.approx(0.3, abs=1e-9),
            "2 mm of 150 N/m",
        )
        assert "device_waits: Inverse3: is there after" in launch.errors


@pytest.mark.process
def test_a_service_that_takes_forces_under_another_name_is_refused_loudly(
    tmp_path: Path,
) -> None:
    with bench("inverse3_driver", tmp_path, "--version", "3.1") as stand:
        device = stand.opened()
        told: list[str] = []

        def refused() -> bool:
            device.write_force((0.0, 0.0, 1.0), 0, 0.0)
            try:
                device.read_position(0)
            except OSError as error:
                told.append(str(error))
            return bool(told)

        wait_for(refused, "it says that no force acts")
        assert (
            "takes no forces (0 N act while a force is asked for): it must be of version 3.5"
            in told[0]
        )
        assert "takes no forces" in device.condition()


@pytest.mark.process
@pytest.mark.smoke
def test_what_another_session_adds_is_told(stand: Bench) -> None:
    device = stand.opened()
    stand.press(device, (0.0, 0.0, 1.0))
    assert device.condition() == ""
    stand.world.state.other[2] = 0.5
    wait_for(
        lambda: "another session of the Inverse Service adds" in device.condition(),
        "the other session",
    )
    assert "+0.50 N" in device.condition()
    stand.world.state.other[2] = 0.0
    wait_for(lambda: device.condition() == "", "nobody adds any more")


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize("events", [True, False])
def test_an_emergency_brake_is_told_and_ends_nothing(
    stand: Bench, events: bool
) -> None:
    device = stand.opened() if events else stand.opened(events_port=0)
    stand.press(device, (0.0, 0.0, 1.0))
    why = (
        "emergency brake of the Inverse3 is on"
        if events
        else "lets no force act (0 N while a force is asked for)"
    )

    def told() -> bool:
        # A person leans on the wall all the while. It once ended the run as a service of the wrong
        # version.
        device.write_force((0.0, 0.0, 1.0), 0, 0.0)
        device.read_position(0)
        return why in device.condition()

    stand.world.state.cause = 1
    braked = time.monotonic()
    wait_for(
        lambda: told() and time.monotonic() - braked > 2.0 * FORCELESS_AFTER,
        "the brake",
    )
    stand.world.state.cause = 0
    stand.press(device, (0.0, 0.0, 1.0))
    wait_for(lambda: device.condition() == "", "the brake released")


@pytest.mark.process
@pytest.mark.smoke
def test_a_service_that_answers_slowly_has_old_samples_counted_as_none(
    stand: Bench,
) -> None:
    """States 80 ms late exceed the deadline of 50 ms: no position, so no force."""
    device = stand.opened()
    stand.press(device, (0.0, 0.0, 1.0))
    stand.world.state.slow_ms = 80
    unknown = 0

    def counted() -> bool:
        nonlocal unknown
        unknown += math.isnan(device.read_position(0)[0])
        return unknown > 20

    wait_for(counted, "positions that are too old")
    stand.world.state.slow_ms = 0
    wait_for(lambda: not math.isnan(device.read_position(0)[0]), "positions are back")


@pytest.mark.process
def test_surplus_answers_make_no_position_older(
    stand: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With each state sent twice, the position was 17.6 s old after 16 s."""
    monkeypatch.setattr("nodes.driver.haply.surplus.SURPLUS_BURST", math.inf)
    device = stand.device(deadline=0.1)
    device.connect()
    device.open()
    stand.world.fail("twice")
    wait_for(
        lambda: device.facts.get("surplus_answers", 0) > 1000,
        "1000 surplus answers",
        30.0,
    )
    stand.world.state.position[2] = 0.01
    moved, seen = device.ticks, 0
    while device.read_position(0)[2] != pytest.approx(0.01, abs=1e-12):
        seen = device.ticks - moved
        # One answer that was under way and its copy; the rest is time in which this thread was not
        # run.
        assert seen < 500, "the position is older by each surplus answer"


@pytest.mark.process
@pytest.mark.smoke
def test_a_service_that_goes_on_with_surplus_answers_is_given_up(stand: Bench) -> None:
    device = stand.opened()
    stand.press(device, (0.0, 0.0, 1.0))
    # A few are forgiven.
    stand.world.fail("twice")
    wait_for(
        lambda: device.facts.get("surplus_answers", 0) > 0, "a surplus answer", 10.0
    )
    stand.world.fail("")
    assert not math.isnan(device.read_position(0)[0])
    stand.world.fail("twice")
    wait_for(
        lambda: "more states than it is asked for" in device.condition(),
        "it is given up",
        30.0,
    )
    assert SURPLUS_BURST <= device.facts["surplus_answers"] <= 2 * SURPLUS_BURST
    with pytest.raises(
        OSError, match="goes on sending more states than it is asked for"
    ):
        device.read_position(0)
    wait_for(lambda: not any(stand.world.force()), "no force acts")


@pytest.mark.process
@pytest.mark.smoke
def test_messages_that_cannot_be_read_end_nothing(stand: Bench) -> None:
    """JSON nested 50 000 deep silently ended the exchange's thread."""
    device = stand.opened()
    stand.press(device, (0.0, 0.0, 1.0))
    stand.world.fail("nested")
    wait_for(
        lambda: "messages that cannot be read" in device.condition(), "it is told", 10.0
    )
    wait_for(lambda: not any(stand.world.force()), "no force without a position", 10.0)
    stand.world.fail("")
    stand.press(device, (0.0, 0.0, 1.0))
    wait_for(lambda: device.condition() == "", "it is readable again", 10.0)


@pytest.mark.process
@pytest.mark.smoke
def test_fifteen_hundred_buttons_are_thirty_two(stand: Bench) -> None:
    device = stand.opened()
    stand.world.fail("buttons")
    wait_for(lambda: "more than 32 buttons" in device.condition(), "it is told", 10.0)
    handle = device.handle()
    assert handle is not None
    assert handle.buttons == 2**32 - 1
    assert not math.isnan(device.read_position(0)[0])


@pytest.mark.process
def test_whatever_ends_the_exchange_ends_forces_and_is_told(
    stand: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = stand.opened()
    monkeypatch.setattr("nodes.driver.haply.driver.buttons", lambda _: 1 / 0)
    wait_for(
        lambda: "ZeroDivisionError: division by zero" in device.condition(),
        "it is told",
        10.0,
    )
    with pytest.raises(
        OSError, match="the exchange with the Inverse Service failed: ZeroDivisionError"
    ):
        device.read_position(0)
