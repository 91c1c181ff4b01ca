"""One drop everywhere: Python, command line, launch and designer agree; laws with code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import haptic
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.launcher import launch_file
from nodes.laws import CompiledLaw, Law
from nodes.laws.pd import PD
from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.fall import falls, settled
from sim.experiments.drop import CONVENTION, drop_scene, held
from sim.experiments.k_max_simulated import at_stiffness, simulated_k_max
from sim.experiments.settling import Criterion, settles
from sim.lab.charts.integrators import drop as integrated
from sim.lab.charts.integrators import integrators
from sim.play.launched import from_launch
from sim.play.one_axis import run

T = 0.002
PLANT = Plant(T, 0.1, 1.0)


class DeadBand(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A spring and a damper beyond a dead band, entirely in code.

    stiffness: K beyond the band [N/m].
    damping: B [N s/m].
    width: of the band [m].
    """

    kind: ClassVar[str] = "deadband"
    stiffness: float
    damping: float = 3.0
    width: float = 0.001

    def compile(self, period: float) -> CompiledLaw:
        """Compile to code only."""

        def force(ring: Sequence[float], head: int) -> float:
            depth = ring[head] - self.width
            if depth < 0.0:
                return 0.0
            return (
                self.stiffness * depth
                + self.damping * (ring[head] - ring[head + 1]) / period
            )

        return CompiledLaw((0.0, 0.0), evaluate=force)


