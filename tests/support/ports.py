"""Free tcp ports for the tests."""

from __future__ import annotations

import contextlib
import socket


def free_ports(count: int) -> int:
    """Find the first of some adjacent free tcp ports.

    Parameters
    ----------
    count : int
        How many.

    Returns
    -------
    int
        The first one.
    """
    while True:
        with contextlib.ExitStack() as stack:
            first = stack.enter_context(socket.socket())
            first.bind(("127.0.0.1", 0))
            port = int(first.getsockname()[1])
            try:
                for i in range(1, count):
                    stack.enter_context(socket.socket()).bind(("127.0.0.1", port + i))
            except (OSError, OverflowError):
                continue
            return port
