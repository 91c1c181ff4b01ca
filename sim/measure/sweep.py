"""Sweeps: many independent jobs that take long, with results kept as they come.

Every result is one line of a ledger file, keyed by the job's parameters: a sweep that was interrupted goes on where it stopped,
and one that is complete is only read. Where the jobs run is `sim.measure.jobs`'.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from sim.measure.jobs import done_by

Row = dict[str, Any]
Job = Callable[[Mapping[str, Any]], Row]
"""From the parameters of a job to its figures; a function of a module, so that other processes find it by name."""


def key_of(parameters: Mapping[str, Any]) -> str:
    """Name a job by its parameters."""
    return json.dumps(dict(parameters), sort_keys=True)


def read_ledger(path: Path) -> dict[str, Row]:
    """Read the results that there are."""
    found: dict[str, Row] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
                found[key_of(entry["job"])] = entry["row"]
            except (json.JSONDecodeError, KeyError, TypeError):
                continue
    return found


def sweep(
    job: Job,
    jobs: Sequence[Mapping[str, Any]],
    pool: Executor,
    ledger: Path,
    chunk: int = 1,
    step: Callable[[str, int], None] | None = None,
) -> list[Row]:
    """Do all jobs that the ledger has no result of."""
    done = read_ledger(ledger)
    left = [parameters for parameters in jobs if key_of(parameters) not in done]
    if step is not None and len(left) < len(jobs):
        step(f"{len(jobs) - len(left)} of {len(jobs)} were done before", len(jobs) - len(left))
    ledger.parent.mkdir(parents=True, exist_ok=True)
    whole = not ledger.exists() or ledger.read_bytes().endswith(b"\n") or not ledger.stat().st_size
    with open(ledger, "a", encoding="utf-8") as file, contextlib.closing(done_by(pool, job, left, chunk)) as found:
        if not whole:
            file.write("\n")
        for part, rows in found:
            for i, row in zip(part, rows, strict=True):
                file.write(json.dumps({"job": dict(left[i]), "row": row}) + "\n")
                done[key_of(left[i])] = row
            file.flush()
            if step is not None:
                step(f"{len(done)} of {len(jobs)}", len(rows))
    return [done[key_of(parameters)] for parameters in jobs]
