"""Structure of the code: imports go one way, between packages, rooms and files.

A room is a sub-package (``nodes.driver``); a module directly in a package is a room of its own.
Every import counts, also one inside a function or for types only.
"""

from __future__ import annotations

import ast
import itertools
import re
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

from nodes.parameters.quantities import QUANTITIES
from tests.support import ROOT
from tests.support.growth import CAPABILITIES
from tests.support.sources import nodes_of, sources_of, tree_of

FLOORS = ("messages", "nodes", "sim")
"""From the bottom up: a package imports from itself and from those before it."""


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    name_of(path): path
    for floor in FLOORS
    for path in sorted((ROOT / floor).rglob("*.py"))
}


@cache
def imported(module: str) -> tuple[tuple[str, str], ...]:
    """Return each own module that this one imports, and the importing line."""
    return tuple(_imported(module))


def _imported(module: str) -> Iterator[tuple[str, str]]:
    path = MODULES[module]
    for found in nodes_of(path):
        if isinstance(found, ast.Import):
            names = [name.name for name in found.names]
        elif isinstance(found, ast.ImportFrom):
            assert found.level == 0, f"{path}:{found.lineno}: relative import"
            names = [
                inner
                if (inner := f"{found.module}.{name.name}") in MODULES
                else str(found.module)
                for name in found.names
            ]
        else:
            continue
        for name in names:
            if name.split(".")[0] in FLOORS and name != module:
                assert name in MODULES, f"{path}:{found.lineno}: no module {name}"
                yield name, f"{path.relative_to(ROOT)}:{found.lineno} imports {name}"


def room(module: str) -> str:
    return ".".join(module.split(".")[:2])


