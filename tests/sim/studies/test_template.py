"""The study of nodes/EXTENDING.md, in one file and one row: called, and typed in."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import haptic
import pytest

from nodes.cli.main import VERBS, Parser
from nodes.parameters.installed import EntryPoint, points
from sim.api import verbs
from sim.cli.functions import declare
from tests.support import ROOT
from tests.support.pages import written_files

FILES = written_files((ROOT / "nodes" / "EXTENDING.md").read_text(encoding="utf-8"))


@pytest.fixture
def halving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Register the page's file by the page's row, as its package does when it is installed."""
    module = ModuleType("halving")
    monkeypatch.setitem(sys.modules, "halving", module)
    exec(compile(FILES["halving/halving.py"], "halving.py", "exec"), module.__dict__)  # noqa: S102
    assert '"study.halving" = "halving:halving"' in FILES["halving/pyproject.toml"]
    row = EntryPoint("study.halving", "halving:halving", "halving")
    known = points("haptic.verbs") | {"study.halving": row}
    monkeypatch.setattr(verbs, "points", lambda _: known)
    monkeypatch.setattr(VERBS, "points", lambda: known)
    return module.halving


def test_the_study_is_called_by_its_name_with_checked_options(halving: Any) -> None:
    found = haptic.study("halving", stiffness=1500)
    # Independent of the study: all poles, from numpy's eigenvalues.
    plant = haptic.Plant(0.002, 0.1, 1.0)
    poles = haptic.poles({"kind": "pd", "stiffness": 1500, "damping": 3}, plant)
    slowest = max(
        abs(complex(*pole)) for pole in zip(poles.real, poles.imaginary, strict=True)
    )
    assert slowest ** found["halving_ticks"] == pytest.approx(0.5, rel=1e-9)
    assert found.held
    assert not haptic.study("halving", stiffness=1500, longest=5).held
    with pytest.raises(
        haptic.HapticError, match="stiffnes: no such option; did you mean stiffness"
    ):
        haptic.study("halving", stiffnes=1500)


def test_the_study_is_typed_in(
    halving: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert VERBS.load("study.halving") is halving
    parser = Parser(prog="haptic study halving")
    declare(halving, parser)
    # An unstable loop halves nothing: exit code 1, and null.
    for stiffness, code in (("1500", 0), ("4000", 1)):
        arguments: argparse.Namespace = parser.parse_args(
            ["--stiffness", stiffness, "--json"]
        )
        assert arguments.run(arguments) == code
        answer = json.loads(capsys.readouterr().out)
        assert (answer["halving_ticks"] is None) == (code == 1)
        assert code == 1 or math.isfinite(answer["halving_ticks"])
