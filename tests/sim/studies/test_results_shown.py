"""Results of ``haptic``: display, figures and tables; the examples in docstrings run."""

from __future__ import annotations

import doctest
import functools
import importlib
import io
import json
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import haptic
import msgspec
import numpy as np
import pytest

import sim.api
from messages.errors import UsageError
from nodes.parameters.options import options_of
from sim.api.recordings import TickTable
from sim.lab.studies.meshes import MeshesOptions
from sim.stability.every_delay import Certificate
from sim.studies.design import design
from sim.studies.design_options import DesignOptions
from sim.studies.detail import DetailOptions
from sim.studies.kmax_found import KMaxBoundary, KMaxFound
from sim.studies.notebook_results import Result
from sim.studies.result import Findings, StudyResult, at_top
from tests.support.launching import assert_nothing_left, private_runtime_dir

MODULES = [
    importlib.import_module(f"sim.api.{found.name}")
    for found in pkgutil.iter_modules(sim.api.__path__)
]

LAW = {"kind": "pd", "stiffness": 1000, "damping": 3}
PLANT = haptic.Plant(0.002, 0.1, 1.0)


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    with private_runtime_dir() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        patch.chdir(folder)
        yield folder
        assert_nothing_left(folder)


@pytest.fixture(scope="module")
def run(place: Path) -> haptic.Run:
    with haptic.launch("floor_drop", pace="lockstep", duration=0.4) as started:
        started.wait()
    return started


@functools.cache
def studied() -> StudyResult:
    """Return one study for all tests, the slowest of the results."""
    return haptic.study("kmax", law="pd", gain="1..5", points=3)


MAKERS: dict[str, Callable[[haptic.Run], Result]] = {
    "KMaxResult": lambda _: haptic.k_max(LAW, PLANT),
    "Poles": lambda _: haptic.poles(LAW, PLANT),
    "Played": lambda _: haptic.drop(LAW, PLANT),
    "Response": lambda _: haptic.response(LAW, PLANT),
    "ZWidthResult": lambda _: haptic.z_width(LAW, PLANT, gains=[0.0, 3.0]),
    "LawTable": lambda _: haptic.compare([LAW, LAW], PLANT),
    "OpenLoop": lambda _: haptic.loop(LAW, PLANT),
    "TrialTable": lambda _: haptic.trials({"a": {}, "b": {}}, blocks=3).run(
        lambda trial: trial.number
    ),
    "Recorded": lambda run: run.recording,
    "RunSummary": lambda run: run.summary,
    KMaxBoundary.__name__: lambda _: studied(),
    KMaxFound.__name__: lambda _: haptic.study("kmax", law="pd", gain=3),
}

LAUNCHED = {
    "IdentifiedPlaces",
    "IdentifiedRecording",
    "KMaxLaunched",
    "LiveTable",
    "SwingFound",
    "TuneResult",
}
"""Made of launches, which tests of identification and tuning start."""


def kinds() -> set[type[Result]]:
    """Return the results with code of their own; those of fields alone behave alike."""
    found, left = set(), [Result]
    while left:
        left += (mine := left.pop().__subclasses__())
        found.update(mine)
    return {kind for kind in found if Findings not in kind.__mro__} | {KMaxBoundary}


def test_every_result_is_looked_at() -> None:
    bases = {StudyResult.__name__, TickTable.__name__}
    assert {kind.__name__ for kind in kinds()} - LAUNCHED - bases == set(MAKERS)


@pytest.mark.process
@pytest.mark.parametrize("name", MAKERS)
def test_a_result_shows_draws_and_tabulates_itself(name: str, run: haptic.Run) -> None:
    result = MAKERS[name](run)
    assert type(result).__name__ == name
    shown = result._repr_html_()
    assert f"<caption>{name}</caption>" in shown
    assert shown.count("<tr>") == len(result.figures()) > 0
    figure = result.plot()
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    assert picture.getvalue().startswith(b"\x89PNG")
    drawn = figure.axes[0]
    assert drawn.lines or drawn.patches or drawn.images
    table = result.to_pandas()
    assert (
        len(table) == max([1, *map(len, result.columns().values())])
        or name == "KMaxBoundary"
    )
    assert str(result).startswith(name)
    assert repr(result) == str(result)


