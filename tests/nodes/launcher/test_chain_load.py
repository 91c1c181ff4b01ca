"""Processor load of chains: reported before the start, spread, and blamed for lost ticks."""

from __future__ import annotations

import itertools
import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.base import realtime
from nodes.launcher import launch_file
from nodes.launcher.chain_load import (
    BUSY,
    CARRIED,
    LATE,
    OVERLOADED,
    Load,
    Meter,
    carried,
    kind_of_chain,
    known_costs,
    load_of,
    spread,
    store_costs,
    warning,
)
from nodes.launcher.launch_spec import Launch
from nodes.launcher.wiring import chains_of, wire
from tests.support.launching import launch_json, running


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use an empty cache, without measurements."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def several(folder: Path, chains: int, **run: Any) -> Launch:
    path = folder / f"several_{chains}.yaml"
    included = [
        {"launch": "floor_drop", "namespace": f"c{i}", "without": ["logger"]}
        for i in range(chains)
    ]
    path.write_text(
        json.dumps({"summary": "s", "run": run, "include": included}), encoding="utf-8"
    )
    return launch_file.read(str(path), {})


def test_an_overload_is_told_before_the_start_by_what_ticks_cost_here(
    tmp_path: Path, cache: Path
) -> None:
    launch = several(tmp_path, 16)
    chains = chains_of(launch)
    assert warning(launch, chains, "compiled", 2) == ""  # nothing was measured here
    kind = kind_of_chain(launch, "c3", "compiled")
    # 16 chains of 150 µs at 500 Hz are 1.2 processors; of 100 µs 0.8 of one.
    store_costs({kind: 150e-6})
    told = warning(launch, chains, "compiled", 1)
    assert told.startswith(
        "overload ahead: 16 chains at 500 Hz will take 120% of one processor, as measured here (150"
        " µs a tick)"
    )
    assert (
        f"this machine carries about {int(CARRIED / (150e-6 * 500.0))} chains of that kind"
        in told
    )
    assert warning(launch, chains, "compiled", 2) == ""
    # another tick costs something else
    assert warning(launch, chains, "plain", 1) == ""
    assert warning(several(tmp_path, 16, pace="lockstep"), chains, "compiled", 1) == ""


def test_costs_are_kept_by_kind_and_whatever_else_is_there_counts_as_nothing(
    tmp_path: Path, cache: Path
) -> None:
    launch = several(tmp_path, 2)
    assert kind_of_chain(launch, "c0", "plain") == kind_of_chain(launch, "c1", "plain")
    assert kind_of_chain(launch, "c0", "plain") != kind_of_chain(
        launch, "c0", "compiled"
    )
    store_costs({"a": 1e-4, "b": 2e-4})
    store_costs({"a": 3e-4})
    # Four times as often finds warmer caches; nearly as often does not.
    assert kind_of_chain(
        several(tmp_path, 2, rate=2000.0), "c0", "plain"
    ) != kind_of_chain(launch, "c0", "plain")
    assert kind_of_chain(
        several(tmp_path, 2, rate=550.0), "c0", "plain"
    ) == kind_of_chain(launch, "c0", "plain")
    assert known_costs() == {"b": 2e-4, "a": 3e-4}
    (place,) = cache.rglob("chain_costs.json")
    for content in (
        "",
        "[]",
        '{"costs": {"a": "x"}}',
        '{"costs": {"a": -1.0, "b": 1e9}}',
    ):
        place.write_text(content, encoding="utf-8")
        assert known_costs() == {}
    place.unlink()
    place.mkdir()
    assert known_costs() == {}
    store_costs({"a": 1e-4})  # there is no place for it, and that is no failure


@given(
    st.dictionaries(
        st.text("abc", min_size=1), st.floats(0.0, 2.0), min_size=1, max_size=12
    ),
    st.integers(2, 6),
)
def test_chains_are_spread_over_the_processors(
    shares: dict[str, float], processors: int
) -> None:
    cores = list(range(processors))
    found = spread(shares, cores, shares)
    assert list(found) == list(shares)
    taken = [
        sum(shares[chain] for chain, core in found.items() if core == one)
        for one in cores
    ]
    # One processor is left to the listeners as long as the others carry all chains.
    if taken[-1] > 0.0:
        assert any(
            sum(taken) > CARRIED * (processors - 1)
            or share > CARRIED - max(shares.values())
            for share in taken
        )
    # No processor has more than its part by more than a chain.
    assert max(taken) <= max(
        CARRIED, sum(taken) / processors + max(shares.values()) + 0.25
    )


