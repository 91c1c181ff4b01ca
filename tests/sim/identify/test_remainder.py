"""Significance is not relevance: a residual's effect on K_max decides on refutation."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from sim.device.model import DeviceModel
from sim.identify import identified_motion as motion
from sim.identify.alterations import stiffest
from sim.identify.choose_model import RicherFit, _best
from sim.identify.experiment import lockstep
from sim.identify.identified import Identified, refusal
from sim.identify.identified_text import figures, from_figures, text, verdict
from sim.identify.identify import identify
from sim.identify.output_error import Fit
from sim.identify.remainder import REFUSED, _by_parts, plant_of, reference_gain
from sim.lab.monte_carlo.outside import k_max_off, named, outcome, summary_outside
from sim.lab.monte_carlo.study import FAR, NAMED
from sim.lab.monte_carlo.virtual import draw_outside, excite_outside
from sim.play.nonideal import NonidealDevice
from sim.play.nonideal import pushed as play_pushed
from tests.support import slowly

T = 0.002
RIGID = DeviceModel(mass=0.1, damping=1.0, friction=0.03, delay=1.2, resolution=23e-6)


def pushed(seed: int = 1, **odd: Any) -> tuple[NonidealDevice, Identified]:
    device = NonidealDevice(RIGID, **odd)
    return device, identify(excite_outside(device, T, 4.0, seed=seed))


# What a referee found refuted with p down to 1e-130, and how it should be named.
SMALL: dict[str, tuple[dict[str, Any], str]] = {
    "cogging of 1 mN": ({"cogging": 0.001}, "a force that repeats"),
    "gain by sign, 0.3 %": ({"gain_by_sign": 0.003}, "more force one way"),
    "half a step of eccentricity": (
        {"ripple": 11.5e-6, "pitch": 0.02},
        "an encoder error that repeats",
    ),
    "force steps of 5 mN": ({"force_step": 0.005}, "in steps"),
}


@pytest.mark.parametrize("name", SMALL)
def test_what_changes_nothing_is_reported_and_the_device_is_identified(
    name: str,
) -> None:
    odd, words = SMALL[name]
    device, found = pushed(**odd)
    assert found.whiteness is not None
    # It is seen: the model was refuted for it.
    assert found.remainder
    assert not found.refuted
    assert refusal(found) is None
    # whose grid of sizes names them as what repeats as well
    if name != "force steps of 5 mN":
        assert words in found.remainder
    off = k_max_off(device, found, T)
    assert off is not None
    assert off <= 0.01
    # What it says the remainder may do is at least what it did, within what the intervals say of
    # the rest.
    assert found.remainder_k_max <= REFUSED
    for parameter, truth in {"mass": 0.1, "damping": 1.0, "delay": 1.2}.items():
        value, low, high = getattr(found, parameter).known()
        assert abs(value - truth) <= FAR * 0.5 * (high - low), parameter
    assert "holds for a design" in verdict(found)
    assert f"{100.0 * found.remainder_k_max:.2g} %" in text(found).splitlines()[0]
    assert from_figures(json.loads(json.dumps(figures(found)))) == found


@pytest.mark.parametrize(
    ("odd", "words"),
    [
        ({"gain_by_sign": 0.06}, "more force one way"),
        ({"warming": 0.6}, "changes during"),
    ],
)
def test_what_may_change_k_max_by_more_than_its_share_is_refused(
    odd: dict[str, Any], words: str
) -> None:
    _, found = pushed(**odd)
    assert found.refuted
    assert found.remainder_k_max > REFUSED
    assert words in found.why
    assert "it may change K_max by" in found.why
    # What the best fit has is kept for who asks for it.
    assert found.anyway().mass.value == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("part", slowly([0.5, 0.25], but=[0.5]))
def test_a_sensor_that_averages_is_no_joint(part: float) -> None:
    """It was reported as a joint of 135 Hz, 120 to 151, and accepted."""
    device, found = pushed(average=part)
    assert found.terms == ("sensor filter",)
    assert found.frequency.value is None
    assert found.average.value == pytest.approx(part, abs=0.05)
    # Its mean delay is in the delay.
    value, low, high = found.delay.known()
    assert abs(value - 1.2 - part) <= FAR * 0.5 * (high - low)
    off = k_max_off(device, found, T)
    assert off is not None
    # A delay in place of the average: 1 − cos² of half the angle at the edge, about 0.4 rad.
    assert off < 0.03
    assert from_figures(json.loads(json.dumps(figures(found)))) == found


def test_a_joint_is_taken_only_where_it_beats_a_term_of_one_unknown_beyond_chance() -> (
    None
):
    """A blur resembles a stiff joint with much loss, whose frequency would be told to 1 Hz."""
    fitted: Any = None
    rng = np.random.default_rng(1)
    blur = rng.uniform(0.9, 1.1, 12)
    a_little, much = blur - rng.normal(1e-3, 0.01, 12), 0.5 * blur
    lag = RicherFit(blur, fitted, "actuator lag")
    joint = RicherFit(a_little, fitted, "flexible mode")
    assert _best([lag, joint]) is lag
    square = RicherFit(1.5 * blur, fitted, "quadratic damping")
    assert _best([square, joint, lag]) is lag
    wild = RicherFit(1.5 * blur + 5.0 * (np.arange(12) == 3), fitted, "actuator lag")
    assert _best([wild, joint]) is joint
    clear = RicherFit(much, fitted, "flexible mode")
    assert _best([lag, clear]) is clear
    assert _best([joint]) is joint
    assert _best([]) is None
    better = RicherFit(0.9 * a_little, fitted, "sensor filter")
    assert _best([lag, joint, better]) is better


@pytest.mark.slow
def test_a_gap_is_not_told_as_a_joint() -> None:
    """Seed 2, device 1: a joint with backlash was found as another one, 31 half widths off."""
    device = draw_outside("backlash", 1, 2)
    found = identify(excite_outside(device, T, 8.0, 1))
    assert found.refuted or found.frequency.value is None


@pytest.mark.slow
def test_a_joint_does_not_hide_behind_something_small() -> None:
    """With --refuted always set, because every device cogs, a joint passed."""
    _, found = pushed(cogging=0.001, share=0.3, frequency=60.0, loss=0.03)
    assert found.terms == ("flexible mode",)
    assert found.frequency.value == pytest.approx(60.0, rel=5e-3)
    assert found.refuted or "repeats" in found.remainder


def test_a_record_of_an_earlier_version_is_read() -> None:
    _, found = pushed()
    record = json.loads(json.dumps(figures(found)))
    for key in ("remainder", "sensor_average"):
        del record[key]
    read = from_figures(record)
    assert read.remainder == ""
    assert read.average.value == 0.0
    assert read.mass == found.mass


@pytest.mark.parametrize("average", [0.0, 0.3, 0.5])
def test_k_max_behind_a_sensor_that_averages_is_the_edge_of_the_poles(
    average: float,
) -> None:
    plant = FlexiblePlant(0.1, 1.0, 0.7)
    gain = reference_gain(plant, T)
    edge = stiffest(plant, T, gain, average)
    assert edge is not None
    for share, stable in ((0.9999, True), (1.0001, False)):
        taps = np.convolve(
            [share * edge + gain / T, -gain / T], [1.0 - average, average]
        )
        assert (
            flexible_radius(CompiledLaw(tuple(taps.tolist())), T, plant) < 1.0
        ) is stable


@pytest.mark.parametrize("spring", [-150.0, 150.0])
def test_k_max_beside_a_spring_of_the_device_is_the_edge_of_the_poles(
    spring: float,
) -> None:
    """Of either sign, acting without the loop's delay; what pushes away has to be held first."""
    plant = FlexiblePlant(0.1, 1.0, 0.7, stiffness=spring)
    gain = reference_gain(plant, T)
    edge = stiffest(plant, T, gain)
    assert edge is not None
    shares = [(0.9999, True), (1.0001, False)]
    if spring < 0.0:
        shares.append((0.99 * -spring / edge, False))
    for share, stable in shares:
        law = CompiledLaw((share * edge + gain / T, -gain / T))
        assert (flexible_radius(law, T, plant) < 1.0) is stable


