"""List nodes of a running launch, show, start, rearm or reset one."""

import argparse
from pathlib import Path
from typing import Any

from messages.errors import RefusedError, UsageError
from nodes.cli.ask import chosen_node, chosen_run, sub_verb
from nodes.cli.main import answer
from nodes.client.launches import ask, node_name
from nodes.launcher.runs import RunError, RunInfo


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen", metavar="list|info|start|rearm|reset", required=True
    )
    sub_verb(sub, "list", _list, "List the nodes with kind, state and process number.")
    info = sub_verb(
        sub, "info", _info, "Show a node's state, counters, topics and operations."
    )
    info.add_argument("node")
    start = sub_verb(
        sub,
        "start",
        _start,
        "Start a node that a launch waits for: one with by_hand or host in the launch file.",
    )
    start.add_argument("node")
    start.add_argument(
        "--bind",
        metavar="HOST:PORT",
        help="address of this node, for a launch on another machine",
    )
    start.add_argument(
        "--kind",
        default="",
        help="with --bind: the only kind allowed (default: the node's name)",
    )
    start.add_argument(
        "--allow-path",
        metavar="DIR",
        type=Path,
        action="append",
        default=[],
        help=(
            "with --bind: directory in which parameters may name files and libraries; repeatable"
        ),
    )
    text = (
        "Re-enable the forces of a driver that stopped an unstable loop, with its ramp. Change the"
        " law first."
    )
    again = sub_verb(sub, "rearm", _rearm, text)
    again.add_argument(
        "node", nargs="?", help="the driver (default: the run's only one)"
    )
    text = (
        "Reset a scene of bodies to its start (its keyframe), with the tool at the device and"
        " without a force step."
    )
    fresh = sub_verb(sub, "reset", _reset, text)
    fresh.add_argument(
        "node", nargs="?", help="the environment (default: the run's only one)"
    )


def _state(run: RunInfo, name: str) -> dict[str, Any]:
    try:
        found: dict[str, Any] = ask(run, name, "status")
        return {key: found[key] for key in ("kind", "state", "pid", "ticks")}
    except (RefusedError, KeyError, TypeError) as error:
        # A node that is down, restarting or foreign must not hide the others.
        return {
            "kind": run.nodes[name].kind,
            "state": "unreachable",
            "pid": 0,
            "error": str(error),
        }


def _list(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    found = {name: _state(run, name) for name in run.nodes}
    width = max(map(len, found))
    lines = [
        f"/{name:{width}}  {node['kind']:12} {node['state']:12} {node['pid']}"
        for name, node in found.items()
    ]
    return answer(arguments.json, {"run": run.run, "nodes": found}, "\n".join(lines))


def _info(arguments: argparse.Namespace) -> int:
    run, name = chosen_node(arguments)
    info = ask(run, name, "info")
    status = info["status"]
    setup = run.nodes[name]
    figures = {
        "run": run.run,
        "node": name,
        "pace": setup.pace,
        "rate_hz": 1.0 / setup.period,
        "cpus": setup.scheduling.cpus,
        "fifo": setup.scheduling.fifo,
        "control": setup.control,
        **info,
    }
    asked = {
        op: ask(run, name, op)
        for op in ("force", "inertia")
        if op in info["operations"]
    }
    figures |= (device := {op: told for op, told in asked.items() if told is not None})
    counters = ("ticks", "sent", "received", "refused", "skipped", "gaps", "denied")
    offset, error = status["clock_offset"], status["clock_error"]
    known = (
        f"{-offset:+.6f} s from the launcher's, known to ±{error * 1e6:.0f} µs"
        if error
        else "the launcher's own"
    )
    lines = [
        f"/{name}: {status['kind']}, {status['state']}, process {status['pid']}",
        (
            f"  {setup.pace} at {1.0 / setup.period:g} Hz, processors"
            f" {setup.scheduling.cpus or 'any'}, FIFO {setup.scheduling.fifo or 'no'}"
        ),
        "  " + ", ".join(f"{key} {status[key]}" for key in counters),
        f"  memory {status['memory'] / 1e6:.1f} MB, processor time {status['cpu']:.2f} s",
        f"  clock {known}",
        *([f"  force: {device['force']['why']}"] if "force" in device else []),
        *([f"  mass: {_mass(device['inertia'])}"] if "inertia" in device else []),
        "  publishes:",
        *(f"    {topic}" for topic in info["publishes"]),
        "  listens to:",
        *(f"    {topic}" for topic in info["listens_to"] or ["(nothing)"]),
        "  operations:",
        *(f"    {operation}" for operation in info["operations"]),
    ]
    return answer(arguments.json, figures, "\n".join(lines))


def _mass(masses: dict[str, Any]) -> str:
    here = ", ".join(f"{value:.4g}" for value in masses["here_kg"])
    seen = f"{masses['least_kg']:.4g} to {masses['greatest_kg']:.4g}"
    return f"{here} kg along x, y, z at its position; {seen} kg in all poses so far"


def _rearm(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    found = run.drivers()
    if not arguments.node and len(found) != 1:
        raise UsageError(
            f"node rearm: {run.run} has the drivers {', '.join(found) or 'none'}; name one"
        )
    name = node_name(run, arguments.node or found[0])
    receipt = ask(run, name, "rearm", beside=True)
    return answer(
        arguments.json,
        {"run": run.run, "node": name, **receipt},
        f"/{name}: forces enabled again, from tick {receipt['seq']}",
    )


def _reset(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    found = [name for name, setup in run.nodes.items() if setup.kind == "mujoco"]
    if not arguments.node and len(found) != 1:
        raise UsageError(
            f"node reset: {run.run} has the scenes of bodies {', '.join(found) or 'none'}; name one"
        )
    name = node_name(run, arguments.node or found[0])
    receipt = ask(run, name, "reset")
    return answer(
        arguments.json,
        {"run": run.run, "node": name, **receipt},
        f"/{name}: the scene starts again, from tick {receipt['seq']}",
    )


def _start(arguments: argparse.Namespace) -> int:
    from nodes.launcher import join

    if arguments.json:
        raise UsageError("node start: has no JSON output; leave --json out")
    try:
        if arguments.bind is None:
            run = chosen_run(arguments)
            return join.start_here(run, node_name(run, arguments.node))
        host, _, port = arguments.bind.rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65535:
            raise UsageError(
                f"--bind {arguments.bind}: expected HOST:PORT with a port from 1 to 65534"
            )
        return join.start_for(
            arguments.node,
            host.strip("[]"),
            int(port),
            arguments.kind,
            arguments.allow_path,
        )
    except (ValueError, RunError) as error:
        # Invalid keys, endpoints and parameters all raise ValueError.
        raise UsageError(str(error)) from error
