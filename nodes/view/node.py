"""The view node: serves a page of the run in its own process, off the chain's core.

It only subscribes and sends requests; the loop does not depend on it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec

from nodes.base.node import Node
from nodes.base.setup import Setup
from nodes.base.status_report import write_whole
from nodes.launcher.runs import read_chain
from nodes.parameters.store import convert
from nodes.recording.logger import QUEUE
from nodes.view.address import ADDRESS, check_address

if TYPE_CHECKING:
    from nodes.view.run_pages import RunPages


class ViewParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of a view node.

    address: Where the page is served: 127.0.0.1, and nothing else.
    port: Port; 0 for any free one.
    foxglove: Port of the live bridge to Foxglove and Lichtblick (nodes/view/foxglove.py); None for
        none.
    """

    address: str = ADDRESS
    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 0
    foxglove: Annotated[int, msgspec.Meta(ge=0, le=65535)] | None = None


class Place(msgspec.Struct, frozen=True, kw_only=True):
    """URL of a run's page, stored as ``NAME.page.json`` in the run's private directory."""

    url: str  # URL with the token
    port: int
    # Token in the URL; a restarted node uses it again, so that open pages reconnect.
    token: str


def place_file(run_dir: str | Path, name: str) -> Path:
    """Return the path of the file with the page's URL."""
    return Path(run_dir) / f"{name}.page.json"


def read_place(run_dir: str | Path, name: str) -> Place | None:
    """Read the page's URL; None without the file."""
    try:
        return msgspec.json.decode(place_file(run_dir, name).read_bytes(), type=Place)
    except FileNotFoundError:
        return None


class View(Node):
    """Serves the page of a launch from its first message to its last."""

    Parameters: ClassVar[type[msgspec.Struct]] = ViewParameters
    listens_to: ClassVar[tuple[str, ...]] = ("*",)
    queue: ClassVar[int] = QUEUE

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Refuse any non-local address."""
        parameters: ViewParameters = convert(
            setup.parameters, ViewParameters, setup.name
        )
        check_address(parameters.address, parameters.port)
        if parameters.foxglove is not None:
            from nodes.view.foxglove import load

            load()

    def configure(self) -> None:
        """Import the server here: numpy and asyncio take 0.2 s, which a launcher can save."""
        from nodes.view import run_pages

        self._make_pages = run_pages.RunPages

    def loop(self) -> None:
        """Serve until stopped."""
        self.state = "running"
        import asyncio

        run = read_chain(self.setup, lambda: self.stopping)
        before = read_place(self.setup.run_dir, self.setup.name)
        token = before.token if before else ""
        assert self.inbox is not None  # noqa: S101  # every kind that listens has one
        with self.loading:
            self._pages = self._make_pages(
                run, self.inbox, token, lambda: self.stopping
            )
        asyncio.run(self._serve(self._pages, before.port if before else 0))

    async def _serve(self, pages: RunPages, port: int) -> None:
        parameters: ViewParameters = self.store.current
        await pages.server.start(parameters.port or port)
        server = pages.server
        if parameters.foxglove is not None:
            self.events.log(
                "Foxglove and Lichtblick can connect to"
                f" ws://{ADDRESS}:{pages.bridge(parameters.foxglove)}"
            )
        place = Place(url=server.url, port=server.port, token=server.token)
        write_whole(place_file(self.setup.run_dir, self.setup.name), place)
        await pages.run(lambda: self.stopping, self._between)

    def _between(self) -> None:
        self.received = self.counters.ticks = self._pages.live.feed.head
        self.between_ticks(0)

    def report(self) -> dict[str, Any]:
        """Return the requests turned away, and the pages that saw the end."""
        if not hasattr(self, "_pages"):
            return {}
        pages = self._pages
        return {"turned_away": pages.server.turned_away, "pages": pages.seen_to_the_end}
