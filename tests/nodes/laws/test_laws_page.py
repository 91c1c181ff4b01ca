"""nodes/laws/README.md lists every law's parameters as the laws declare them."""

from __future__ import annotations

import re
from typing import Any

import pytest

from nodes.laws import law_kinds
from nodes.laws.law_fields import law_fields
from nodes.laws.presets import PRESETS
from tests.support import ROOT

PAGE = (ROOT / "nodes" / "laws" / "README.md").read_text(encoding="utf-8")
SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
LAWS = {
    name: kind
    for name, kind in law_kinds().items()
    if kind.__module__.startswith("nodes.laws.")
}


def limits(field: dict[str, Any]) -> str:
    """Return the limits of a field as on the page."""
    found = [(sign, field[name]) for name, sign in SIGNS.items() if name in field]
    if [sign for sign, _ in found] == ["≥", "≤"]:
        return f"{found[0][1]:g} to {found[1][1]:.0f}"
    return ", ".join(f"{sign} {value:g}" for sign, value in found)


def default(field: dict[str, Any]) -> str:
    """Return the default of a field as on the page."""
    value = field.get("default", "")
    return value if isinstance(value, str) else f"{value:g}"


@pytest.mark.parametrize("name", LAWS)
def test_parameters_are_those_of_the_law(name: str) -> None:
    section = PAGE.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
    rows = [
        tuple(cell.strip() for cell in line.split("|")[1:5])
        for line in section.splitlines()
        if line.startswith("| `")
    ]
    assert rows == [
        (f"`{field['name']}`", field["unit"], limits(field), default(field))
        for field in law_fields(LAWS[name])
    ]


def test_every_choice_of_gains_and_every_preset_is_explained() -> None:
    (gains,) = (
        field for field in law_fields(LAWS["pd_alpha"]) if field["name"] == "gains"
    )
    assert set(gains["choices"]) == set(
        re.findall(r"^\| `(\w+)` \| N s", PAGE, re.MULTILINE)[:3]
    )
    for preset in PRESETS:
        assert preset in PAGE or f"{preset.partition('_d')[0]}_*" in PAGE
