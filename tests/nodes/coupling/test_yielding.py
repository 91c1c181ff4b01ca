"""A proxy that yields to the same tick's force: the force equals that at its final place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.types import Proxy
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law

T = 0.002
LAWS = [
    compile_law(parse_law(description), T)
    for description in (
        {"kind": "pd", "stiffness": 800.0, "damping": 2.0},
        {"kind": "pd_filtered", "stiffness": 500.0, "damping": 3.0, "cutoff": 70.0},
        {"kind": "paper_optimum", "stiffness": 1200.0, "damping": 1.0},
        {
            "kind": "pd_alpha",
            "stiffness": 600.0,
            "damping": 2.0,
            "order": 0.8,
            "taps": 6,
            "gains": "physical",
            "derivative": "oustaloup_tustin",
        },
    )
]


def made(axes: list[int], law: CompiledLaw) -> Renderer:
    renderer = Renderer(axes, 64)
    renderer.fallback = ActiveLaw(
        "fallback", "", CompiledLaw((0.0,)), renderer.histories
    )
    renderer.law = ActiveLaw("first", "", law, renderer.histories)
    return renderer


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([[0], [0, 1, 2]]),
    st.sampled_from(LAWS),
    st.lists(
        st.tuples(
            st.integers(1, 60), st.sampled_from(LAWS), st.sampled_from([0, 1, 7, 30])
        ),
        max_size=4,
    ),
    st.floats(1e-6, 1e-2),
    st.integers(0, 2**32 - 1),
)
def test_the_force_is_that_of_where_the_proxy_went(
    axes: list[int],
    law: CompiledLaw,
    swaps: list[tuple[int, CompiledLaw, int]],
    compliance: float,
    seed: int,
) -> None:
    """Taps, sections, nested swaps: a second renderer gets the final place of the proxy."""
    rng = np.random.default_rng(seed)
    yielding, rigid = made(axes, law), made(axes, law)
    for tick in range(80):
        for at, new, ramp in swaps:
            if at == tick:
                for renderer in (yielding, rigid):
                    incoming = ActiveLaw("new", "", new, renderer.histories)
                    incoming.warm_up(renderer.histories)
                    renderer.swap(incoming, ramp)
        free = rng.normal(0.0, 1e-3, 3)
        position, zero = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        place: dict[str, Any] = {
            "seq": tick,
            "stamp": 0.0,
            "position": position,
            "normal": zero,
            "contact": True,
        }
        force = yielding.render(
            Proxy(**place, proxy=tuple(free.tolist()), compliance=compliance)
        )
        left = free - compliance * np.array(force)
        same = rigid.render(Proxy(**place, proxy=tuple(left.tolist())))
        # What a newest deflection of 1 mm does to the force, and 80 ticks of rounding of it.
        assert force == pytest.approx(
            same, abs=1e-9 * 1e-3 * max(sum(map(abs, one.taps)) + 1e3 for one in LAWS)
        )
        for one, other in zip(yielding.histories, rigid.histories, strict=True):
            assert one.values[one.head] == pytest.approx(
                other.values[other.head], abs=1e-15
            )


def test_a_proxy_without_compliance_and_a_law_that_grows_by_itself_are_rendered_as_they_come() -> (
    None
):
    """Negative compliance, or a newest tap too negative for an equilibrium: no yielding."""
    zero = (0.0, 0.0, 0.0)
    for law, compliance, expected in (
        (CompiledLaw((500.0, -100.0)), -1.0, 0.5),
        (CompiledLaw((-500.0, 100.0)), 0.01, -0.5),
        (CompiledLaw((500.0, -100.0)), 0.002, 0.25),
    ):
        met = Proxy(
            seq=0,
            stamp=0.0,
            position=zero,
            proxy=(1e-3, 0.0, 0.0),
            contact=True,
            compliance=compliance,
        )
        assert made([0], law).render(met) == pytest.approx(
            (expected, 0.0, 0.0), abs=1e-15
        )
