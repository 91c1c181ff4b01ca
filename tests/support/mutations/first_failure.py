"""Pytest plugin of a mutation run: write the first test that fails into a file.

Loaded by ``-p``; the file is the value of `FILE` in the environment. A failing example of a
property is not made smaller, which takes minutes, nor kept for the next mutation.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import pytest
from hypothesis import Phase, settings

FILE: Final = "HAPTIC_FIRST_FAILURE"


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Stop a property at the first example that fails."""
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile(
        "first failure", settings.default, phases=phases, database=None
    )
    settings.load_profile("first failure")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Write the id of a test that fails, in its body or a fixture."""
    if report.failed:
        _write(report.nodeid)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Write the file whose tests cannot be collected."""
    if report.failed:
        _write(report.nodeid)


def _write(test: str) -> None:
    path = Path(os.environ[FILE])
    if not path.exists():
        path.write_text(test, encoding="utf-8")