def cycle(arrows: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the imports of a cycle; empty if there is none."""
    done: set[str] = set()

    def search(at: str, way: list[str]) -> list[str]:
        if at in way:
            ring = [*way[way.index(at) :], at]
            return [arrows[a][b] for a, b in itertools.pairwise(ring)]
        if at in done:
            return []
        for following in arrows.get(at, {}):
            if ring := search(following, [*way, at]):
                return ring
        done.add(at)
        return []

    for start in arrows:
        if ring := search(start, []):
            return ring
    return []


def test_no_import_goes_up() -> None:
    wrong = [
        line
        for module in MODULES
        for name, line in imported(module)
        if FLOORS.index(name.split(".")[0]) > FLOORS.index(module.split(".")[0])
    ]
    assert wrong == []


def test_no_circle_between_files() -> None:
    assert cycle({module: dict(imported(module)) for module in MODULES}) == []


def test_no_circle_between_rooms() -> None:
    arrows: dict[str, dict[str, str]] = {}
    for module in MODULES:
        for name, line in imported(module):
            if room(name) != room(module):
                arrows.setdefault(room(module), {}).setdefault(room(name), line)
    assert cycle(arrows) == []


def test_a_circle_is_found_and_named() -> None:
    """Tests the search itself: otherwise an empty list would prove nothing."""
    arrows = {
        "a": {"b": "a imports b"},
        "b": {"c": "b imports c"},
        "c": {"b": "c imports b"},
    }
    assert cycle(arrows) == ["b imports c", "c imports b"]


def test_few_modules_stand_outside_the_rooms() -> None:
    outside = [
        module
        for module in MODULES
        if module.count(".") == 1 and MODULES[module].name != "__init__.py"
    ]
    assert (
        len([module for module in outside if not module.startswith("messages.")]) <= 6
    )


APART = (
    ("nodes.driver", "nodes.view"),
    ("sim.device", "nodes.view"),
    ("nodes.base", "nodes.driver"),
    ("nodes.base", "nodes.compiled"),
)
"""Pairs of rooms of which the first must not import the second."""


def test_a_device_does_without_the_page_and_the_foundation_without_the_compiled_tick() -> (
    None
):
    found = [
        line
        for module in MODULES
        for name, line in imported(module)
        if (room(module), room(name)) in APART
    ]
    assert found == []


def types_of(path: Path) -> Iterator[str]:
    """Yield capitalised names defined at a module's top: classes and type aliases."""
    for node in tree_of(path).body:
        if isinstance(node, ast.ClassDef):
            yield node.name
        elif (
            isinstance(node, ast.AnnAssign)
            and isinstance(node.target, ast.Name)
            and ast.unparse(node.annotation) == "TypeAlias"
        ):
            yield node.target.id
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            made = ast.unparse(node.value).partition("(")[0]
            if (
                re.fullmatch("[A-Z][a-z][A-Za-z0-9]*", node.targets[0].id)
                and made != "TypeVar"
            ):
                yield node.targets[0].id


def test_one_word_is_one_class() -> None:
    """No two public classes or type aliases have the same name."""
    found: dict[str, list[str]] = {}
    for module, path in MODULES.items():
        for name in types_of(path):
            if not name.startswith("_"):
                found.setdefault(name, []).append(module)
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


PARTS = {"__init__", "node", "driver", "state", "parameters", "kernel", "compiled_tick"}
"""Parts that several rooms have: node, driver, state, parameters, kernels."""


def test_one_word_is_one_module() -> None:
    """No two modules share a name, except parts of several rooms, verbs and studies."""
    found: dict[str, list[str]] = {}
    for module, path in MODULES.items():
        if (
            room(module) in ("nodes.cli", "sim.cli")
            or module.rpartition(".")[0] in FUNCTIONS
        ):
            continue
        if path.stem not in PARTS:
            found.setdefault(path.stem, []).append(module)
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_the_tables_of_rooms_name_every_room_and_no_other() -> None:
    for floor in ("nodes", "sim"):
        page = (ROOT / floor / "README.md").read_text(encoding="utf-8")
        table = re.search(r"^\| room .*\n\| ---.*\n((?:\|.*\n)+)", page, re.MULTILINE)
        assert table is not None, floor
        told = set(
            re.findall(
                r"`([\w.]+?)/?`",
                "".join(re.findall(r"^\| (`.*?) \|", table[1], re.MULTILINE)),
            )
        )
        there = {
            path.name
            for path in (ROOT / floor).iterdir()
            if path.is_dir() and path.name != "__pycache__"
        }
        assert there - told == set(), floor
        assert {name for name in told if not (ROOT / floor / name).exists()} == set(), (
            floor
        )


PAGES = (
    "README.md",
    ".github/*.md",
    "launch/*.md",
    "messages/*.md",
    "nodes/**/*.md",
    "sim/*.md",
)
SOURCES = (
    "messages/**/*.py",
    "nodes/**/*.py",
    "sim/**/*.py",
    "launch/*.yaml",
    "nodes/view/web/*.js",
    "tests/**/*.py",
)
NAMED = re.compile(
    r"(?<![\w./-])((?:messages|nodes|sim|tests|launch)/"
    r"[\w/.-]*?\.(?:py|md|js|c|yaml|png|css|html))\b"
)
EXAMPLES = {"nodes/gone.py"}


def test_files_that_are_named_exist() -> None:
    """Files named in pages, docstrings and comments exist."""
    for pattern in (*PAGES, *SOURCES):
        for path in ROOT.glob(pattern):
            named = set(NAMED.findall(path.read_text(encoding="utf-8"))) - EXAMPLES
            # `NAME.py` stands for one of the reader's own.
            named = {name for name in named if "NAME" not in name}
            assert {name for name in named if not (ROOT / name).exists()} == set(), path


DIALECT = re.compile(
    r"told by a line|own name only|(?:is|are) told as|connected anew|no credit for|\bput"
    r" out\b|requests without an end|"
    r"who sends more|the text tells|left behind are|some (?:ten|twenty|thirty) seconds",
    re.IGNORECASE,
)
"""Sentences that had to be read twice."""


def test_pages_docstrings_and_messages_are_plain_english() -> None:
    found = {
        str(path.relative_to(ROOT)): words
        for pattern in (*PAGES, *SOURCES[:-1])
        for path in ROOT.glob(pattern)
        if (words := DIALECT.findall(path.read_text(encoding="utf-8")))
    }
    assert found == {}


WORDS = (
    "age apply coupling deflection drill edge guard H(1) H(−1) hold K_max knock landing lockstep"
    " needs proxy rest tap tick"
)


def test_the_glossary_explains_the_words_of_the_field() -> None:
    page = (ROOT / "nodes/GLOSSARY.md").read_text(encoding="utf-8")
    told = [word.strip("`") for word in re.findall(r"^\| (.+?) \|", page, re.MULTILINE)]
    assert set(WORDS.split()) - set(told) == set()
    assert len(set(told)) == len(told)


WITH_ARGUMENTS = {
    "sim.emulators.inverse_service": "a process of its own, that stands for a vendor's service"
}
"""Modules outside the command line that parse a command line."""


FUNCTIONS = ("sim.studies", "sim.lab.studies")
"""Where functions of options stand that are sub-verbs: one a file, called as it is."""

LONGEST_VERB = 60
"""Lines of a function of a command, which parses, calls and prints."""


def test_verbs_are_short() -> None:
    long = [
        f"{module}.{node.name}: {lines} lines"
        for module, path in MODULES.items()
        if module.startswith(("nodes.cli", "sim.cli", *FUNCTIONS, "sim.tune.tune"))
        for node in nodes_of(path)
        if isinstance(node, ast.FunctionDef)
        and (lines := (node.end_lineno or 0) - node.lineno + 1) > LONGEST_VERB
    ]
    assert long == []


def test_verbs_are_in_one_place() -> None:
    """A verb is a module in cli/ or a function; no other room reads arguments."""
    points = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]["entry-points"]
    verbs = points["haptic.verbs"]
    functions = {name: place for name, place in verbs.items() if ":" in place}
    assert {
        name: module.split(".cli.")[1]
        for name, module in verbs.items()
        if ":" not in module
    } == {name: name for name in verbs.keys() - functions.keys()}
    for name, place in functions.items():
        own = name.partition(".")[2]
        assert place in {f"{folder}.{own}:{own}" for folder in FUNCTIONS}, name
    for module, path in MODULES.items():
        tree = tree_of(path)
        if room(module) in ("nodes.cli", "sim.cli"):
            if any(
                isinstance(node, ast.FunctionDef) and node.name == "add"
                for node in tree.body
            ):
                # `topic pub` is long enough for a module of its own.
                assert module in {*verbs.values(), "nodes.cli.publish"}, (
                    f"{module}: a verb that pyproject.toml does not name"
                )
            continue
        names = {name for name, _ in imported(module)}
        assert not [
            name for name in names if name.startswith(("nodes.cli.", "sim.cli."))
        ], module
        reads = any(
            isinstance(node, ast.Import) and node.names[0].name == "argparse"
            for node in nodes_of(path)
        )
        assert reads == (module in WITH_ARGUMENTS), f"{module}: reads a command line"


