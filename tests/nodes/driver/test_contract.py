"""The contract of every registered device, each on its emulator.

A check is a test of a bench; the table of the contract (nodes/driver/DEVICES.md) names the same
checks.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nodes.driver.limits import SafetyParameters, lower, undeclared
from tests.support import ROOT
from tests.support.contract import CALLS, checks
from tests.support.devices import Bench, bench, real_devices
from tests.support.launching import wait_for

HERE = (0.01, -0.02, 0.03)
FORCE = (0.5, -0.25, 1.0)


def without_force(stand: Bench) -> bool:
    return not any(stand.world.force())


STANDS = [
    # The service of an Inverse3 is a process of its own; a library is loaded into this one.
    pytest.param(kind, marks=[pytest.mark.process, pytest.mark.smoke])
    if kind == "inverse3_driver"
    else kind
    for kind in sorted(real_devices())
]


@pytest.fixture(params=STANDS)
def stand(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    with bench(request.param, tmp_path) as made:
        # what the driver asks of its device is looked at, not what the arm bears
        made.world.state.peak = 100.0
        if request.param != "inverse3_driver":
            made.world.state.peak = 7.9
        yield made
        # The stand-in counts what breaks the vendor's rules.
        if request.function is not test_every_call_may_fail:
            assert made.world.state.broken == 0


def test_position_before_force(stand: Bench) -> None:
    stand.world.state.position[:] = HERE
    device = stand.opened()
    assert device.read_position(0) == pytest.approx(HERE, abs=1e-12)
    assert stand.world.state.largest == 0.0
    device.close()


def test_forces_off_until_asked_for(stand: Bench) -> None:
    device = stand.device()
    device.connect()
    if stand.kind != "inverse3_driver":  # which knows no switch for forces
        assert not stand.world.state.forces
    device.open()
    wait_for(lambda: device._box.ticks > 20, "the servo loop goes on")
    assert stand.world.state.largest == 0.0
    stand.press(device, FORCE)
    device.close()
    wait_for(lambda: without_force(stand), "no force after the end")


def test_limits_are_read_and_kept(stand: Bench) -> None:
    device = stand.opened()
    assert undeclared(SafetyParameters(), device.limits) == ""
    peak = device.limits.peak_force
    asked = lower(
        SafetyParameters(peak_force=1000.0, watchdog=10_000), device.limits, 0.002
    )
    assert asked.peak == peak
    assert len(asked.overruled) == 2

    def presses() -> bool:
        device.write_force((1e6, -1e6, 0.0), 0, 0.0)
        return bool(stand.world.state.largest)

    wait_for(presses, "a force")
    assert stand.world.state.largest == pytest.approx(peak, rel=1e-12)

    def no_number() -> bool:
        device.write_force((0.0, 0.0, math.nan), 0, 0.0)
        return without_force(stand)

    wait_for(no_number, "what is no number is no force")
    stand.press(device, FORCE)
    assert stand.world.force()[2] == pytest.approx(FORCE[2], abs=1e-12)
    device.close()


def test_silence_ends_the_force_within_hold(stand: Bench) -> None:
    device = stand.opened()
    assert 0.0 < device.limits.hold <= 0.1
    lets = device.let_go
    stand.press(device, FORCE)
    # Nobody writes any more: this thread could be stopped as well.
    # A tick without a position has no force either.
    wait_for(lambda: device.let_go > lets and without_force(stand), "it lets go")
    # When the force went, by the servo loop's own clock: the newest command is the last one of a
    # force.
    silence = time.monotonic() - device._box.commanded_at
    assert silence >= device.limits.hold * 0.5
    stand.press(device, FORCE)
    device.close()


def test_unplugged_it_says_so_and_ends_safely(stand: Bench) -> None:
    stand.world.state.position[:] = HERE
    device = stand.opened()
    stand.press(device, FORCE)
    stand.world.state.unplugged = 1
    told: list[str] = []

    def says() -> bool:
        device.write_force(FORCE, 0, 0.0)
        try:
            position = device.read_position(0)
        except OSError as error:
            told.append(str(error))
            return True
        assert position == pytest.approx(HERE, abs=1e-12) or all(
            map(math.isnan, position)
        )
        return False

    wait_for(says, "it says so")
    assert told[0].startswith(device.TITLE)
    assert re.search(
        r"communication error|no device found|unplugged|closed the connection", told[0]
    )
    device.close()


def test_a_read_that_blocks_holds_up_nobody(stand: Bench) -> None:
    stand.world.state.position[:] = HERE
    device = stand.opened()
    stand.press(device, FORCE)
    ticks = device._box.ticks
    stand.world.state.block_ms = 150

    def blocked() -> bool:
        position = device.read_position(0)
        assert math.isnan(position[0]) or position == pytest.approx(HERE, abs=1e-12)
        return math.isnan(position[0])

    wait_for(blocked, "the position counts as unknown")
    # The driver's own call did not wait, or it had a position; and the hand is not held by the
    # force of before: it ends within the same read.
    blocked_at = device._box.ticks
    wait_for(lambda: without_force(stand), "the device lets go")
    assert device._box.ticks - blocked_at <= 1
    wait_for(lambda: not math.isnan(device.read_position(0)[0]), "positions are back")
    assert device._box.ticks > ticks
    stand.press(device, FORCE)
    device.close()


def test_a_failed_read_is_no_zero(stand: Bench) -> None:
    stand.world.state.position[:] = HERE
    device = stand.opened()
    stand.world.fail(
        {
            "touch_driver": "hdGetDoublev",
            "force_dimension_driver": "dhdGetPosition",
        }.get(stand.kind, "state")
    )
    seen: list[tuple[float, ...]] = []

    def ends() -> bool:
        try:
            seen.append(device.read_position(0))
        except OSError:
            return True
        return math.isnan(seen[-1][0])

    wait_for(ends, "the position counts as unknown")
    for position in seen:
        assert math.isnan(position[0]) or position == pytest.approx(HERE, abs=1e-12)
    stand.world.fail("")
    device.close()


def test_nan_is_no_position(stand: Bench) -> None:
    stand.world.state.position[:] = HERE
    device = stand.opened()
    stand.world.state.nan = 1
    wait_for(lambda: all(map(math.isnan, device.read_position(0))), "no position")
    stand.world.state.nan = 0
    wait_for(
        lambda: device.read_position(0) == pytest.approx(HERE, abs=1e-12),
        "a position again",
    )
    device.close()


def test_remarks_are_no_errors(stand: Bench) -> None:
    stand.world.state.position[:] = HERE
    stand.world.state.positive = 1
    device = stand.opened()
    stand.press(device, FORCE)
    assert device.read_position(0) == pytest.approx(HERE, abs=1e-12)
    wait_for(lambda: device.condition() == "", "nothing keeps forces off")
    device.close()


def test_every_call_may_fail(stand: Bench) -> None:
    failures: list[str] = []
    for call in CALLS[stand.kind]:
        stand.world.state.calibrations = 1
        for moment in ("before", "while it runs"):
            device = stand.device()
            stand.world.fail(call if moment == "before" else "")
            try:
                device.connect()
                device.open()
                stand.world.fail(call)
                for _ in range(3):
                    device.write_force(FORCE, 0, 0.0)
                    device.read_position(0)
                    time.sleep(0.002)  # let the servo loop meet it
            except OSError as error:
                failures.append(str(error))
            finally:
                device.close()
                stand.world.fail("")
            wait_for(
                lambda: without_force(stand),
                f"no force after {call} has failed {moment}",
            )
            # its service counts sessions, which end by themselves
            if stand.kind != "inverse3_driver":
                assert stand.world.state.open == 0, (call, moment)
                assert stand.world.state.forces == 0, (call, moment)
    assert failures
    names = ("Touch", "device", "Force Dimension", "Inverse3")
    assert [text for text in failures if not any(name in text for name in names)] == []


def test_closed_twice_is_closed(stand: Bench) -> None:
    stand.device().close()
    device = stand.device()
    device.connect()
    device.close()
    device = stand.opened()
    device.close()
    device.close()
    wait_for(lambda: stand.world.state.open == 0, "it is given back")


def test_the_wrong_device_first(stand: Bench) -> None:
    """Of two devices the chosen one is used, or a clear error is given."""
    wrong: dict[str, Any] = {
        "serial": 1 if stand.kind == "force_dimension_driver" else "1"
    }
    if stand.kind == "inverse3_driver":
        wrong["start_time"] = 0
    device = stand.device(**wrong)

    def use() -> None:
        device.connect()
        device.open()

    known = {"inverse3_driver": "04BA"}.get(stand.kind, str(stand.world.state.serial))
    with pytest.raises(OSError, match=known):
        use()
    device.close()
    if stand.kind == "force_dimension_driver":
        stand.world.state.devices = 3
        device = stand.device(serial=stand.world.state.serial)
        device.connect()
        assert device.facts["serial"] == str(stand.world.state.serial)
        device.close()
    wait_for(lambda: stand.world.state.open == 0, "what was not meant is given back")


def test_the_table_of_the_contract_is_whole() -> None:
    page = (ROOT / "nodes" / "driver" / "DEVICES.md").read_text(encoding="utf-8")
    table = page.partition("## The contract")[2]
    for check in checks(Path(__file__)):
        assert f"| {check} |" in table
    for kind in real_devices():
        assert f"`{kind}`" in table
