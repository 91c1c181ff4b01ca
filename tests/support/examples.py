"""Examples of property tests: ``HAPTIC_EXAMPLES=20`` tries twenty times as many of each.

README's line tries a quarter; whoever names tests or markers, as CI does, tries all of them.
"""

from __future__ import annotations

import os
from typing import Any, Final

import hypothesis
import pytest

TIMES: Final = "HAPTIC_EXAMPLES"
QUARTER: Final = "0.25"
_SETTINGS: Final = "_hypothesis_internal_use_settings"
"""Where hypothesis keeps a test's settings: it has a profile for all tests, but no factor."""


def multiply(test: Any, times: float) -> None:
    """Multiply the number of examples of a property test by `times`; at least one is tried."""
    function = getattr(test, "__func__", test)
    own = getattr(function, _SETTINGS)
    number = max(round(own.max_examples * times), 1)
    setattr(function, _SETTINGS, hypothesis.settings(own, max_examples=number))


def is_readme_line(config: pytest.Config) -> bool:
    """Return whether all of pyproject.toml's own selection runs: no test, no marker is named."""
    words = config.invocation_params.args
    named = config.args_source is pytest.Config.ArgsSource.ARGS
    return not named and not any(str(word).startswith(("-m", "-k")) for word in words)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Set the factor of README's line, for the workers too, which inherit it."""
    if not hasattr(config, "workerinput") and is_readme_line(config):
        os.environ.setdefault(TIMES, QUARTER)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Multiply the examples of all property tests, once per function."""
    times = float(os.environ.get(TIMES, "1"))
    if times == 1.0:
        return
    tests = [getattr(item, "obj", None) for item in items]
    found = [test for test in tests if hypothesis.is_hypothesis_test(test)]
    functions = {id(getattr(test, "__func__", test)): test for test in found}
    for test in functions.values():
        multiply(test, times)
