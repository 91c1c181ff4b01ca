"""Fixtures of the recording tests."""

from __future__ import annotations

import pytest

from tests.support.whole import Whole


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    return Whole(tmp_path_factory.mktemp("whole") / "r.mcap")
