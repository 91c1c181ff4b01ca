"""What is left out of numba saves time and changes no instruction."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support import ROOT

CODE = """
import hashlib, sys
from nodes.compiled import lean_numba, machine_code
if sys.argv[1] == "whole":
    lean_numba.TRIED = ()
print(hashlib.sha256(machine_code.object_file("nodes.environment.kernel")).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.process
def test_machine_code_is_the_same_as_of_the_whole_numba() -> None:
    made = {
        subprocess.run(
            [sys.executable, "-c", CODE, which],
            capture_output=True,
            text=True,
            cwd=ROOT,
            check=True,
        ).stdout
        for which in ("lean", "whole")
    }
    assert len(made) == 1
    assert len(made.pop().strip()) == 64
