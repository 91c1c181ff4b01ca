"""The page on one's own data: its shell lines and its Python run as they are written."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import ROOT

PAGE = (ROOT / "nodes" / "recording" / "OWN_DATA.md").read_text(encoding="utf-8")


def run(folder: Path, *words: str) -> str:
    """Run a program in a folder; return what it printed."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        words,
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.process
def test_the_rig_of_the_page_is_imported_and_identified(tmp_path: Path) -> None:
    """The page's rig has 0.2 kg; its position is rounded to 10 µm, which costs under 2 %."""
    (shell,) = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
    run(tmp_path, "bash", "-euo", "pipefail", "-c", shell)
    assert {"rig.csv", "rig.mcap"} <= {path.name for path in tmp_path.iterdir()}
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    shape, *masses = run(tmp_path, sys.executable, "-c", code).splitlines()
    assert shape.startswith("(4000")
    assert [float(mass) for mass in masses] == pytest.approx([0.2, 0.2], rel=0.02)
