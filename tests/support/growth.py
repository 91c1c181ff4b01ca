"""Growth of the code since a commit, in code tokens, from git alone.

``python -m tests.support.growth [BASE]`` prints a table in Markdown: tokens and lines of ``nodes``,
``messages`` and ``sim`` at both commits. Both trees are laid out alike first (ruff, 100 columns),
so that a change of the line length does not count. Modules of capabilities that did not exist at
the base are listed by the issue that asked for them (`CAPABILITIES`); everything else counts as
what was there, with all that was added to it.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tarfile
import tempfile
import tokenize
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

from tests.support import ROOT

BASE: Final = "7bc706e5"
"""The commit that issues 49 to 55 were written about."""

ROOMS: Final = ("nodes", "messages", "sim")

CAPABILITIES: Final[Mapping[str, tuple[str, ...]]] = {
    "49: soft beginnings, drawn launches": (
        "nodes/driver/epoch",
        "nodes/driver/soft_stop",
        "nodes/environment/shapes/beginning",
        "nodes/environment/shapes/carry",
        "nodes/environment/note_tick",
        "nodes/environment/spent_counters",
        "sim/drill/begins",
        "sim/drill/drawn_launches",
        "sim/drill/held_up",
        "sim/drill/random_launches",
        "sim/drill/witness",
        "sim/drill/writes",
    ),
    "50: any world, any hand, two hands": (
        "nodes/cli/law_worlds",
        "nodes/coupling/felt_law",
        "nodes/coupling/field_judgement",
        "nodes/coupling/force_fields",
        "nodes/driver/paired",
        "nodes/environment/partner",
        "nodes/environment/world",
        "nodes/stability/bracketed_roots",
        "nodes/stability/cosine_sums",
        "nodes/stability/dips",
        "nodes/stability/field_loop",
        "nodes/stability/k_window",
        "nodes/stability/landing_proof",
        "nodes/stability/loop_region",
        "nodes/stability/needed",
        "nodes/stability/pair",
        "nodes/stability/resonances",
        "nodes/stability/spring_world",
        "nodes/stability/world",
        "nodes/stability/worst_world",
        "sim/design/any_world",
        "sim/design/hand",
        "sim/design/linear_family",
        "sim/design/surroundings",
        "sim/experiments/body_detail",
        "sim/experiments/hands_apart",
        "sim/experiments/perception",
        "sim/lab/monte_carlo/outside",
        "sim/lab/paper/failures_beyond",
        "sim/stability/grasp",
        "sim/stability/two_hands",
        "sim/studies/any_world_design",
        "sim/studies/hands",
        "sim/studies/world",
    ),
    "51: events as data, remedies, results page": (
        "messages/event_kinds",
        "messages/reference_codec",
        "nodes/base/log_line",
        "nodes/cli/bug_report",
        "nodes/coupling/remedies",
        "nodes/parameters/interface_words",
        "sim/lab/result_page",
        "sim/lab/studies/results",
        "sim/results",
    ),
    "52: every scenario in one process, chains": (
        "nodes/launcher/chain_load",
        "nodes/launcher/plants",
        "nodes/launcher/usual_arguments",
        "sim/cli/bench/chains",
        "sim/drill/overload",
        "sim/measure/cancelling",
        "sim/play/chain",
    ),
    "53: meshes, scenes, recordings and data of others": (
        "nodes/cli/bag_import",
        "nodes/cli/mesh",
        "nodes/environment/bodies/contacts",
        "nodes/environment/bodies/implicit",
        "nodes/environment/bodies/scene_file",
        "nodes/environment/bodies/start",
        "nodes/environment/shapes/mesh_",
        "nodes/environment/shapes/polygons",
        "nodes/environment/shapes/region",
        "nodes/environment/shapes/surface_friction",
        "nodes/environment/shapes/triangle_sets",
        "nodes/recording/bag_table",
        "nodes/recording/foreign_",
        "nodes/recording/import",
        "nodes/recording/mat_file",
        "nodes/recording/part_clocks",
        "nodes/recording/ros2_",
        "nodes/ros2/added_bridges",
        "nodes/ros2/chain_control",
        "sim/lab/mesh_survey",
        "sim/lab/proxy_shapes",
        "sim/lab/studies/meshes",
    ),
    "54: laws, loops and own data in Python": (
        "nodes/launcher/given_law",
        "nodes/laws/described_laws",
        "nodes/laws/own_code_reads",
        "sim/api/compared_laws",
        "sim/api/linear",
        "sim/api/live_data",
        "sim/api/loops",
        "sim/api/named_worlds",
        "sim/api/own_data",
        "sim/api/responses",
        "sim/api/staircase",
        "sim/api/trials",
        "sim/device/hand",
        "sim/studies/notebook_results",
        "sim/studies/response",
    ),
    "55: the page at an address": (
        "nodes/view/ended_run",
        "nodes/view/law_edges",
        "nodes/view/map_drawer",
        "nodes/view/page_words",
        "nodes/view/ringing",
        "nodes/view/shown_surface",
        "nodes/view/steady_delay",
        "nodes/view/tessellation",
        "nodes/view/upload",
        "sim/javascript",
        "sim/static_page",
    ),
}
"""Modules of new capabilities, by their issue; a name stands for all that begin so."""


class Size(NamedTuple):
    """Size of some code."""

    tokens: int = 0  # names, operators, numbers and strings without docstrings
    code: int = 0  # lines with such a token
    lines: int = 0  # all lines

    def plus(self, other: Size) -> Size:
        """Return the sum of both."""
        return Size(*(a + b for a, b in zip(self, other, strict=True)))


_COUNTED: Final = (tokenize.NAME, tokenize.OP, tokenize.NUMBER, tokenize.STRING)
_DOCUMENTED = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module


def size_of(source: str) -> Size:
    """Return the size of a module."""
    documented = set[int]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node):
            text = node.body[0]
            documented |= set(range(text.lineno, (text.end_lineno or 0) + 1))
    found = [
        token.start[0]
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type in _COUNTED and token.start[0] not in documented
    ]
    return Size(len(found), len(set(found)), source.count("\n"))


def sizes_at(commit: str) -> dict[str, Size]:
    """Return the sizes of the modules at a commit, by path."""
    packed = subprocess.run(
        ["git", "-C", str(ROOT), "archive", commit, *ROOMS],
        capture_output=True,
        check=True,
    ).stdout
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(packed)) as files:
            files.extractall(folder, filter="data")
        alike = "--config=format.skip-magic-trailing-comma=true"
        words = ["format", "--isolated", "--quiet", "--line-length=100", alike]
        subprocess.run(["ruff", *words, folder], check=True)
        return {
            str(path.relative_to(folder)): size_of(path.read_text("utf-8"))
            for path in sorted(Path(folder).rglob("*.py"))
        }


def capability_of(module: str) -> str:
    """Return the capability that a module belongs to; empty for what was there at the base."""
    return next(
        (name for name, modules in CAPABILITIES.items() if module.startswith(modules)),
        "",
    )


def total(sizes: Mapping[str, Size], begin: str) -> Size:
    """Return the size of all modules of a folder."""
    found = Size()
    for path, size in sizes.items():
        if path.startswith(begin):
            found = found.plus(size)
    return found


def rows(before: Mapping[str, Size], after: Mapping[str, Size]) -> Iterator[list[str]]:
    """Yield the rows of the table: rooms, capabilities, sums."""
    new: dict[str, dict[str, Size]] = {name: {} for name in CAPABILITIES}
    then: dict[str, Size] = {}
    for path, size in after.items():
        name = "" if path in before else capability_of(path)
        (new[name] if name else then)[path] = size
    for title, begin in (*((room, f"{room}/") for room in ROOMS), ("all three", "")):
        was, now, whole = (total(sizes, begin) for sizes in (before, then, after))
        yield [
            title,
            *map(str, (was.tokens, now.tokens, whole.tokens)),
            f"{whole.tokens / whole.code:.2f}",
            *map(str, (was.lines, now.lines, whole.lines)),
        ]
    for name, sizes in new.items():
        size = total(sizes, "")
        yield [name, "", "", str(size.tokens), "", "", "", str(size.lines)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("base", nargs="?", default=BASE)
    parser.add_argument("head", nargs="?", default="HEAD")
    arguments = parser.parse_args()
    head = (
        *("what", "tokens at the base", "tokens of that now", "all tokens now"),
        *("tokens a line", "lines at the base", "lines of that now", "all lines now"),
    )
    print(f"| {' | '.join(head)} |\n|{' --- |' * len(head)}")
    for row in rows(sizes_at(arguments.base), sizes_at(arguments.head)):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
