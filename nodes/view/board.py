"""What pages get beside the bins: documents of which only the newest counts, and a log of which everything does."""

from __future__ import annotations

from collections import deque
from typing import Any

import msgspec

KEPT = 500
"""Entries of the log that a page which opens later still sees."""


class Board:
    """Documents by name, and the log. One thread uses it."""

    def __init__(self) -> None:
        self._documents: dict[str, tuple[int, str]] = {}
        self._version = 0
        self._log: deque[str] = deque(maxlen=KEPT)
        self.logged = 0  # entries of the log so far

    def put(self, kind: str, content: dict[str, Any]) -> None:
        """Replace a document; one that has not changed is not sent again."""
        text = msgspec.json.encode({"type": kind, **content}).decode()
        if kind not in self._documents or self._documents[kind][1] != text:
            self._version += 1
            self._documents[kind] = (self._version, text)

    def log(self, content: dict[str, Any]) -> None:
        """Add to the log."""
        self._log.append(msgspec.json.encode({"type": "log", **content}).decode())
        self.logged += 1

    def since(self, version: int, logged: int) -> tuple[list[str], int, int]:
        """List what is new."""
        new = sorted(entry for entry in self._documents.values() if entry[0] > version)
        count = min(self.logged - logged, len(self._log))
        entries = list(self._log)[len(self._log) - count :] if count else []
        return [text for _, text in new] + entries, self._version, self.logged