@pytest.mark.process
def test_an_answer_is_the_rows_of_its_study_and_its_picture(place: Path) -> None:
    found = studied()
    assert list(found.to_pandas()["gain"]) == [1.0, 3.0, 5.0]
    assert Path(found["plot"]).exists()
    assert len(found.plot().axes[0].images) == 1
    with pytest.raises(KeyError, match=r"there are .*k_max_n_per_m"):
        found["nonsense"]
    # Nothing is stable: that is an answer, and no error.
    none = haptic.study("kmax", law="pd", gain=1000)
    assert (none.held, none["k_max_n_per_m"]) == (False, None)
    with pytest.raises(haptic.HapticError, match=r"--gain"):
        haptic.study("kmax", law="pd")
    with pytest.raises(
        haptic.HapticError, match=r"^gan: no such option; did you mean gain\?$"
    ):
        haptic.study("kmax", law="pd", gan=3)
    with pytest.raises(haptic.HapticError, match=r"^points: 1: must be between 2"):
        haptic.study("kmax", law="pd", gain=(1, 5), points=1)
    with pytest.raises(haptic.LaunchError, match=r"haptic\.lab\('fig2'\) is it now"):
        haptic.study("fig2")
    with pytest.raises(haptic.LaunchError, match="no launch file is named 'nosuch'"):
        haptic.tune("nosuch")


def test_options_are_read_as_the_command_line_reads_them() -> None:
    assert options_of(design) is DesignOptions
    options = DesignOptions
    found = options.of(
        land=False,
        every_delay=True,
        delays=[0, 1],
        rate=None,
        mass=(0.05, 0.2),
        hand="stylus_firm",
    )
    typed: Any = options.of(
        delays=["0", "1"], mass="0.05..0.2", every_delay=True, land=False
    )
    assert found.mass == typed.mass == (0.05, 0.2)
    assert found.delays == typed.delays == [0.0, 1.0]
    assert (found.land, found.every_delay, found.rate) == (False, True, None)
    assert found.hand[0] == 0.0 < found.hand[1]
    with pytest.raises(UsageError, match="land = 1: expected True or False"):
        options.of(land=1)
    with pytest.raises(UsageError, match="world = 'moon': expected one of wall"):
        options.of(world="moon")


def test_the_last_argument_of_several_takes_them_apart_or_as_a_list() -> None:
    for kind, first in ((MeshesOptions, ()), (DetailOptions, ("shapes",))):
        name = "sources" if kind is MeshesOptions else "assignments"
        for given in (("a", "b"), (["a", "b"],), (("a", "b"),)):
            assert getattr(kind.of(*first, *given), name) == ["a", "b"]
        assert getattr(kind.of(*first, "a"), name) == ["a"]
    assert MeshesOptions.of().sources == []
    assert DetailOptions.of("shapes").assignments == []


@dataclass(frozen=True, repr=False, kw_only=True)
class Shown(Findings):
    """Figures of each type."""

    a: dict[str, float]
    c: int
    d: str
    e: bool
    f: None


@dataclass(frozen=True)
class Part:
    """Figures that stand at the top level."""

    g: Any
    h: Path


@dataclass(frozen=True, repr=False, kw_only=True)
class Nested(Findings):
    """Figures of figures."""

    part: Part = at_top()
    kind: Certificate
    parts: tuple[Part, ...]


def test_fields_are_figures_of_json_types() -> None:
    part = Part(np.array([1.0, np.nan]), Path("a.yaml"))
    found = Nested(
        lines=("said",),
        part=part,
        kind=Certificate.UNDECIDED,
        parts=(part,),
        ledger=Path("l"),
    )
    told = {"g": [1.0, None], "h": "a.yaml"}
    assert found.answer == {**told, "kind": "undecided", "parts": [told], "ledger": "l"}
    assert json.loads(json.dumps(found.answer)) == found.answer
    assert found.text == "said\nl"
    assert not found.kind


def test_figures_without_a_picture_are_bars() -> None:
    drawn = Shown(lines=(), a={"b": 1.0}, c=2, d="text", e=True, f=None).plot()
    (axes,) = drawn.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a.b", "c"]
    widths = [bar.get_bbox().width for bar in axes.patches]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(widths, [1.0, 2.0])


@pytest.mark.slow
def test_the_examples_run_and_there_is_one_for_each(place: Path) -> None:
    finder, runner = (
        doctest.DocTestFinder(),
        doctest.DocTestRunner(optionflags=doctest.ELLIPSIS),
    )
    run = set()
    for module in (*MODULES, importlib.import_module(haptic.Plant.__module__)):
        for example in finder.find(module):
            if example.examples:
                report = io.StringIO()
                assert runner.run(example, out=report.write).failed == 0, (
                    report.getvalue()
                )
                run.add(example.name.rpartition(".")[2])
    # Results come from functions; laws have examples of their own (test_described.py).
    others = (Result, msgspec.Struct, Exception)
    found = {name: getattr(haptic, name) for name in haptic.__all__}
    offered = {
        name
        for name, one in found.items()
        if not (isinstance(one, type) and issubclass(one, others))
    }
    assert offered - run == set()
