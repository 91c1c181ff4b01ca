"""Support shared by the tests."""

import os
from collections.abc import Container, Iterable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
INSTALLED = {
    "PYTHONPATH": os.pathsep.join(
        [str(FIXTURES / "installed"), os.environ.get("PYTHONPATH", "")]
    )
}
"""Environment in which the package of tests/fixtures/installed is installed."""


def slowly(values: Iterable[Any], but: Container[Any] = ()) -> list[Any]:
    """Parametrize a test with values of which all but some are marked slow."""
    return [
        value if value in but else pytest.param(value, marks=pytest.mark.slow)
        for value in values
    ]


def thoroughly(
    values: Iterable[Any], quick: str, but: Container[Any] = ()
) -> list[Any]:
    """Parametrize a test with values that CI runs, and a few that README's line runs too.

    `quick`: the test whose name makes the others dispensable, see `tests.support.thorough`; the
    parametrized one itself if some values are in `but`.
    """
    mark = pytest.mark.thorough(quick)
    return [
        value if value in but else pytest.param(value, marks=mark) for value in values
    ]
