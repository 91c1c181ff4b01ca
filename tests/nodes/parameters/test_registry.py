"""A foreign package that cannot be imported loses only its own names."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from nodes.parameters.registry import NotInstalledError, Registry
from tests.support.launching import haptic, launch_json, private_runtime_dir, running

HALF_DERIVED = (
    "{kind: pd_alpha, stiffness: 1000, damping: 3, order: 0.5, taps: 4, gains: physical,"
    " derivative: half}"
)
NOUNS = {
    "laws": "law",
    "derivatives": "realisation of D^α",
    "surfaces": "surface",
    "nodes": "kind of node",
    "verbs": "verb",
}
"""What a registry's entries are called."""


@pytest.fixture
def broken(tmp_path: Path) -> dict[str, str]:
    """Install by PYTHONPATH a package whose names all raise on import; return variables."""
    folder = tmp_path / "site"
    info = folder / "half_finished-0.1.dist-info"
    info.mkdir(parents=True)
    (folder / "half_finished.py").write_text(
        "raise SystemExit('no licence server')\n", encoding="utf-8"
    )
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: half-finished\nVersion: 0.1\n", encoding="utf-8"
    )
    points = "".join(
        f"[haptic.{group}]\nhalf = half_finished:Half\n" for group in NOUNS
    )
    (info / "entry_points.txt").write_text(points, encoding="utf-8")
    return {
        **os.environ,
        "PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
    }


@pytest.mark.slow
def test_what_does_not_import_leaves_everything_else_alone(
    tmp_path: Path, broken: dict[str, str]
) -> None:
    with private_runtime_dir() as runtime_dir:
        environment = {**broken, "HAPTIC_RUNTIME_DIR": str(runtime_dir)}
        words = ("launch", "floor_drop", "pace:=lockstep", "duration:=0.2", "--no-plot")
        haptic(tmp_path, *words, environment=environment)
    haptic(tmp_path, "study", "kmax", "--law", "pd", "--gain", "3", environment=broken)
    assert "half" in haptic(tmp_path, environment=broken, code=2).stdout
    checks = json.loads(
        haptic(tmp_path, "doctor", "--json", environment=broken, code=None).stdout
    )["checks"]
    found = next(check for check in checks if check["name"] == "other packages")
    assert found["state"] == "limited"
    unnamed = [
        noun
        for noun in NOUNS.values()
        if f"'half': the {noun} cannot be imported" not in found["found"]
    ]
    assert unnamed == []
    assert "of the package half-finished" in found["found"]


@pytest.mark.process
@pytest.mark.parametrize(
    ("words", "noun"),
    [
        (("study", "kmax", "--law", "half"), "law"),
        (("law", "show", HALF_DERIVED), "realisation of D^α"),
        (("launch", "half.yaml"), "surface"),
        (("launch", "node.yaml"), "kind of node"),
        (("half",), "verb"),
    ],
)
def test_who_asks_for_it_is_told_what_is_wrong_and_whose_it_is(
    words: tuple[str, ...], noun: str, tmp_path: Path, broken: dict[str, str]
) -> None:
    (tmp_path / "half.yaml").write_text(
        "summary: s\nnodes:\n  environment: {kind: environment, parameters: {surface: {kind:"
        " half}}}\n  driver: {kind: sim_driver, parameters: {device: {mass: 0.1}}}\n  coupling:"
        " {kind: coupling, parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 100.0, damping:"
        " 1.0}}}}\n",
        encoding="utf-8",
    )
    (tmp_path / "node.yaml").write_text(
        "summary: s\nnodes: {odd: {kind: half}}\n", encoding="utf-8"
    )
    with private_runtime_dir() as runtime_dir:
        told = haptic(
            tmp_path,
            *words,
            environment={**broken, "HAPTIC_RUNTIME_DIR": str(runtime_dir)},
            code=2,
        ).stderr
    assert "Traceback" not in told
    assert "SystemExit: no licence server" in told
    assert "half_finished:Half" in told
    if noun != "kind of node":
        assert f"'half': the {noun} cannot be imported" in told
        assert "half-finished" in told


UNRESOLVED = """
from __future__ import annotations
import msgspec

class Soft(msgspec.Struct):
    stiffness: Stifness
"""


