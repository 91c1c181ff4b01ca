"""The socket of a page, without a browser."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from typing import Any

from websockets.sync.client import ClientConnection, connect


@contextlib.contextmanager
def live(url: str, **more: Any) -> Iterator[ClientConnection]:
    with connect(
        url.replace("http", "ws") + "live",
        compression=None,
        open_timeout=20.0,
        max_size=1 << 26,
        **more,
    ) as page:
        yield page


def texts(page: ClientConnection, kind: str, **wanted: Any) -> dict[str, Any]:
    """Wait for a document of a kind."""
    while True:
        found = page.recv(timeout=30.0)
        if isinstance(found, str):
            document: dict[str, Any] = json.loads(found)
            if document["type"] == kind and all(
                document.get(key) == value for key, value in wanted.items()
            ):
                return document
