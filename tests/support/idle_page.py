"""A page of a server that grants its hand and does nothing."""

from __future__ import annotations

import asyncio
from typing import Any

from nodes.view.server import SEND_PERIOD


class IdlePage:
    """Base of pages that only send."""

    async def due(self) -> None:
        """Wait for nothing but the next look."""
        await asyncio.sleep(SEND_PERIOD)

    def hand(self, target: list[float] | None) -> str:
        """Grant the hand."""
        del target
        return ""

    async def ask(self, request: dict[str, Any]) -> Any:
        """Do nothing."""
        del request
        return {}

    def close(self) -> None:
        """Do nothing."""
