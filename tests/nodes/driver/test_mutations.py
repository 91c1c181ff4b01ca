"""No mutation of a safety rule survives: each is made in a copy of the sources, and its tests must fail there."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.mutations import MUTATIONS, Mutation, copy_sources, survives


def test_every_mutation_changes_a_rule_that_stands_there_once() -> None:
    for mutation in MUTATIONS:
        assert (ROOT / mutation.file).read_text(encoding="utf-8").count(mutation.old) == 1, (
            mutation.name
        )
        assert all((ROOT / test).exists() for test in mutation.tests), mutation.name
    assert len({mutation.name for mutation in MUTATIONS}) == len(MUTATIONS)


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mutated")
    copy_sources(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_a_mutation_of_a_safety_rule_is_noticed(mutation: Mutation, sources: Path) -> None:
    assert not survives(mutation, sources)
