"""Fixtures for all tests of this package."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.overlap import checked_figures


@pytest.fixture(autouse=True)
def _texts_of_figures_stand_apart() -> Iterator[None]:
    """Assert that texts do not overlap in any figure that a test saved."""
    with checked_figures() as found:
        yield
    assert found == []
