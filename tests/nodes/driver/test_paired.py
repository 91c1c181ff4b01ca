"""Two devices at once: coupled by one law in one launch, or each in its own launch."""

from __future__ import annotations

import json
import math
import re
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nodes.driver.device import DeviceLimits
from nodes.driver.paired.driver import PairedDriver
from nodes.driver.paired.paired_device import Alignment, PairedDevice
from nodes.laws.parse import parse_law
from nodes.parameters.store import ParameterError
from nodes.recording.reader import Recording
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant, held_plant
from sim.device.driver import SimDriver, SimDriverParameters
from tests.support import ROOT, slowly
from tests.support.devices import SOFT, Bench, bench, needs_cc, through
from tests.support.launching import running, typed, typed_in, wait_for
from tests.support.setups import setup_of


@pytest.mark.process
def test_two_hands_are_coupled_and_judged_at_the_measured_delay(tmp_path: Path) -> None:
    with running(tmp_path, "hands_coupled", "duration:=0") as launch:

        def places() -> Any:
            return launch.call("driver", "places")

        # The first is led 30 mm, against the grip of the second, which follows: springs of 300, 500
        # and 100 N/m in a row. The first goes to 0.03·300/(300 + 500·100/600) m, the second to
        # 500/600 of that.
        first = 0.03 * 300.0 / (300.0 + 500.0 * 100.0 / 600.0)

        def arrives() -> bool:
            found = places()
            return bool(
                abs(found["first_m"][0] - first) < 1e-3
                and abs(found["second_m"][0] - first * 500.0 / 600.0) < 1e-3
            )

        wait_for(arrives, "the second follows the first")
        # Judged at the delay of this loop: what is far too stiff for half the mass is refused, with
        # the limit.
        refused = typed(
            launch, "param", "set", "coupling", "laws.pd.stiffness", "50000", code=1
        )
        assert "unstable" in refused.stderr
        assert re.search(
            r"mass 0.145 kg, .* coupled to 0.145 kg, .* at a delay of \d.*that is accepted is"
            r" \d{3,4}; ",
            refused.stderr,
        )


class _Recorded:
    """A device that records its calls."""

    def __init__(self, place: tuple[float, float, float], **limits: Any) -> None:
        self.place, self.limits, self.calls = place, DeviceLimits(**limits), list[Any]()

    def open(self) -> None:
        self.calls.append("open")

    def read_position(self, seq: int) -> tuple[float, float, float]:
        del seq
        return self.place

    def write_force(
        self, force: tuple[float, float, float], seq: int, offset: float
    ) -> None:
        del seq, offset
        self.calls.append(force)

    def close(self) -> None:
        self.calls.append("close")


class _Broken(_Recorded):
    """A device that cannot be opened."""

    def open(self) -> None:
        raise OSError("gone")


def test_a_pair_pushes_one_and_pulls_the_other() -> None:
    box = ((-0.1, 0.2), (-0.1, 0.1), (0.0, 0.1))
    first = _Recorded(
        (0.03, 0.0, 0.01), peak_force=8.0, hold=0.05, workspace=box, latency=0.001
    )
    second = _Recorded(
        (0.01, 0.02, 0.0), peak_force=3.0, hold=0.03, workspace=((-0.1, 0.1), *box[1:])
    )
    pair = PairedDevice(first, second)
    assert pair.read_position(0) == pytest.approx((0.02, -0.02, 0.01), abs=1e-15)
    pair.write_force((1.0, 2.0, -3.0), 0, 0.0)
    assert (first.calls, second.calls) == ([(1.0, 2.0, -3.0)], [(-1.0, -2.0, 3.0)])
    limits = pair.limits
    assert (limits.peak_force, limits.hold, limits.lets_go, limits.latency) == (
        3.0,
        0.05,
        0.03,
        None,
    )
    assert limits.workspace[0] == pytest.approx((-0.2, 0.3), abs=1e-15)
    # Where one does not know its place, neither is pushed.
    second.place = (float("nan"), 0.0, 0.0)
    pair.read_position(1)
    pair.write_force((1.0, 0.0, 0.0), 1, 0.0)
    assert first.calls[-1] == (0.0, 0.0, 0.0)
    # Nor where one is outside its own workspace, although they are near each other.
    first.place = second.place = (0.15, 0.0, 0.0)
    assert all(map(math.isnan, pair.read_position(2)))
    pair.write_force((1.0, 0.0, 0.0), 2, 0.0)
    assert (first.calls[-1], second.calls[-1]) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert (
        pair.outside() == "second: x = 0.15 m, outside its workspace of -0.1 to 0.1 m"
    )
    # What was opened before the other failed is closed again.
    half = PairedDevice(first, _Broken((0.0, 0.0, 0.0)))
    with pytest.raises(OSError, match="gone"):
        half.open()
    assert first.calls[-2:] == ["open", "close"]


