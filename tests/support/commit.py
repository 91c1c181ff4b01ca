"""The commit under test, as a seed: random properties vary with each commit, reproducibly."""

from __future__ import annotations

import functools
import subprocess
import time

from tests.support import ROOT


@functools.cache
def commit() -> str:
    """Return the hash of the commit in hexadecimal; the date without a repository."""
    done = subprocess.run(
        ["git", "rev-parse", "HEAD"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or time.strftime("%Y%m%d0000")
