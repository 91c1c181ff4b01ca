"""Every named mutation, applied in a copy of the sources, makes its tests fail."""

from __future__ import annotations

import json
import weakref
from pathlib import Path
from typing import Any

import pytest

from tests.support import ROOT
from tests.support.mutations.__main__ import try_all
from tests.support.mutations.drawn import (
    ROOMS,
    all_of,
    draw,
    launched_by,
    room_of,
    suite_of,
)
from tests.support.mutations.forked import replace, replaced_code
from tests.support.mutations.mutation import (
    Mutation,
    Stage,
    copy_sources,
    mutated,
    near,
    noticed_by,
    stages,
)
from tests.support.mutations.rooms import NAMED_RULES
from tests.support.mutations.safety import SAFETY_RULES
from tests.support.mutations.score import (
    Tried,
    as_lines,
    as_record,
    counts,
    known,
    source_of,
    wilson,
)
from tests.support.mutations.unnoticed import EQUIVALENT, Equivalent

NAMED = (*SAFETY_RULES, *NAMED_RULES)


def test_every_mutation_changes_a_rule_that_stands_there_once() -> None:
    for mutation in NAMED:
        text = (ROOT / mutation.file).read_text(encoding="utf-8")
        assert mutated(text, mutation) != text
        assert all((ROOT / test).exists() for test in mutation.tests), mutation.name
    assert len({mutation.name for mutation in NAMED}) == len(NAMED)


@pytest.mark.parametrize("room", ROOMS)
def test_what_is_drawn_is_another_program(room: str) -> None:
    """Each compiles, differs in one place, and is drawn again by the same seed."""
    drawn = draw(40, "one", [room])
    for mutation in drawn:
        text = (ROOT / mutation.file).read_text(encoding="utf-8")
        changed = mutated(text, mutation)
        assert changed != text
        assert len(changed) == len(text) + len(mutation.new) - len(mutation.old)
        compile(changed, mutation.file, "exec")
        assert room_of(mutation) == room
    assert drawn == draw(40, "one", [room]) != draw(40, "two", [room])


def test_comparisons_signs_numbers_conditions_and_statements_are_changed(
    tmp_path: Path,
) -> None:
    file = tmp_path / "rule.py"
    file.write_text(
        'def rule(x: int = 3) -> str:\n    """Add 1."""\n    if x < 2 and x:\n        x += 5\n'
        '    assert x * 2.0\n    raise ValueError(f"{x + 1}")\n',
        encoding="utf-8",
    )
    found = {(one.old, one.new) for one in all_of(file, tmp_path)}
    assert found == {
        ("3", "4"),
        ("x < 2 and x", "(not (x < 2 and x))"),
        ("and", "or"),
        ("<", "<="),
        ("2", "3"),
        ("x += 5", "pass"),
        ("5", "6"),
        ("*", "/"),
        ("2.0", "4.0"),
    }


def test_what_changes_no_behaviour_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "looks.py"
    file.write_text(
        "LINES: tuple = ((0, (6, 1.5)),)\n"
        "STYLE = {'axes.labelsize': 9.0, 'alpha': 0.5, 'limit': 7}\n"
        "class WallParameters:\n    stiffness: float = 1000.0\n    pairs = 3\n"
        "class PD(Law, frozen=True):\n    gain: float = 3.0\n    taps = 2\n"
        "class State:\n    ticks: int = 4\n"
        "    def __repr__(self): return 5 * 'a'\n"
        "def draw(axes): axes.plot(6, lw=2.0, alpha=0.3, marker=8)\n",
        encoding="utf-8",
    )
    found = [one.old for one in all_of(file, tmp_path)]
    assert found == ["7", "3", "2", "4", "6", "8"]


RULES = """
BOUND = 3

def outer(x, most=4):
    def inner(y):
        return y + BOUND
    return inner(x) * 2

class Law:
    TAPS = 5
    def force(self, x):
        return [x - tap for tap in range(6)]

KEPT = Law().force
MADE = outer(1)
"""


