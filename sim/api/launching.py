"""Launches from Python: start one, or connect to one that runs.

A launch is started as ``haptic launch`` starts it, in its own processes. However the program or the
notebook's cell ends, no process is left behind.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nodes.client import launches
from nodes.launcher.runs import RunInfo
from sim.api.launch_arguments import launch_arguments, left_out
from sim.api.python_runs import LaunchError, Run
from sim.api.python_words import launch_environment, speaking_python
from sim.measure.haptic_commands import MeasurementError
from sim.measure.interrupts import deferred
from sim.measure.started_launch import StartedLaunch

STARTS_WITHIN = 60.0  # time to the first tick before a launch is given up [s]
# the same where the tick is compiled first: once for each version [s]
COMPILES_WITHIN = 900.0


def connect(name: str | None = None) -> Run:
    """Connect to a running launch.

    Parameters
    ----------
    name : str, optional
        Name of the run or of its scenario; may be omitted if only one runs.

    Returns
    -------
    Run
        The launch; it keeps running when this program ends.

    Raises
    ------
    nodes.launcher.runs.RunError
        If no run matches, or several do.

    Examples
    --------
    >>> with launch("wall_press", duration=0):
    ...     connect().law.switch("multi_term", ramp=50)["to"]
    'multi_term'
    """
    with speaking_python():
        return Run(launches.find(name))


def launch(
    scenario: str,
    *,
    view: bool = False,
    out_dir: str | Path | None = None,
    params: Mapping[str, Any] | None = None,
    without: str | Sequence[str] = (),
    **arguments: Any,
) -> Run:
    """Start a scenario in its own processes; return at its first tick.

    Parameters
    ----------
    scenario : str
        Name or path of a launch file; ``haptic.scenarios()`` lists them.
    view : bool
        Serve the page; its URL is in ``run.url``.
    out_dir : str or Path, optional
        Directory of recordings; by default the launch file's.
    params : mapping of str to object, optional
        Parameters of nodes, e.g. ``{"driver.device.mass": 0.2}``; checked as in the file.
    without : str or sequence of str
        Nodes to leave out, e.g. ``["logger"]``.
    **arguments : object
        Arguments of the launch file, e.g. ``stiffness=1500, pace="lockstep"``; ``law=`` takes any
        law, e.g. ``haptic.PD(stiffness=1500, damping=3)``.

    Returns
    -------
    Run
        The launch; the end of a ``with`` block stops it.

    Raises
    ------
    LaunchError
        If the launch does not start; the text states why.

    Warns
    -----
    LaunchWarning
        Of an unstable law, of what is not judged, and of what fails while it runs; the latter when
        the program waits for the end or stops it.

    Examples
    --------
    >>> with launch("floor_drop", stiffness=1500, pace="lockstep") as run:
    ...     run.wait().ticks
    1500
    """
    words = [
        f"{name}:={value if isinstance(value, str) else json.dumps(value)}"
        for name, value in launch_arguments(arguments, params).items()
    ]
    for node in left_out(without):
        words += ["--without", node]
    if view:
        words.append("--view")
    if out_dir is not None:
        words += ["--out-dir", str(out_dir)]
    started = StartedLaunch(scenario, *words, environment=launch_environment())
    try:
        with deferred() as came:
            compiles = arguments.get("tick") == "compiled"
            patience = COMPILES_WITHIN if compiles else STARTS_WITHIN
            started.await_tick(longest=patience, interrupts=came)
        info = started.info()
        if info is None:
            printed = started.figures
            info = RunInfo(
                run=printed["run"],
                scenario=printed["scenario"],
                launcher=started.process.pid,
                nodes={},
            )
        return Run(info, started)
    except MeasurementError as error:
        started.close()
        raise LaunchError(str(error)) from error
    except BaseException:
        started.close()
        raise
