"""The guard's accounts: friction does not pay for the normal; a partner's energy counts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.driver.passivity import PassivityParameters, count_step, guarded, set_guard
from nodes.launcher import launch_file
from nodes.recording.reader import Recording
from sim.play.player import play
from sim.play.trace import ChainTrace
from tests.support import ROOT
from tests.support.launching import launch_json
from tests.support.safety import state_of

STIFF = 6000.0  # beyond what PD bears here without the guard [N/m]
# of launch/rough_plane.yaml
NORMAL = np.array([-0.3, 0.1, 0.95]) / np.linalg.norm([-0.3, 0.1, 0.95])


def _rubbed(friction: float) -> Any:
    launch = launch_file.read(
        "rough_plane",
        {
            "duration": 2.0,
            "stiffness": STIFF,
            "friction": friction,
            "sliding": 0.66 * friction,
            "law": "pd",
            "pace": "lockstep",
        },
    )
    driver, coupling = launch.nodes["driver"], launch.nodes["coupling"]
    guard = {"guard": "on", "stiffness": STIFF, "damping": 5.0}
    watched = {"parameters": {**driver.parameters, "passivity": guard}}
    unjudged = {"parameters": {**coupling.parameters, "stability": "off"}}
    nodes = {
        **launch.nodes,
        "driver": msgspec.structs.replace(driver, **watched),
        "coupling": msgspec.structs.replace(coupling, **unjudged),
    }
    return msgspec.structs.replace(launch, nodes=nodes)


def _chatter(trace: ChainTrace) -> float:
    """Rms speed along the normal while the hand presses and slides [m/s]."""
    speed = np.diff(trace.position @ NORMAL)[300:900] / 0.002
    return float(np.sqrt((speed**2).mean()))


def test_a_rubbing_surface_does_not_pay_for_an_unstable_normal() -> None:
    smooth, rough = _chatter(play(_rubbed(0.0))), _chatter(play(_rubbed(0.3)))
    # With one account friction fed the normal: 52 mm/s against 22. Friction itself may not add to
    # what is left.
    assert rough < 1.2 * smooth


@pytest.mark.slow
def test_a_launch_of_it_has_the_bits_of_one_process(tmp_path: Path) -> None:
    launch = _rubbed(0.3)
    text = yaml.safe_load(
        (ROOT / "launch" / "rough_plane.yaml").read_text(encoding="utf-8")
    )
    nodes = {
        name: {"kind": spec.kind, "parameters": spec.parameters}
        for name, spec in launch.nodes.items()
    }
    own = {
        "summary": text["summary"],
        "run": {"duration": 2.0, "pace": "lockstep", "axes": ["x", "y", "z"]},
        "nodes": nodes,
    }
    (tmp_path / "rubbed.yaml").write_text(yaml.safe_dump(own), encoding="utf-8")
    ended = launch_json(tmp_path, "./rubbed.yaml", "run.tick:=compiled")
    states = Recording(tmp_path / ended["recording"]).messages("/device/state")
    played = play(launch)
    # The last state is of the tick after the last one, which has no answer any more.
    assert np.array_equal(
        np.array([state.position for state in states[:-1]]), played.position
    )


@given(data=st.data())
@settings(max_examples=50)
def test_both_accounts_hold_the_bound_of_one_axis_each(data: st.DataObject) -> None:
    """E_{k+1} ≤ max(E_k, 0) + F_k·(Δ_{k+1} − Δ_k), normal and tangential separately."""
    s = state_of((0, 1, 2))
    s.elapsed = 1
    set_guard(s, PassivityParameters())
    rng = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    s.got_normal[:] = s.normal[:] = normal
    position, last, force = np.zeros(3), np.zeros(3), np.zeros(3)
    before = np.zeros(2)
    for _ in range(60):
        moved = last + rng.normal(scale=1e-3, size=3)
        s.before[:], s.position[:], s.acted[:] = position, position + moved, force
        count_step(s)
        position = position + moved
        change = moved - last
        along = float(force @ normal) * float(change @ normal)
        across = float(force @ change) - along
        # Rounding of a few products of some newtons and millimetres.
        assert s.guard_energy[0] <= max(before[0], 0.0) + along + 1e-14
        assert s.guard_energy[1] <= max(before[1], 0.0) + across + 1e-14
        last = moved
        s.wanted[:] = rng.normal(scale=5.0, size=3)
        guarded(s, 0.0)
        before = np.array(s.guard_energy[:2])
        force = np.array(s.wanted[:])


@given(seed=st.integers(0, 10_000), loss=st.floats(0.0, 0.9), late=st.integers(0, 12))
@settings(max_examples=40)
def test_partners_together_give_out_no_more_than_was_put_in(
    seed: int, loss: float, late: int
) -> None:
    """Whatever laws and hands do, a network with loss and delay makes no energy."""
    rng = np.random.default_rng(seed)
    sides = [state_of((0,)), state_of((0,))]
    for s in sides:
        s.elapsed = 1
        set_guard(s, PassivityParameters(stiffness=500.0))
    steps, forces, positions = np.zeros(2), np.zeros(2), np.zeros(2)
    under_way: list[list[tuple[int, float]]] = [[], []]
    given_out = explained = 0.0
    for k in range(300):
        moved = 0.9 * steps + rng.normal(scale=2e-4, size=2)
        given_out += float(forces @ moved)
        # What nobody can know when a force is chosen: by how much the step changes.
        explained += float(np.maximum(forces * (moved - steps), 0.0).sum())
        for n, s in enumerate(sides):
            s.before[0], s.position[0], s.acted[0] = (
                positions[n],
                positions[n] + moved[n],
                forces[n],
            )
            count_step(s)
            if rng.random() >= loss:
                under_way[1 - n].append(
                    (k + int(rng.integers(late + 1)), s.guard_surplus)
                )
        positions, steps = positions + moved, moved
        for n, s in enumerate(sides):
            arrived = [credit for at, credit in under_way[n] if at <= k]
            under_way[n] = [one for one in under_way[n] if one[0] > k]
            # Sums that overtake each other are taken as the environment takes them: only what is
            # newer counts.
            s.got_credit = max([s.got_credit, *arrived])
            s.wanted[0] = rng.normal(scale=3.0)
            guarded(s, 0.0)
            forces[n] = s.wanted[0]
        assert given_out <= explained + 1e-12


def test_credit_is_given_out_once_and_a_sum_that_begins_anew_gives_nothing() -> None:
    s = state_of((0,))
    s.elapsed = 1
    set_guard(s, PassivityParameters())
    s.guard_step[0] = 1e-3

    def force(credit: float) -> float:
        s.got_credit = credit
        s.wanted[0] = 2.0
        guarded(s, 0.0)
        return float(s.wanted[0])

    # the first sum is where a partner stands, not what it gave to us
    assert force(0.5) == 0.0
    # 1 mJ over a step of 1 mm; rounding of 0.501 − 0.5
    assert force(0.501) == pytest.approx(1.0, rel=1e-12)
    # nothing moved: it is still there, and no more than that
    assert force(0.501) == pytest.approx(1.0, rel=1e-12)
    assert force(0.2) == pytest.approx(1.0, rel=1e-12)  # the partner was started again
    assert force(0.201) == 2.0  # and has put in 1 mJ more: 2 mJ in store