def test_friction_that_builds_up_is_a_spring_of_the_device_and_not_of_the_law() -> None:
    """It was refused for 14 % of K_max; played, the device rests at 0.97 of the fit's K_max."""
    device = draw_outside("presliding", 5, 6)
    found = identify(excite_outside(device, T, 4.0, seed=5))
    assert not found.refuted
    assert "presliding" in found.remainder
    plant = found.plant()
    gain = reference_gain(plant, T)
    edge = stiffest(plant, T, gain)
    assert edge is not None
    fine = replace(
        device, rigid=msgspec.structs.replace(device.rigid, resolution=1e-12)
    )
    law = np.array([0.97 * edge + gain / T, -gain / T])
    for start in (0.2, 3.0, 30.0):
        seen, _ = play_pushed(
            fine, T, np.zeros(4000), law, (0.0, 1e9, 1e6, start * device.presliding), 1
        )
        assert float(np.ptp(seen[-500:])) < 1e-3 * device.presliding


@pytest.mark.parametrize(("drift", "part"), [(0.0, 0.5), (1.0, 0.9)])
def test_of_what_quarters_differ_by_chance_the_fit_has_half(
    drift: float, part: float
) -> None:
    """White votes count half of their spread between quarters, a change in time in full."""
    rng, windows = np.random.default_rng(3), 400
    free = np.array([motion.MOBILITY, motion.DAMPING])
    theta = np.zeros(12)
    theta[free] = 10.0, 10.0
    sides = rng.normal(0.0, 1.0, (windows, 2))
    sides += drift * np.linspace(-3.0, 3.0, windows)[:, None]
    found = Fit(
        theta,
        free,
        np.zeros((windows, 4)),
        np.ones(windows),
        np.repeat(np.eye(2)[None], windows, axis=0),
        sides,
        np.arange(windows) * 5,
        5,
    )
    experiment = lockstep(T, rng.normal(size=5 * windows), np.zeros(5 * windows))
    plant = plant_of(experiment, found)
    gain = reference_gain(plant, T)
    here = stiffest(plant, T, gain)
    assert here is not None
    change, _, devices = _by_parts(experiment, found, here, gain)
    alone = [stiffest(device.plant, T, gain) for device in devices]
    most = max(abs((there or 0.0) / here - 1.0) for there in alone)
    assert change == pytest.approx(part * most, rel=0.4 if drift == 0.0 else 0.12)