OTHER_QUANTITIES = {
    ("nodes.cli.bag_arguments", "--rate"),  # of `bag play`, a speed as in ROS 2
    ("nodes.cli.publish", "--rate"),  # of `topic pub`, messages a second as in ROS 2
    ("sim.cli.bench.taps", "--taps"),  # several
    # a range, or a published hand by its name
    ("sim.studies.design_options", "hand"),
}


def declared(calls: str) -> Iterator[tuple[str, str, ast.Call]]:
    """Return verbs' arguments and functions' options: module, name and declaring call."""
    for module, path in MODULES.items():
        for node in nodes_of(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr == "add_argument" and calls == "argument":
                    for one in node.args:
                        if isinstance(one, ast.Constant):
                            yield module, str(one.value), node
            elif (
                calls == "option"
                and isinstance(node, ast.AnnAssign)
                and isinstance(node.value, ast.Call)
                and ast.unparse(node.value.func) in ("option", "argument")
            ):
                yield module, ast.unparse(node.target), node.value


def test_a_quantity_is_declared_once() -> None:
    found = {
        (module, name)
        for module, name, _ in (*declared("argument"), *declared("option"))
        if name.removeprefix("--") in QUANTITIES
    }
    assert found == OTHER_QUANTITIES


def test_each_number_of_a_command_line_has_its_limits() -> None:
    """A bare int or float would accept zero, huge values and infinity."""
    found = [
        f"{module}: {name}"
        for module, name, call in (*declared("argument"), *declared("option"))
        if module not in WITH_ARGUMENTS
        for word in call.keywords
        if word.arg == "type" and ast.unparse(word.value) in ("int", "float")
    ]
    assert found == []


STATE = "everything that goes on from tick to tick, one line a variable with its unit"

WIDE = {
    "nodes.base.node.Node": "the parts that every node is made of, one attribute each",
    "nodes.base.setup.Setup": "what a node is told: one field a fact",
    "nodes.ros2.node.Ros2": "a node, and one publisher or subscription a topic of the graph",
    "nodes.view.feed.Feed": "one binning a curve of the page",
    "nodes.view.live.LiveRun": "what a page sees of a run, one attribute each",
    "nodes.launcher.supervisor.Supervisor": (
        "what is known of a run while it goes on, one attribute each"
    ),
    "sim.identify.identified.Identified": "what is known of a device: one field a figure",
    "nodes.compiled.layout.LoopState": STATE,
    "nodes.coupling.state.CouplingState": STATE,
    "nodes.driver.state.DriverState": STATE,
    "sim.device.state.AxisState": STATE,
    "sim.play.nonideal.NonidealDevice": "what a device may have beyond a mass: one field a term",
}
"""Classes of more than 20 attributes, and why."""


def begins_with_a_path(text: ast.expr) -> bool:
    """Return whether an f-string begins as in ``f"{name}.law: ..."``."""
    if not isinstance(text, ast.JoinedStr):
        return False
    begin = ""
    for piece in text.values:
        if isinstance(piece, ast.Constant):
            begin += str(piece.value)
        elif isinstance(piece, ast.FormattedValue):
            begin += (
                "{}" if piece.conversion == -1 and piece.format_spec is None else " "
            )
    return re.match(r"[\w.\[\]]*\{\}[\w.{}\[\]]*: ", begin) is not None


def test_the_path_of_a_parameter_is_data() -> None:
    """A launch file's line is found from `ParameterError.path`; nobody reads it in a sentence."""
    errors = {
        "ParameterError",
        "LawRefusedError",
        "NotInstalledError",
        "NotOneAxisError",
    }
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in MODULES.values()
        for node in nodes_of(path)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args
        if node.func.id in errors and begins_with_a_path(node.args[0])
        if not any(keyword.arg == "path" for keyword in node.keywords)
    ]
    assert wrong == []