def _paired(second: dict[str, Any], pair: dict[str, Any], **first: Any) -> PairedDriver:
    """Return the driver of two virtual devices, with safety of each and of the pair."""
    members = {
        name: {
            "kind": "sim_driver",
            "parameters": {"device": {"mass": 0.1}, "hold": hold, "safety": safety},
        }
        for name, hold, safety in (("first", 0.05, first), ("second", 0.03, second))
    }
    return PairedDriver(
        setup_of(
            kind="paired_driver",
            parameters={"safety": {"hang": None, **pair}, **members},
        )
    )


def test_the_limits_of_each_hold_for_the_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    box = [[-0.1, 0.1]] * 3
    driver = _paired(
        {"peak_force": 2.0, "workspace": box},
        {"peak_force": 7.9, "workspace": [[-0.2, 0.2]] * 3},
        slew=500.0,
    )
    driver.configure()
    s = driver.driving
    assert (s.peak, s.slew) == (2.0, 500.0 * 0.002)
    assert s.device_hold_ticks == 0.03 / 0.002
    driver.pair.places = (0.0, 0.0, 0.05), (0.0, 0.0, 0.15)
    assert (
        driver.condition()
        == "second: z = 0.15 m, outside its workspace of -0.1 to 0.1 m"
    )
    # A real one has no usual limits, and declares what it must, each of the two.
    monkeypatch.setattr(SimDriver, "virtual", False)
    monkeypatch.setattr(SimDriverParameters, "_limit", lambda _: None)
    with pytest.raises(
        ParameterError, match=r"^driver\.second: the device declares no workspace"
    ):
        _paired(
            {}, {"peak_force": 7.9, "workspace": [[-0.2, 0.2]] * 3}, workspace=box
        ).configure()
    _paired(
        {},
        {"peak_force": 7.9, "workspace": box, "without": ["workspace"]},
        workspace=box,
    ).configure()


def written(start: str) -> Any:
    """Return the page's code block with a given first line."""
    page = (ROOT / "nodes" / "driver" / "DEVICES.md").read_text(encoding="utf-8")
    (text,) = (
        text
        for text in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
        if text.startswith(start)
    )
    return yaml.safe_load(text)


def two(tmp_path: Path, stack: ExitStack, kinds: tuple[str, str]) -> list[Bench]:
    """Set up two emulators, each in its own folder, as on the page."""
    found = []
    for name, kind in zip(("a", "b"), kinds, strict=True):
        (tmp_path / name).mkdir()
        found.append(stack.enter_context(bench(kind, tmp_path / name)))
    return found


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize(
    "kinds",
    [
        ("force_dimension_driver", "force_dimension_driver"),
        ("inverse3_driver", "touch_driver"),
    ],
    ids="+".join,
)
def test_two_chains_of_real_devices_in_one_launch(
    kinds: tuple[str, str], tmp_path: Path
) -> None:
    content = written("summary: Two devices at two walls")
    with ExitStack() as stack:
        left, right = two(tmp_path, stack, kinds)
        for name, stand in (("left", left), ("right", right)):
            # As the page has it, on the stand-in.
            content["nodes"][f"{name}/driver"] = {
                "kind": stand.kind,
                "parameters": stand.written(),
            }
        path = tmp_path / "two.yaml"
        path.write_text(json.dumps(content), encoding="utf-8")
        with running(tmp_path, str(path)) as launch:
            # The wall stands at 20 mm: one device 1 mm, the other 2 mm behind it.
            left.world.state.position[0], right.world.state.position[0] = 0.021, 0.022
            left.world.state.buttons, right.world.state.buttons = 1, 0
            wait_for(
                lambda: left.world.force()[0] == pytest.approx(-1.0, abs=1e-9),
                "its own force",
            )
            wait_for(
                lambda: right.world.force()[0] == pytest.approx(-2.0, abs=1e-9),
                "its own force",
            )
            nodes = json.loads(
                typed(launch, "node", "list", "--json").stdout.splitlines()[-1]
            )["nodes"]
            assert {
                f"{name}/{node}"
                for name in ("left", "right")
                for node in ("driver", "coupling")
            } <= set(nodes)
            assert len({node["pid"] for node in nodes.values()}) == len(nodes)
            topics = set(
                json.loads(typed(launch, "topic", "list", "--json").stdout)["topics"]
            )
            assert {
                "/left/device/state",
                "/right/device/state",
                "/left/device/handle",
                "/right/device/handle",
            } <= topics
            for name, pressed in (("left", 1), ("right", 0)):
                told = typed(
                    launch,
                    "topic",
                    "echo",
                    f"/{name}/device/handle",
                    "--once",
                    "--json",
                ).stdout
                assert json.loads(told.splitlines()[-1])["buttons"] == pressed
            # One is unplugged: each chain's driver ends forces by itself, and the launch ends both.
            left.world.state.unplugged = 1
            launch.finish(code=1)
        assert "[left/driver] ended: " in launch.errors
        assert not any(right.world.force())
    assert len(list(tmp_path.rglob("*.mcap"))) == 2


