"""Every installed law has a control per parameter, with the limits that msgspec enforces."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec
import pytest

from nodes.laws import CompiledLaw, Law, law_kinds
from nodes.laws.law_fields import law_fields


@pytest.mark.parametrize("kind", law_kinds())
def test_every_parameter_of_every_law_has_a_control(kind: str) -> None:
    law = law_kinds()[kind]
    assert [field["name"] for field in law_fields(law)] == list(law.__struct_fields__)
    for field in law_fields(law):
        assert field["told"], f"{kind}.{field['name']} is not documented"


def test_units_limits_and_choices_are_those_of_the_type() -> None:
    found = {field["name"]: field for field in law_fields(law_kinds()["pd_alpha"])}
    assert found["stiffness"]["unit"] == "N/m"
    assert found["stiffness"]["gt"] == 0.0
    assert (found["order"]["gt"], found["order"]["lt"]) == (0.0, 4.0)
    assert (found["taps"]["type"], found["taps"]["ge"]) == ("integer", 2)
    assert "gl" in found["derivative"]["choices"]
    terms = {field["name"]: field for field in law_fields(law_kinds()["multi_term"])}[
        "terms"
    ]
    assert [inner["name"] for inner in terms["fields"]] == ["gain", "order"]


class Invented(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A law unknown to the page.

    Attributes
    ----------
    depth : float
        How deep [mm].
    mode : str
        Which way.
    on : bool
        Whether.
    spare : float or None
        Perhaps [N].
    """

    kind: ClassVar[str] = "invented"
    depth: Annotated[float, msgspec.Meta(gt=1.0, le=2.0)]
    mode: Literal["up", "down"] = "up"
    on: bool = False
    spare: float | None = None

    def compile(self, period: float) -> CompiledLaw:
        """Compile a spring."""
        return CompiledLaw((self.depth / period,))


def test_a_new_law_gets_its_sliders_by_existing() -> None:
    depth, mode, on, spare = law_fields(Invented)
    assert depth == {
        "name": "depth",
        "unit": "mm",
        "told": "How deep [mm].",
        "type": "number",
        "gt": 1.0,
        "le": 2.0,
    }
    assert mode["choices"] == ["down", "up"]
    assert mode["default"] == "up"
    assert on["choices"] == [False, True]
    assert spare["type"] == "number"


def test_a_tuple_has_a_control_if_its_items_are_numbers_of_one_kind() -> None:
    class Pairs(Law, frozen=True, kw_only=True):
        """A law with pairs.

        Attributes
        ----------
        ends : tuple of float
            Both ends [m].
        named : tuple
            A number and its name.
        names : tuple of str
            Names.
        more : tuple of int
            As many as there are.
        """

        kind: ClassVar[str] = "pairs"
        ends: tuple[float, float]
        named: tuple[float, str]
        names: tuple[str, str]
        more: tuple[int, ...]

    found = {field["name"]: field["type"] for field in law_fields(Pairs)}
    assert found == {"ends": "numbers", "more": "numbers"}
