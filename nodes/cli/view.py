"""Show a launch or a recording in a browser, or write a page that needs no server."""

import argparse
import asyncio
import json
import sys
import time
from pathlib import Path

from messages.errors import RefusedError, UsageError
from nodes.cli.ask import chosen_chain
from nodes.cli.main import add_run_name, answer, heeding
from nodes.cli.page import announce
from nodes.client.listen import listening
from nodes.launcher.runs import RunInfo, alive
from nodes.parameters.quantities import PORT

PROGRESS_PERIOD = 2.0  # time between progress messages while reading a recording [s]


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_run_name(parser)
    parser.add_argument(
        "--replay",
        type=Path,
        metavar="FILE",
        help="show a recording instead of a running launch",
    )
    parser.add_argument(
        "--over",
        type=Path,
        metavar="FILE",
        help="with --replay: draw another recording over it",
    )
    parser.add_argument(
        "--static",
        nargs="+",
        metavar=("DIR", "SCENARIO"),
        help=(
            "write a folder of plain files whose page plays scenarios by itself, for any web host"
            " or a double click (default scenario: touch_wall)"
        ),
    )
    parser.add_argument(
        "--port", type=PORT, default=0, help="port of the page (default: any free port)"
    )
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        help="only 127.0.0.1 is allowed; the error for others names the alternative",
    )
    parser.add_argument(
        "--foxglove",
        type=PORT,
        nargs="?",
        const=8765,
        metavar="PORT",
        help=(
            "also serve Foxglove and Lichtblick at ws://127.0.0.1:PORT (default: 8765); needs"
            " haptic-nodes[foxglove]"
        ),
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help='print the URL as {"url": …} on the first line',
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from nodes.view.address import check_address

    if arguments.static:
        return _static(arguments)
    check_address(arguments.address, arguments.port)
    if arguments.replay is not None and arguments.foxglove is not None:
        raise UsageError(
            "view: --foxglove serves a running launch, but --replay shows a recording; write it for"
            f" Foxglove with: haptic bag export {arguments.replay} --format foxglove"
        )
    ended: list[int] = []
    try:
        with heeding(ended.append):
            if arguments.replay is not None:
                return _replay(arguments, ended)
            found = chosen_chain(arguments)
            return _beside(found, arguments, ended)
    except OSError as error:
        raise RefusedError(
            f"port {arguments.port}: {error.strerror or error}"
        ) from error


def _static(arguments: argparse.Namespace) -> int:
    from nodes.view.pages import PAGES

    directory, *scenarios = arguments.static
    written = PAGES.load("static")(Path(directory), scenarios)
    return answer(
        arguments.json,
        written,
        f"{directory}: {written['files']} files, {written['bytes'] / 1000:.0f} kB; open"
        f" {directory}/index.html, or put the folder on any web host",
    )


def _beside(found: RunInfo, arguments: argparse.Namespace, ended: list[int]) -> int:
    from nodes.base.realtime import quiet_interpreter
    from nodes.recording.logger import QUEUE
    from nodes.view.run_pages import RunPages

    # A map that is being computed must not delay an answer by 5 ms at each of its steps.
    quiet_interpreter()
    # Threads started here inherit a processor set without the loop's.
    with listening(found, set(found.publishers().values()), [""], QUEUE) as (
        inbox,
        links,
    ):
        pages = RunPages(found, inbox)

        async def serve() -> None:
            await pages.server.start(arguments.port)
            announce(pages.server.url, arguments.json)
            if arguments.foxglove is not None:
                port = pages.bridge(arguments.foxglove)
                print(
                    f"Foxglove and Lichtblick can connect to ws://127.0.0.1:{port}",
                    file=sys.stderr,
                    flush=True,
                )
            # A launch announces its end; a killed one does not.
            await pages.run(
                lambda: bool(ended or pages.live.ended or not alive(found.launcher)),
                links.keep,
            )

        asyncio.run(serve())
    return answer(
        arguments.json,
        {"run": found.run, "ended": pages.live.ended},
        f"{found.run}: {pages.live.ended}",
    )


def _replay(arguments: argparse.Namespace, ended: list[int]) -> int:
    from nodes.recording.writer import RecordError
    from nodes.view.replay import ReplayPages

    told = time.monotonic()

    def progress(share: float) -> None:
        nonlocal told
        if ended:
            raise KeyboardInterrupt
        if time.monotonic() - told > PROGRESS_PERIOD:
            told = time.monotonic()
            print(
                f"reading {arguments.replay}: {100.0 * share:.0f} %",
                file=sys.stderr,
                flush=True,
            )

    try:
        pages = ReplayPages(arguments.replay, arguments.over, progress)
    except RecordError as error:
        raise UsageError(str(error)) from error

    async def serve() -> None:
        await pages.server.start(arguments.port)
        announce(pages.server.url, arguments.json)
        await pages.run(lambda: bool(ended))

    asyncio.run(serve())
    if arguments.json:
        print(
            json.dumps({"replay": str(arguments.replay), "duration_s": pages.duration}),
            flush=True,
        )
    return 0
