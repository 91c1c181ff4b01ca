"""A listener as it should not be: thousands of subscriptions, heartbeats behind them, frames far too long, and gone.

It speaks ZMTP 3.0 (RFC 23) on a bare socket, so that it can leave in the middle of anything. What libzmq makes of it depends on
where it is cut; a few hundred connections meet every case.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time

GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01NULL" + bytes(16) + b"\0" + bytes(31)


def _command(name: bytes, body: bytes) -> bytes:
    content = bytes([len(name)]) + name + body
    return bytes([4, len(content)]) + content


PING = _command(b"PING", b"\0\x01abc")
# As many in a row as fill a queue of a few dozen, then a heartbeat: what is read at once, 8 KiB, holds both.
SUBSCRIPTIONS = b"".join(b"\0\x05\x01%04d" % i + PING * (i % 50 == 49) for i in range(3000))
REQUESTS = ((b"\x01\0" + b"\0\x05hello") * 20 + PING) * 50
LONG_FRAME = b"\x02" + struct.pack(">Q", 100_000) + bytes(100_000)


def connect(place: str) -> socket.socket:
    """Connect a bare socket to ZeroMQ's endpoint."""
    bare = place.partition("#")[0]
    if bare.startswith("ipc://"):
        made = socket.socket(socket.AF_UNIX)
        made.settimeout(1.0)
        try:
            made.connect(bare.removeprefix("ipc://"))
        except OSError:
            made.close()
            raise
        return made
    host, _, port = bare.removeprefix("tcp://").rpartition(":")
    return socket.create_connection((host.strip("[]"), int(port)), 1.0)


def visit(place: str, chance: random.Random, requests: bool = False) -> bool:
    """Come, misbehave and leave; whether it was let in."""
    try:
        found = connect(place)
    except OSError:
        return False
    kind = b"DEALER" if requests else b"SUB"
    content = REQUESTS if requests else SUBSCRIPTIONS
    found.settimeout(0.5)
    # Whom it is put out by does not wait until it has said all.
    with contextlib.suppress(OSError), found:
        found.sendall(GREETING + _command(b"READY", b"\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind))
        found.sendall(content[: chance.randrange(1, len(content))] + LONG_FRAME * chance.randrange(2))
        # Until what it sent was read, or not.
        time.sleep(0.01 * chance.randrange(2))
        if chance.randrange(2):
            # A reset in place of an end.
            found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    return True
