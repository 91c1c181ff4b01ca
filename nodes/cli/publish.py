"""``haptic topic pub``: publish external forces, targets or controls."""

import argparse
import time
from collections.abc import Callable
from typing import Any

from messages.errors import RefusedError, UsageError
from messages.topics import LOOP, split
from messages.types import Vector
from nodes.cli.ask import chosen_chain, chosen_run
from nodes.cli.main import answer
from nodes.client.launches import ask, roles
from nodes.driver.pointer import PointerWriter, pointer_file
from nodes.launcher.runs import RunInfo
from nodes.parameters.quantities import between, whole
from nodes.parameters.store import convert
from nodes.parameters.yaml_io import parse_yaml

# force added to the law's [N]; position that a virtual hand pulls to [m]; controls of actuators
# in a scene of bodies; offset of a shape that moves [m]
WRENCH = "/external/wrench"
TARGET = "/external/target"
CONTROLS = "/external/controls"
SHAPE = "/external/shape"


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "topic",
        help=(
            f"{WRENCH} (force added to the law's), {TARGET} (of a virtual device's hand),"
            f" {CONTROLS} (of actuators in a scene of bodies) or {SHAPE} (that moves)"
        ),
    )
    parser.add_argument(
        "values",
        help=(
            "{force: [0, 0, 1]} in N, {position: [0.02, 0, 0]} in m, or the three numbers alone;"
            " {ACTUATOR: 0.5} or a list for all actuators; {shape: 1, position: [0.01, 0, 0]}"
        ),
    )
    parser.add_argument(
        "--rate",
        "-r",
        type=between(1e-3, 1000.0),
        default=50.0,
        metavar="HZ",
        help="rate of publishing",
    )
    parser.add_argument(
        "--once", "-1", action="store_true", help="publish once, then exit"
    )
    parser.add_argument(
        "--times",
        "-t",
        type=whole(0, 10**9),
        default=0,
        metavar="N",
        help="publish N times, then exit",
    )


def _vector(text: str, name: str) -> Vector:
    given = parse_yaml(text, "values")
    if isinstance(given, dict) and set(given) != {name}:
        raise UsageError(f"{text}: expected {{{name}: [x, y, z]}}")
    found: Vector = convert(
        given[name] if isinstance(given, dict) else given, Vector, name
    )
    return found


def _sender(run: RunInfo, arguments: argparse.Namespace) -> Callable[[], Any]:
    inside = split(arguments.topic)[1]
    if inside == CONTROLS:
        environment = roles(run).get("environment", "")
        if "mujoco" not in {
            run.nodes[name].kind for name in run.nodes if name == environment
        }:
            raise UsageError(
                f"{run.run}: has no scene of bodies (kind mujoco) with actuators"
            )
        controls = parse_yaml(arguments.values, "values")
        return lambda: ask(run, environment, "controls", controls=controls)
    if inside == SHAPE:
        environment = roles(run).get("environment", "")
        given = parse_yaml(arguments.values, "values")
        if not isinstance(given, dict) or not {"position"} <= set(given) <= {
            "shape",
            "position",
        }:
            raise UsageError(
                f"{arguments.values}: expected {{shape: 0, position: [x, y, z]}}"
            )
        return lambda: ask(run, environment, "move", **given)
    driver = roles(run).get("driver")
    if driver is None:
        raise UsageError(f"{run.run}: has no driver")
    if inside == WRENCH:
        force = _vector(arguments.values, "force")
        return lambda: ask(run, driver, "external", force=list(force))
    position = _vector(arguments.values, "position")
    setup = run.nodes[driver]
    try:
        pointer = PointerWriter(pointer_file(setup.run_dir, setup.name))
    except FileNotFoundError as error:
        raise RefusedError(
            f"{driver}: has no hand to move; set device.hand and pointer: {{}} of a sim_driver"
        ) from error
    return lambda: pointer.write(position)


def publish(arguments: argparse.Namespace) -> int:
    """Publish until --once or --times is reached, Ctrl-C, or the end of the run."""
    # As in ROS, the full name of a chain's topic begins with its namespace.
    namespace, inside = split(arguments.topic)
    if inside not in (WRENCH, TARGET, CONTROLS, SHAPE):
        why = ": its own node publishes one per tick" if inside in LOOP else ""
        raise UsageError(
            f"{arguments.topic} cannot be published from outside{why}; there are {WRENCH},"
            f" {TARGET}, {CONTROLS} and {SHAPE}"
        )
    run = (
        chosen_run(arguments).within(namespace).only_chain()
        if namespace
        else chosen_chain(arguments)
    )
    send = _sender(run, arguments)
    count = 0
    limit = 1 if arguments.once else arguments.times
    following = time.monotonic()
    try:
        while run.lives and not (limit and count >= limit):
            send()
            count += 1
            following += 1.0 / arguments.rate
            time.sleep(max(0.0, following - time.monotonic()))
    except KeyboardInterrupt:
        # Values that are not renewed expire by themselves.
        pass
    return answer(
        arguments.json,
        {"topic": arguments.topic, "published": count},
        f"{arguments.topic}: published {count}",
    )
