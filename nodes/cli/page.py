"""Parts shared by ``launch --view`` and ``view``: add a view node and announce its page."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import IO, TYPE_CHECKING

import msgspec

from nodes.base.stderr_queue import StderrQueue
from nodes.launcher.launch_spec import Launch, NodeSpec
from nodes.launcher.wiring import chains_of, free_name

if TYPE_CHECKING:
    from nodes.launcher.supervisor import Supervisor

KIND = "view"  # kind of node that serves a page


def with_view(launch: Launch) -> Launch:
    """Add a view node to a launch without one.

    Drivers whose page may push them beyond a limit are set to restart.
    """
    if any(spec.kind == KIND for spec in launch.nodes.values()):
        return launch
    realtime = launch.run.pace == "realtime"
    again = {
        driver: msgspec.structs.replace(
            spec, respawn=True, respawn_delay=0.0, respawn_max=-1
        )
        for driver, spec in launch.nodes.items()
        if realtime and (spec.parameters.get("pointer") or {}).get("beyond")
    }
    view = NodeSpec(
        kind=KIND,
        required=False,
        respawn=True,
        parameters={"again": True} if again else {},
    )
    chains = chains_of(launch)  # a page shows one chain
    pages = {
        free_name(
            launch, f"{chain}/{KIND}" if len(chains) > 1 and chain else KIND
        ): view
        for chain in chains or [""]
    }
    return msgspec.structs.replace(launch, nodes={**launch.nodes, **again, **pages})


def announce(url: str, as_json: bool, out: IO[str] | StderrQueue | None = None) -> None:
    """Print the URL of the page, and open it in a browser if there is a screen."""
    print(
        json.dumps({"url": url}) if as_json else f"page  {url}",
        file=out or sys.stdout,
        flush=True,
    )
    screen = "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ
    if screen and not as_json and sys.stdout.isatty():
        _open(url)


def _open(url: str) -> None:
    """Open a page through a private file: a command line is public, and the URL holds a token."""
    import atexit
    import tempfile
    import webbrowser

    descriptor, path = tempfile.mkstemp(prefix="haptic-page-", suffix=".html")
    with open(descriptor, "w", encoding="utf-8") as file:
        file.write(
            '<!doctype html><title>haptic</title><meta http-equiv="refresh" content="0;'
            f' url={url}"><a href="{url}">page</a>\n'
        )
    # Removed at exit only: a browser may start late.
    atexit.register(lambda: Path(path).unlink(missing_ok=True))
    webbrowser.open(Path(path).as_uri())


class PageAnnouncer:
    """Announces each page of a launch once, without waiting for a reader of the output."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self._announced: set[str] = set()
        self._words: StderrQueue | None = None

    def drain(self) -> None:
        """Wait for the reader of the output, before anything else is printed."""
        if self._words is not None:
            self._words.drain()

    def __call__(self, supervisor: Supervisor) -> None:
        """Announce pages that are now served."""
        for name, child in supervisor.children.items():
            if (
                child.setup.kind == KIND
                and name not in self._announced
                and child.running
                and not supervisor.ending
            ):
                # Decoded here, so that the launcher need not import the view.
                path = Path(supervisor.run_dir) / f"{name}.page.json"
                if path.exists():
                    self._announced.add(name)
                    self._words = self._words or StderrQueue(sys.stdout.fileno())
                    announce(
                        msgspec.json.decode(path.read_bytes())["url"],
                        self._as_json,
                        self._words,
                    )