class Nameless(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A spring in code whose stiffness has another name.

    rate: K [N/m].
    """

    kind: ClassVar[str] = "nameless"
    rate: float

    def compile(self, period: float) -> CompiledLaw:
        """Compile the spring to code."""
        del period
        return CompiledLaw((0.0,), evaluate=lambda ring, head: self.rate * ring[head])


class Limited(PD, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """PD that refuses more than 500 N/m."""

    kind: ClassVar[str] = "limited"

    def compile(self, period: float) -> CompiledLaw:
        """Refuse too large stiffness."""
        if self.stiffness > 500.0:
            raise ValueError(f"stiffness: {self.stiffness:g} N/m, at most 500")
        return super().compile(period)


def test_a_launch_s_floor_and_every_other_drop_have_the_convention_of_the_coupling() -> (
    None
):
    launched = from_launch(launch_file.read("floor_drop", {})).scene
    assert (launched.raw, launched.clamp) == CONVENTION
    ours = drop_scene(held(PLANT), T)
    assert (ours.raw, ours.clamp) == CONVENTION


@settings(max_examples=12, deadline=None)
@given(st.floats(1.0, 40.0), st.floats(0.6, 1.1), st.floats(0.002, 0.02))
def test_python_the_command_line_and_the_designer_drop_alike(
    damping: float, share: float, height: float
) -> None:
    """Also where only a pulling wall settles: 14 500 N/m for 12 300 at B 21 N s/m."""
    law = PD(stiffness=share * 450.0 * damping, damping=damping)
    taps = law.compile(T)
    told = haptic.drop(law, PLANT, height, ticks=2500).settled
    assert (
        told
        == settles(drop_scene(held(PLANT), T, height=height), [taps], Criterion(2500))[
            0
        ]
    )
    asked = Demand((0.1, 0.1), 1.0, (0.0, 0.0), T, 0.99, 1e6)
    # A drop that the last bit decides may differ: two maps of one tick, each rounded in its own
    # order.
    near = {
        settled(taps, falls(asked, [mass], [CONVENTION], [height]))[0]
        for mass in (0.1, 0.1 * (1.0 + 1e-9))
    }
    assert told in near


def test_a_wall_that_pulls_is_asked_for() -> None:
    """13 400 N/m lies between the two limits, 12 300 and 14 500 N/m."""
    stiff = PD(stiffness=13_400.0, damping=21.0)
    assert not haptic.drop(stiff, PLANT, ticks=2500).settled
    pulled = haptic.drop(stiff, PLANT, ticks=2500, clamp=False)
    assert pulled.settled
    assert (
        pulled.force_n.min()
        < 0.0
        <= haptic.drop(stiff, PLANT, ticks=2500).force_n.min()
    )
    with pytest.raises(ValueError, match="history is 'raw'"):
        haptic.drop(stiff, PLANT, history="raw")  # type: ignore[arg-type]


def test_the_integrators_drop_is_the_simulator_s() -> None:
    law = PD(stiffness=400.0, damping=1.0)
    trace = run(drop_scene(held(PLANT), T, height=0.005), law.compile(T), 250)
    # Two ways to write one exact map, 250 times rounded.
    assert integrated(integrators()["exact map"], 250) == pytest.approx(
        trace.position, abs=1e-12
    )


@pytest.mark.parametrize("cubic", [0.0, 1e7, 1e8, 1e9])
def test_a_law_with_code_of_its_own_settles_where_its_forces_balance(
    cubic: float,
) -> None:
    """EXTENDING's law: K x + C x³ = m g has one root, where the drop rests."""

    class Stiffening(Law, frozen=True, kw_only=True):
        kind: ClassVar[str] = "stiffening"
        stiffness: float

        def compile(self, period: float) -> CompiledLaw:
            del period
            return CompiledLaw(
                (self.stiffness,), evaluate=lambda ring, head: cubic * ring[head] ** 3
            )

    played = haptic.drop(Stiffening(stiffness=500.0), Plant(T, 0.1, 3.0), ticks=4000)
    roots = (
        np.roots([cubic, 0.0, 500.0, -0.981]) if cubic else np.array([0.981 / 500.0])
    )
    depth = float(roots[np.abs(roots.imag) < 1e-12].real[0])
    # The criterion's own tolerance of rest.
    assert played.final_position_m == pytest.approx(-depth, abs=1e-4)
    assert played.settled


def test_a_dead_band_that_hums_has_not_settled() -> None:
    """Inside and outside of the limit that the search finds."""
    scene = drop_scene(held(PLANT), T)
    told = settles(
        scene,
        [DeadBand(stiffness=k).compile(T) for k in (2000.0, 6000.0)],
        Criterion(2500),
    )
    assert told == [True, False]
    # Nothing holds it: it falls through.
    assert settles(
        scene, [DeadBand(stiffness=0.0, damping=0.0).compile(T)], Criterion(2500)
    ) == [False]


def test_k_max_of_a_law_with_code_of_its_own_does_not_depend_on_the_stiffness_given() -> (
    None
):
    scene = drop_scene(held(PLANT), T)
    brief = Criterion(600)
    found = [
        simulated_k_max(
            at_stiffness(DeadBand(stiffness=k), T), scene, brief, 500.0, 8000.0, 0.02
        )
        for k in (1.0, 1000.0)
    ]
    assert found[0] == found[1]
    edge, beyond = found[0].k_max_n_per_m, found[0].unsettled_n_per_m
    assert edge is not None
    assert beyond is not None
    laws = [DeadBand(stiffness=k).compile(T) for k in (edge, beyond)]
    assert settles(scene, laws, brief) == [True, False]
    # Its taps are 0: H(1) of them is no stiffness.
    assert found[0].h1_max_n_per_m is None


@settings(max_examples=20, deadline=None)
@given(st.floats(1.0, 1e4), st.floats(0.0, 30.0))
def test_compiled_anew_is_the_spring_in_tap_0_for_laws_of_taps(
    stiffness: float, damping: float
) -> None:
    law = PD(stiffness=7.0, damping=damping)
    taps = at_stiffness(law, T)(stiffness).taps
    assert taps == PD(stiffness=stiffness, damping=damping).compile(T).taps
    fir = haptic.law([damping / T, -damping / T])
    # K added to and taken from a tap is rounded twice.
    assert at_stiffness(fir, T)(stiffness).taps == pytest.approx(
        taps, rel=1e-12, abs=1e-9
    )


def test_a_law_whose_stiffness_cannot_be_raised_is_refused() -> None:
    with pytest.raises(
        ValueError, match="nameless has code of its own and no parameter 'stiffness'"
    ):
        at_stiffness(Nameless(rate=500.0), T)


def test_a_law_s_own_limit_ends_the_search() -> None:
    found = simulated_k_max(
        at_stiffness(Limited(stiffness=1.0, damping=3.0), T), drop_scene(held(PLANT), T)
    )
    assert found.k_max_n_per_m == np.inf
    assert found.searched_n_per_m[1] <= 500.0 < 1.1 * found.searched_n_per_m[1]
    law = msgspec.structs.replace(PD(stiffness=1.0, damping=3.0), stiffness=2.0)
    with pytest.raises(ValueError, match="at most 500"):
        simulated_k_max(
            lambda k: Limited(stiffness=600.0 + k, damping=law.damping).compile(T),
            drop_scene(held(PLANT), T),
        )
