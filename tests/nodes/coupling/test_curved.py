"""Laws on curved surfaces: the effect of a history in world axes, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from messages.types import Proxy
from nodes.cli.main import main
from nodes.coupling.render import LEAST_COSINE, begin_turning, turn
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.laws import Law
from nodes.laws.multi_term import MultiTerm, Term
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha

PERIOD, RADIUS, DEPTH, SPEED = 0.002, 0.035, 2e-3, 0.2
TURN = SPEED * PERIOD / (RADIUS - DEPTH)
LAWS: dict[str, Law] = {
    "pd": PD(stiffness=800.0, damping=2.0),
    "pd_alpha": PDAlpha(
        stiffness=800.0, damping=2.0, order=1.2, taps=10, gains="physical"
    ),
    "multi_term": MultiTerm(
        stiffness=800.0,
        damping=2.0,
        terms=(Term(gain=1.0, order=1.2), Term(gain=0.5, order=0.8)),
        taps=10,
        gains="physical",
    ),
}


def led_round(name: str, frame: str, ticks: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Move a device round a sphere at constant depth; return tangential and normal forces [N]."""
    law = LAWS[name].compile(PERIOD)
    renderer = Renderer([0, 1, 2], 16)
    begin_turning(renderer.state, frame)
    renderer.law = ActiveLaw(name, name, law, renderer.histories)
    along, across = [], []
    for k in range(ticks):
        normal = np.array([np.sin(k * TURN), 0.0, np.cos(k * TURN)])
        way = np.array([np.cos(k * TURN), 0.0, -np.sin(k * TURN)])
        force = np.array(renderer.render(touching(k, normal)))
        along.append(float(force @ way))
        across.append(float(force @ normal))
    return np.array(along), np.array(across)


def touching(k: int, normal: np.ndarray, depth: float = DEPTH) -> Proxy:
    return Proxy(
        seq=k,
        stamp=0.0,
        position=tuple(((RADIUS - depth) * normal).tolist()),
        proxy=tuple((RADIUS * normal).tolist()),
        normal=tuple(normal.tolist()),
        distance=-depth,
        contact=True,
    )


@pytest.mark.parametrize("name", LAWS)
def test_a_history_in_the_worlds_axes_pushes_along_a_curved_way(name: str) -> None:
    """Round a sphere only the normal changes: tap j pulls by −h_j d sin(jθ)."""
    law = LAWS[name].compile(PERIOD)
    along, across = led_round(name, "world")
    taps = np.array(law.taps)
    ages = np.arange(len(taps)) * TURN
    # Rounding of forces of some newtons, through deflections that are differences of positions.
    assert along[-1] == pytest.approx(-DEPTH * float(taps @ np.sin(ages)), abs=1e-9)
    assert across[-1] == pytest.approx(DEPTH * float(taps @ np.cos(ages)), abs=1e-9)
    # It pushes on: a damping of −B d/(r − d) on the way, which for a spring and damper is exact as
    # the period goes to 0.
    assert along[-1] > 0.0
    if name == "pd":
        assert along[-1] == pytest.approx(
            2.0 * DEPTH * SPEED / (RADIUS - DEPTH), rel=TURN**2
        )
    assert across[-1] == pytest.approx(law.h1 * DEPTH, rel=0.01)


@pytest.mark.parametrize("name", LAWS)
def test_in_axes_that_turn_with_the_surface_the_way_is_not_felt(name: str) -> None:
    """All deflections are equal then: only the spring, no tangential force."""
    along, across = led_round(name, "surface")
    settled = len(LAWS[name].compile(PERIOD).taps)
    # Rounding of some newtons, as above.
    assert np.abs(along[settled:]).max() < 1e-9
    assert across[settled:] == pytest.approx(
        LAWS[name].compile(PERIOD).h1 * DEPTH, rel=1e-9
    )


def test_axes_stay_axes_however_long_they_turn() -> None:
    turned, upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0]
    rng = np.random.default_rng(1)
    normal = np.array([0.0, 0.0, 1.0])
    turn(turned, upright, normal.tolist(), True)
    begin = np.array(turned).reshape(3, 3) @ normal
    for _ in range(20_000):
        normal = normal + 0.05 * rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        turn(turned, upright, normal.tolist(), True)
    axes = np.array(turned).reshape(3, 3)
    # 20 000 turns, each with some roundings; they add up as a random walk, and lengths are mended.
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert axes @ normal == pytest.approx(begin, abs=1e-12)


def test_at_an_edge_and_off_the_surface_the_axes_stay() -> None:
    turned, upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0]
    turn(turned, upright, (0.0, 0.0, 1.0), True)
    turn(turned, upright, (1.0, 0.0, 0.0), True)
    assert np.array_equal(np.reshape(turned, (3, 3)), np.eye(3))
    # A step just under the limit turns; what comes after a gap in the contact does not.
    angle = 0.99 * np.arccos(LEAST_COSINE)
    turn(turned, upright, (np.cos(angle), np.sin(angle), 0.0), True)
    after = list(turned)
    assert np.arccos(after[0]) == pytest.approx(angle, rel=1e-9)
    turn(turned, upright, (1.0, 0.0, 0.0), False)
    turn(turned, upright, (1.0, 0.0, 0.0), True)
    assert turned == after


def test_a_frame_may_change_while_a_law_renders() -> None:
    """The force continues without a jump, though the axes turn by a right angle."""
    law = LAWS["pd"].compile(PERIOD)
    renderer = Renderer([0, 1, 2], 16)
    begin_turning(renderer.state, "auto")
    renderer.law = ActiveLaw("pd", "pd", law, renderer.histories)
    for k in range(130):
        normal = np.array([np.sin(k * TURN), 0.0, np.cos(k * TURN)])
        force = renderer.render(touching(k, normal))
    begin_turning(renderer.state, "world")
    still = renderer.render(touching(130, normal))
    assert still == pytest.approx(force, abs=1e-9)
    assert np.array(still) @ normal == pytest.approx(law.h1 * DEPTH, rel=1e-9)


def test_axes_that_turn_need_all_three(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "given.yaml"
    given.write_text("coupling: {frame: surface}", encoding="utf-8")
    assert (
        main(
            [
                "launch",
                "floor_drop",
                "--params",
                str(given),
                "pace:=lockstep",
                "duration:=0.1",
            ]
        )
        == 2
    )
    told = capfd.readouterr().err
    assert "coupling.frame" in told
    assert "run.axes is [z]" in told
