"""Keys of this machine and of those that may take part in its launches: new, allow, revoke, list."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from messages.errors import UsageError
from messages.transport import keys
from nodes.cli.main import add_json, answer


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(dest="chosen", metavar="new|allow|revoke|list", required=True)
    text = "Make this machine's key pair and print the public key."
    new = sub.add_parser("new", help=text, description=text)
    new.add_argument("--replace", action="store_true", help="replace the pair that is there")
    text = "Let another machine in: its public key, under a name (its address, as launch files say host)."
    allow = sub.add_parser("allow", help=text, description=text)
    allow.add_argument("name")
    allow.add_argument("key", help="64 hexadecimal digits, as its haptic keys list prints them")
    allow.add_argument("--replace", action="store_true", help="replace another key under that name")
    text = "Let a machine in no more: its open connections to whatever runs here end within a second."
    revoke = sub.add_parser("revoke", help=text, description=text)
    revoke.add_argument("name")
    text = "Print this machine's public key and the machines that are let in."
    listing = sub.add_parser("list", help=text, description=text)
    for verb, function in ((new, _new), (allow, _allow), (revoke, _revoke), (listing, _list)):
        add_json(verb)
        verb.set_defaults(run=_telling(function))


def _telling(function: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    def run(arguments: argparse.Namespace) -> int:
        try:
            return function(arguments)
        except keys.KeyRefusedError as error:
            raise UsageError(str(error)) from error

    return run


def _new(arguments: argparse.Namespace) -> int:
    made = keys.new_identity(arguments.replace)
    text = f"{made.public}\n(on the other machines: haptic keys allow NAME {made.public})"
    answer(arguments.json, {"public_key": made.public, "directory": str(keys.key_dir())}, text)
    return 0


def _allow(arguments: argparse.Namespace) -> int:
    path = keys.allow(arguments.name, arguments.key, arguments.replace)
    figures = {"name": arguments.name, "public_key": keys.key_of(arguments.name), "file": str(path)}
    answer(arguments.json, figures, f"{arguments.name} is allowed ({path})")
    return 0


def _revoke(arguments: argparse.Namespace) -> int:
    path = keys.revoke(arguments.name)
    text = (
        f"{arguments.name} is no longer allowed ({path} removed); what runs here ends its connections within a second"
    )
    answer(arguments.json, {"name": arguments.name, "file": str(path)}, text)
    return 0


def _list(arguments: argparse.Namespace) -> int:
    try:
        mine = keys.identity().public
        own = mine
    except keys.KeyRefusedError as error:
        mine, own = "", str(error)
    there = keys.allowed()
    lines = [f"this machine  {own}", *(f"{name:12}  {key}" for name, key in there.items())]
    answer(arguments.json, {"public_key": mine, "allowed": there, "directory": str(keys.key_dir())}, "\n".join(lines))
    return 0
