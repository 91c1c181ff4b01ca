"""One colour a law in every figure."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from sim.studies.law_looks import law_looks

NAMES = (
    "pd",
    "PD",
    "pd_alpha 0.5",
    "pd_alpha 1.5",
    "paper_optimum",
    "designed, H(1) = 900 N/m",
    "my_own",
    "passive",
)


@given(st.lists(st.sampled_from(NAMES), unique=True, max_size=8))
def test_a_law_has_its_colour_in_any_company_and_no_two_look_alike(
    names: list[str],
) -> None:
    looks = law_looks(names)
    for name, look in zip(names, looks, strict=True):
        if name not in ("my_own", "passive"):
            assert look.color == law_looks([name])[0].color
    assert len({(look.color, look.marker) for look in looks}) == len(looks)
    assert len({(look.color, str(look.line)) for look in looks}) == len(looks)


def test_more_laws_than_colours_are_grey_and_differ_by_line() -> None:
    looks = law_looks([f"own_{k}" for k in range(12)])
    assert len({(look.color, str(look.line)) for look in looks}) == 12