def attributes(kind: ast.ClassDef) -> set[str]:
    """Return what a class assigns to itself, and the fields it declares."""
    names = {
        node.target.id
        for node in kind.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    for node in ast.walk(kind):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and isinstance(node.value, ast.Name)
        ):
            names |= {node.attr} if node.value.id == "self" else set()
    return names


def test_long_functions_say_why() -> None:
    """Ruff holds the limits (C901, PLR0915); a longer function has a comment with the reason."""
    silent = []
    for path in sources_of(*FLOORS, "tests"):
        lines = path.read_text(encoding="utf-8").splitlines()
        for number, line in enumerate(lines, 1):
            if re.search(r"^\s*def .*# noqa: .*(C901|PLR0915)", line):
                above = itertools.dropwhile(
                    lambda text: text.lstrip().startswith("@"),
                    reversed(lines[: number - 1]),
                )
                if not next(above, "").lstrip().startswith("# Long"):
                    silent.append(f"{path.relative_to(ROOT)}:{number}")
    assert silent == []


def test_wide_classes_say_why() -> None:
    wide = set()
    for module, path in MODULES.items():
        for node in nodes_of(path):
            if isinstance(node, ast.ClassDef) and len(attributes(node)) > 20:
                wide.add(f"{module}.{node.name}")
    assert wide == set(WIDE)


def test_state_is_typed() -> None:
    """No rule takes an untyped state or node, so that mypy finds misspelt variables."""
    untyped = [
        f"{module}.{node.name}"
        for module, path in MODULES.items()
        for node in nodes_of(path)
        if isinstance(node, ast.FunctionDef)
        for argument in node.args.args
        if argument.arg in ("s", "d", "node", "driver")
        # the nodes of a YAML document are PyYAML's
        and module != "nodes.parameters.yaml_io"
        and isinstance(argument.annotation, ast.Name)
        and argument.annotation.id == "Any"
    ]
    assert untyped == []


def test_a_capability_names_modules_that_are_there() -> None:
    """The table of tests/support/growth.py counts nothing that has another name by now."""
    paths = [str(path.relative_to(ROOT)) for path in MODULES.values()]
    assert [
        name
        for names in CAPABILITIES.values()
        for name in names
        if not any(path.startswith(name) for path in paths)
    ] == []


WORDED = (*FLOORS, "tests")
"""Folders whose docstrings are in the words of the field: all of them."""

NOT_OF_THE_FIELD = frozenset(
    ["Tell", "Take", "Let", "Give", "Lay", "Look", "Say", "Have", "Hold", "Keep"]
)


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Return line and text of every docstring of a file, those of attributes included."""
    for node in nodes_of(path):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node.lineno, node.value.value.strip()


def worded_files() -> tuple[Path, ...]:
    return sources_of(*WORDED)


def test_docstrings_begin_with_words_of_the_field() -> None:
    """A first line has at most 88 columns, and begins with a verb of the field."""
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in worded_files()
        for line, text in docstrings(path)
        if text.split()[0] in NOT_OF_THE_FIELD or len(text.splitlines()[0]) > 88
    ]
    assert wrong == []


def test_no_line_is_longer_than_100_columns() -> None:
    long = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in worded_files()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        # what only a checker reads does not count
        if len(re.sub(r"\s+# (?:noqa|type: ignore).*", "", line)) > 100
    ]
    assert long == []


CROWDED = re.compile(
    r"[(\[]\n +(?:[^\n#]*[^,\n#\s]  # [^\n]*\n *[)\]]|[^\n#]*\n *[)\]][^\n#]*  # (?!type:|noqa))"
)
"""A value alone between brackets, beside a comment that did not fit on its line."""


def test_a_long_comment_stands_above_its_line() -> None:
    """Ruff would put the value between brackets of its own to keep the comment beside it."""
    for crowded in (
        "A = (\n    1  # why\n)\n",
        "a: list[\n    int\n] = []  # why\n",
        "    x: (\n        int  # why\n    )\n",
    ):
        assert CROWDED.search(crowded)
    for plain in (
        "A = (\n    1,  # why\n)\n",
        "f(\n    a=1,  # why\n    b=2,\n)\n",
        "# why\nA = 1\n",
        "a = [\n    1,\n    2,\n]  # why\n",
    ):
        assert not CROWDED.search(plain)
    found = [
        f"{path.relative_to(ROOT)}: {one[0]}"
        for path in worded_files()
        for one in CROWDED.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []
