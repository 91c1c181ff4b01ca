"""What the tests share."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
INSTALLED = {"PYTHONPATH": os.pathsep.join([str(FIXTURES / "installed"), os.environ.get("PYTHONPATH", "")])}
"""The environment in which the package of tests/fixtures/installed is installed."""