def test_a_launch_of_many_chains_uses_all_processors_and_each_goes_before_the_next(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(realtime, "quietest_processor", lambda: 0)
    launch = several(tmp_path, 8)
    setups = wire(launch, "r", tmp_path, {})
    # eight times a twentieth fit on one
    assert {setup.scheduling.cpus[0] for setup in setups.values()} == {0}
    store_costs({kind_of_chain(launch, "c0", launch.run.tick): 400e-6})  # a fifth each
    setups = wire(launch, "r", tmp_path, {})
    on = {
        core: [
            name for name, setup in setups.items() if setup.scheduling.cpus == [core]
        ]
        for core in (0, 1)
    }
    assert {core: len(names) for core, names in on.items()} == {0: 15, 1: 9}
    for names in on.values():
        chains = dict.fromkeys(name.partition("/")[0] for name in names)
        levels = [
            [
                setups[f"{chain}/{node}"].scheduling.fifo
                for node in ("environment", "coupling", "driver")
            ]
            for chain in chains
        ]
        for first, second in itertools.pairwise(levels):
            assert first == sorted(first)
            assert min(first) > max(second), (
                "a driver of one chain must not hold up the answers of another that goes before"
            )


def used(
    launch: Launch, had: float, waited: float, lost: float, ticks: int = 1000
) -> Load | None:
    """Return the load of a run whose chains took shares of a processor, and lost ticks."""
    chains = chains_of(launch)
    reports = {
        chain: {"ticks": ticks, "missed": round(lost * ticks), "overruns": 0}
        for chain in chains
    }
    return load_of(launch, had * ticks / launch.run.rate, waited, reports, 1)


def test_the_reason_of_lost_ticks_is_named_where_it_is_known(tmp_path: Path) -> None:
    launch = several(tmp_path, 4)
    full = used(launch, had=0.95, waited=1.0, lost=0.25)
    assert full is not None
    assert full.cause == "chains"
    assert full.text.startswith(
        "4 chains at 500 Hz lost 25.0% of the ticks: they took 95% of one processor"
    )
    others = used(launch, had=0.3, waited=1.0, lost=0.25)
    assert others is not None
    assert others.cause == "others"
    assert "waited for other processes 1 s per second" in others.text
    # Both sides of each limit, and what has another reason: a node that was killed, say.
    for had, waited, lost, cause in (
        (BUSY, 0.0, LATE, "chains"),
        (BUSY, 0.0, LATE - 1e-3, ""),
        (BUSY - 1e-3, 0.0, LATE, ""),
        (0.1, 4.0 * LATE, LATE, "others"),
        (0.1, 3.9 * LATE, LATE, ""),
    ):
        found = used(launch, had, waited, lost)
        assert found is not None
        assert found.cause == cause, (had, waited, lost)
        assert bool(found.text) is bool(cause)
    assert used(launch, 0.5, 0.0, 0.0, ticks=100) is None
    assert carried(100e-6, 500.0, 2) == 2 * int(CARRIED / 0.05)


def test_the_meter_counts_the_processor_time_of_a_process_and_how_long_it_waits() -> (
    None
):
    gone = 2**22 + 1
    meter = Meter({"a": os.getpid(), "gone": gone})
    begun = time.process_time()
    while time.process_time() - begun < 0.05:
        pass
    meter.sample()
    end = {
        "a": {"status": {"pid": os.getpid(), "cpu": time.process_time()}},
        "gone": {"status": {"pid": gone, "cpu": 0.0}},
    }
    had = meter.processor_times(end)
    assert 0.05 <= had["a"] <= time.process_time() - begun + 0.05
    assert had["gone"] == 0.0
    # another process than the one of the first tick
    assert meter.processor_times({"a": {"status": {"pid": 1, "cpu": 1e9}}}) == {}
    assert meter.waiting() >= 0.0


@pytest.mark.process
def test_a_run_says_what_it_took_and_keeps_it_for_the_next(
    tmp_path: Path, cache: Path
) -> None:
    figures = launch_json(
        tmp_path,
        "floor_drop",
        "duration:=1.5",
        "--without",
        "logger",
        "--tick",
        "plain",
    )
    load = figures["load"]
    assert load["chains"] == 1
    assert load["tick_cost_us"] > 0.0
    if load["lost"] < LATE:
        (cost,) = known_costs().values()
        # One divides by all ticks, the other by those that were answered.
        assert cost * 1e6 == pytest.approx(load["tick_cost_us"], rel=LATE + 0.01)


@pytest.mark.process
def test_a_loop_too_fast_for_its_machine_ends_with_a_code_of_its_own(
    tmp_path: Path, cache: Path
) -> None:
    words = (
        "rate:=20000",
        "stiffness:=500",
        "duration:=1",
        "--without",
        "logger",
        "--tick",
        "plain",
    )
    with running(tmp_path, "floor_drop", *words, ready=False) as launch:
        figures = launch.finish(code=None)
        load = figures["load"]
        # Beside busy processes without FIFO the loop may not even get the processor that it asks
        # for.
        assert launch.process.returncode == (
            OVERLOADED if load["cause"] == "chains" else 0
        )
        assert load["lost"] >= LATE
        assert load["cause"]
