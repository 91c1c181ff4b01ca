"""A restarted process continues with exactly the accepted parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from nodes.base.node import Node
from nodes.base.saved_parameters import resume, save_parameters
from nodes.coupling.node import Coupling
from nodes.driver.passivity import PassivityParameters
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import WatchedFile
from sim.device.driver import SimDriver
from tests.support.setups import setup_of

UNSTABLE = {"laws.pd.stiffness": 1e6}


def started_again(
    node: type[Node], folder: Path, values: dict[str, Any], **given: Any
) -> Any:
    """Start a node, change its parameters while it runs, and restart it."""
    setup = setup_of(run_dir=str(folder), **given)
    first = node(setup)
    first.watched = (1, 2, 3)
    first.store.accept(first.store.changed(values))
    save_parameters(first)
    second = node(setup)
    resume(second)
    second.configure()
    return second


def coupling(**more: Any) -> dict[str, Any]:
    laws = {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}}
    parameters = {
        "law": "pd",
        "laws": laws,
        "plant": {"mass": 0.1, "damping": 1.0},
        **more,
    }
    return {"name": "coupling", "kind": "coupling", "parameters": parameters}


@pytest.mark.parametrize("policy", ["refuse", "changes", "warn"])
def test_a_law_that_was_taken_by_force_renders_again(
    policy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = coupling(stability=policy)
    node = started_again(Coupling, tmp_path, UNSTABLE, **given)
    assert node.store.get("laws.pd.stiffness") == 1e6
    why = (
        "coupling.stability is warn"
        if policy == "warn"
        else "it was accepted before the restart"
    )
    assert f"started anyway: {why}" in capsys.readouterr().err
    # A launch that begins so is refused as before.
    if policy != "warn":
        laws = {"pd": {"kind": "pd", "stiffness": 1e6, "damping": 3.0}}
        with pytest.raises(ParameterError, match="the loop is unstable"):
            Coupling(setup_of(**coupling(stability=policy, laws=laws))).configure()


def test_a_device_that_was_withdrawn_leaves_nobody_without_a_law(
    tmp_path: Path,
) -> None:
    node = started_again(
        Coupling, tmp_path, {"plant": None}, **coupling(stability="refuse")
    )
    assert node.store.current.plant is None


def test_a_guard_that_was_set_while_it_ran_can_be_taken_away(tmp_path: Path) -> None:
    given = {"parameters": {"device": {"mass": 0.1}}}
    node = started_again(
        SimDriver, tmp_path, {"passivity": {"guard": "on", "allowance": 0.01}}, **given
    )
    assert node.driving.guard_on == 1
    node.prepare(node.store.changed({"passivity": None}))(0)
    assert node.driving.guard_on == 0
    # The launch file's own stays.
    own = SimDriver(
        setup_of(parameters={"device": {"mass": 0.1}, "passivity": {"guard": "on"}})
    )
    own.configure()
    with pytest.raises(ParameterError, match="the launch file's own guard is fixed"):
        own.prepare(own.store.changed({"passivity": None}))
    assert own.store.current.passivity == PassivityParameters()


def test_a_watched_file_is_older_than_what_was_set_since(tmp_path: Path) -> None:
    node = started_again(Coupling, tmp_path, {"ramp": 7}, **coupling())
    assert node.watched == (1, 2, 3)
    path = tmp_path / "coupling.yaml"
    path.write_text("ramp: 1\n", encoding="ascii")
    before = WatchedFile(str(path))
    assert [before.poll(), before.poll()] == [None, {"ramp": 1}]
    after = WatchedFile(str(path), before.applied)
    assert [after.poll() for _ in range(3)] == [None] * 3
    # Saved while nobody looked.
    path.write_text("ramp: 12\n", encoding="ascii")
    later = WatchedFile(str(path), before.applied)
    assert [later.poll(), later.poll()] == [None, {"ramp": 12}]
