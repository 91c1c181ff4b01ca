"""What Python reports of a run: stops, refusals, failures and warnings, in Python's words."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import haptic
import pytest

from nodes.parameters.store import ParameterError
from sim.api.python_words import in_python
from sim.api.run_summary import RunSummary, summary_of, warnings_in
from tests.support import ROOT
from tests.support.launching import private_runtime_dir
from tests.support.sources import nodes_of

STOP = {
    "tick": 432.0,
    "before": "active",
    "after": "stopped",
    "reason": "run haptic node rearm",
}
START = {
    "tick": 0.0,
    "before": "waiting",
    "after": "active",
    "reason": "the first force",
}
QUIET = {
    "state": "active",
    "changes": [START],
    "refused": {"stale": 0},
    "limited": {"peak": 0},
}
STOPPED = {
    "state": "stopped",
    "changes": [START, STOP],
    "refused": {"stale": 2},
    "limited": {},
}
REARMED = {**STOPPED, "state": "active", "limited": {"peak": 3}}


def printed(safety: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return figures of ``haptic launch --json``, cut to what the summary reads."""
    figures = {
        "scenario": "wall_press",
        "exit_reason": "done",
        "ticks": 1500,
        "missed": 0,
    }
    figures |= {"rate_hz": 500.0, "response_us": {}, "recording": None, "failures": []}
    return figures | {
        "final": {"motion": "at rest"},
        "not_judged": {},
        "safety": safety,
        **more,
    }


@pytest.mark.parametrize(
    ("safety", "reason", "at"),
    [
        (QUIET, "done", None),
        (STOPPED, "loop stopped at tick 432", 432),
        (REARMED, "done", 432),  # forces came back
    ],
)
def test_a_stopped_loop_is_not_done(
    safety: dict[str, Any], reason: str, at: int | None
) -> None:
    found = summary_of(printed(safety), "", ended_here=False)
    assert (found.exit_reason, found.stopped_at_tick) == (reason, at)
    assert found.stopped_why == ("" if at is None else "call run.rearm()")
    # What happened is on the screen, and nothing of what did not.
    assert (
        ("refused" in found.figures()) == bool(found.refused) == (safety is not QUIET)
    )
    assert found.limited == ({"peak": 3} if safety is REARMED else {})
    assert ("loop stopped" in str(found)) == (safety is STOPPED)


def test_a_stop_of_any_chain_counts() -> None:
    chains = {"left": printed(QUIET), "right": printed(STOPPED)}
    found = summary_of(printed(QUIET, chains=chains), "", ended_here=False)
    assert found.exit_reason == "loop stopped at tick 432"
    assert found.stopped_why.startswith("right: ")
    assert found.refused == {"stale": 2}


def test_failures_and_what_is_not_judged_are_shown() -> None:
    more = {
        "failures": ["logger ended with exit code 3"],
        "not_judged": {"coupling": "no plant"},
    }
    found = summary_of(printed(QUIET, **more), "", ended_here=False)
    for text in ("logger ended with exit code 3", "no plant"):
        assert text in str(found)


def test_a_launch_ended_by_this_program_is_stopped() -> None:
    def reason(text: str, ended_here: bool) -> str:
        return summary_of(printed(QUIET, exit_reason=text), "", ended_here).exit_reason

    assert reason("SIGINT", True) == "stopped"
    assert reason("SIGINT", False) == "SIGINT"  # Ctrl-C elsewhere
    assert reason("done", True) == "done"  # it ended by itself just before


def test_warnings_are_what_a_program_must_not_overlook() -> None:
    errors = """[launch] the plain tick ran; the compiled one is being made in the background
[coupling] stability: coupling.laws.pd: pole radius 1.02; to study it anyway, use --force
[driver] safety: waiting → active at tick 0: the first force
[left/driver] stopped: active → stopped at tick 432: then run haptic node rearm
[launch] warning: stability not judged: coupling.plant, the device, is not declared
[logger] recording: floor_drop.mcap
"""
    assert warnings_in(errors) == [
        "[coupling] stability: coupling.laws.pd: pole radius 1.02; to study it anyway, pass"
        " force=True",
        "[left/driver] stopped: active → stopped at tick 432: then call run.rearm()",
        "[launch] warning: stability not judged: coupling.plant, the device, is not declared",
    ]


def texts(folder: Path) -> set[str]:
    """Return all string literals of a folder's modules that are no docstrings."""
    found = set()
    for path in folder.rglob("*.py"):
        docs = {
            id(node.body[0].value)
            for node in nodes_of(path)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        for node in nodes_of(path):
            if isinstance(node, ast.Constant) and id(node) not in docs:
                found |= {node.value} if isinstance(node.value, str) else set()
    return found


@pytest.mark.parametrize(
    "room", ["coupling", "driver", "laws", "environment", "parameters"]
)
def test_no_error_of_a_loop_speaks_of_options_in_python(room: str) -> None:
    options = [
        text
        for text in texts(ROOT / "nodes" / room)
        if re.search(r"(^|\s)--[a-z]", text)
    ]
    assert not [
        text for text in map(in_python, options) if re.search(r"(^|\s)--force", text)
    ]
    assert not [text for text in texts(ROOT / "nodes" / room) if "rearm()" in text]


def test_errors_of_a_launch_file_are_worded_for_python() -> None:
    with pytest.raises(ParameterError, match=r'haptic\.scenarios\(\)\["floor_drop"\]'):
        haptic.play("floor_drop", stifness=3)
    with pytest.raises(ParameterError, match=r"given as stiffness=-1\)"):
        haptic.play("floor_drop", stiffness=-1)


@pytest.mark.process
def test_an_unstable_run_is_told_as_one() -> None:
    # 9000 N/m on 0.145 kg in a hand of 300 N/m: above the limit that the warning itself names,
    # which tests of the judgement check against closed forms.
    with private_runtime_dir() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        patch.chdir(folder)
        with (
            pytest.warns(haptic.LaunchWarning, match="the loop is unstable"),
            pytest.warns(haptic.LaunchWarning, match="the loop generates energy"),
            haptic.launch("wall_press", stiffness=9000, pace="lockstep") as run,
        ):
            summary: RunSummary = run.wait()
        played = haptic.play("wall_press", stiffness=9000)
        assert summary.stopped_at_tick == played.stopped_at_tick
        assert summary.exit_reason == f"loop stopped at tick {played.stopped_at_tick}"
        assert "generates energy" in summary.stopped_why
