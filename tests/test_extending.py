"""The packages of nodes/EXTENDING.md work as printed, installed beside this project.

They are installed in a fresh environment that sees what is installed here; nothing is downloaded.
"""

from __future__ import annotations

import json
import sysconfig
import venv
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.launching import private_runtime_dir
from tests.support.pages import Block, blocks, command, promised, shell, written_files

PAGE = (ROOT / "nodes" / "EXTENDING.md").read_text(encoding="utf-8")
FILES = written_files(PAGE)
# The first installs a law of one's own; what else may be installed, is in the same way.
BLOCKS = [
    pytest.param(block, id=block.lines[0], marks=[pytest.mark.slow] * (n > 0))
    for n, block in enumerate(blocks(PAGE))
]
OFFLINE = {
    "pip install": "-q --no-deps --no-index --no-build-isolation --disable-pip-version-check"
}


@pytest.fixture(scope="module")
def places(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[Path, Path, Path]]:
    """Write the page's files and create an environment; return folder, runtime dir, programs."""
    folder = tmp_path_factory.mktemp("extending")
    for name, text in FILES.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    fresh = folder / "fresh"
    venv.create(fresh, with_pip=False, symlinks=True)
    (packages,) = fresh.glob("lib/python*/site-packages")
    beside = sysconfig.get_path("purelib")
    (packages / "beside.pth").write_text(
        f"import site; site.addsitedir({beside!r})\n", encoding="ascii"
    )
    for name, module in (("haptic", "nodes.cli.main"), ("pip", "pip")):
        program = fresh / "bin" / name
        program.write_text(
            f'#!/bin/sh\nexec "{fresh}/bin/python" -m {module} "$@"\n', encoding="ascii"
        )
        program.chmod(0o755)
    with private_runtime_dir() as runtime_dir:
        yield folder, runtime_dir, fresh / "bin"


@pytest.mark.process
@pytest.mark.parametrize("block", BLOCKS)
def test_examples_install_and_run(
    block: Block, places: tuple[Path, Path, Path]
) -> None:
    said = ""
    with shell(*places) as terminal:
        for line in block.lines:
            wanted = command(line, OFFLINE)
            printed = terminal.run(wanted)
            said += printed
            if "--json" in wanted.words and wanted.words[:2] == ["haptic", "launch"]:
                assert json.loads(printed.splitlines()[-1])["exit_reason"] == "done"
    assert promised(block.prints, said) == [], said


def test_every_group_has_an_example() -> None:
    groups = {
        "haptic.laws",
        "haptic.surfaces",
        "haptic.nodes",
        "haptic.launch",
        "haptic.verbs",
    }
    shown = {
        group
        for text in FILES.values()
        for group in groups
        if f'entry-points."{group}"' in text
    }
    assert shown == groups


@pytest.mark.slow  # as is the block that writes the tape
def test_the_tape_holds_the_forces_of_the_floor(
    places: tuple[Path, Path, Path],
) -> None:
    """The page's device gets a 500 N/m floor's force at 3 mm, and a soft stop to zero."""
    lines = (places[0] / "forces.txt").read_text(encoding="ascii").splitlines()
    forces = [[float(word) for word in line.split()[1:]] for line in lines]
    assert [0.0, 0.0, 1.5] in [[round(value, 9) for value in force] for force in forces]
    assert forces[-1] == [0.0, 0.0, 0.0]
