"""The simulator's yardstick: C gives the same bits; a missing compiler is reported."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from sim.lab.bench.simulator_speed import (
    NoCompilerError,
    compile_c,
    in_c,
    laws,
    ours,
    scene,
)
from sim.play.one_axis import run
from tests.support.launching import exit_code


def test_c_and_nodes_kernels_give_the_same_bits(tmp_path: Path) -> None:
    if shutil.which("cc") is None and shutil.which("gcc") is None:
        pytest.skip("no C compiler here")
    play = compile_c(tmp_path)
    for law in laws().values():
        positions = in_c(play, law, 3000)()
        assert positions.tobytes() == ours(law, 3000)().tobytes()
        assert positions.tobytes() == run(scene(), law, 3000).position.tobytes()
        assert np.ptp(positions) > 0.01


def test_no_compiler_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NoCompilerError, match="neither cc nor gcc"):
        compile_c(tmp_path)
    assert (
        main(["bench", "simulator", "--rounds", "1", "--ticks", "100", "--json"]) == 0
    )
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "install one" in answer["no_c_because"]
    assert [point["ratio"] for point in answer["points"]] == [None, None, None]
    assert all(point["ticks_per_s"] > 0.0 for point in answer["points"])


def test_a_broken_compiler_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = tmp_path / "cc"
    fake.write_text("#!/bin/sh\necho 'cc: out of ink' >&2\nexit 1\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(NoCompilerError, match="out of ink"):
        compile_c(tmp_path)


def test_senseless_requests_are_refused() -> None:
    assert exit_code("bench", "simulator", "--rounds", "0") == 2
    assert exit_code("bench", "simulator", "--ticks", "10") == 2
