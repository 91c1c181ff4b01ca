"""The page's law with code of its own: what it gets, and that its force is added to that of the taps."""

from __future__ import annotations

import re
from typing import Any

import pytest

from nodes.coupling.law_on_axis import History, LawOnAxis
from nodes.laws.parse import compile_law
from tests.support import ROOT


def test_the_pages_law_is_added_to_its_taps() -> None:
    page = (ROOT / "nodes" / "EXTENDING.md").read_text(encoding="utf-8")
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class Stiffening" in block)
    names: dict[str, Any] = {"__name__": "stiffening"}
    exec(compile(code, "EXTENDING.md", "exec", dont_inherit=True), names)  # noqa: S102  # our own page
    law = compile_law(names["Stiffening"](stiffness=1000.0, cubic=2e8), 0.002)
    history = History(len(law.taps))
    history.push(1e-3)
    # K x + C x³ = 1 N + 0.2 N.
    assert LawOnAxis(law, history).force(history.head) == pytest.approx(1.2, rel=1e-12)
    assert law.h1 == 1000.0
