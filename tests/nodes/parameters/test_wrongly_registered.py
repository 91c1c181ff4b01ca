"""A registered object of the wrong kind loses only its name, in every registry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from nodes.base.node_kinds import NODES
from nodes.cli.doctor import CHECKS
from nodes.cli.main import VERBS
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.environment.surfaces import SURFACES, parse_surface
from nodes.launcher.scenario_files import scenarios
from nodes.laws.base import LAWS, law_kinds, law_names
from nodes.laws.derivatives import DERIVATIVES, derivative_kinds
from nodes.laws.parse import LawRefusedError, parse_law
from nodes.parameters.registry import NotInstalledError, Registry
from nodes.parameters.store import ParameterError, convert
from nodes.view.comparison import PLAYERS
from tests.support.launching import exit_code

REGISTRIES = {
    registry.group: registry
    for registry in (LAWS, DERIVATIVES, SURFACES, NODES, VERBS, PLAYERS)
}

WRONG = """
import msgspec
from nodes.laws import CompiledLaw, Law

number = 3

class Plain:
    pass

class Misnamed(Law, frozen=True, kw_only=True, forbid_unknown_fields=True):
    kind = "another"

class Raises(Law, frozen=True, kw_only=True, forbid_unknown_fields=True):
    kind = "raises"
    def __post_init__(self):
        raise KeyError("no licence")

class Unwritable(Law, frozen=True, kw_only=True, forbid_unknown_fields=True):
    kind = "unwritable"
    held: object = object()
    def compile(self, period):
        return CompiledLaw((1.0,))

def add(parser):
    raise RuntimeError("half an update")
"""


@pytest.fixture
def wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install a package that registers wrong objects."""
    info = tmp_path / "wrong_things-1.0.dist-info"
    info.mkdir()
    (tmp_path / "wrong_things.py").write_text(WRONG, encoding="utf-8")
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: wrong-things\nVersion: 1.0\n", encoding="utf-8"
    )
    points = "".join(
        f"[{group}]\nnumber_there = wrong_things:number\n" for group in REGISTRIES
    )
    points += "[haptic.laws]\nplain_there = wrong_things:Plain\n"
    points += "misnamed_there = wrong_things:Misnamed\n"
    points += "raises = wrong_things:Raises\nunwritable = wrong_things:Unwritable\n"
    points += "[haptic.surfaces]\nmisplaced_there = wrong_things:Misnamed\n"
    points += (
        "[haptic.verbs]\nbag.raising = wrong_things\n[haptic.launch]\nmore ="
        " no_such_package.launch\n"
    )
    (info / "entry_points.txt").write_text(points, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("group", REGISTRIES)
def test_a_number_is_of_no_kind(wrong: Path, group: str) -> None:
    registry = REGISTRIES[group]
    with pytest.raises(
        NotInstalledError,
        match=rf"'number_there': .*3 .*wrong_things:number, registered in {group} by",
    ):
        registry.load("number_there")
    found, broken = registry.all()
    assert "number_there" in broken
    assert set(found) | set(broken) == set(registry.names())
    assert set(broken) <= {
        "number_there",
        "plain_there",
        "misnamed_there",
        "misplaced_there",
    }


@pytest.mark.parametrize("name", [[], {}, 5, None, "x" * 10_000])
def test_what_is_no_name_is_refused(name: Any) -> None:
    for registry in REGISTRIES.values():
        with pytest.raises(NotInstalledError, match="is not an installed"):
            registry.load(name)
    with pytest.raises(ParameterError, match=r"surface\.kind"):
        parse_surface({"kind": name}, "surface")


def test_laws_are_listed_but_for_the_wrong_ones(wrong: Path) -> None:
    """One wrong law broke the whole list."""
    assert {"plain_there", "misnamed_there", "raises", "unwritable"} <= set(law_names())
    laws = {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}}
    usual = {"stiffness": 800.0, "damping": 2.0}
    parameters = convert(
        {"law": "pd", "laws": laws, "usual": usual}, CouplingParameters, "coupling"
    )
    book = LawBook("coupling", 0.002)
    listed = {
        name: book.description(parameters, name) for name in book.names(parameters)
    }
    assert {"pd", "designed_d0"} <= set(listed)
    assert not {"plain_there", "misnamed_there", "raises", "unwritable"} & set(listed)
    for name in ("plain_there", "misnamed_there", "number_there"):
        with pytest.raises(
            LawRefusedError, match=rf"law.kind: '{name}': .*wrong-things"
        ):
            parse_law({"kind": name})
        assert name not in law_kinds()
    with pytest.raises(
        LawRefusedError,
        match=r"law: cannot be made: KeyError: 'no licence' \(law kind raises\)",
    ):
        parse_law({"kind": "raises"})
    assert "number_there" not in derivative_kinds()


def test_verbs_scenarios_and_the_doctor_go_on(
    wrong: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "floor_drop" in scenarios()
    assert exit_code("bag", "info", "absent.mcap") == 2
    assert capsys.readouterr().err == "haptic: absent.mcap: no such file\n"
    assert exit_code("bag", "raising", "a") == 2
    assert (
        "cannot declare its arguments: RuntimeError('half an update')"
        in capsys.readouterr().err
    )
    assert exit_code("number_there") == 2
    assert "has no add(parser)" in capsys.readouterr().err
    found = CHECKS["other packages"]()
    assert found.state == "limited"
    for name in (
        "number_there",
        "plain_there",
        "misnamed_there",
        "misplaced_there",
        "more",
    ):
        assert f"'{name}'" in found.found


def test_a_registry_without_a_rule_takes_anything(wrong: Path) -> None:
    assert Registry("haptic.laws", "name").load("number_there") == 3
