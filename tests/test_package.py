"""The wheel contains everything the project needs, and runs without a clone.

It is built with the installed backend into its own folder, so nothing is downloaded and the clone's
installation is untouched.
"""

from __future__ import annotations

import configparser
import json
import os
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.launching import assert_nothing_left, private_runtime_dir

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
SHARED = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"]
PACKAGES = ("haptic", "messages", "nodes", "sim")


def pip(*words: str) -> None:
    command = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "--no-input",
        *words,
    ]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    pip(
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "--wheel-dir",
        str(folder),
        str(ROOT),
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install it without dependencies into its own folder."""
    folder = tmp_path_factory.mktemp("installed")
    pip("install", "--no-deps", "--no-index", "--target", str(folder), str(wheel))
    return folder


def inside(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.process
def test_wheel_holds_packages_scenarios_markers_and_licence(wheel: Path) -> None:
    files = inside(wheel)
    metadata = f"haptic_nodes-{PROJECT['version']}.dist-info"
    # What goes into the environment's own ``share``: the package of ROS 2.
    shared = f"haptic_nodes-{PROJECT['version']}.data"
    assert {name.split("/")[0] for name in files} == {*PACKAGES, metadata, shared}
    assert {name for name in files if name.startswith(shared)} == {
        f"{shared}/data/{place}" for place in SHARED.values()
    }
    for package in PACKAGES:
        beside = {
            path
            for path in (ROOT / package).rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        }
        sources = {path.relative_to(ROOT).as_posix() for path in beside}
        # Pictures and notebooks are for who reads the sources; ``haptic`` stands beside the
        # packages.
        apart = ("sim/figures/", "sim/notebooks/", "sim/python/")
        assert {name for name in sources if not name.startswith(apart)} <= set(files)
        assert f"{package}/py.typed" in files
    scenarios = {
        path.name: path.read_bytes() for path in (ROOT / "launch").glob("*.yaml")
    }
    packed = {
        name.rpartition("/")[2]: text
        for name, text in files.items()
        if name.startswith("nodes/_launch/") and name.endswith(".yaml")
    }
    assert packed == scenarios
    assert files[f"{metadata}/licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()
    assert not [
        name for name in files if name.endswith((".pyc", ".png", ".mcap", ".so"))
    ]


@pytest.mark.process
def test_wheel_says_what_it_is_and_what_it_needs(wheel: Path) -> None:
    files = inside(wheel)
    metadata = f"haptic_nodes-{PROJECT['version']}.dist-info"
    told = Parser().parsestr(files[f"{metadata}/METADATA"].decode("utf-8"))
    assert told["Name"] == PROJECT["name"]
    assert told["License-Expression"] == PROJECT["license"]
    assert told["Requires-Python"] == PROJECT["requires-python"]
    needed = [
        text.partition(";")[0].strip()
        for text in told.get_all("Requires-Dist", [])
        if "extra" not in text
    ]
    assert sorted(needed) == sorted(PROJECT["dependencies"])
    registered = configparser.ConfigParser(delimiters=("=",))
    registered.optionxform = str  # type: ignore[assignment,method-assign]
    registered.read_string(files[f"{metadata}/entry_points.txt"].decode("utf-8"))
    groups = {"console_scripts": PROJECT["scripts"], **PROJECT["entry-points"]}
    assert {group: dict(registered[group]) for group in registered.sections()} == groups
    for group in groups.values():
        for place in group.values():
            module = place.partition(":")[0].replace(".", "/")
            assert {f"{module}.py", f"{module}/__init__.py"} & set(files), (
                f"{place}: not in the wheel"
            )


@pytest.mark.slow
def test_scenarios_run_from_the_wheel_in_another_folder(
    installed: Path, tmp_path: Path
) -> None:
    with private_runtime_dir() as runtime_dir:
        environment = {
            **os.environ,
            "PYTHONPATH": str(installed),
            "HAPTIC_RUNTIME_DIR": str(runtime_dir),
        }

        def run(*words: str) -> str:
            done = subprocess.run(
                words,
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=120,
            )
            assert done.returncode == 0, done.stderr
            return done.stdout

        haptic = str(installed / "bin" / "haptic")
        assert run(haptic, "--version").split()[-1] == PROJECT["version"]
        where = "import messages, nodes, sim; "
        where += "print(messages.__file__, nodes.__file__, sim.__file__)"
        assert all(
            Path(path).is_relative_to(installed)
            for path in run(sys.executable, "-c", where).split()
        )
        listed = json.loads(run(haptic, "launch", "--list", "--json"))["scenarios"]
        assert set(listed) == {path.stem for path in (ROOT / "launch").glob("*.yaml")}
        figures = json.loads(
            run(haptic, "launch", "floor_drop", "duration:=1", "--json").splitlines()[
                -1
            ]
        )
        assert figures["exit_reason"] == "done"
        assert figures["ticks"] + figures["overruns"] == 500
        assert (tmp_path / figures["recording"]).is_file()
        assert (tmp_path / figures["plot"]).read_bytes().startswith(b"\x89PNG")
        assert_nothing_left(runtime_dir)
