"""The identifying push: its law, places and axes, and its refusals."""

from __future__ import annotations

import json
import signal
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from messages.errors import RefusedError
from messages.transport.requests import ControlError
from sim.identify.borrowed import PushedLaunch
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
