"""Pytest plugin of a mutation run: write the first test that fails into a file.

Loaded by ``-p``; the file is the value of `FILE` in the environment.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import pytest

FILE: Final = "HAPTIC_FIRST_FAILURE"


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
