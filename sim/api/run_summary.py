"""The final report of a launch in Python, and its warnings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from messages.event_kinds import SERIOUS
from nodes.base.log_line import LAUNCH, WARNS, LogLine
from sim.api.python_words import in_python
from sim.api.recordings import read
from sim.studies.notebook_results import Result, bars

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class LaunchWarning(UserWarning):
    """What a launch warns of: an unstable law, a refused force, a node that was lost.

    Attributes
    ----------
    node : str
        Node that warns; ``launch`` for the launcher.
    kind : str
        Kind of its event (messages/event_kinds.py), or ``warning`` of the launcher.
    reason : str
        The sentence for people.
    data : dict of str to float
        Numbers of the event, e.g. ``tick``.
    """

    def __init__(self, line: LogLine) -> None:
        line = msgspec.structs.replace(line, text=in_python(line.text))
        super().__init__(str(line))
        self.node, self.kind, self.reason = line.node, line.kind, line.text
        self.data = dict(line.data)

    def __reduce__(self) -> tuple[type[LaunchWarning], tuple[LogLine]]:
        """Return what copies it, e.g. into another process."""
        line = LogLine(self.reason, self.node, self.kind, self.data)
        return LaunchWarning, (line,)


def warnings_in(log: Iterable[LogLine]) -> list[LaunchWarning]:
    """Return the lines of a launch that warn."""
    return [
        LaunchWarning(line)
        for line in log
        if (line.kind == WARNS if line.node == LAUNCH else line.kind in SERIOUS)
    ]


@dataclass(frozen=True, repr=False)
class RunSummary(Result):
    """Final report of a launch: the figures of ``haptic launch --json``."""

    scenario: str  # name of the launched scenario
    # ``done``; ``loop stopped at tick N`` if the driver ended the loop and no force came back;
    # ``stopped`` if this program ended the launch; else the reason
    exit_reason: str
    ticks: int  # number of ticks done
    missed: int  # number of ticks whose force was late
    rate_hz: float  # measured tick rate [Hz]
    response_us: dict[str, float]  # percentiles of the response time [µs]
    final: dict[str, Any]  # final position [m], force [N] and motion
    recording: str | None  # path of the recording
    # first tick with the driver stopped; None: never stopped
    stopped_at_tick: int | None
    stopped_why: str  # reason of that stop
    refused: dict[str, int]  # forces that the driver refused, by reason
    limited: dict[str, int]  # forces that it lowered, by limit
    failures: tuple[str, ...]  # nodes that failed, and why
    not_judged: dict[str, str]  # couplings whose stability was not judged, and why
    warnings: tuple[LaunchWarning, ...]  # all warnings of the launch
    all: dict[str, Any]  # all figures of the report

    def figures(self) -> dict[str, Any]:
        """Return the figures that fit on a screen; safety and warnings only if there are any."""
        empty = ("refused", "limited", "failures", "not_judged", "stopped_why")
        return {
            name: value
            for name, value in super().figures().items()
            if name not in ("all", "warnings") and (value or name not in empty)
        } | ({"warnings": len(self.warnings)} if self.warnings else {})

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Plot position and force of its recording; without a recording, the response times."""
        if ax is not None and self.recording is None:
            raise ValueError(f"{self.scenario}: no recording to draw beside others")
        if self.recording is not None and Path(self.recording).exists():
            return read(self.recording).plot(ax)
        return bars(self.response_us, "response time [µs]", self.scenario)


def summary_of(
    printed: dict[str, Any], log: Iterable[LogLine], ended_here: bool
) -> RunSummary:
    """Return the report of an ended launch.

    Parameters
    ----------
    printed : dict
        Figures of ``haptic launch --json``.
    log : iterable of LogLine
        Its lines of standard error.
    ended_here : bool
        Whether this program ended it, which Ctrl-C also does.

    Returns
    -------
    RunSummary
        Its report; of several chains the safety of all.
    """
    chains: dict[str, dict[str, Any]] = printed.get("chains") or {"": printed}
    at, why, still = _stop_of(chains)
    exit_reason = str(printed["exit_reason"])
    if still:
        exit_reason = f"loop stopped at tick {at}"
    elif ended_here and exit_reason == "SIGINT":
        exit_reason = "stopped"
    same = (
        "scenario",
        "ticks",
        "missed",
        "rate_hz",
        "response_us",
        "final",
        "recording",
    )
    return RunSummary(
        **{key: printed[key] for key in same},
        exit_reason=exit_reason,
        stopped_at_tick=at,
        stopped_why=in_python(why),
        refused=_counts(chains, "refused"),
        limited=_counts(chains, "limited"),
        failures=tuple(printed["failures"]),
        not_judged=dict(printed["not_judged"]),
        warnings=tuple(warnings_in(log)),
        all=printed,
    )


def _stop_of(chains: dict[str, dict[str, Any]]) -> tuple[int | None, str, bool]:
    """Return tick and reason of the first stop of any chain, and whether one is still stopped."""
    stops = [
        (
            int(change["tick"]),
            f"{chain}: {change['reason']}" if chain else str(change["reason"]),
        )
        for chain, figures in chains.items()
        for change in figures["safety"].get("changes", ())
        if change["after"] == "stopped"
    ]
    still = any(
        figures["safety"].get("state") == "stopped" for figures in chains.values()
    )
    at, why = min(stops, default=(None, ""))
    return at, why, still and at is not None


def _counts(chains: dict[str, dict[str, Any]], what: str) -> dict[str, int]:
    """Return how often each of the driver's actions happened, summed over chains; no zeros."""
    found: dict[str, int] = {}
    for figures in chains.values():
        for name, number in figures["safety"].get(what, {}).items():
            if number:
                found[name] = found.get(name, 0) + int(number)
    return found
