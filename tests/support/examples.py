"""Examples of property tests: ``HAPTIC_EXAMPLES=20`` tries twenty times as many of each."""

from __future__ import annotations

import os
from typing import Any, Final

import hypothesis
import pytest

TIMES: Final = float(os.environ.get("HAPTIC_EXAMPLES", "1"))
_SETTINGS: Final = "_hypothesis_internal_use_settings"
"""Where hypothesis keeps a test's settings: it has a profile for all tests, but no factor."""


def multiply(test: Any, times: float) -> None:
    """Multiply the number of examples of a property test by `times`; at least one is tried."""
    function = getattr(test, "__func__", test)
    own = getattr(function, _SETTINGS)
    number = max(round(own.max_examples * times), 1)
    setattr(function, _SETTINGS, hypothesis.settings(own, max_examples=number))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Multiply the examples of all property tests, once per function."""
    if TIMES == 1.0:
        return
    tests = [getattr(item, "obj", None) for item in items]
    found = [test for test in tests if hypothesis.is_hypothesis_test(test)]
    functions = {id(getattr(test, "__func__", test)): test for test in found}
    for test in functions.values():
        multiply(test, TIMES)