@pytest.mark.process
@needs_cc
@pytest.mark.parametrize(
    "kinds",
    slowly(
        [
            ("touch_driver", "force_dimension_driver"),
            ("inverse3_driver", "touch_driver"),
        ],
        but=[("inverse3_driver", "touch_driver")],
    ),
    ids="+".join,
)
def test_two_devices_of_different_kinds_on_one_law(
    kinds: tuple[str, str], tmp_path: Path
) -> None:
    content = yaml.safe_load(
        (ROOT / "launch" / "hands_coupled.yaml").read_text(encoding="utf-8")
    )
    with ExitStack() as stack:
        stands = two(tmp_path, stack, kinds)
        driver = written("driver:\n  kind: paired_driver")["driver"]
        for which, stand in zip(("first", "second"), stands, strict=True):
            driver["parameters"][which] = {
                "kind": stand.kind,
                "parameters": stand.written(),
            }
        content["nodes"]["driver"] = driver
        arms = {
            "mass": 0.1,
            "damping": 1.0,
            "partner_mass": 0.1,
            "partner_damping": 1.0,
        }
        content["nodes"]["coupling"]["parameters"]["plant"] = arms
        path = tmp_path / "pair.yaml"
        path.write_text(json.dumps(content), encoding="utf-8")
        first, second = stands
        first.world.state.position[0] = second.world.state.position[0] = 0.05
        with running(tmp_path, str(path), "duration:=0") as launch:
            first.world.state.position[0] = 0.054
            wait_for(
                lambda: first.world.force()[0] == pytest.approx(-2.0, abs=1e-9),
                "4 mm of 500 N/m",
            )
            wait_for(
                lambda: second.world.force()[0] == pytest.approx(2.0, abs=1e-9),
                "the opposite",
            )
            refused = typed(
                launch, "param", "set", "coupling", "laws.pd.stiffness", "50000", code=1
            )
            assert re.search(
                r"mass 0.1 kg, damping 1 N s/m, coupled to 0.1 kg, 1 N s/m at a delay of \d",
                refused.stderr,
            )
            # One has no position any more: neither is pushed.
            second.world.state.nan = 1
            for stand in stands:
                wait_for(lambda stand=stand: not any(stand.world.force()), "no force")  # type: ignore[misc]
            second.world.state.nan = 0
            wait_for(lambda: second.world.force()[0] > 0.0, "the force comes back")
            first.world.state.cause = 1 if kinds[0] == "inverse3_driver" else 0
            first.world.state.unplugged = kinds[0] == "touch_driver"
            if kinds[0] == "touch_driver":
                launch.finish(code=1)
                assert "ended: " in launch.errors
            else:

                def told() -> bool:
                    info = json.loads(
                        typed(
                            launch, "node", "info", "driver", "--json"
                        ).stdout.splitlines()[-1]
                    )
                    return (
                        "first: the emergency brake of the Inverse3 is on"
                        in info["force"]["why"]
                    )

                wait_for(told, "whose brake it is")


