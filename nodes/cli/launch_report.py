"""The end of a launch: its figures for ``--json``, and the same as text."""

import os
from pathlib import Path
from typing import Any

import msgspec

from messages.transport.endpoints import is_remote
from nodes.base.setup import Setup
from nodes.launcher.launch_spec import Launch
from nodes.launcher.supervisor import Supervisor
from nodes.recording.logger import LoggerParameters, file_of
from nodes.recording.writer import Ended, write_ended


def recordings_of(launch: Launch, supervisor: Supervisor) -> list[tuple[str, str]]:
    """Return host (``host:``, empty for this machine) and path of each recording, as for scp."""
    found = []
    for name, child in supervisor.children.items():
        # A killed logger leaves no report, but a file.
        path = supervisor.reports.get(name, {}).get("recording") or _path_of(
            child.setup, supervisor.run
        )
        if path:
            host = launch.nodes[name].host
            place = f"[{host}]:" if ":" in host else f"{host}:"
            found.append((place if host and is_remote(f"tcp://{place}1") else "", path))
    return found


def _path_of(setup: Setup, run: str) -> str:
    """Return the existing file that a local logger records to; else an empty string."""
    if setup.kind != "logger" or setup.control.startswith("tcp://"):
        return ""
    path = file_of(
        msgspec.convert(setup.parameters, LoggerParameters).path, run, setup.name
    )
    return path if os.path.exists(path) else ""


def note_cut(supervisor: Supervisor, ticks: int) -> None:
    """Write the run's number of ticks beside each recording that its logger did not finish."""
    for child in supervisor.children.values():
        path = _path_of(child.setup, supervisor.run) if child.ended_badly else ""
        if path:
            write_ended(Path(path), Ended(ticks, child.end))


def summarise(launch: Launch, supervisor: Supervisor) -> dict[str, Any]:
    """Collect the figures of a run from the reports of its nodes."""
    drivers = {
        name.rpartition("/")[0]: name
        for name, child in supervisor.children.items()
        if child.drives
    }
    chains = {
        chain: _of_chain(launch, chain, supervisor.reports.get(name, {}))
        for chain, name in drivers.items()
    }
    recordings = [place + path for place, path in recordings_of(launch, supervisor)]
    return {
        "scenario": launch.scenario,
        "run": supervisor.run,
        # Of several chains the first; all are listed below.
        **next(iter(chains.values()), _of_chain(launch, "", {})),
        "tick": supervisor.tick,
        "tick_by_node": {
            name: tick
            for name, report in supervisor.reports.items()
            if (tick := report.get("tick"))
        },
        "ticks_compiled": {
            name: report.get("ticks_compiled", 0)
            for name, report in supervisor.reports.items()
        },
        "spent_us": {
            name: spent
            for name, report in supervisor.reports.items()
            if (spent := report.get("spent_us"))
        },
        "moved": {
            name: moved
            for name, report in supervisor.reports.items()
            if (moved := report.get("moved"))
        },
        "recording": recordings[0] if recordings else None,
        "recordings": recordings,
        "plot": None,
        "exit_reason": supervisor.exit_reason,
        "failures": supervisor.failures,
        "restarts": {
            name: child.restarts
            for name, child in supervisor.children.items()
            if child.restarts
        },
        "not_judged": supervisor.unjudged,
        "load": None
        if supervisor.load is None
        else msgspec.to_builtins(supervisor.load),
        "startup_s": round(supervisor.startup_s, 3),
        "nodes": {
            name: report["status"] for name, report in supervisor.reports.items()
        },
        **({"chains": chains} if len(chains) > 1 else {}),
    }


