"""Sweeping studies give the same bits on a cluster; who may be a worker, and its end."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import haptic
import pytest

from messages.errors import RefusedError, UsageError
from nodes.cli.main import VERBS, main, sub_verbs
from nodes.parameters.options import options_of
from sim.studies.sweeps import SpreadOptions, executor, spread
from tests.support import ROOT, slowly
from tests.support.dask_cluster import DaskCluster, dask_cluster, keywords, own_address
from tests.support.launching import wait_for

STUDIES = {
    name.partition(".")[2]: name
    for name in (*sub_verbs("study").values(), *sub_verbs("lab").values())
}


TINY: dict[str, list[str]] = {
    "chart": ["--quick", "--parts", "demand"],
    "curved": ["--slides", "0.02", "--rate", "400"],
    "design": [
        "--compare",
        "--delays",
        "1",
        "--margins",
        "0",
        "--taps",
        "2",
        "--no-land",
    ],
    "edge": ["--points", "3"],
    "failures": [],
    "guard": ["--points", "3", "--duration", "2"],
    "kmax": [
        "--law",
        "pd",
        "--gain",
        "1..5",
        "--points",
        "3",
        "--method",
        "simulation",
        "--horizon",
        "1000",
    ],
    "meshes": [str(ROOT / "launch/meshes")],
    "needs": ["floor_drop", "--rounds", "0"],
    "optimise": [
        "--starts",
        "2",
        "--steps",
        "30",
        "--rates",
        "0.03",
        "--nyquist",
        "3.05",
    ],
    "price": ["--no-land", "--hand", "0", "--known"],
    "proxies": ["--finest", "2", "--ticks", "400", "--steps", "2000"],
    "relatives": ["--families", "pd", "Maxwell", "--mass", "0.1"],
}
"""The smallest grid of every study that sweeps."""

ELSEWHERE = {"coverage", "fig4", "tuned"}
"""Studies that take minutes on any grid; same pool and ledger as ``price``."""

LEDGER = {"price", "relatives"}
"""Studies with a ledger: their jobs always use processes, slow to start."""

TIMES = {
    "call_us",
    "call_p99_us",
    "tick_us",
    "cost_us",
    "cost_spread_us",
    "seconds",
    "duration_s",
    "machine",
    "load_1min",
    "pid",
}
PLACES = {"plot", "files", "page", "ledger", "data", "figure", "text", "yaml"}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    with dask_cluster(tmp_path_factory.mktemp("dask")) as found:
        wait_for(lambda: answers(found), "the scheduler", 120.0)
        yield found


def options(*words: str) -> SpreadOptions:
    return SpreadOptions.of(**keywords(words))


def answers(cluster: DaskCluster) -> bool:
    try:
        with executor(options(*cluster.options())):
            return True
    except RefusedError:
        return False


def without(told: Any) -> Any:
    """Remove facts of one machine or folder."""
    if isinstance(told, dict):
        return {
            key: without(value)
            for key, value in told.items()
            if key not in TIMES | PLACES
        }
    return [without(value) for value in told] if isinstance(told, list) else told


def study(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, Any]:
    verb, _, _ = STUDIES[words[0]].partition(".")
    code = main([verb, *words, "--json"])
    return code, without(json.loads(capsys.readouterr().out.splitlines()[-1]))


def test_every_study_that_sweeps_has_a_small_grid() -> None:
    """Its options tell; a study of one law, scene or recording needs no row here."""
    sweeping = {
        name
        for name, verb in STUDIES.items()
        if issubclass(options_of(VERBS.load(verb)), SpreadOptions)
    }
    assert TINY.keys() | ELSEWHERE == sweeping


@pytest.mark.parametrize("name", slowly(TINY))
def test_a_study_gives_the_same_bits_on_a_cluster(
    name: str,
    cluster: DaskCluster,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # One order and one demand of six: the jobs carry theirs.
    monkeypatch.setattr("sim.lab.charts.equal_demand.ORDERS", (1.0,))
    monkeypatch.setattr("sim.lab.charts.equal_demand.RADII", {"calm": 0.99})
    words = [name, *TINY[name]]
    # Two studies write no files.
    alone, beside = (
        [] if name in {"curved", "meshes"} else ["--out", str(tmp_path / kind)]
        for kind in ("a", "b")
    )
    here = study(
        capsys, *words, *alone, *(["--workers", "1"] if name in LEDGER else [])
    )
    assert here[1], "an empty answer is equal to any other"
    # The same answer makes the same picture, which has been drawn.
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_, **__: None)
    assert study(capsys, *words, *beside, *cluster.options()) == here


@pytest.mark.slow
def test_two_clients_from_python_give_the_same_bits_at_once(
    cluster: DaskCluster,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    distributed: Any = importlib.import_module("distributed")
    monkeypatch.chdir(tmp_path)
    asked = {
        "law": "pd",
        "gain": "1..5",
        "points": 3,
        "method": "simulation",
        "horizon": 1000,
    }
    _, here = study(capsys, "kmax", *TINY["kmax"], "--out", "alone", "--workers", "1")
    with ThreadPoolExecutor(2) as both, distributed.Client(cluster.address) as client:
        answers = [
            both.submit(haptic.study, "kmax", client=client, out=f"{n}", **asked)
            for n in range(2)
        ]
        for answer in answers:
            assert without(answer.result(timeout=240.0).answer) == here
    with (
        distributed.Client(
            processes=False, n_workers=1, dashboard_address=":0"
        ) as inside,
        pytest.raises(haptic.LaunchError, match="is inside this process"),
    ):
        haptic.study("kmax", client=inside, **asked)


# -- workers that come, go, and are not what they should be
# -----------------------------------------------------------


def marked(folder: str, number: int) -> int:
    """Signal the start, and wait for permission to continue."""
    (Path(folder) / f"{number}-{os.getpid()}").touch()
    wait_for((Path(folder) / "go").exists, "the word to go on", 120.0)
    return number**2


@pytest.mark.slow
def test_a_worker_that_is_killed_and_one_that_joins_change_nothing(
    cluster: DaskCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def busy() -> set[int]:
        return {int(mark.name.split("-")[1]) for mark in tmp_path.glob("*-*")}

    jobs = [partial(marked, str(tmp_path), number) for number in range(6)]
    with ThreadPoolExecutor(1) as beside:
        result = beside.submit(spread, options(*cluster.options()), jobs)
        wait_for(lambda: len(busy()) == 2, "both workers to be at work", 120.0)
        lost = next(worker for worker in cluster.workers if worker.pid in busy())
        lost.send_signal(signal.SIGKILL)
        lost.wait()
        added = cluster.add_worker()
        wait_for(lambda: added.pid in busy(), "the new worker to be at work", 120.0)
        (tmp_path / "go").touch()
        assert result.result(timeout=240.0) == [number**2 for number in range(6)]


@pytest.mark.slow
def test_a_worker_of_another_version_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other"
    for package in ("messages", "nodes", "sim", "tests"):
        shutil.copytree(
            ROOT / package,
            other / package,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    with open(other / "sim" / "measure" / "jobs.py", "a", encoding="utf-8") as file:
        file.write("# another version\n")
    with dask_cluster(tmp_path, workers=0) as found:
        found.add_worker(root=other)
        wait_for(lambda: answers(found), "the scheduler", 120.0)
        with pytest.raises(
            RefusedError,
            match=r"another version of haptic-nodes in .*other.*install the same",
        ):
            spread(options(*found.options()), [partial(pow, 2, 3)])


@pytest.mark.slow
def test_a_scheduler_that_dies_is_told(tmp_path: Path) -> None:
    with dask_cluster(tmp_path, workers=1) as found, ThreadPoolExecutor(1) as beside:
        wait_for(lambda: answers(found), "the scheduler", 120.0)
        result = beside.submit(
            spread, options(*found.options()), [partial(marked, str(tmp_path), 1)]
        )
        wait_for(lambda: any(tmp_path.glob("1-*")), "the job to begin", 120.0)
        found.scheduler.kill()
        (tmp_path / "go").touch()
        with pytest.raises(RefusedError, match="scheduler has ended"):
            result.result(timeout=240.0)


def test_an_address_of_this_machine_that_others_reach_needs_tls() -> None:
    host = own_address()
    if host == "127.0.0.1":
        pytest.skip("this machine has no other address than loopback")
    with pytest.raises(
        UsageError, match=rf"TLS is required: tls://{host}:8786 with --tls-ca-file"
    ):
        spread(options("--cluster", f"tcp://{host}:8786"), [])