def test_a_pair_is_judged_as_the_two_devices_that_it_is() -> None:
    """K's limit against polynomials of both devices, to the root's accuracy."""
    light, heavy = (
        Plant(0.002, 0.05, 0.5, 0.7, 150.0),
        Plant(0.002, 0.2, 3.0, 0.7, 100.0),
    )
    law = parse_law({"kind": "pd", "stiffness": 1.0, "damping": 1.0}, "pd")
    edges = [
        k_max(without_spring(law, 0.002), one.paired_with(other)).k_max_n_per_m
        for one, other in ((light, heavy), (heavy, light))
    ]
    assert edges[0] == pytest.approx(edges[1], rel=1e-9)
    assert edges[0] is not None
    assert (
        _exact(0.9999 * edges[0], 1.0, light, heavy)
        < 1.0
        < _exact(1.0001 * edges[0], 1.0, light, heavy)
    )


def _exact(stiffness: float, damping: float, first: Plant, second: Plant) -> float:
    """Return the largest pole of PD between two devices, without simplification."""
    one, other = held_plant(first), held_plant(second)
    numerator = np.polyadd(
        np.polymul(one.numerator, other.denominator),
        np.polymul(other.numerator, one.denominator),
    )
    late = np.polymul(
        np.polymul(one.denominator, other.denominator), [1.0, *[0.0] * (one.whole + 1)]
    )
    per_tick = damping / first.period
    law = [stiffness + per_tick, -per_tick]
    poles = np.roots(
        np.polyadd(np.polymul(late, [1.0, 0.0]), np.polymul(numerator, law))
    )
    return float(np.abs(poles).max())