def row(**changes: Any) -> dict[str, Any]:
    whole = {
        "kind": "cogging",
        "refuted": False,
        "why": "",
        "terms": [],
        "remainder": "",
        "k_max_off": 0.001,
        "off": {"mass": 0.5},
    }
    return whole | changes


def test_both_errors_are_counted() -> None:
    """False certainty (missed or wrong K_max), and needless refusal of a useful fit."""
    rows = [
        row(),
        row(remainder="a force that repeats every 8 mm"),
        row(refuted=True, off={}, why="the data ask for a force that repeats"),
        row(refuted=True, off={}, k_max_off=0.2),
        row(refuted=True, off={}, k_max_off=None),
        row(off={"mass": FAR + 0.1}),
        row(k_max_off=0.06),
    ]
    assert [outcome(one) for one in rows] == [
        "rigid",
        "reported",
        "refused",
        "refused",
        "refused",
        "false",
        "false",
    ]
    assert [named(one) for one in rows] == [
        False,
        True,
        True,
        False,
        False,
        False,
        False,
    ]
    found = summary_outside(rows)
    total = found.total
    assert (total.false, total.refused, total.good, total.needless) == (2, 3, 4, 1)
    assert found.kinds["cogging"].false_of == ("K_max", "moving mass")
    assert "cogging" in NAMED
