"""Create and list keys, and allow or revoke the machines that may take part in launches."""

import argparse
from collections.abc import Callable

from messages.errors import UsageError
from messages.transport import keys
from nodes.cli.main import add_json, answer


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen", metavar="new|allow|revoke|list", required=True
    )

    def declare(
        name: str, run: Callable[[argparse.Namespace], int], text: str
    ) -> argparse.ArgumentParser:
        own = sub.add_parser(name, help=text, description=text)
        add_json(own)
        own.set_defaults(run=lambda arguments: _told(run, arguments))
        return own

    new = declare(
        "new", _new, "Create this machine's key pair and print the public key."
    )
    new.add_argument("--replace", action="store_true", help="replace the existing pair")
    allow = declare(
        "allow",
        _allow,
        "Allow another machine by its public key, under a name (its address, as host in a launch"
        " file).",
    )
    allow.add_argument("name")
    allow.add_argument(
        "key", help="64 hexadecimal digits, printed there by haptic keys list"
    )
    allow.add_argument(
        "--replace", action="store_true", help="replace another key under that name"
    )
    revoke = declare(
        "revoke",
        _revoke,
        "Revoke a machine's access; its open connections here end within a second.",
    )
    revoke.add_argument("name")
    declare("list", _list, "Print this machine's public key and the allowed machines.")


def _told(
    run: Callable[[argparse.Namespace], int], arguments: argparse.Namespace
) -> int:
    try:
        return run(arguments)
    except keys.KeyRefusedError as error:
        raise UsageError(str(error)) from error


def _new(arguments: argparse.Namespace) -> int:
    made = keys.new_identity(arguments.replace)
    text = (
        f"{made.public}\n(on the other machines: haptic keys allow NAME {made.public})"
    )
    return answer(
        arguments.json,
        {"public_key": made.public, "directory": str(keys.key_dir())},
        text,
    )


def _allow(arguments: argparse.Namespace) -> int:
    path = keys.allow(arguments.name, arguments.key, arguments.replace)
    figures = {
        "name": arguments.name,
        "public_key": keys.key_of(arguments.name),
        "file": str(path),
    }
    return answer(arguments.json, figures, f"{arguments.name} is allowed ({path})")


def _revoke(arguments: argparse.Namespace) -> int:
    path = keys.revoke(arguments.name)
    text = (
        f"{arguments.name} is no longer allowed ({path} removed); its connections to this machine"
        " end within a second"
    )
    return answer(arguments.json, {"name": arguments.name, "file": str(path)}, text)


def _list(arguments: argparse.Namespace) -> int:
    try:
        own = mine = keys.identity().public
    except keys.KeyRefusedError as error:
        mine = ""
        own = str(error)
    there = keys.allowed()
    lines = [
        f"this machine  {own}",
        *(f"{name:12}  {key}" for name, key in there.items()),
    ]
    return answer(
        arguments.json,
        {"public_key": mine, "allowed": there, "directory": str(keys.key_dir())},
        "\n".join(lines),
    )
