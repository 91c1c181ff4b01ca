"""The page of a run that has ended: why, its recordings, and "start again".

The launcher serves it at the address of the view that has ended, so that open pages come back.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import msgspec

from nodes.view.commands import CommandError
from nodes.view.server import SEND_PERIOD, PageServer

# Time without a page after which nobody is waited for; a page tries again every 2 s [s].
ABSENCE = 5.0
_CHECK_PERIOD = 0.1  # time between two looks at the pages [s]


class EndedPage:
    """An open page of a run that has ended; its only request is to start again."""

    def __init__(self, document: str, start: Callable[[], None]) -> None:
        self._news: list[str | bytes] = [document]
        self._start = start

    def news(self) -> list[str | bytes]:
        """Return why the run has ended, once."""
        news = self._news
        self._news = []
        return news

    async def due(self) -> None:
        """Wait for nothing but the next look."""
        await asyncio.sleep(SEND_PERIOD)

    def hand(self, target: list[float] | None) -> str:
        """Ignore the hand, which has nothing to move."""
        del target
        return ""

    async def ask(self, request: dict[str, Any]) -> Any:
        """Start the run again; refuse anything else."""
        if request.get("op") != "restart":
            raise CommandError("The run has ended; press Start again.")
        self._start()
        return {}

    def close(self) -> None:
        """Do nothing."""


def wait_for_page(
    token: str,
    port: int,
    reason: str,
    recordings: list[str],
    is_ended: Callable[[], bool],
) -> bool:
    """Serve the page of an ended run; return whether a page asks to start it again.

    Parameters
    ----------
    token, port : str, int
        Address of the page before.
    reason : str
        Why the run has ended.
    recordings : list of str
        Where it was recorded.
    is_ended : callable
        Whether the user ends the waiting.

    Returns
    -------
    bool
        False once no page was open for `ABSENCE`, the user ended it, or the port is taken.
    """
    document = {"type": "ended", "reason": reason, "recordings": recordings}
    return asyncio.run(
        _serve(token, port, msgspec.json.encode(document).decode(), is_ended)
    )


async def _serve(
    token: str, port: int, document: str, is_ended: Callable[[], bool]
) -> bool:
    wanted = asyncio.Event()
    server = PageServer(lambda: EndedPage(document, wanted.set), token)
    try:
        await server.start(port)
    except OSError:
        # Another program has taken the port: pages cannot come back.
        return False
    seen_at = time.monotonic()
    try:
        while not (wanted.is_set() or is_ended()):
            if server.pages:
                seen_at = time.monotonic()
            elif time.monotonic() - seen_at > ABSENCE:
                break
            await asyncio.sleep(_CHECK_PERIOD)
    finally:
        await server.stop()
    return wanted.is_set()
