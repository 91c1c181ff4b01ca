"""Surplus answers of the service, which would make every later position older.

One answer is requested each time. One more that stays queued makes every later position older by a
period, without limit; so all that came are read, and a service that keeps sending them is given up.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from websockets.sync.client import ClientConnection

from messages.errors import HapticError

SURPLUS_BURST, SURPLUS_RATE = 100, 10.0
"""Surplus answers tolerated at once, and per second [1/s]; each was one round trip old."""


class SurplusError(HapticError):
    """The service keeps sending more answers than requested."""


class SurplusAnswers:
    """Counts surplus answers against a token bucket.

    Parameters
    ----------
    report : callable
        Gets the number of all so far, after each.
    """

    def __init__(self, report: Callable[[int], None]) -> None:
        self._report = report
        self._count, self._forgiven, self._counted = 0, float(SURPLUS_BURST), 0.0

    def begin(self) -> None:
        """Begin the time over which they are tolerated."""
        self._counted = time.monotonic()

    def newest(self, socket: ClientConnection, answer: str | bytes) -> str | bytes:
        """Return the newest answer received, `answer` if none; SurplusError if they go on."""
        while True:
            try:
                answer = socket.recv(timeout=0)
            except TimeoutError:
                return answer
            now = time.monotonic()
            more = (now - self._counted) * SURPLUS_RATE
            self._forgiven = min(SURPLUS_BURST, self._forgiven + more) - 1.0
            self._counted = now
            self._count += 1
            self._report(self._count)
            if self._forgiven < 0.0:
                raise SurplusError
