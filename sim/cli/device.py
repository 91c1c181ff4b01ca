"""List, check, free and identify devices; every estimate has a 95 % interval."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from nodes.cli.ask import chosen_run, sub_verb
from nodes.parameters.quantities import declare
from sim.cli.answers import add_answer, report
from sim.cli.functions import declare as declare_function
from sim.studies.device_identify import device_identify

_INFO = (
    "Connect to a device with forces off; print what it is and which force it can give."
)
_CHECK = (
    "Check a device by hand: noise, rate, axes without a force, then a first force in"
    " steps, each asked for."
)
_FREE = (
    "Name the process that holds a device; where there is none, switch its forces off"
    " and release it."
)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen",
        metavar="list|info|check|free|recentre|presets|identify",
        required=True,
    )
    listed = sub.add_parser("list", help="which devices can be driven from here")
    add_answer(listed, _list, files=False)
    for name, run, text in (
        ("info", _info, _INFO),
        ("check", _check, _CHECK),
        ("free", _free, _FREE),
    ):
        one = sub.add_parser(name, help=text, description=text)
        one.add_argument("kind", help="kind of node that drives it: haptic device list")
        one.add_argument(
            "parameters",
            nargs="*",
            metavar="name:=value",
            help="of its driver: touch.library:=/opt/libHD.so",
        )
        add_answer(one, run, files=False)
        if name == "info":
            declare(one, rate=500.0, delay=1.0, gain=3.0)
    centred = sub_verb(
        sub,
        "recentre",
        _recentre,
        "Put the device of a running launch into the middle of its scene, wherever its handle is.",
    )
    centred.add_argument(
        "driver", nargs="?", default="driver", help="node that drives it"
    )
    known = sub.add_parser(
        "presets",
        help="known values of real devices, with their sources: device:=touch_x",
    )
    add_answer(known, _presets, files=False)
    text = "Push the device of a running launch (or of a scenario, started for it) and identify it."
    own = sub.add_parser("identify", help=text, description=text)
    declare_function(device_identify, own)


def _list(arguments: argparse.Namespace) -> int:
    from sim.device_check.found import devices, text

    return report(arguments, {"devices": [asdict(kind) for kind in devices()]}, text())


def _info(arguments: argparse.Namespace) -> int:
    from sim.device_check.found import device_of
    from sim.device_check.info import info, text

    device = device_of(arguments.kind, arguments.parameters)
    found = info(device, arguments.rate, arguments.delay, arguments.gain)
    return report(arguments, found, f"{arguments.kind}: {device.TITLE}\n{text(found)}")


def _check(arguments: argparse.Namespace) -> int:
    from sim.device_check.check import check
    from sim.device_check.found import device_of

    found = check(device_of(arguments.kind, arguments.parameters), arguments.kind)
    return report(arguments, found, found["line"], held=found["passed"])


def _free(arguments: argparse.Namespace) -> int:
    from sim.device_check.found import device_of
    from sim.device_check.free import free

    device = device_of(arguments.kind, arguments.parameters)
    return report(
        arguments,
        free(device),
        f"{arguments.kind}: forces are off, and no process holds it",
    )


def _recentre(arguments: argparse.Namespace) -> int:
    from nodes.client.launches import ask, node_name

    run = chosen_run(arguments)
    found = ask(run, node_name(run, arguments.driver), "recentre")
    x, y, z = (f"{1e3 * value:+.1f}" for value in found["moved_m"])
    return report(
        arguments,
        found,
        f"the device is in the middle of the scene: moved by {x}, {y}, {z} mm",
    )


def _presets(arguments: argparse.Namespace) -> int:
    from sim.device.real_devices import figures, text

    return report(arguments, {"presets": figures()}, text())
