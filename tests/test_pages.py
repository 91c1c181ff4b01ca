"""Pages are correct: commands run, promises hold, links exist, scenarios are named."""

from __future__ import annotations

import argparse
import ast
import itertools
import json
import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml

from nodes.cli.main import VERBS, Parser, parser_for, sub_verbs, verbs
from nodes.parameters.installed import OURS
from sim.lab.bench.scene_costs import BODIES
from tests.support import ROOT
from tests.support.launching import private_runtime_dir, typed_in
from tests.support.pages import Block, anchors, blocks, command, links, promised, shell
from tests.support.sources import nodes_of

PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [
        ROOT / "README.md",
        *sorted((ROOT / ".github").glob("*.md")),
        *sorted(
            path
            for folder in ("launch", "messages", "nodes", "sim")
            for path in (ROOT / folder).rglob("*.md")
            # Sections of sim/RESULTS.md, which is a page.
            if path.parent.name != "measured"
        ),
    ]
}
README = PAGES["README.md"]


SHORTER = {
    "haptic launch": "duration:=1",
    "haptic launch floor_swap": "first:=0.4 second:=0.8 duration:=1.2",
    "haptic launch --list": "",
    "haptic launch --show-args": "",
    "haptic bench loop": "--rounds 1 --seconds 0.2 --ticks 200 --rates 500 --cases",
    "haptic study detail": "duration:=1",
    "haptic lab proxies": "--finest 3 --ticks 300 --steps 20000",
    "haptic bench chains": "--most 2 --seconds 0.6",
    "haptic bench listeners": "--rounds 1 --seconds 0.3",
    "haptic bench ros2": "--rounds 1 --seconds 0.4",
    "haptic bench loop --scenes": "--rounds 1 --seconds 0.5 --finest 3 --json",
    "haptic bench swaps": "--swaps 4 --sets 4 --duration 0.5 --blocks 1",
    "haptic bench simulator": "--rounds 1",
    "haptic bench taps": "--rounds 1 --taps 4,10",
    "haptic lab results": "--list",
    "haptic bench curve": "--rounds 1 --ticks 50",
    "haptic drill": "flood",
    "haptic drill --list": "",
    "haptic drill random": "--launches 1 --json",
    "haptic drill soak": "--minutes 0.17 --miss-limit 1 --json",
    "haptic study kmax --law pd --gain 3 --method lockstep": "--grid 3 --horizon 600",
    "haptic study chart": "--quick --parts kmax",
    "haptic lab curved": "--slides 0.02",
    "haptic study needs": "--rounds 1",
    "haptic study response": "--points 3",
    "haptic study needs sphere_feel": "duration:=1 --rounds 0",
    "haptic study design": "--mass 0.1 --taps 2",
    "haptic study design --compare": "--mass 0.1 --taps 2 --delays 0 --margins 0 --no-land",
    "haptic lab coverage": "--devices 1 --seconds 3 --workers 1",
    "haptic lab fig4": "--gain 2..20 --points 2 --horizon 1500 --workers 1",
}
"""Options that make a command short enough for a test, by its first words."""

INSTALLING = [
    line
    for block in blocks(README)
    for line in block.lines
    if line.startswith("python3 -m venv")
]
"""The two installation lines, run by `.ci/run` and in a fresh clone."""

BLOCKS = [  # tests/test_extending.py runs those of nodes/EXTENDING.md
    pytest.param(
        name,
        block,
        id=f"{name}: {block.lines[0].partition('#')[0].strip()}",
        # Those of the other pages measure and study, or launch what the README launches too.
        marks=[
            pytest.mark.process,
            *[pytest.mark.slow] * (name != "README.md"),
            *[pytest.mark.smoke]
            * (block.lines[-1].startswith("haptic launch touch_wall --view")),
        ],
    )
    for name, text in PAGES.items()
    for block in blocks(text)
    if name != "nodes/EXTENDING.md" and not set(block.lines) & set(INSTALLING)
]