def test_a_field_of_an_unknown_type_is_told_with_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "typing_error-1.0.dist-info"
    info.mkdir()
    (tmp_path / "typing_error.py").write_text(UNRESOLVED, encoding="utf-8")
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: typing-error\nVersion: 1.0\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(
        "[haptic.surfaces]\nsoft = typing_error:Soft\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(
        NotInstalledError,
        match=r"'soft': the surface .*NameError: .*Stifness.*of the package typing-error",
    ):
        Registry("haptic.surfaces", "surface").load("soft")


SOFT = """
from nodes.laws import CompiledLaw, Law

class Soft(Law, frozen=True, kw_only=True, forbid_unknown_fields=True):
    kind = "soft"
    stiffness: float

    def compile(self, period):
        return CompiledLaw((self.stiffness,))
"""


@pytest.mark.process
def test_an_installed_law_is_taken_by_name_in_every_scenario(tmp_path: Path) -> None:
    info = tmp_path / "site" / "soft_laws-1.0.dist-info"
    info.mkdir(parents=True)
    (info.parent / "soft_laws.py").write_text(SOFT, encoding="utf-8")
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: soft-laws\nVersion: 1.0\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(
        "[haptic.laws]\nsoft = soft_laws:Soft\n", encoding="utf-8"
    )
    environment = {
        "PYTHONPATH": f"{info.parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    }
    figures = launch_json(
        tmp_path,
        "floor_drop",
        "law:=soft",
        "stiffness:=500",
        "duration:=10",
        "pace:=lockstep",
        environment=environment,
    )
    # m g / K with the scenario's K; the device's own damper less K T/2, 0.5 N s/m, leaves e^-25 of
    # the bounce after 10 s.
    assert figures["final"]["position_m"] == pytest.approx(
        -0.1 * 9.81 / 500.0, rel=1e-5
    )
    with running(
        tmp_path, "wall_press", "duration:=0", environment=environment
    ) as launch:
        assert "soft" in launch.call("coupling", "law.list")["laws"]
        assert launch.call("coupling", "law.show", law="soft")["h1_n_per_m"] == 1000.0


@pytest.mark.process
@pytest.mark.smoke
def test_a_sub_verb_that_does_not_import_leaves_those_beside_it_alone(
    tmp_path: Path, broken: dict[str, str]
) -> None:
    points = tmp_path / "site" / "half_finished-0.1.dist-info" / "entry_points.txt"
    points.write_text(
        points.read_text(encoding="utf-8") + "bag.half = half_finished\n",
        encoding="utf-8",
    )
    told = haptic(
        tmp_path, "bag", "info", "absent.mcap", environment=broken, code=2
    ).stderr
    assert told == "haptic: absent.mcap: no such file\n"
    told = haptic(
        tmp_path, "bag", "half", "a.mcap", "--more", environment=broken, code=2
    ).stderr
    assert told.startswith(
        "haptic: 'bag.half': the verb cannot be imported: SystemExit: no licence server"
    )


@pytest.mark.process
@pytest.mark.parametrize("verb", ["bag", "law", "study"])
def test_one_module_is_a_sub_verb_of_any_verb_that_has_some(
    verb: str, tmp_path: Path
) -> None:
    """The same module works as a verb, and as a sub-verb of `bag` and `law`."""
    folder = tmp_path / "site"
    info = folder / "counted-0.1.dist-info"
    info.mkdir(parents=True)
    (folder / "counted.py").write_text(
        '"""Count 100 % of the words."""\n\nfrom nodes.cli.main import add_json, answer\n\n\ndef'
        ' add(parser):\n    parser.add_argument("words", nargs="+")\n    add_json(parser)\n   '
        " parser.set_defaults(run=run)\n\n\ndef run(arguments):\n    return answer(arguments.json,"
        ' {"words": len(arguments.words)}, "")\n',
        encoding="utf-8",
    )
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: counted\nVersion: 0.1\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(
        f"[haptic.verbs]\n{verb}.count = counted\n", encoding="utf-8"
    )
    environment = {
        **os.environ,
        "PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
    }
    told = haptic(
        tmp_path, verb, "count", "a", "b", "--json", environment=environment
    ).stdout
    assert json.loads(told) == {"words": 2}
    assert (
        "Count 100 % of the words."
        in haptic(tmp_path, verb, "--help", environment=environment).stdout
    )
