"""The commit under test: properties that are drawn from it try others with each commit, and the same ones again with it."""

from __future__ import annotations

import functools
import subprocess
import time

from tests.support import ROOT


@functools.cache
def commit() -> str:
    """Return its hash in hexadecimal digits; the day where there is no repository."""
    done = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or time.strftime("%Y%m%d0000")
