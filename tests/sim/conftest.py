"""What holds for every test of this package."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.overlap import checked_figures


@pytest.fixture(autouse=True)
def _texts_of_figures_stand_apart() -> Iterator[None]:
    """In no figure that a test has drawn and saved does a text lie over another."""
    with checked_figures() as found:
        yield
    assert found == []
