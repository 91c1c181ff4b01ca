"""Free tcp ports for launches and drills that must not collide on this machine."""

import random
import socket
from contextlib import ExitStack
from pathlib import Path

RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
LOWEST, HIGHEST = 10_000, 60_000


def free_ports(count: int) -> int:
    """Return the first of `count` adjacent free ports.

    If possible they lie outside the range of outgoing connections.
    """
    outgoing = int(RANGE.read_text(encoding="ascii").split()[0])
    highest = outgoing if outgoing > LOWEST + 1000 else HIGHEST
    while True:
        first = random.randrange(LOWEST, highest - count)  # noqa: S311  # a place, not a secret
        with ExitStack() as stack:
            try:
                for port in range(first, first + count):
                    stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
            except OSError:
                continue
            return first
