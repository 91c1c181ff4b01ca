"""The first launch builds compiled ticks, the second runs them; with a changed rule.

With real launches and a real compiler it shows that whoever never asked for compiled ticks has them
from the second launch on, and that a rule of the tick exists once: changed there, interpreter,
compiled nodes, one-process scene and replay follow it to the bit.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from messages.topics import DEVICE_STATE
from nodes.compiled.cache import folder
from nodes.launcher import launch_file, scenario_files
from nodes.recording.reader import Recording
from sim.play.player import play
from tests.support import ROOT
from tests.support.background import background, parent_of
from tests.support.launching import private_runtime_dir, wait_for

RULE = (
    "nodes/driver/safety.py",
    "share = s.regained / s.ramp_ticks",
    "share = (s.regained / s.ramp_ticks) ** 2",
)
"""Changed rule: the ramp grows with the square of time."""

KERNELS = (
    "nodes.driver.kernel",
    "nodes.environment.kernel",
    "nodes.coupling.kernel",
    "sim.device.kernel",
)
WORDS = ("floor_drop", "duration:=0.6", "--params", "slow.yaml")
RAMP = 500

PLAYED = """
import json, sys
from pathlib import Path
from nodes.launcher import launch_file, scenario_files
from sim.identify.counterfactual import replay
from sim.identify.recorded_scene import rebuild
from sim.play.player import play

assigned = scenario_files.parse_assignments(["duration:=0.6"])
trace = play(launch_file.read("floor_drop", assigned, (Path("slow.yaml"),))).along()
again = replay(rebuild(Path(sys.argv[1])))
forces = {"one process": trace.force, "replay": again.force[: len(trace.force)]}
print(json.dumps({name: [float(value) for value in row] for name, row in forces.items()}))
"""


class Changed(NamedTuple):
    """A copy of this project with another rule, a launch folder, and an empty cache."""

    sources: Path
    folder: Path
    cache: Path
    environment: dict[str, str]

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run Python in the folder."""
        return subprocess.run(
            [sys.executable, *words],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=True,
        )

    def launch(self, *words: str) -> tuple[dict[str, Any], str]:
        """Launch the scenario; return its summary and output."""
        done = self.run("-m", "nodes.cli.command", "launch", *WORDS, *words, "--json")
        return json.loads(done.stdout.splitlines()[-1]), done.stderr


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Changed]:
    base = tmp_path_factory.mktemp("changed")
    sources, runs, cache = base / "sources", base / "runs", base / "cache"
    for name in ("messages", "nodes", "sim", "launch"):
        shutil.copytree(
            ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    path, before, after = RULE
    text = (sources / path).read_text(encoding="utf-8")
    assert text.count(before) == 1
    (sources / path).write_text(text.replace(before, after), encoding="utf-8")
    runs.mkdir()
    (runs / "slow.yaml").write_text(
        f"driver: {{safety: {{ramp: {RAMP * 0.002}}}}}", encoding="utf-8"
    )
    with private_runtime_dir() as runtime:
        variables = {
            "PYTHONPATH": str(sources),
            "NUMBA_CACHE_DIR": str(cache),
            "HAPTIC_COMPILE": "background",
            "HAPTIC_RUNTIME_DIR": str(runtime),
        }
        made = Changed(sources, runs, cache, {**os.environ, **variables})
        keep_what_is_compiled(made)
        yield made


def keep_what_is_compiled(changed: Changed) -> None:
    """Copy the present compiled code into the copy's cache, to save half a minute.

    Modules that the rule affects are absent there by digest; otherwise the old rule would run.
    """
    there = Path(
        changed.run(
            "-c", "from nodes.compiled.cache import folder; print(folder())"
        ).stdout.strip()
    )
    there.mkdir(mode=0o700, parents=True)
    for path in (folder() / f"{kernel}.tick" for kernel in KERNELS):
        if path.exists():
            shutil.copy(path, there)


def forces_of(place: Path, figures: dict[str, Any]) -> list[float]:
    return [
        float(state.force[2])
        for state in Recording(place / figures["recording"]).messages(DEVICE_STATE)
    ][1:]


def hurried(cache: Path) -> dict[int, str]:
    """Return what compiles in the background, no longer at idle priority.

    It waits for an idle processor, which a machine that tests does not have.
    """
    compiling = background(cache)
    for process in compiling:
        with contextlib.suppress(PermissionError, ProcessLookupError):
            os.sched_setscheduler(process, os.SCHED_OTHER, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, process, 0)
    return compiling


@pytest.mark.slow
def test_the_second_launch_runs_compiled_and_every_player_keeps_the_changed_rule(
    changed: Changed,
) -> None:
    first, said = changed.launch("pace:=lockstep")
    assert first["tick"] == "plain"
    assert said.count("for the next launch") == 1
    # One that was started, and those that it has already forked, one a kernel.
    compiling = background(changed.cache)
    assert len([one for one in compiling if parent_of(one) not in compiling]) == 1
    wait_for(lambda: not hurried(changed.cache), "it is compiled", 600.0)
    assert {path.stem for path in changed.cache.rglob("*.tick")} == set(KERNELS)

    # By default: nobody asks for it, in real time and in lockstep.
    for words in ((), ("pace:=lockstep",)):
        second, said = changed.launch(*words)
        assert second["tick"] == "compiled"
        assert second["tick_by_node"] == dict.fromkeys(
            ("driver", "environment", "coupling"), "compiled"
        )
        assert second["ticks_compiled"]["driver"] == second["ticks"]
        assert "for the next launch" not in said
        assert "plain tick" not in said

    forces = {
        "interpreted nodes": forces_of(changed.folder, first),
        "compiled nodes": forces_of(changed.folder, second),
    }
    forces |= json.loads(
        changed.run("-c", PLAYED, str(changed.folder / first["recording"])).stdout
    )
    expected = forces["interpreted nodes"]
    assert len(expected) == 300
    assert all(row == expected for row in forces.values()), [
        name for name, row in forces.items() if row != expected
    ]

    # Until the first force the motion is that of the old rule: there the new force is the old one
    # times its share of the ramp.
    given = scenario_files.parse_assignments(["duration:=0.6"])
    old = (
        play(launch_file.read("floor_drop", given, (changed.folder / "slow.yaml",)))
        .along()
        .force.tolist()
    )
    touched = next(tick for tick, force in enumerate(old) if force)
    assert 1 < touched < RAMP - 1
    # A product of three numbers.
    assert expected[touched] / old[touched] == pytest.approx(
        (touched + 1) / RAMP, rel=1e-14
    )

    # Whoever changes it once more has the plain tick again, not the compiled one of other sources.
    path = changed.sources / RULE[0]
    path.write_text(
        path.read_text(encoding="utf-8").replace(RULE[2], RULE[1]), encoding="utf-8"
    )
    changed.environment["HAPTIC_COMPILE"] = "asked"
    third, _ = changed.launch("pace:=lockstep")
    assert third["tick"] == "plain"
    assert forces_of(changed.folder, third) == old
