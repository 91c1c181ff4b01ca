"""The page's law with its own code: its inputs, and its force added to the taps'."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, ClassVar

import pytest

from messages.types import Proxy
from nodes.coupling.law_on_axis import History, LawOnAxis
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.laws import CompiledLaw, Law
from nodes.laws.parse import LawRefusedError, compile_law
from tests.support import ROOT


def test_the_pages_law_is_added_to_its_taps() -> None:
    page = (ROOT / "nodes" / "EXTENDING.md").read_text(encoding="utf-8")
    (code,) = (
        block
        for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL)
        if "class Stiffening" in block
    )
    names: dict[str, Any] = {"__name__": "stiffening"}
    exec(compile(code, "EXTENDING.md", "exec", dont_inherit=True), names)  # noqa: S102  # our own page
    law = compile_law(names["Stiffening"](stiffness=1000.0, cubic=2e8), 0.002)
    history = History(len(law.taps))
    history.push(1e-3)
    # K x + C x³ = 1 N + 0.2 N.
    assert LawOnAxis(law, history).force(history.head) == pytest.approx(1.2, rel=1e-12)
    assert law.h1 == 1000.0


class Counting:
    """Code with state: its force is the number of calls, plus ten per axis."""

    def __init__(self, axis: int = 0) -> None:
        self._axis, self._calls = axis, 0

    def on_axis(self, axis: int) -> Counting:
        """Return code with fresh state for an axis."""
        return Counting(axis)

    def __call__(self, ring: Sequence[float], head: int) -> float:
        """Count a tick."""
        del ring, head
        self._calls += 1
        return 10.0 * self._axis + self._calls


def test_code_that_remembers_begins_anew_on_each_axis_and_after_each_swap() -> None:
    renderer = Renderer([0, 2], 16)
    plain, counting = CompiledLaw((0.0,)), CompiledLaw((0.0,), evaluate=Counting())
    renderer.law = renderer.fallback = ActiveLaw("plain", "", plain, renderer.histories)
    proxy = Proxy(
        seq=0, stamp=0.0, position=(0.0, 0.0, 0.0), proxy=(0.0, 0.0, 0.0), contact=True
    )
    for _ in range(2):
        # The trial run before the swap, and the force step that it tells, are no ticks.
        step = renderer.swap(ActiveLaw("counting", "", counting, renderer.histories), 0)
        assert step == pytest.approx(math.hypot(1.0, 11.0), rel=1e-15)
        assert [renderer.render(proxy) for _ in range(2)] == [
            (1.0, 0.0, 11.0),
            (2.0, 0.0, 12.0),
        ]
        renderer.swap(ActiveLaw("plain", "", plain, renderer.histories), 0)
        renderer.render(proxy)


def test_code_that_cannot_be_made_for_an_axis_is_refused() -> None:
    class Broken(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Law whose code cannot be created for an axis."""

        def compile(self, period: float) -> CompiledLaw:
            class Code(Counting):
                def on_axis(self, axis: int) -> Counting:
                    """Raise."""
                    raise RuntimeError(f"no axis {axis} at {period:g} s")

            return CompiledLaw((1000.0,), evaluate=Code())

    with pytest.raises(
        LawRefusedError,
        match=r"law: its own code cannot be made for an axis: RuntimeError: no axis 0",
    ):
        compile_law(Broken(), 0.002)


@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.parametrize("far", [-1, 0, 1, 2, 6, 7, 400])
@pytest.mark.parametrize("how", ["index", "slice"])
def test_own_code_reads_no_further_than_its_taps_or_is_refused(
    count: int, far: int, how: str
) -> None:
    def own(ring: Any, head: int) -> float:
        if ring[head] <= 0.0:
            return 0.0  # at rest it reads nothing else
        return float(
            ring[head + far] if how == "index" else ring[head + far : head + far + 1][0]
        )

    class Far(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
        kind: ClassVar[str] = "far"

        def compile(self, _period: float) -> CompiledLaw:
            return CompiledLaw((100.0, *(count - 1) * [0.0]), evaluate=own)

    if 0 <= far < count:
        assert compile_law(Far(), 0.002).evaluate is own
        return
    place = f"ring[head {'+' if far > 0 else '-'} {abs(far)}]"
    with pytest.raises(
        LawRefusedError, match=re.escape(f"law: its own code reads {place}, but")
    ):
        compile_law(Far(), 0.002)
