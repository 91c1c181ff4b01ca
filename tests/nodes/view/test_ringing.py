"""Ringing is a force that generates energy at every stroke, at any frequency."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from nodes.driver.force_words import explain
from nodes.launcher import launch_file
from nodes.laws.parse import parse_law
from nodes.view.law_edges import edge_of_law
from nodes.view.ringing import FADING, SLOWEST, Ring, Ringing, ring_of
from nodes.view.stability_map import plant_of
from sim.play.given import Given
from sim.play.player import play
from tests.support.touching import FORCE, PROXY, STATE

T = 0.002


def swung(hertz: float, late: float, seconds: float = 1.2) -> Ring | None:
    """Return how a one-sided spring rings whose force lags its position by `late` radians."""
    time = np.arange(0.0, seconds, T)
    angle = 2.0 * math.pi * hertz * time
    position = 1e-3 * np.sin(angle)
    force = -2.0 * np.maximum(0.0, np.sin(angle - late))
    energy = np.concatenate([[0.0], np.cumsum(force[:-1] * np.diff(position))])
    watched = Ringing()
    for k in range(len(time)):
        watched.take(
            float(time[k]),
            (float(position[k]), 0.0, 0.0),
            (float(force[k]), 0.0, 0.0),
            float(energy[k]),
        )
    return watched.ring()


@pytest.mark.parametrize("hertz", [5.0, 9.0, 20.0, 60.0, 160.0])
def test_a_force_that_lags_rings_and_one_that_leads_absorbs(hertz: float) -> None:
    """A force is held for a tick, which alone lags by half of one."""
    late = 0.5 * 2.0 * math.pi * hertz * T
    found = swung(hertz, 0.3)
    assert found is not None
    # Turns lie on whole ticks: a part of T·hertz of a cycle at each end of a stroke.
    assert found.frequency == pytest.approx(hertz, rel=0.02 + 2.0 * hertz * T)
    assert found.force == pytest.approx(2.0, rel=0.1)
    assert swung(hertz, -late - 0.3) is None
    words = explain(STATE, PROXY, FORCE, 0.0, "", str(found))[1]
    told = f"It rings at {found.frequency:.0f} Hz, up to {found.force:.1f} N: this wall"
    assert words.startswith(told)


@pytest.mark.parametrize("part", [1.0, 0.6, 0.3])
def test_pulses_of_two_sizes_ring_as_often_as_they_come_back(part: float) -> None:
    """As a law that bounces off the wall; the smaller pulse was taken for one that settles."""
    hertz, late, seconds = 20.0, 0.3, 1.2
    time = np.arange(0.0, seconds, T)
    angle = 2.0 * math.pi * hertz * time
    # Every other cycle is smaller; each begins and ends in the free, where the force is 0.
    size = np.where(np.floor((angle - late) / (2.0 * math.pi)) % 2 < 1, 1.0, part)
    position = 1e-3 * size * np.sin(angle)
    force = -2.0 * size * np.maximum(0.0, np.sin(angle - late))
    energy = np.concatenate([[0.0], np.cumsum(force[:-1] * np.diff(position))])
    watched = Ringing()
    for t, x, f, e in zip(time, position, force, energy, strict=True):
        watched.take(float(t), (float(x), 0.0, 0.0), (float(f), 0.0, 0.0), float(e))
    found = watched.ring()
    assert found is not None
    pairs = 1.0 if part >= FADING else 2.0
    # Turns lie on whole ticks, as above.
    assert found.frequency == pytest.approx(hertz / pairs, rel=0.02 + 2.0 * hertz * T)
    assert found.force == pytest.approx(2.0, rel=0.1)


def test_pulses_of_two_sizes_that_settle_do_not_ring() -> None:
    """Each pair is smaller than the one before by more than `FADING`."""
    watched, energy = Ringing(), 0.0
    for k in range(600):
        angle = 0.25 * k
        n = math.floor(angle / (2.0 * math.pi))
        size = 4.0 * 0.6 ** (n // 2) * (0.6 if n % 2 else 1.0)
        force = -size * max(0.0, math.sin(angle))
        watched.take(
            k * T, (1e-3 * math.sin(angle), 0.0, 0.0), (force, 0.0, 0.0), energy
        )
        energy += 1e-6
        assert watched.ring() is None


def test_a_designed_law_that_bounces_past_its_edge_rings() -> None:
    """Two ticks late it hits the wall twice in a period of 32 ticks, once a quarter as hard."""
    driver = launch_file.read("touch_wall", {}).nodes["driver"].parameters
    plant = plant_of(None, {**driver, "device": {**driver["device"], "delay": 2.0}})
    assert plant is not None
    law = parse_law({"kind": "designed_d1"})
    edge = edge_of_law(law, plant.over_workspace(T, 0.0))
    assert edge is not None
    by = 1.25 * edge / law.compile(T).h1
    taps = [by * tap for tap in law.compile(T).taps]
    trace = pressed_wall({"kind": "fir", "taps": taps}, 2.0, 3.0)
    force = trace.force[:, 0]
    found = ring_of(trace.measured[:, 0].tolist(), force.tolist(), T, 2.0)
    assert found is not None
    # The period by the force itself: where it fits best to its own past.
    end = force[-500:] - force[-500:].mean()
    fits = [float(end[lag:] @ end[:-lag]) / (500 - lag) for lag in range(10, 60)]
    assert found.frequency == pytest.approx(
        1.0 / (T * (10 + int(np.argmax(fits)))), rel=0.05
    )


def test_what_a_hand_does_is_no_ringing() -> None:
    """Slower than `SLOWEST`; and once it is over it rings no more."""
    assert swung(0.9 / SLOWEST, 0.3, 3.0) is None
    watched = Ringing()
    position = [1e-3 * math.sin(0.25 * k) for k in range(500)] + [0.0] * 200
    force = [2.0 * -math.sin(0.25 * k - 0.3) for k in range(500)] + [0.0] * 200
    heard, energy = [], 0.0
    for k in range(700):
        watched.take(k * T, (position[k], 0.0, 0.0), (force[k], 0.0, 0.0), energy)
        heard.append(watched.ring())
        energy += force[k] * (position[min(k + 1, 699)] - position[k])
    assert heard[499] is not None
    assert heard[500 + math.ceil((SLOWEST + 0.05) / T)] is None
    # In the past of a recording there is no before.
    watched.take(0.0, (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.0)
    assert watched.ring() is None


def test_noise_on_a_force_is_no_ringing() -> None:
    watched = Ringing()
    for k in range(500):
        force = -3.0 + 0.3 * math.sin(2.9 * k)
        watched.take(k * T, (0.021, 0.0, 0.0), (force, 0.0, 0.0), 0.0)
    assert watched.ring() is None


def pressed_wall(law: dict[str, Any], delay: float, seconds: float) -> Any:
    """Return a wall that a hand presses, answered late [ticks]."""
    launch = launch_file.read("touch_wall", {})
    nodes = {name: spec for name, spec in launch.nodes.items() if name != "logger"}
    driver, coupling = nodes["driver"].parameters, nodes["coupling"].parameters
    late = {**driver, "device": {**driver["device"], "delay": delay}}
    nodes["driver"] = msgspec.structs.replace(nodes["driver"], parameters=late)
    warned = {**coupling, "stability": "warn", "law": "own", "laws": {"own": law}}
    nodes["coupling"] = msgspec.structs.replace(nodes["coupling"], parameters=warned)
    time = np.arange(0.0, seconds, T)
    target = 0.016 + 0.012 * np.minimum(time, 1.0)
    return play(
        msgspec.structs.replace(launch, nodes=nodes),
        ticks=len(time),
        given=Given(target=target),
    )


@pytest.mark.parametrize("delay", [0.0, 0.5, 3.0, 8.0])
def test_a_loop_rings_past_its_edge_and_not_at_half_of_it(delay: float) -> None:
    """Also by delay alone, at 9 Hz; the edge is that of the poles."""
    driver = launch_file.read("touch_wall", {}).nodes["driver"].parameters
    plant = plant_of(None, {**driver, "device": {**driver["device"], "delay": delay}})
    assert plant is not None
    law = parse_law({"kind": "pd", "stiffness": 1000.0, "damping": 3.0})
    edge = edge_of_law(law, plant.over_workspace(T, 0.0))
    assert edge is not None
    found = {}
    for by in (0.5, 1.1):
        hard = {"kind": "pd", "stiffness": by * edge, "damping": 3.0}
        trace = pressed_wall(hard, delay, 3.0)
        x, f = trace.measured[:, 0].tolist(), trace.force[:, 0].tolist()
        found[by] = ring_of(x, f, T, delay)
    assert found[0.5] is None
    assert found[1.1] is not None
    assert 5.0 < found[1.1].frequency < 40.0
