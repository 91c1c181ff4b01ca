"""Inertia by pose: from the device to the law, node info, the page's map and tuning."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from nodes.driver.hardware.inertia import SeenMasses, masses_along
from nodes.view.commands import Commander
from sim.identify.borrowed import PushedLaunch
from tests.support.devices import SOFT, bench, through
from tests.support.launching import running, wait_for


def test_a_push_along_an_axis_moves_what_the_other_axes_leave() -> None:
    turn = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    matrix = turn @ np.diag([0.1, 0.2, 0.4]) @ turn.T
    along, (least, greatest) = masses_along(matrix.tolist())
    assert (least, greatest) == pytest.approx((0.1, 0.4), rel=1e-12)
    for axis in range(3):
        # One newton along it: what it is accelerated by, along itself.
        push = np.eye(3)[axis]
        assert 1.0 / along[axis] == pytest.approx(
            (np.linalg.inv(matrix) @ push)[axis], rel=1e-12
        )
        assert least <= along[axis] <= matrix[axis, axis]


@pytest.mark.parametrize(
    "wrong",
    [[[0.0] * 3] * 3, [[float("nan")] * 3] * 3, np.diag([0.1, -0.1, 0.1]).tolist()],
)
def test_what_is_no_inertia_is_refused(wrong: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="inertia is not"):
        masses_along(wrong)
    a, b, c = (tuple(row) for row in wrong)
    assert SeenMasses().record((a, b, c)) is None  # type: ignore[arg-type]  # each is three long


def test_poses_are_remembered() -> None:
    seen = SeenMasses()
    assert seen.record(None) is None
    seen.record(((0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.1)))
    told = seen.record(((0.15, 0.0, 0.0), (0.0, 0.15, 0.0), (0.0, 0.0, 0.3)))
    assert told == {
        "here_kg": pytest.approx([0.15, 0.15, 0.3]),
        "least_kg": pytest.approx(0.1),
        "greatest_kg": pytest.approx(0.3),
    }


@pytest.mark.process
def test_a_running_device_tells_its_masses_to_whoever_judges_a_loop(
    tmp_path: Path,
) -> None:
    with (
        bench("force_dimension_driver", tmp_path) as stand,
        running(tmp_path, through(stand, tmp_path), *SOFT, "duration:=0") as launch,
        ExitStack() as held,
    ):
        commander = Commander(launch.run)
        held.callback(commander.end)
        held.callback(commander.close)

        def told() -> dict[str, float]:
            return commander.inertia() or {}

        # The stand-in is half as heavy again towards the operator, and twice as heavy 0.1 m to the
        # right of ours.
        wait_for(
            lambda: told().get("greatest_kg") == pytest.approx(0.15),
            "the masses of this pose",
        )
        assert told()["here_kg"] == pytest.approx([0.15, 0.1, 0.1])
        stand.world.state.position[1] = 0.1
        wait_for(
            lambda: told()["greatest_kg"] == pytest.approx(0.3),
            "the masses of another pose",
        )
        assert told()["least_kg"] == pytest.approx(0.1)
        stand.world.state.position[1] = 0.0
        wait_for(
            lambda: told()["here_kg"][2] == pytest.approx(0.1),  # type: ignore[index]
            "the first pose again",
        )
        info = launch.haptic("node", "info", "driver")
        assert (
            "mass: 0.15, 0.1, 0.1 kg along x, y, z at its position; 0.1 to 0.3 kg in all poses"
            in info.stdout
        )
        figures = json.loads(
            launch.haptic("node", "info", "driver", "--json").stdout.splitlines()[-1]
        )
        assert figures["inertia"]["greatest_kg"] == pytest.approx(0.3)
        # A tuning that pushes along z identifies 0.1 kg: elsewhere it is up to 0.2 kg more.
        assert PushedLaunch(launch.run).poses() == pytest.approx((0.0, 0.2), abs=1e-12)