@pytest.mark.parametrize(
    ("old", "new", "functions"),
    [
        ("y + BOUND", "y - BOUND", ["outer", "outer.<locals>.inner"]),
        ("* 2", "/ 2", ["outer"]),
        ("x - tap", "x + tap", ["Law.force", "Law.force.<locals>.<listcomp>"]),
        ("range(6)", "range(7)", ["Law.force"]),
        # Other code runs these: of the module, of a class, of a default, of a kernel.
        ("BOUND = 3", "BOUND = 4", None),
        ("TAPS = 5", "TAPS = 6", None),
        ("most=4", "most=5", None),
        ("outer(1)", "outer(2)", None),
        ("y + BOUND\n", "y - BOUND  # numba\n", ["outer", "outer.<locals>.inner"]),
    ],
)
def test_code_of_functions_is_replaced_where_they_stand(
    tmp_path: Path, old: str, new: str, functions: list[str] | None
) -> None:
    """A function that somebody keeps runs the new code too; whatever else is tried otherwise."""
    changed = RULES.replace(old, new)
    pairs = replaced_code(RULES, changed)
    assert (functions is None) == (pairs is None)
    assert replaced_code(f"import numba\n{RULES}", f"import numba\n{changed}") is None
    if pairs is None:
        return
    assert [one.co_qualname for one, _ in pairs] == functions
    file = str(tmp_path / "rules.py")
    here: dict[str, Any] = {}
    wanted: dict[str, Any] = {}
    exec(compile(RULES, file, "exec", dont_inherit=True), here)  # noqa: S102
    exec(compile(changed, "other", "exec", dont_inherit=True), wanted)  # noqa: S102
    # A weak proxy of what is gone, as others leave, is no function.
    gone = weakref.proxy(set())
    assert replace(pairs, file)
    assert (here["outer"](7), here["KEPT"](7)) == (
        wanted["outer"](7),
        wanted["KEPT"](7),
    )
    assert here["MADE"] == 8  # computed before
    assert not replace(pairs, file)
    del gone


@pytest.mark.parametrize("row", EQUIVALENT, ids=lambda row: f"{row.file}: {row.line}")
def test_an_equal_program_is_a_change_of_a_line_that_stands_there(
    row: Equivalent,
) -> None:
    text = (ROOT / row.file).read_text(encoding="utf-8")
    lines = [line.strip() for line in text.splitlines()]
    assert row.line in lines
    assert row.old in row.line
    assert row.why
    assert not any(
        (one.old, one.new) == (row.old, row.new)
        and lines[text.count("\n", 0, one.place)] == row.line
        for one in all_of(ROOT / row.file)
    )


@pytest.mark.parametrize(
    ("test", "changed"),
    [
        ("x > 1.0 + 1e-6", False),
        ("abs(x - 1.0) <= 1e-9 * y", False),
        ("x > 2e-6", True),
        ("x >= 0.0", True),
        ("x == 1e-9", True),
        ("x < 1", True),
    ],
)
def test_a_margin_for_rounding_has_no_sides(
    tmp_path: Path, test: str, changed: bool
) -> None:
    """Its numbers are changed all the same."""
    file = tmp_path / "rule.py"
    file.write_text(f"is_so = {test}\n", encoding="utf-8")
    found = [one.old for one in all_of(file, tmp_path)]
    assert any(one in ("<", "<=", ">", ">=", "==") for one in found) is changed
    assert len(found) > int(changed)


def test_files_are_tried_before_the_rest_of_their_folders() -> None:
    (law,) = (one for one in draw(400, "one", ["nodes/laws"])[:1])
    tests = (*("tests/test_house.py", "tests/test_imports.py"), "tests/a", "tests/c")
    assert stages(tests) == [
        tests[:2],
        (
            "tests/a",
            "tests/c",
            "--ignore=tests/test_house.py",
            "--ignore=tests/test_imports.py",
        ),
    ]
    assert stages(tests[:2]) == [tests[:2]]
    assert near(tests) == tests
    assert near(("a/test_e.py", *tests)) == ("a/test_e.py", *tests[:2])
    assert stages(law.tests)[-1][:1] == ROOMS["nodes/laws"]


