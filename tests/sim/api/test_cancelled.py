"""A cancelled study ends soon, leaves nothing behind, and goes on when called again."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest

from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.families import designed
from sim.experiments.hands_apart import over_delay
from sim.identify.experiment import Experiment
from sim.identify.identify import identify
from sim.measure.cancelling import StudyCancelledError, cancelled_by
from sim.studies.kmax_found import KMaxBoundary
from tests.support.launching import wait_for

T = 0.002


def children() -> set[int]:
    """Return the live children of this process."""
    return {
        int(child)
        for task in Path("/proc/self/task").iterdir()
        for child in (task / "children").read_text(encoding="utf-8").split()
    }


def cancelling(
    after: int, event: threading.Event
) -> Callable[[int], Callable[..., None]]:
    """Return a progress display that cancels after some steps."""

    def begin(total: int) -> Callable[..., None]:
        left = [min(after, total)]

        def step(what: str, count: int = 1) -> None:
            del what
            left[0] -= count
            if left[0] <= 0:
                event.set()

        return step

    return begin


def test_the_progress_callback_cancels_and_the_next_call_returns_objects(
    tmp_path: Path,
) -> None:
    event, asked = (
        threading.Event(),
        {"law": "pd", "gain": (1, 5), "points": 3, "out": tmp_path},
    )
    with pytest.raises(haptic.StudyCancelledError, match="cancelled by its caller"):
        haptic.study("kmax", **asked, cancel=event, progress=cancelling(2, event))
    assert not list(tmp_path.iterdir())
    event.clear()
    found: Any = haptic.study("kmax", **asked, cancel=event)
    assert isinstance(found, KMaxBoundary)
    assert [point.gain for point in found.points] == [1.0, 3.0, 5.0]


TICKS = np.arange(1300.0)
RUN = Experiment(
    T,
    1e-3 * np.sin(0.01 * TICKS),
    ((0, 1300),),
    TICKS,
    np.sin(0.01 * TICKS),
    np.ones(1300),
)
SEARCHES: dict[str, Callable[[], object]] = {
    "design": lambda: designed(Demand((0.05, 0.2), 1.0, (1.0, 1.0), T, 0.99, 1e4), 2),
    "identify": lambda: identify(RUN),
    "hands": lambda: over_delay(Plant(T, 0.045, 1.0), 500.0, 1.0, [1]),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_a_long_search_looks_whether_it_was_cancelled(name: str) -> None:
    event = threading.Event()
    event.set()
    with cancelled_by(event), pytest.raises(StudyCancelledError):
        SEARCHES[name]()


@pytest.mark.process
def test_workers_end_and_the_ledger_goes_on(tmp_path: Path) -> None:
    """The first family is done at once; the second would take much longer."""
    event, before = threading.Event(), children()
    asked = {
        "families": ["Maxwell", "designed"],
        "mass": (0.1, 0.1),
        "out": tmp_path,
        "workers": 1,
    }
    with pytest.raises(
        haptic.StudyCancelledError, match=r"relatives.jsonl, and the same command"
    ):
        haptic.lab("relatives", **asked, cancel=event, progress=cancelling(1, event))
    wait_for(lambda: children() <= before, "the end of the workers")
    assert not [
        one.name for one in threading.enumerate() if one.name.startswith("worker")
    ]
    ledger = (tmp_path / "relatives.jsonl").read_text(encoding="utf-8")
    assert '"family": "Maxwell"' in ledger
    assert '"family": "designed"' not in ledger
    assert os.listdir(tmp_path) == ["relatives.jsonl"]