def _of_chain(launch: Launch, chain: str, driver: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of one chain from its driver's report."""
    axes = launch.axes.get(chain) or launch.run.axes
    axis = "xyz".index(axes[0])
    single = len(axes) == 1
    final = driver.get("final", {})
    nothing = {
        "ticks": 0,
        "missed": 0,
        "overruns": 0,
        "rate_hz": 0.0,
        "response_us": {},
        "age_ticks_max": 0,
    }
    nothing |= {"energy_j": 0.0, "energy_max_j": 0.0, "guard": None, "safety": {}}
    return {key: driver.get(key, none) for key, none in nothing.items()} | {
        "final": {
            key: (final[key][axis] if single else final[key]) if key in final else None
            for key in (
                "position_m",
                "force_n",
                "motion",
                "swing_m",
                "frequency_hz",
                "velocity_m_per_s",
            )
        }
    }


def _safety_text(safety: dict[str, Any]) -> list[str]:
    """Return lines about the driver's safety actions; none if there were none."""
    counts = [
        f"{number} refused ({why})"
        for why, number in safety.get("refused", {}).items()
        if number
    ]
    counts += [
        f"{number} lowered ({which})"
        for which, number in safety.get("limited", {}).items()
        if number
    ]
    first = ("waiting", "active")  # happens in every run, so not shown
    changes = [
        one["reason"]
        for one in safety.get("changes", [])
        if (one["before"], one["after"]) != first
    ]
    lines = [f"  safety    forces {', '.join(counts)}"] if counts else []
    lines += [f"  safety    {text}" for text in (*safety.get("told", []), *changes)]
    return lines


def _ending(final: dict[str, Any], stopped: bool) -> str:
    """Return a line about the final motion: stopped, at rest, swinging, falling or moving."""
    motion = final["motion"]
    where = (
        f"position {final['position_m'] * 1e3:+.4f} mm, force {final['force_n']:+.4f} N"
    )
    swing = f"{final['swing_m'] * 1e3:.3g} mm"
    speed = f"{final['velocity_m_per_s']:+.3g} m/s"
    if stopped:
        return f"  stopped   {where}, {motion}: no force acts any more"
    if motion == "swinging":
        return (
            f"  swinging  {where}, {swing} to and fro at {final['frequency_hz']:.3g} Hz"
        )
    if motion == "falling":
        return f"  falling   {where}, {speed}: it touches nothing"
    return (
        f"  at rest   {where}"
        if motion == "at rest"
        else f"  moving    {where}, {speed}"
    )


def text_of(launch: Launch, figures: dict[str, Any], overload: str = "") -> str:
    """Return the figures of a run as text, with what overloaded the machine."""
    lines = [
        f"{launch.scenario}: {figures['exit_reason']} after {figures['ticks']} ticks"
    ]
    lines += [
        f"  failed    {failure}"
        for failure in figures["failures"]
        if failure != figures["exit_reason"]
    ]
    lines += [
        f"  restarts  {name}: {count}; its figures are those of the last process"
        for name, count in figures["restarts"].items()
    ]
    by_node = figures["tick_by_node"]
    if by_node:
        ticks = sorted(set(by_node.values()))
        shown = [
            f"{tick}: {', '.join(name for name in by_node if by_node[name] == tick)}"
            for tick in ticks
        ]
        lines.append(f"  tick      {'; '.join(shown) if len(ticks) > 1 else ticks[0]}")
    if overload:
        lines.append(f"  overload  {overload}")
    lines += [
        f"  stability not judged: {why}" for why in figures["not_judged"].values()
    ]
    for chain, own in figures.get("chains", {"": figures}).items():
        lines += [f" /{chain}"] if chain else []
        lines += _chain_text(own)
    lines += [
        f"  moved     shapes of {name} put {1e3 * moved['energy_j']:.3g} mJ into the device, at"
        f" most {moved['power_w']:.3g} W"
        for name, moved in figures["moved"].items()
    ]
    lines += [f"  recording {path}" for path in figures["recordings"]]
    return "\n".join(lines)


def _chain_text(figures: dict[str, Any]) -> list[str]:
    """Return lines about one chain."""
    response = figures["response_us"]
    lines = list[str]()
    if response and figures["ticks"]:
        lines = [
            (
                f"  rate      {figures['rate_hz']:.2f} Hz, missed {figures['missed']}, overruns"
                f" {figures['overruns']}, oldest force {figures['age_ticks_max']} ticks"
            ),
            (
                f"  response  p50 {response['p50']:.0f} µs, p99 {response['p99']:.0f} µs, "
                f"p99.9 {response['p999']:.0f} µs, max {response['max']:.0f} µs"
            ),
        ]
    if guard := figures["guard"]:
        lines.append(
            f"  guard     lowered {guard['lowered']} and raised {guard['raised']} forces; energy"
            f" owed: at most {guard['highest_j'] * 1e3:.4g} mJ"
        )
    lines += _safety_text(figures["safety"])
    final = figures["final"]
    if figures["ticks"] and isinstance(final["position_m"], float):
        lines.append(_ending(final, figures["safety"].get("state") == "stopped"))
    return lines