@pytest.mark.parametrize(
    ("file", "noticing"),
    [
        # By its name, by an import of it, by one of what imports it.
        ("nodes/driver/pointer.py", "tests/nodes/driver/test_pointer.py"),
        ("nodes/driver/motion.py", "tests/nodes/driver/test_oracles.py"),
        ("sim/identify/conclude.py", "tests/sim/identify/test_identify.py"),
        ("nodes/driver/tick.py", "tests/nodes/driver/test_no_push.py"),
        # By an import in another folder, where none of its room imports it.
        ("nodes/recording/ros2_shapes.py", "tests/nodes/ros2/test_topics.py"),
    ],
)
def test_a_file_is_tried_by_the_tests_that_run_it(file: str, noticing: str) -> None:
    one = all_of(ROOT / file)[0]
    files = stages(suite_of(room_of(one), ROOT / file))[0]
    assert noticing in files
    assert len(set(files)) == len(files)


@pytest.mark.parametrize(
    ("file", "first", "also"),
    [
        ("nodes/driver/touch/driver.py", "test_touch", "test_last_line"),
        ("nodes/coupling/node.py", "test_hot_swap", "test_refused_live"),
        ("nodes/recording/logger.py", "test_own_data_page", "test_record"),
    ],
)
def test_a_survivor_is_tried_by_its_folder_tests_that_start_processes(
    file: str, first: str, also: str
) -> None:
    room = file.rpartition("/")[0].removesuffix("/touch")
    found = launched_by(room, ROOT / file)
    assert found[0] == f"tests/{room}/{first}.py"
    assert f"tests/{room}/{also}.py" in found
    assert all(
        "mark.process" in (ROOT / one).read_text(encoding="utf-8") for one in found
    )
    (one,) = (one for one in draw(1, "one", ["nodes/stability"]))
    assert one.launched == () == one.tests_of(Stage.LAUNCHED)


@pytest.mark.parametrize(
    ("noticed", "tried"), [(0, 7), (7, 7), (27, 30), (1, 1), (90, 180)]
)
def test_wilson_bounds_are_the_shares_that_lie_a_quantile_away(
    noticed: int, tried: int
) -> None:
    """Each bound p solves (k/n - p)² = z² p (1 - p) / n, which is how Wilson derived them."""
    share = noticed / tried
    low, high = wilson(noticed, tried)
    assert 0.0 <= low <= share <= high <= 1.0
    for bound in (low, high):
        spread = 1.959963984540054**2 * bound * (1.0 - bound) / tried
        assert (share - bound) ** 2 == pytest.approx(spread, abs=1e-12)
    assert (low == 0.0) == (noticed == 0)
    assert (high == 1.0) == (noticed == tried)


def test_the_score_counts_rooms_and_all_that_were_drawn() -> None:
    some = draw(12, "one")
    noticed = [None if i < 3 else "test_a.py::test_b" for i in range(12)]
    tried = [
        Tried(room_of(one), one, noticed[i], Stage.LAUNCHED if i < 5 else Stage(1))
        for i, one in enumerate(some)
    ]
    tried.append(Tried("named", NAMED_RULES[0], "test_a.py::test_c"))
    found = counts(tried)
    assert found["all drawn"] == (12, 7, 2)
    assert found["named"] == (1, 1, 0)
    assert {room: found[room].noticed for room in ROOMS} == {
        room: 1 if i < 3 else 2 for i, room in enumerate(ROOMS)
    }
    assert all(found[room].tried == 2 for room in ROOMS)
    record = as_record(tried)
    assert record["survive"] == [one.name for one in some[:3]]
    lines = as_lines(tried)
    assert lines[-4].split()[:5] == ["all", "drawn", "12", "7", "2"]
    assert lines[-4].split()[5:6] == ["75"]
    assert lines[-3:] == [f"survives: {one.name}" for one in some[:3]]