@pytest.fixture(scope="module")
def places(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[dict[str, Path], Path]]:
    """Create a folder per page and one runtime directory; later blocks read earlier output."""
    with private_runtime_dir() as runtime_dir:
        yield {name: tmp_path_factory.mktemp("page") for name in PAGES}, runtime_dir


@pytest.mark.parametrize(("name", "block"), BLOCKS)
def test_commands_run_as_they_are_written(
    name: str,
    block: Block,
    places: tuple[dict[str, Path], Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folders, runtime_dir = places
    said = ""
    with shell(folders[name], runtime_dir) as terminal:
        if name == ".github/CONTRIBUTING.md":
            # Its reader stands in the clone.
            terminal.folder = ROOT
        for line in block.lines:
            wanted = command(line, SHORTER)
            printed = terminal.run(wanted)
            said += printed
            if "--json" in wanted.words:
                figures = json.loads(printed.splitlines()[-1])
                assert isinstance(figures, dict)
                if "--scenes" in wanted.words:
                    every_scene_has_its_row(figures["rows"])
                if wanted.words[:3] == ["haptic", "drill", "soak"]:
                    every_message_is_accounted_for(figures)
    assert promised(block.prints, said) == [], said


def every_scene_has_its_row(rows: list[dict[str, Any]]) -> None:
    """Check the page's launches of ``haptic bench loop --scenes``, to avoid a second run."""
    bodies = set(BODIES) if find_spec("mujoco") else set()
    assert {row["scene"] for row in rows} == {
        "floor_drop",
        "sphere_feel",
        "mesh_pebble",
        "ball of 1280 triangles",
    } | bodies
    for row in rows:
        assert row["tick"] == ("plain" if row["scene"] in bodies else "compiled")
        assert 0.0 < row["spent_us"]["p50"] <= row["spent_us"]["p99"]
        assert 0.0 < row["response_us"]["p50"] <= row["response_us"]["p99"]
        assert 0 <= row["missed"] <= row["ticks"]


def every_message_is_accounted_for(found: dict[str, Any]) -> None:
    """Check the page's soak of ten seconds; the number of missed ticks is not judged."""
    assert found["passed"], found["reasons"]
    assert found["rounds"] == found["respawns"] >= 1
    assert found["loggers"] == 2 * found["rounds"]
    assert found["changes"] == 8 * found["rounds"]
    assert {"driver", "environment", "coupling"} <= set(found["accounts"])
    assert all(one["lost"] == 0 for one in found["accounts"].values())
    assert found["accounts"]["driver"]["sent"] > 100
    assert found["shared"] > 100
    assert (
        sum(found["missed_after"].values())
        == sum(found["causes"].values())
        == found["missed"]
        >= found["held_up"]
    )


def test_the_pasted_lines_install_launch_and_test() -> None:
    launching, testing = INSTALLING
    assert launching.endswith(".venv/bin/haptic launch floor_drop")
    assert testing.endswith(".venv/bin/pytest")
    # It looks the line up by this pattern.
    pattern = r"^python3 -m venv .*pytest"
    assert pattern in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert re.findall(pattern + "$", README, re.MULTILINE) == [testing]


def test_the_template_of_a_report_is_a_test_that_passes() -> None:
    (code,) = re.findall(
        r"```python\n(.*?)```", PAGES[".github/CONTRIBUTING.md"], re.DOTALL
    )
    names: dict[str, Any] = {}
    exec(compile(code, "CONTRIBUTING.md", "exec"), names)  # noqa: S102  # our own page
    (test,) = (found for name, found in names.items() if name.startswith("test_"))
    test()


def test_templates_and_citation_are_what_github_reads() -> None:
    """Of an issue template: name and about; of CITATION.cff: the required fields of 1.2.0."""
    templates = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.md"))
    assert len(templates) >= 3
    for path in templates:
        _, head, body = path.read_text(encoding="utf-8").split("---\n", 2)
        assert {"name", "about"} <= set(yaml.safe_load(head)), path
        assert body.strip()
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert cited["cff-version"] == "1.2.0"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    assert (cited["version"], cited["license"]) == (
        project["version"],
        project["license"],
    )
    assert f"## [{cited['version']}] - {cited['date-released']}" in CHANGES


@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_left_to_be_filled_in(name: str) -> None:
    assert not re.findall(r"@@\w+@@|TODO|TBD", PAGES[name])


def test_the_first_page_is_read_in_three_minutes() -> None:
    assert len(README.split()) <= 1200
    assert len(README.splitlines()) <= 150


CHANGES = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [*PAGES, "CHANGELOG.md"])
def test_lines_have_at_most_100_columns(name: str) -> None:
    """Except rows of tables and pictures, which Markdown cannot break."""
    text = PAGES.get(name, CHANGES)
    assert [
        line
        for line in text.splitlines()
        if len(line) > 100 and not line.startswith(("|", "!["))
    ] == []


def test_changes_are_kept_as_the_page_says() -> None:
    """The format of keepachangelog.com; one line per change; 0.2.0 fits in 80 lines."""
    versions = re.split(r"^## ", CHANGES, flags=re.MULTILINE)[1:]
    heads = [version.partition("\n")[0] for version in versions]
    assert heads[0] == "[Unreleased]"
    assert all(
        re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", head) for head in heads[1:]
    )
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert set(re.findall(r"^### (.+)$", CHANGES, re.MULTILINE)) <= kinds
    (released,) = (version for version in versions if version.startswith("[0.2.0]"))
    assert len(released.splitlines()) <= 80
    for version in versions:
        for line in filter(None, version.splitlines()[1:]):
            assert line.startswith(("- ", "### ")), f"more than one line: {line}"


TABLED = sorted(
    {
        (name, line)
        for name, text in PAGES.items()
        for row in re.findall(r"^\|.*\|$", text, re.MULTILINE)
        for line in re.findall(r"`(haptic [a-z]+ [^`]*)`", row)
        # Others have a placeholder.
        if not re.search(r"\b[A-Z]+\b|…|\[", line)
    }
)
QUICK = (
    "haptic study kmax",
    "haptic study world",
    "haptic law show",
    "haptic launch --list",
)


@pytest.mark.parametrize(("name", "line"), TABLED)
def test_commands_of_tables_run(name: str, line: str, tmp_path: Path) -> None:
    """Quick ones are run as they are typed; of the others the words are read."""
    words = shlex.split(line)[1:]
    if line.startswith(QUICK) and name == "README.md":
        typed_in(tmp_path, *command(line, SHORTER).words[1:])
    elif words[0] in ("study", "lab", "bench") and len(words) > 2:
        own, declaring = Parser(), parser_for(words[0]).parse_args(words[:2]).declare
        declaring(VERBS.load(".".join(words[:2])), own)
        own.parse_args(words[2:])
    elif any(word.startswith("-") for word in words):
        parser_for(words[0]).parse_args(words)
    else:
        # A sub-verb that is named, without what it asks for.
        verb = ".".join(words[:2])
        if verb in VERBS.points():
            VERBS.load(verb)
        else:
            with pytest.raises(SystemExit) as asked:
                parser_for(words[0]).parse_args([*words[:2], "--help"])
            assert asked.value.code == 0


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    targets = [
        target
        for target in links(PAGES[name])
        if not target.startswith(("https://", "mailto:"))
    ]
    paths = []
    for target in targets:
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f"{target}: there is no such file"
        assert not anchor or anchor in anchors(there.read_text(encoding="utf-8")), (
            f"{target}: there is no such heading"
        )
        paths.append(str(there.relative_to(ROOT)))
    if (ROOT / ".git").exists() and paths:
        listed = subprocess.run(
            ["git", "ls-files", "--", *paths],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        for path in paths:
            tracked = [
                line
                for line in listed.stdout.splitlines()
                if line == path or line.startswith(path + "/")
            ]
            assert tracked, f"{path}: is not in the repository, so not in a clone"


def test_every_page_is_reached_from_the_first() -> None:
    reached = {"README.md"}
    while True:
        more = {
            str(
                (ROOT / name)
                .parent.joinpath(target.partition("#")[0])
                .resolve()
                .relative_to(ROOT)
            )
            for name in reached & set(PAGES)
            for target in links(PAGES[name])
            if not target.startswith(("https://", "mailto:", "#"))
        }
        if more <= reached:
            break
        reached |= more
    assert set(PAGES) <= reached


def test_every_scenario_and_every_verb_is_mentioned() -> None:
    for path in (ROOT / "launch").glob("*.yaml"):
        assert f"`{path.stem}`" in PAGES["launch/README.md"], (
            f"scenario {path.stem} is not described"
        )
    for verb in (VERBS.points()[name] for name in verbs()):
        if verb.package == OURS:
            assert re.search(rf"\bhaptic {verb.name}\b", README), (
                f"haptic {verb.name} is not mentioned"
            )


def leaves(parser: argparse.ArgumentParser) -> Iterator[tuple[str, ...]]:
    """Yield the words of each command below a parser."""
    below = [
        one for one in parser._actions if isinstance(one, argparse._SubParsersAction)
    ]
    if not below:
        yield ()
    for name, own in (
        (name, own) for one in below for name, own in one.choices.items()
    ):
        for words in leaves(own):
            yield (name, *words)


def constants(words: Sequence[ast.expr]) -> Iterator[tuple[str, ...]]:
    """Yield the runs of string constants in an argument list, split at blanks, from each on."""
    for first in range(len(words)):
        found = itertools.takewhile(
            lambda one: isinstance(one, ast.Constant), words[first:]
        )
        yield tuple(" ".join(str(one.value) for one in found).split()[:3])  # type: ignore[attr-defined]


def argument_lists(path: Path) -> Iterator[tuple[str, ...]]:
    """Yield the runs of constants in all calls, lists and tuples of a file."""
    for node in nodes_of(path):
        if isinstance(node, ast.Call):
            yield from constants(node.args)
        elif isinstance(node, ast.List | ast.Tuple):
            yield from constants(node.elts)
        elif isinstance(node, ast.Dict):
            # Tables of short runs, by the study's name.
            yield from constants([key for key in node.keys if key is not None])


def test_every_verb_is_run_by_a_page_or_a_test() -> None:
    """The words of each command of our own stand on a page or in an argument list of a test."""
    typed = {
        tuple(command(line, SHORTER).words[1:4])
        for text in PAGES.values()
        for block in blocks(text)
        for line in block.lines
    }
    ours = {
        words
        for verb in verbs()
        if VERBS.points()[verb].package == OURS
        for words in (
            {(verb, name) for name in sub_verbs(verb)} | {*leaves(parser_for(verb))}
        )
        if words != (verb,) or not sub_verbs(verb)
    }
    assert len(ours) > 75

    def run(words: tuple[str, ...]) -> bool:
        # Tests of studies give the name alone to a helper of theirs.
        starts = {words, words[1:]} if words[0] in ("study", "lab") else {words}
        return any(one[: len(start)] == start for one in typed for start in starts)

    missing = [words for words in sorted(ours) if not run(words)]
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        # A file is parsed only if the words of a missing command stand in it.
        if any(
            all(word in text for word in words[words[0] in ("study", "lab") :])
            for words in missing
        ):
            typed = set(argument_lists(path))
            missing = [words for words in missing if not run(words)]
    assert missing == []


def test_every_study_is_explained() -> None:
    """Studies and claims of the laboratory stand on sim/README.md, by their names."""
    page = PAGES["sim/README.md"]
    for name, point in VERBS.points().items():
        group, _, verb = name.partition(".")
        if point.package == OURS and group in ("study", "lab"):
            assert re.search(rf"\b{group} {verb}\b|`{verb}`", page), (
                f"haptic {group} {verb}"
            )


def test_nothing_is_shortened_that_is_not_there() -> None:
    typed = [
        command(line, {}).words
        for text in PAGES.values()
        for block in blocks(text)
        for line in block.lines
    ]
    for start in SHORTER:
        assert any(words[: len(start.split())] == start.split() for words in typed), (
            f"no command starts with {start}"
        )
