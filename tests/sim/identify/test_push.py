"""The identifying push: its law, places and axes, and its refusals."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from messages.errors import RefusedError
from messages.transport.requests import ControlError
from messages.types import DeviceState
from nodes.launcher.runs import RunInfo
from sim.identify.borrowed import PushedLaunch, carried
from tests.support.launching import Running, running, typed, typed_in, wait_for


def stands_still(launch: Running) -> None:
    """Pause the loop: it starts no tick but accepts changes, and resumes on request."""
    anywhere: dict[str, Any] = {"values": {"passivity": {"guard": "off"}}}
    for seconds in (-1.0, 61.0, float("nan"), "long"):
        with pytest.raises(ControlError, match="0 to 60 s"):
            launch.call("driver", "stand", seconds=seconds)
    launch.call("driver", "stand", seconds=60.0)
    ticks = []
    for _ in range(2):
        # Taken between two ticks: the one under way is over then.
        launch.call("driver", "param.set", **anywhere)
        ticks.append(launch.call("driver", "progress")["tick"])
    assert ticks[0] == ticks[1]
    launch.call("driver", "stand", seconds=0.0)
    wait_for(
        lambda: launch.call("driver", "progress")["tick"] > ticks[0],
        "the loop to go on",
    )


@pytest.mark.slow
def test_three_axes_are_identified_in_three_places_held_by_a_hand(
    tmp_path: Path,
) -> None:
    hand = "hand: {mass: 0.1, damping: 3.0, stiffness: 150.0, path: [[0.0, 0.0]]}"
    (tmp_path / "held.yaml").write_text(
        f"driver: {{device: {{{hand}}}}}", encoding="utf-8"
    )
    words = (
        "identify",
        "axes:=[x,y,z]",
        "pace:=lockstep",
        "apply:=next_tick",
        "duration:=0",
        "--params",
        "held.yaml",
    )
    with running(tmp_path, *words) as launch:
        stands_still(launch)
        done = typed(launch, "device", "identify", "--duration", "8", "--json")
        launch.finish(signal.SIGINT, code=None)
    told = json.loads(done.stdout.splitlines()[-1])["places"]
    assert [one["axis"] for one in told] == ["x", "y", "z"] * 3
    # Three places, 20 mm apart along every axis.
    places = [one["place_m"] for one in told[::3]]
    for nearer, farther in pairwise(places):
        assert [b - a for a, b in zip(nearer, farther, strict=True)] == pytest.approx(
            [0.02] * 3, abs=1e-12
        )
    for one in told:
        assert one["held"] is True
        # Eight seconds a place: 5 %.
        for key, truth in (
            ("mass_kg", 0.2),
            ("damping_n_s_per_m", 4.0),
            ("hand_stiffness_n_per_m", 150.0),
        ):
            assert one[key]["value"] == pytest.approx(truth, rel=0.05), (
                key,
                one["axis"],
            )


@pytest.mark.process
def test_device_list_tells_where_it_looked(tmp_path: Path) -> None:
    listed = json.loads(
        typed_in(tmp_path, "device", "list", "--json").stdout.splitlines()[-1]
    )["devices"]
    kinds = {entry["kind"]: entry for entry in listed}
    assert kinds["sim_driver"]["found"] is True
    assert kinds["touch_driver"]["library"]
    assert kinds["touch_driver"]["searched"]
    for entry in listed:
        assert set(entry) == {"kind", "found", "library", "searched", "checked"}


def test_a_wrong_push_is_refused_by_its_path(tmp_path: Path) -> None:
    done = typed_in(
        tmp_path,
        "device",
        "identify",
        "identify",
        "--amplitude",
        "-1",
        "--run",
        "none",
        code=2,
    )
    assert "amplitude" in done.stderr


class Still(PushedLaunch):
    """A launch whose driver answers but makes no ticks."""

    def __init__(self) -> None:
        self.driver = "driver"

    def progress(self) -> Any:
        """Return the same tick every time."""
        return {"tick": 7}


def test_a_driver_that_makes_no_ticks_is_not_waited_for_without_end() -> None:
    with pytest.raises(RefusedError, match=r"driver: no tick within 0\.05 s"):
        Still().wait(1, silence=0.05)


class Resting(PushedLaunch):
    """A launch whose driver sends the states of a device that is left alone, and then ends."""

    def __init__(self, force: list[float], *axes: int, moved: float = 0.0) -> None:
        self.driver, self.period, self.axes = "driver", 0.002, axes or (2,)
        self.peak = None
        self.run = RunInfo(run="floor", scenario="s", launcher=0, nodes={}, manifest={})
        self._force, self._moved = force, moved

    def states(self, silence: float = 0.0) -> Iterator[DeviceState]:  # noqa: ARG002  # ends
        """Yield one state a force, on the z axis; the position alternates by what it moves."""
        for seq, force in enumerate(self._force):
            yield state_at(seq, force, self._moved * (seq % 2))


def state_at(seq: int, force: float, height: float) -> DeviceState:
    return DeviceState(
        seq=seq, stamp=0.0, position=(0.0, 0.0, height), force=(0.0, 0.0, force)
    )


def test_a_push_and_the_weight_may_reach_the_driver_s_limit_and_no_further() -> None:
    loop = Resting([])
    for loop.peak, strongest in ((None, 20.0), (4.0, 4.0)):
        for sign in (1.0, -1.0):
            weight = sign * (strongest - 0.5)
            assert carried(loop, 0.5, weight) == weight
            with pytest.raises(RefusedError, match=f"more than {strongest:g} N"):
                carried(loop, 0.5, weight * (1.0 + 1e-9))


def test_the_weight_is_the_mean_force_of_a_fifth_of_a_second_at_rest() -> None:
    """100 ticks of 2 ms; with several axes nobody knows which of them is vertical."""
    swaying = [0.25, 0.75] * 50
    assert carried(Resting(swaying), 0.7, None) == 0.5
    assert carried(Resting(swaying, 1, 2), 0.7, None) == 0.0
    with pytest.raises(RefusedError, match="floor: the launch has ended"):
        carried(Resting(swaying[1:]), 0.7, None)
    # As large as the push it may be a weight; above, it may be a hand.
    assert carried(Resting([-0.5] * 100), 0.5, None) == -0.5
    with pytest.raises(
        RefusedError, match=r"-0\.501 N acts on the device.*--load -0\.501"
    ):
        carried(Resting([-0.501] * 100), 0.5, None)


@pytest.mark.parametrize(("moved", "ticks"), [(1e-4, 100), (1.01e-4, 1500)])
def test_a_device_that_moves_gets_three_seconds_to_rest(
    moved: float, ticks: int
) -> None:
    """Then the force on it is not taken for its weight."""
    weight = carried(Resting([0.5] * ticks, moved=moved), 0.7, None)
    assert weight == (0.5 if ticks == 100 else 0.0)
    with pytest.raises(RefusedError, match="has ended"):
        carried(Resting([0.5] * (ticks - 1), moved=moved), 0.7, None)