def test_a_run_goes_on_from_its_file(tmp_path: Path) -> None:
    """What the file has is not tried again, unless it survived and that is asked for."""
    some = draw(4, "one")
    tried = [Tried("named", one, None, Stage.LAUNCHED) for one in some]
    tried[0] = Tried("named", some[0], "pytest ends with -24")
    record = tmp_path / "score.json"
    assert known(record, again=False) == {}
    text = json.dumps(as_record(tried))
    record.write_text(text, encoding="utf-8")
    assert len(known(record, again=False)) == 4
    assert list(known(record, again=True).values()) == [tried[0][2:]]
    # The folder has no sources, so whatever was tried would fail.
    groups = [("named", one) for one in some]
    assert try_all(groups, tmp_path, record) == tried
    with pytest.raises(FileNotFoundError):
        try_all(groups, tmp_path, record, again=True)
    # What survived in one process is tried by tests that start processes, if that is asked for.
    later = [tried[0], *(one._replace(stage=Stage.IN_PROCESS) for one in tried[1:])]
    record.write_text(json.dumps(as_record(later)), encoding="utf-8")
    assert try_all(groups, tmp_path, record, last=Stage.IN_PROCESS) == later
    with pytest.raises(FileNotFoundError):
        try_all(groups, tmp_path, record)
    # A result belongs to the text of its file.
    record.write_text(text.replace(source_of(some[0]), "0"), encoding="utf-8")
    with pytest.raises(FileNotFoundError):
        try_all(groups, tmp_path, record)


@pytest.mark.slow
def test_who_tries_one_tells_which_test_noticed(tmp_path: Path) -> None:
    """A change of nothing survives, a named one does not, and the sources are as they were."""
    copy_sources(tmp_path)
    (marginal,) = (one for one in NAMED_RULES if "grow by e" in one.name)
    before = (tmp_path / marginal.file).read_bytes()
    nothing = marginal._replace(name="nothing", new=f"{marginal.old}  # as it is")
    assert noticed_by(nothing, tmp_path) is None
    noticing = noticed_by(marginal, tmp_path)
    assert str(noticing).startswith(f"{marginal.tests[0]}::test_")
    assert (tmp_path / marginal.file).read_bytes() == before
    # A test that fails without any mutation notices nothing.
    always = tmp_path / "tests" / "test_always.py"
    always.write_text("def test_fails(): assert 0\n", encoding="utf-8")
    tests = (f"tests/{always.name}", *marginal.tests)
    both: list[tuple[str, Mutation]] = [
        ("named", one._replace(tests=tests)) for one in (nothing, marginal)
    ]
    record = tmp_path / "score.json"
    tried = try_all(both, tmp_path, record)
    assert [one.noticed_by for one in tried] == [None, noticing]
    assert [one.stage for one in tried] == [Stage.LAUNCHED, Stage.IN_PROCESS]
    assert json.loads(record.read_text(encoding="utf-8"))["survive"] == ["nothing"]


@pytest.mark.slow
def test_a_process_that_fails_by_chance_notices_nothing(tmp_path: Path) -> None:
    """Tests that start processes try what survives; one must fail twice, and only with it."""
    copy_sources(tmp_path)
    rule = tmp_path / "rule.py"
    rule.write_text("ANSWER = 42\n", encoding="utf-8")
    text = """
import subprocess, sys
from pathlib import Path
import pytest

def answer():
    return subprocess.check_output([sys.executable, "-c", "import rule; print(rule.ANSWER)"])

@pytest.mark.process
def test_fails_at_first():
    answer()
    seen = Path("seen")
    first, _ = not seen.exists(), seen.touch()
    assert not first

@pytest.mark.process
def test_answers():
    assert answer() == b"42\\n"

def test_in_process():
    assert 0
"""
    test = tmp_path / "tests" / "test_launched.py"
    test.write_text(text, encoding="utf-8")
    name = f"tests/{test.name}"
    other = Mutation("other", "rule.py", "42", "43", (), launched=(name,))
    same = other._replace(name="same", new="42 ")
    assert noticed_by(other, tmp_path) is None
    assert noticed_by(other, tmp_path, stage=Stage.LAUNCHED) == f"{name}::test_answers"
    (tmp_path / "seen").unlink()
    assert noticed_by(same, tmp_path, stage=Stage.LAUNCHED) is None
