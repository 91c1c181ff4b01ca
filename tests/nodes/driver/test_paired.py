"""Two devices at once: coupled to each other by one law in one launch, and each in a launch of its own."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from nodes.driver.device import DeviceLimits
from nodes.driver.paired.driver import PairedDevice
from tests.nodes.driver.test_touch import needs_cc, scenario
from tests.sim.test_stand_ins import SOFT, through
from tests.support import ROOT
from tests.support.devices import bench
from tests.support.launching import running, wait_for


def test_the_pages_pair_is_coupled_and_judged(tmp_path: Path) -> None:
    page = (ROOT / "nodes" / "driver" / "DEVICES.md").read_text(encoding="utf-8")
    (written,) = re.findall(r"```yaml\n(summary: .*?)```", page, re.DOTALL)
    path = tmp_path / "pair.yaml"
    path.write_text(written, encoding="utf-8")
    with running(tmp_path, str(path), "duration:=0") as launch:

        def places() -> Any:
            return launch.call("driver", "places")

        # The first is led 30 mm, against the grip of the second, which follows: springs of 300, 500 and 100 N/m in a row. The
        # first goes to 0.03·300/(300 + 500·100/600) m, the second to 500/600 of that.
        first = 0.03 * 300.0 / (300.0 + 500.0 * 100.0 / 600.0)

        def arrives() -> bool:
            found = places()
            return bool(
                abs(found["first_m"][0] - first) < 1e-3 and abs(found["second_m"][0] - first * 500.0 / 600.0) < 1e-3
            )

        wait_for(arrives, "the second follows the first")
        # Judged at the delay of this loop: what is far too stiff for half the mass is refused, with the limit.
        refused = launch.haptic("param", "set", "coupling", "laws.pd.stiffness", "50000", code=1)
        assert "unstable" in refused.stderr
        assert re.search(r"mass 0.0725 kg, .* at a delay of \d.*would be taken is \d{3,4}; ", refused.stderr)


class _Recorded:
    """A device that keeps its calls."""

    def __init__(self, place: tuple[float, float, float], **limits: Any) -> None:
        self.place, self.limits, self.calls = place, DeviceLimits(**limits), list[Any]()

    def open(self) -> None:
        self.calls.append("open")

    def read_position(self, seq: int) -> tuple[float, float, float]:
        del seq
        return self.place

    def write_force(self, force: tuple[float, float, float], seq: int, offset: float) -> None:
        del seq, offset
        self.calls.append(force)

    def close(self) -> None:
        self.calls.append("close")


class _Broken(_Recorded):
    """One that cannot be opened."""

    def open(self) -> None:
        raise OSError("gone")


def test_a_pair_pushes_one_and_pulls_the_other() -> None:
    box = ((-0.1, 0.2), (-0.1, 0.1), (0.0, 0.1))
    first = _Recorded((0.03, 0.0, 0.01), peak_force=8.0, hold=0.05, workspace=box, latency=0.001)
    second = _Recorded((0.01, 0.02, 0.0), peak_force=3.0, hold=0.03, workspace=box)
    pair = PairedDevice(first, second)
    assert pair.read_position(0) == pytest.approx((0.02, -0.02, 0.01), abs=1e-15)
    pair.write_force((1.0, 2.0, -3.0), 0, 0.0)
    assert (first.calls, second.calls) == ([(1.0, 2.0, -3.0)], [(-1.0, -2.0, 3.0)])
    limits = pair.limits
    assert (limits.peak_force, limits.hold, limits.latency) == (3.0, 0.05, None)
    assert limits.workspace[0] == pytest.approx((-0.3, 0.3), abs=1e-15)
    # Where one does not know its place, neither is pushed.
    second.place = (float("nan"), 0.0, 0.0)
    pair.read_position(1)
    pair.write_force((1.0, 0.0, 0.0), 1, 0.0)
    assert first.calls[-1] == (0.0, 0.0, 0.0)
    # What was opened before the other failed is closed again.
    half = PairedDevice(first, _Broken((0.0, 0.0, 0.0)))
    with pytest.raises(OSError, match="gone"):
        half.open()
    assert first.calls[-2:] == ["open", "close"]


@needs_cc
def test_two_launches_with_a_device_each(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    with bench("touch_driver", folders[0]) as left, bench("force_dimension_driver", folders[1]) as right:
        for stand in (left, right):
            stand.world.state.position[2] = -0.001
        with (
            running(folders[0], through(left, folders[0]), *SOFT, "duration:=0") as one,
            running(folders[1], through(right, folders[1]), *SOFT, "duration:=0") as other,
        ):
            # 1 mm into a floor of 150 N/m, on each by itself.
            wait_for(lambda: left.world.force()[2] == pytest.approx(0.15, abs=1e-9), "its own force")
            wait_for(lambda: right.world.force()[2] == pytest.approx(0.15, abs=1e-9), "its own force")
            one.interrupt()
            wait_for(lambda: not any(left.world.force()), "the first launch ends")
            wait_for(lambda: right.world.force()[2] == pytest.approx(0.15, abs=1e-9), "the other goes on")
            assert json.loads(other.haptic("node", "list", "--json").stdout.splitlines()[-1])["nodes"]["driver"]


def test_a_member_that_is_no_device_is_refused(tmp_path: Path) -> None:
    content = json.loads(Path(scenario(tmp_path, "none")).read_text(encoding="utf-8"))
    member = {"kind": "sim_driver", "parameters": {"device": {"mass": 0.1}}}
    content["nodes"]["driver"] = {
        "kind": "paired_driver",
        "parameters": {"first": member, "second": {"kind": "coupling"}},
    }
    path = tmp_path / "wrong.yaml"
    path.write_text(json.dumps(content), encoding="utf-8")
    with running(tmp_path, str(path), ready=False) as launch:
        launch.finish(code=1)
        assert "driver.second.kind: 'coupling' drives no single device" in launch.errors
