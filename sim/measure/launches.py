"""Launches as measurements: a scenario started as a user starts it, in a folder of its own, answered as figures."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from nodes.launcher.child import PYTHON
from sim.measure import stopwatch


class MeasurementError(RuntimeError):
    """A launch or a yardstick that was to be measured failed; the text holds what it said."""


def last_line(command: list[str], folder: Path, timeout: float) -> dict[str, Any]:
    """Run a command that answers with one JSON object on its last line.

    Parameters
    ----------
    command : list of str
        Program and arguments.
    folder : Path
        Where it runs.
    timeout : float
        Longest time [s].

    Returns
    -------
    dict
        The object.

    Raises
    ------
    MeasurementError
        When it fails or answers something else.
    """
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout, check=False)
    try:
        figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, json.JSONDecodeError) as error:
        raise MeasurementError(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr[-2000:]}") from error
    if done.returncode != 0:
        raise MeasurementError(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    return figures


def launch(scenario: str, *words: str, timeout: float = 300.0) -> dict[str, Any]:
    """Run a scenario to its end.

    Parameters
    ----------
    scenario : str
        Name or path of a launch file.
    *words : str
        Further arguments of ``haptic launch``.
    timeout : float
        Longest time [s].

    Returns
    -------
    dict
        What ``haptic launch --json`` answers.
    """
    with tempfile.TemporaryDirectory(prefix="haptic-bench-") as folder:
        command = [*PYTHON, "-m", "nodes.cli.main", "launch", scenario, "--json", "--no-plot", *words]
        return last_line(command, Path(folder), timeout)


def bare_loop(ticks: int, core: str, fifo: int = 0, rate: float = 0.0) -> dict[str, Any]:
    """Run the yardstick.

    Parameters
    ----------
    ticks : int
        How many ticks.
    core : str
        Core of all three processes, or ``any``.
    fifo : int
        SCHED_FIFO priority, 0 for none.
    rate : float
        Ticks per second; 0 for lockstep.

    Returns
    -------
    dict
        ``ticks_per_s``, ``missed``, ``response_us``.
    """
    from sim.measure.bare_loop import ROLES

    with tempfile.TemporaryDirectory(prefix="haptic-bare-") as folder:
        words = [folder, str(ticks), core, str(fifo), str(rate)]
        started = [
            subprocess.Popen([*PYTHON, "-m", "sim.measure.bare_loop", role, *words], stdout=subprocess.PIPE, text=True)
            for role in ROLES
        ]
        try:
            out, _ = started[-1].communicate(timeout=60.0 + 4.0 * ticks / (rate or 1000.0))
            codes = [process.wait(timeout=10.0) for process in started]
        finally:
            for process in started:
                process.kill()
                if process.stdout is not None:
                    process.stdout.close()
        if any(codes):
            raise MeasurementError(f"the bare loop failed with exit codes {codes}")
        figures: dict[str, Any] = json.loads(out)
        return figures


def machine() -> str:
    """Name the machine that a figure was measured on.

    Returns
    -------
    str
        Processor, number of cores, kernel, Python.
    """
    here = stopwatch.machine()
    cores = len(os.sched_getaffinity(0))
    return f"{here['cpu']}, {cores} cores, {here['system']}, Python {here['python']}"


def fifo_granted() -> bool:
    """Whether this user may have real-time priority.

    Returns
    -------
    bool
        True when the kernel grants SCHED_FIFO.
    """
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))"
    return subprocess.run([*PYTHON, "-c", code], capture_output=True, check=False).returncode == 0
