"""Commands import only what they need, and the Python API starts no command."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.sources import nodes_if_named, sources_of

NETWORK = ("zmq", "msgpack", "nodes.launcher", "nodes.client", "nodes.base.node")
"""What carries messages between processes, and starts them."""

COMPILER = ("numba", "llvmlite")

WITHOUT: dict[str, tuple[str, ...]] = {
    "--version": (*NETWORK, *COMPILER, "numpy", "scipy", "matplotlib"),
    "study --help": (
        *NETWORK,
        *COMPILER,
        "numpy",
        "scipy",
        "matplotlib",
        "sim.studies.kmax",
    ),
    "study kmax --law pd --gain 3": (
        *NETWORK,
        *COMPILER,
        "matplotlib.pyplot",
        "sim.play",
    ),
    "study world --gain 3": (*NETWORK, *COMPILER, "matplotlib.pyplot", "sim.play"),
    "lab two_rate --help": (*NETWORK, *COMPILER, "sim.play"),
    "tune --help": ("matplotlib", "sim.play", *COMPILER),
}
"""By command: modules that it must do without, each with all that is below it."""

CODE = """
import json, sys
from nodes.cli.main import main
try:
    code = main(sys.argv[2:])
except SystemExit as end:
    code = end.code
open(sys.argv[1], "w").write(json.dumps([code, sorted(sys.modules)]))
"""


@pytest.mark.process
@pytest.mark.parametrize("command", WITHOUT)
def test_a_command_imports_nothing_that_it_does_not_need(
    command: str, tmp_path: Path
) -> None:
    told = tmp_path / "modules.json"
    subprocess.run(
        [sys.executable, "-c", CODE, str(told), *command.split()],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
        check=True,
        capture_output=True,
        timeout=300.0,
    )
    code, modules = json.loads(told.read_text(encoding="utf-8"))
    assert code == 0
    found = [
        name
        for name in modules
        for without in WITHOUT[command]
        if name == without or name.startswith(f"{without}.")
    ]
    assert found == []


def test_the_python_api_starts_no_process_itself() -> None:
    """Launches start in sim/measure; studies, identification and tuning run in this process."""
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for folder in ("sim/api", "sim/studies", "sim/tune")
        for path in sources_of(folder)
        for node in nodes_if_named(path, "subprocess", "multiprocessing")
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in (
            [one.name for one in node.names]
            if isinstance(node, ast.Import)
            else [str(node.module)]
        )
        if name.partition(".")[0] in ("subprocess", "multiprocessing")
    ]
    assert wrong == []
