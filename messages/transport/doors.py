"""Doors: the listening sockets of this process, which let in one connection at a time, and the connections that came in.

ZeroMQ accepts whatever connects, as fast as it can, and ends the process when descriptors run out. It has no limit of its
own, so the limit is set where it waits for connections: its epoll. A listening socket there is made one-shot (epoll(7)), so
that the kernel reports one connection and then none until the door is opened again. What waits in front of a closed door
costs this process nothing: neither descriptor nor time.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import resource
import select
import socket
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)
_MODIFY = 3


class _Event(ctypes.Structure):
    """``struct epoll_event``, which is packed on x86 only."""

    if platform.machine() in ("x86_64", "AMD64", "i686"):
        _pack_ = 1
    _fields_ = (("events", ctypes.c_uint32), ("data", ctypes.c_uint64))


class Door:
    """One listening socket, as ZeroMQ waits for it.

    Parameters
    ----------
    epoll, descriptor : int
        ZeroMQ's epoll and the listening socket in it.
    data : int
        What ZeroMQ has the kernel hand back with the event.

    Attributes
    ----------
    knocks : int
        A descriptor of our own that is readable when somebody waits in front of the door; -1 before `adopt`.
    """

    def __init__(self, epoll: int, descriptor: int, data: int) -> None:
        self._place = (epoll, descriptor, data)
        self.knocks = -1

    def adopt(self) -> None:
        """Shut the door, and open `knocks`."""
        self.close()
        self.knocks = os.dup(self._place[1])

    def forget(self) -> None:
        """Close `knocks`; the door stays shut."""
        os.close(self.knocks)

    def open_once(self) -> None:
        """Let in one connection: the next one, or one that waits."""
        self._wait_for(select.EPOLLIN | select.EPOLLONESHOT)

    def close(self) -> None:
        """Let in nobody until it is opened again."""
        self._wait_for(select.EPOLLONESHOT)

    def _wait_for(self, events: int) -> None:
        epoll, descriptor, data = self._place
        event = _Event(events, data)
        # It fails only for a socket that was just closed, which lets in nobody.
        _LIBC.epoll_ctl(epoll, _MODIFY, descriptor, ctypes.byref(event))


def doors() -> dict[str, Door]:
    """Find the listening sockets of this process that ZeroMQ waits for."""
    found: dict[str, Door] = {}
    for entry in Path("/proc/self/fdinfo").glob("*"):
        with contextlib.suppress(OSError):
            for line in entry.read_text(encoding="ascii").splitlines():
                if line.startswith("tfd:"):
                    words = line.split()
                    descriptor, data = int(words[1]), int(words[words.index("data:") + 1], 16)
                    events = int(words[words.index("events:") + 1], 16)
                    # Not one that ZeroMQ is just about to wait for: it would undo what is set here.
                    endpoint = _listens(descriptor) if events & (select.EPOLLIN | select.EPOLLONESHOT) else ""
                    if endpoint:
                        found[endpoint] = Door(int(entry.name), descriptor, data)
    return found


def _listens(descriptor: int) -> str:
    """Endpoint of a listening socket; empty for anything else."""
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(descriptor)) as found:
        if found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            return _endpoint(found.family, found.getsockname())
    return ""


def _endpoint(family: int, name: object) -> str:
    if family == socket.AF_UNIX:
        return f"ipc://{name}"
    assert isinstance(name, tuple)  # noqa: S101  # of tcp: address and port first
    host = plain_address(str(name[0]))
    return f"tcp://{f'[{host}]' if ':' in host else host}:{name[1]}"


def plain_address(text: str) -> str:
    """Write an address as all do: one of IPv4 that came through a socket of IPv6 as IPv4."""
    return text.removeprefix("::ffff:")


def has_descriptors(count: int) -> bool:
    """Whether this process may open so many more files and connections."""
    try:
        # The kernel gives out the lowest number that is free.
        lowest = os.memfd_create("")
    except OSError:
        return False
    os.close(lowest)
    return lowest + count < resource.getrlimit(resource.RLIMIT_NOFILE)[0]


class Peer:
    """A connection that came in, to be put out again, whoever uses its descriptor's number by then.

    Parameters
    ----------
    descriptor : int
        As ZeroMQ tells it.

    Attributes
    ----------
    address : str
        The other machine's; empty for ipc.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._inode = -1
        self.address = ""
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(descriptor)) as found:
            self._inode = os.fstat(found.fileno()).st_ino
            if found.family != socket.AF_UNIX:
                self.address = plain_address(str(found.getpeername()[0]))

    def is_there(self) -> bool:
        """Whether the descriptor still is this connection's."""
        try:
            return os.fstat(self._descriptor).st_ino == self._inode
        except OSError:
            return False

    def cut(self) -> None:
        """End the connection; ZeroMQ sees it as ended from the other side."""
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self._descriptor)) as found:
            if os.fstat(found.fileno()).st_ino == self._inode:
                found.shutdown(socket.SHUT_RDWR)
