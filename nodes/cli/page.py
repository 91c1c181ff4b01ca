"""Parts shared by ``launch --view`` and ``view``: add a view node and announce its page."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import msgspec

from nodes.base.node_kinds import is_hop, load, node_kinds
from nodes.base.stderr_queue import StderrQueue
from nodes.cli.main import heeding
from nodes.launcher.launch_spec import Launch, NodeSpec
from nodes.launcher.wiring import chains_of, free_name

if TYPE_CHECKING:
    from nodes.launcher.supervisor import Supervisor

KIND = "view"  # kind of node that serves a page
STOP_REASON = "stop requested"  # end of a run that a page, or a request, stopped
RESPAWNS = 20  # restarts of a demo's node in one run


def is_demo(launch: Launch) -> bool:
    """Whether a page may make this launch unstable, so that it goes on whatever happens to it."""
    return launch.run.pace == "realtime" and any(
        (spec.parameters.get("pointer") or {}).get("beyond")
        for spec in launch.nodes.values()
    )


def with_view(launch: Launch) -> Launch:
    """Add a view node to a launch without one; the loop's nodes of a demo are set to restart."""
    if any(spec.kind == KIND for spec in launch.nodes.values()):
        return launch
    again = {}
    kinds = node_kinds()
    for name, spec in launch.nodes.items() if is_demo(launch) else ():
        if spec.kind in kinds and is_hop(load(kinds[spec.kind])) and not spec.host:
            again[name] = msgspec.structs.replace(
                spec, respawn=True, respawn_delay=0.0, respawn_max=RESPAWNS
            )
    view = NodeSpec(kind=KIND, required=False, respawn=True)
    chains = chains_of(launch)  # a page shows one chain
    pages = {
        free_name(
            launch, f"{chain}/{KIND}" if len(chains) > 1 and chain else KIND
        ): view
        for chain in chains or [""]
    }
    return msgspec.structs.replace(launch, nodes={**launch.nodes, **again, **pages})


def wants_another_run(
    launch: Launch, supervisor: Supervisor, page: PageAnnouncer, recordings: list[str]
) -> bool:
    """Wait for the pages of a demo that has ended; return whether one asks to start it again.

    A demo is over when its duration has passed, the user ends it, or no page has seen the end.
    """
    stopped = supervisor.exit_reason == STOP_REASON
    if not (page.places and is_demo(launch) and (supervisor.failed or stopped)):
        return False
    place = next(iter(page.places.values()))
    reports = [supervisor.reports.get(name, {}) for name in page.places]
    # A view that was killed could not report its pages.
    if supervisor.interrupted or not any(one.get("pages", 1) for one in reports):
        return False
    from nodes.view.ended_run import wait_for_page

    ended: list[int] = []
    with heeding(ended.append):
        return wait_for_page(
            place["token"],
            place["port"],
            supervisor.exit_reason,
            recordings,
            lambda: bool(ended),
        )


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
        self.places: dict[str, dict[str, Any]] = {}  # address of each page by its node
        self._words: StderrQueue | None = None

    def files(self) -> dict[str, bytes]:
        """Return the files that give the views of another run the same addresses."""
        return {
            f"{name}.page.json": msgspec.json.encode(place)
            for name, place in self.places.items()
        }

    def drain(self) -> None:
        """Wait for the reader of the output, before anything else is printed."""
        if self._words is not None:
            self._words.drain()

    def __call__(self, supervisor: Supervisor) -> None:
        """Announce pages that are now served."""
        for name, child in supervisor.children.items():
            if (
                child.setup.kind == KIND
                and name not in self.places
                and child.running
                and not supervisor.ending
            ):
                # Decoded here, so that the launcher need not import the view.
                path = Path(supervisor.run_dir) / f"{name}.page.json"
                if path.exists():
                    self.places[name] = msgspec.json.decode(path.read_bytes())
                    self._words = self._words or StderrQueue(sys.stdout.fileno())
                    announce(self.places[name]["url"], self._as_json, self._words)
