"""README.md keeps its word: each command runs, each link leads somewhere, each scenario and verb is told of."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from nodes.cli.main import VERBS
from tests.support import ROOT
from tests.support.launching import private_runtime_dir
from tests.support.readme import Command, anchors, blocks, command, links, shell

README = (ROOT / "README.md").read_text(encoding="utf-8")

SHORTER = {
    "haptic launch": "duration:=1",
    "haptic launch floor_swap": "first:=0.4 second:=0.8 duration:=1.2",
    "haptic launch --list": "",
    "haptic launch --show-args": "",
    "haptic bench loop": "--rounds 1 --seconds 0.2 --ticks 200",
    "haptic bench listeners": "--rounds 1 --seconds 0.3",
    "haptic bench swaps": "--swaps 4 --sets 4 --duration 0.5 --blocks 1",
    "haptic bench simulator": "--rounds 1",
    "haptic bench taps": "--rounds 1 --taps 4,10",
    "haptic bench curve": "--rounds 1 --ticks 50",
    "haptic drill": "flood",
    "haptic drill --list": "",
    "haptic drill soak": "--minutes 0.17 --miss-limit 1",
    "haptic study chart": "--quick --parts kmax",
    "haptic study needs": "--rounds 1",
    "haptic study design": "--mass 0.1 --taps 2",
    "haptic study design --compare": "--mass 0.1 --taps 2 --delays 0 --margins 0",
    "haptic study fig4": "--points 3 --horizon 500",
}
"""What makes a command short enough for a test, by its first words."""

INSTALLING = [line for block in blocks(README) for line in block if line.startswith("python3 -m venv")]
"""The two pasted lines: `.ci/run` takes the second one from README.md, and any user's fresh clone the first."""

BLOCKS = [block for block in blocks(README) if not set(block) & set(INSTALLING)]


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Path]]:
    """One folder and one runtime directory for all blocks: later ones read what earlier ones wrote."""
    with private_runtime_dir() as runtime_dir:
        yield tmp_path_factory.mktemp("readme"), runtime_dir


@pytest.mark.parametrize("lines", BLOCKS, ids=[block[0].partition("#")[0].strip() for block in BLOCKS])
def test_commands_run_as_they_are_written(lines: list[str], places: tuple[Path, Path]) -> None:
    with shell(*places) as terminal:
        for line in lines:
            wanted = command(line, SHORTER)
            told = terminal.run(wanted)
            if "--json" in wanted.words:
                assert isinstance(json.loads(told.splitlines()[-1]), dict)


def test_the_pasted_lines_install_launch_and_test() -> None:
    launching, testing = INSTALLING
    assert launching.endswith(".venv/bin/haptic launch floor_drop")
    assert testing.endswith(".venv/bin/pytest")
    # It looks the line up by this pattern.
    pattern = r"^python3 -m venv .*pytest"
    assert pattern in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert re.findall(pattern + "$", README, re.MULTILINE) == [testing]


def test_nothing_is_left_to_be_filled_in() -> None:
    assert not re.findall(r"@@\w+@@|TODO|TBD", README)


def test_links_lead_somewhere() -> None:
    targets = [target for target in links(README) if not target.startswith(("https://", "mailto:"))]
    for target in targets:
        path, _, anchor = target.partition("#")
        assert not path or (ROOT / path).exists(), f"{target}: there is no such file"
        text = README if not path else (ROOT / path).read_text(encoding="utf-8") if anchor else ""
        assert not anchor or anchor in anchors(text), f"{target}: there is no such heading"
    if (ROOT / ".git").exists():
        paths = [target.partition("#")[0] for target in targets if not target.startswith("#")]
        listed = subprocess.run(["git", "ls-files", "--", *paths], cwd=ROOT, capture_output=True, text=True, check=True)
        for path in paths:
            there = [
                name for name in listed.stdout.splitlines() if name == path or name.startswith(path.rstrip("/") + "/")
            ]
            assert there, f"{path}: is not in the repository, so not in a clone"


def test_every_scenario_and_every_verb_is_mentioned() -> None:
    for path in (ROOT / "launch").glob("*.yaml"):
        assert re.search(rf"\b{path.stem}\b", README), f"scenario {path.stem} is not mentioned"
    for verb in VERBS.points().values():
        assert re.search(rf"\bhaptic {verb.name}\b", README), f"haptic {verb.name} is not mentioned"


def test_nothing_is_shortened_that_is_not_there() -> None:
    typed = [command(line, {}).words for block in BLOCKS for line in block]
    for start in SHORTER:
        assert any(words[: len(start.split())] == start.split() for words in typed), f"no command starts with {start}"


DRAFT = """# Draft

See [the rest](#the-rest), `[not](a-link)` and ![a picture](some/picture.png).

```sh
haptic launch wall_press duration:=0 &   # until the block ends
haptic node list --json | tail -n 1 > nodes.json  # a pipe, a file
haptic law switch \\
    multi_term
```

```
haptic is not run here
```

## The rest

```sh
# a comment of its own
test -s nodes.json
haptic launch floor_drop --json pace:=lockstep
```
"""


def test_blocks_links_and_headings_are_found() -> None:
    assert [len(block) for block in blocks(DRAFT)] == [3, 2]
    assert links(DRAFT) == ["#the-rest", "some/picture.png"]
    assert anchors(DRAFT) == {"draft", "the-rest"}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("haptic a b  # why", Command("haptic a b -s 1", False)),
        ("haptic a b > out.txt", Command("haptic a b -s 1 > out.txt", False)),
        ("haptic a b | head -n 1 && true", Command("haptic a b -s 1 | head -n 1 && true", False)),
        ("haptic a c 'x > y' &  # on and on", Command("haptic a c 'x > y'", True)),
        ("haptic a c 'x > y'", Command("haptic a c 'x > y' -t", False)),
        ("haptic a cd", Command("haptic a cd -t", False)),
        ("haptic ab", Command("haptic ab", False)),
    ],
)
def test_commands_are_shortened_before_what_the_shell_adds(line: str, expected: Command) -> None:
    assert command(line, {"haptic a": "-t", "haptic a b": "-s 1"}) == expected


def test_a_draft_is_run_and_leaves_nothing(tmp_path: Path) -> None:
    first, second = blocks(DRAFT)
    with private_runtime_dir() as runtime_dir:
        with shell(tmp_path, runtime_dir) as terminal:
            for line in first:
                terminal.run(command(line, {}))
            assert len(terminal.background) == 1
        with shell(tmp_path, runtime_dir) as terminal:
            terminal.run(command(second[0], {}))
            told = terminal.run(command(second[1], {"haptic launch": "duration:=0.2"}))
            assert json.loads(told.splitlines()[-1])["ticks"] == 100
            with pytest.raises(AssertionError, match=r"exit code [12]$"):
                terminal.run(command("haptic node info nobody", {}))
    assert set(json.loads((tmp_path / "nodes.json").read_text(encoding="utf-8"))) > {"run"}