@pytest.mark.slow
@needs_cc
def test_two_launches_with_a_device_each(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    with (
        bench("touch_driver", folders[0]) as left,
        bench("force_dimension_driver", folders[1]) as right,
    ):
        for stand in (left, right):
            stand.world.state.position[2] = -0.001
        with (
            running(folders[0], through(left, folders[0]), *SOFT, "duration:=0") as one,
            running(
                folders[1], through(right, folders[1]), *SOFT, "duration:=0"
            ) as other,
        ):
            # 1 mm into a floor of 150 N/m, on each by itself.
            wait_for(
                lambda: left.world.force()[2] == pytest.approx(0.15, abs=1e-9),
                "its own force",
            )
            wait_for(
                lambda: right.world.force()[2] == pytest.approx(0.15, abs=1e-9),
                "its own force",
            )
            one.interrupt()
            wait_for(lambda: not any(left.world.force()), "the first launch ends")
            wait_for(
                lambda: right.world.force()[2] == pytest.approx(0.15, abs=1e-9),
                "the other goes on",
            )
            assert json.loads(
                typed(other, "node", "list", "--json").stdout.splitlines()[-1]
            )["nodes"]["driver"]


@pytest.mark.parametrize(
    ("second", "told"),
    [
        (
            {"kind": "coupling"},
            "driver.second.kind: 'coupling' drives no single device",
        ),
        (
            {"kind": "sim_drivr"},
            "driver.second.kind: 'sim_drivr' is no installed kind of driver",
        ),
        (
            {"kind": "sim_driver", "parameters": {"device": {"mas": 0.1}}},
            "driver.second.device.mas",
        ),
        (None, "driver.second: "),
    ],
)
@pytest.mark.parametrize("device", [(), ("device:=touch_x",)])
def test_a_member_that_is_no_device_is_refused_before_anything_starts(
    second: dict[str, Any] | None, told: str, device: tuple[str, ...], tmp_path: Path
) -> None:
    content = yaml.safe_load(
        (ROOT / "launch/hands_coupled.yaml").read_text(encoding="utf-8")
    )
    parameters = content["nodes"]["driver"]["parameters"]
    parameters |= {"second": second} if second is not None else {}
    if second is None:
        del parameters["second"]
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert told in typed_in(tmp_path, "launch", str(path), *device, code=2).stderr


# -- devices that stand apart
# -------------------------------------------------------------------------------------------


def _aligned(
    step: float = 1e-3, apart: float = math.inf
) -> tuple[_Recorded, _Recorded, PairedDevice]:
    box = ((-0.1, 0.1),) * 3
    first, second = (
        _Recorded((0.03, 0.0, 0.0), workspace=box),
        _Recorded((0.0, 0.0, -0.04), workspace=box),
    )
    return (
        first,
        second,
        PairedDevice(first, second, alignment=Alignment(step=step, apart=apart)),
    )


def test_devices_that_start_apart_count_as_together_and_are_brought_there_evenly() -> (
    None
):
    """30 mm apart, 30 N were requested at tick 0."""
    first, _, pair = _aligned()
    path = [pair.read_position(seq) for seq in range(60)]
    # 50 mm in a straight line, a millimetre a tick: each part exact to a rounding of 30 or 40 mm,
    # each tick.
    shares = [min(seq / 50.0, 1.0) for seq in range(60)]
    assert path == [
        pytest.approx((0.03 * s, 0.0, 0.04 * s), abs=60 * 1e-17) for s in shares
    ]
    # A motion is felt at once, and ticks that are left out count.
    first.place = (0.05, 0.0, 0.0)
    assert pair.read_position(60) == pytest.approx((0.05, 0.0, 0.04), abs=1e-16)


def test_an_offset_may_stay_and_devices_too_far_apart_may_be_refused() -> None:
    first, _, pair = _aligned(step=0.0)
    assert pair.read_position(0) == (0.0, 0.0, 0.0)
    first.place = (0.031, 0.0, 0.0)
    assert pair.read_position(500) == pytest.approx((0.001, 0.0, 0.0), abs=1e-17)
    # At the edge, both sides: the larger part decides.
    assert _aligned(apart=0.04)[2].read_position(0) == (0.0, 0.0, 0.0)
    with pytest.raises(
        OSError,
        match=r"stand \(0.03, 0, 0.04\) m apart, limit apart: 0.0399 m; move them together",
    ):
        _aligned(apart=0.0399)[2].read_position(0)


def test_a_pair_goes_on_from_where_it_was_when_one_is_read_again_elsewhere_or_jumps() -> (
    None
):
    first, second, pair = _aligned()
    for seq in range(60):
        pair.read_position(seq)
    there = (0.03, 0.0, 0.04)
    # Lost for some ticks, and moved by 20 mm meanwhile.
    second.place = (math.nan, 0.0, -0.04)
    assert math.isnan(pair.read_position(60)[0])
    second.place = (0.02, 0.0, -0.04)
    assert pair.read_position(65) == pytest.approx(there, abs=1e-16)
    assert pair.read_position(75) == pytest.approx((0.02, 0.0, 0.04), abs=1e-16)
    assert pair.read_position(85) == pytest.approx((0.01, 0.0, 0.04), abs=1e-16)
    # Re-centred: elsewhere without a motion.
    first.jumps = 1  # type: ignore[attr-defined]
    first.place = (0.08, 0.0, 0.0)
    assert pair.read_position(86) == pytest.approx((0.01, 0.0, 0.04), abs=1e-16)
    assert pair.read_position(87) == pytest.approx((0.011, 0.0, 0.04), abs=1e-16)


@pytest.mark.process
def test_two_hands_that_start_apart_feel_no_step(tmp_path: Path) -> None:
    """30 mm apart at the start: the force grows with the offset's fading at 50 mm/s."""
    scene = yaml.safe_load((ROOT / "launch" / "hands_coupled.yaml").read_text())
    driver = scene["nodes"]["driver"]["parameters"]
    driver["second"]["parameters"]["device"] |= {"position": 0.03}
    driver["second"]["parameters"]["device"]["hand"]["path"] = [[0.0, 0.03]]
    scene["nodes"]["logger"]["parameters"] = {"path": "run.mcap", "overwrite": True}
    path = tmp_path / "apart.yaml"
    path.write_text(yaml.safe_dump(scene))
    with running(tmp_path, str(path), "duration:=0.5", ready=False) as launch:
        launch.finish()
        assert (
            "the devices stand 0.03 m apart without a motion, and are brought together at 0.05 m/s"
            in launch.errors
        )
    states = list(Recording(tmp_path / "run.mcap").messages("/device/state"))
    forces = [state.force[0] for state in states]
    assert forces[0] == 0.0
    # K·v·T + B·Δv, of 500 N/m and 1 N s/m; the hands move meanwhile, at no more than the offset
    # does.
    assert max(abs(b - a) for a, b in pairwise(forces)) < 2.0 * (
        500.0 * 0.05 * 0.002 + 1.0 * 0.05
    )


@pytest.mark.parametrize(
    ("scales", "plant"), [((2.0, 2.0), {"scale": 2.0}), ((2.0, 1.0), {})]
)
def test_two_real_devices_have_a_scale_if_it_is_one(
    scales: tuple[float, float], plant: dict[str, float]
) -> None:
    members = {
        which: {"kind": "touch_driver", "parameters": {"mapping": {"scale": scale}}}
        for which, scale in zip(("first", "second"), scales, strict=True)
    }
    assert PairedDriver.plant(members, "driver", ("x",)) == plant
