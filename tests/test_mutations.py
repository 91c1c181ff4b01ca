"""Every named mutation, applied in a copy of the sources, makes its tests fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.mutations.drawn import ROOMS, all_of, draw
from tests.support.mutations.mutation import copy_sources, mutated, survives
from tests.support.mutations.rooms import NAMED_RULES
from tests.support.mutations.safety import SAFETY_RULES

NAMED = (*SAFETY_RULES, *NAMED_RULES)


def test_every_mutation_changes_a_rule_that_stands_there_once() -> None:
    for mutation in NAMED:
        text = (ROOT / mutation.file).read_text(encoding="utf-8")
        assert mutated(text, mutation) != text
        assert all((ROOT / test).exists() for test in mutation.tests), mutation.name
    assert len({mutation.name for mutation in NAMED}) == len(NAMED)


@pytest.mark.parametrize("room", ROOMS)
def test_what_is_drawn_is_another_program(room: str) -> None:
    """Each compiles, differs in one place, and is drawn again by the same seed."""
    drawn = draw(40, "one", [room])
    for mutation in drawn:
        text = (ROOT / mutation.file).read_text(encoding="utf-8")
        changed = mutated(text, mutation)
        assert changed != text
        assert len(changed) == len(text) + len(mutation.new) - len(mutation.old)
        compile(changed, mutation.file, "exec")
    assert drawn == draw(40, "one", [room]) != draw(40, "two", [room])


def test_comparisons_signs_numbers_conditions_and_statements_are_changed(tmp_path: Path) -> None:
    file = tmp_path / "rule.py"
    file.write_text(
        'def rule(x: int = 3) -> str:\n    """Add 1."""\n    if x < 2 and x:\n        x += 5\n'
        '    assert x * 2.0\n    raise ValueError(f"{x + 1}")\n',
        encoding="utf-8",
    )
    found = {(one.old, one.new) for one in all_of(file, (), tmp_path)}
    assert found == {
        ("3", "4"),
        ("x < 2 and x", "(not (x < 2 and x))"),
        ("and", "or"),
        ("<", "<="),
        ("2", "3"),
        ("x += 5", "pass"),
        ("5", "6"),
        ("*", "/"),
        ("2.0", "4.0"),
    }


@pytest.mark.slow
def test_who_tries_one_tells_whether_a_test_noticed(tmp_path: Path) -> None:
    """A change of nothing survives, a named one does not, and the sources are as they were."""
    copy_sources(tmp_path)
    (marginal,) = (one for one in NAMED_RULES if "grow by e" in one.name)
    before = (tmp_path / marginal.file).read_bytes()
    nothing = marginal._replace(name="nothing", new=f"{marginal.old}  # as it is")
    assert survives(nothing, tmp_path)
    assert not survives(marginal, tmp_path)
    assert (tmp_path / marginal.file).read_bytes() == before
