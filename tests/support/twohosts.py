"""Two machines for a test: network namespaces, a cable with delay, jitter, loss, clocks.

The cable is a pair of TUN devices whose packets this process forwards, late or not at all, so it
needs neither iproute2 nor the kernel's netem. No packet can leave: the namespaces have no other
route. Needs the right to create namespaces.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import heapq
import os
import random
import select
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

CLONE_NEWNET = 0x40000000
CLONE_NEWTIME = 0x00000080
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCGIFFLAGS, _SIOCSIFFLAGS, _SIOCSIFMTU = (
    0x8916,
    0x891C,
    0x8913,
    0x8914,
    0x8922,
)
_UP_AND_RUNNING = 0x41


class NoRightsError(RuntimeError):
    """The machine does not allow network namespaces or TUN devices."""


def _address(text: str) -> bytes:
    return struct.pack("<HH4s8x", socket.AF_INET, 0, socket.inet_aton(text))


class Host:
    """A network namespace with one cable, and its own monotonic clock.

    Parameters
    ----------
    address : str
        Its address in 10.77.0.0/24.
    ahead : float
        How far its monotonic clock is to be ahead of this process's, in whole seconds.

    Attributes
    ----------
    tun : int
        Descriptor of the cable's end.
    ahead : float
        How far its clock is ahead: 0 where this machine's kernel has no time namespaces.
    """

    def __init__(self, address: str, ahead: float = 0.0) -> None:
        self.address = address
        self.ahead = ahead
        self.tun = -1
        self._namespace = -1
        self._error: Exception | None = None
        # A namespace belongs to a thread: this one makes it and keeps nothing else.
        maker = threading.Thread(target=self._make)
        maker.start()
        maker.join()
        if self._error is not None:
            raise NoRightsError(
                f"a network namespace with a TUN device: {self._error}"
            ) from self._error

    def _make(self) -> None:
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            if libc.unshare(CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
            self._namespace = os.open(
                f"/proc/self/task/{threading.get_native_id()}/ns/net", os.O_RDONLY
            )
            self.tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(
                self.tun,
                _TUNSETIFF,
                struct.pack("16sH22x", b"cable", _IFF_TUN | _IFF_NO_PI),
            )
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:

                def set_(request: int, name: bytes, value: bytes) -> None:
                    fcntl.ioctl(control, request, struct.pack("16s24s", name, value))

                set_(_SIOCSIFADDR, b"cable", _address(self.address))
                set_(_SIOCSIFNETMASK, b"cable", _address("255.255.255.0"))
                for name in (b"cable", b"lo"):
                    set_(_SIOCSIFFLAGS, name, struct.pack("H", _UP_AND_RUNNING))
            if self.ahead:
                self.ahead = self.ahead if self._has_clock(libc) else 0.0
        except OSError as error:
            self._error = error

    def _has_clock(self, libc: ctypes.CDLL) -> bool:
        """Whether processes of this host get the requested clock; not every kernel supports it."""
        with contextlib.suppress(OSError):
            self._set_clock_of_children(libc)
        words = [
            sys.executable,
            "-S",
            "-E",
            "-c",
            "import time; print(time.monotonic())",
        ]
        told = subprocess.run(words, capture_output=True, check=True, text=True).stdout
        return float(told) > time.monotonic() + self.ahead / 2.0

    def popen(
        self,
        words: Sequence[str],
        environment: Mapping[str, str],
        folder: Path,
        out: IO[bytes],
        err: IO[bytes],
    ) -> subprocess.Popen[bytes]:
        """Start a process on this host.

        Parameters
        ----------
        words : sequence of str
            Command line.
        environment : mapping of str to str
            All its variables.
        folder : Path
            Its working directory.
        out, err : binary file
            Where it writes.

        Returns
        -------
        subprocess.Popen
            The process.
        """
        started: list[subprocess.Popen[bytes]] = []

        def start() -> None:
            libc = ctypes.CDLL(None, use_errno=True)
            if libc.setns(self._namespace, CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")
            if self.ahead:
                self._set_clock_of_children(libc)
            started.append(
                subprocess.Popen(
                    list(words),
                    env=dict(environment),
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                    process_group=0,
                )
            )

        starter = threading.Thread(target=start)
        starter.start()
        starter.join()
        return started[0]

    def _set_clock_of_children(self, libc: ctypes.CDLL) -> None:
        """Set the clock of processes that this thread starts; the thread keeps its own."""
        if libc.unshare(CLONE_NEWTIME):
            raise OSError(ctypes.get_errno(), "unshare")
        Path(f"/proc/{threading.get_native_id()}/timens_offsets").write_text(
            f"monotonic {int(self.ahead)} 0\n", encoding="ascii"
        )

    def close(self) -> None:
        """Release the namespace when its last process has ended."""
        for descriptor in (self.tun, self._namespace):
            if descriptor >= 0:
                os.close(descriptor)


class Cable(threading.Thread):
    """Forwards packets between the hosts.

    Parameters
    ----------
    hosts : tuple of Host
        Its two ends.
    delay : float
        Of each packet one way [s].
    jitter : float
        Largest further delay, uniform [s]; packets may overtake each other.
    loss : float
        Share of packets that are lost.

    Attributes
    ----------
    carried, lost : int
        Packets so far.
    cut : bool
        Whether nothing comes through at the moment.
    """

    def __init__(
        self,
        hosts: tuple[Host, Host],
        delay: float = 0.0,
        jitter: float = 0.0,
        loss: float = 0.0,
    ) -> None:
        super().__init__(daemon=True, name="cable")
        self._ends = (hosts[0].tun, hosts[1].tun)
        self.delay, self.jitter, self.loss = delay, jitter, loss
        self.carried = self.lost = 0
        self.cut = False
        self._random = random.Random(7)  # noqa: S311  # repeatable losses
        self._closing = threading.Event()

    def run(self) -> None:
        """Forward packets until closed."""
        under_way: list[tuple[float, int, int, bytes]] = []
        number = 0
        while not self._closing.is_set():
            wait = (
                min(0.1, max(0.0, under_way[0][0] - time.monotonic()))
                if under_way
                else 0.1
            )
            ready, _, _ = select.select(self._ends, (), (), wait)
            for end in ready:
                packet = os.read(end, 65536)
                if self.cut or self._random.random() < self.loss:
                    self.lost += 1
                    continue
                number += 1
                due = (
                    time.monotonic() + self.delay + self.jitter * self._random.random()
                )
                heapq.heappush(
                    under_way, (due, number, self._ends[end == self._ends[0]], packet)
                )
            while under_way and under_way[0][0] <= time.monotonic():
                _, _, sink, packet = heapq.heappop(under_way)
                # A full device drops packets, as a full switch does.
                with contextlib.suppress(BlockingIOError):
                    os.write(sink, packet)
                    self.carried += 1

    def close(self) -> None:
        """Stop forwarding."""
        self._closing.set()
        self.join()


@contextlib.contextmanager
def two_hosts(
    delay: float = 0.0, jitter: float = 0.0, loss: float = 0.0, ahead: float = 0.0
) -> Iterator[tuple[Host, Host, Cable]]:
    """Create two hosts and a cable for a with block.

    Parameters
    ----------
    delay, jitter, loss : float
        See `Cable`.
    ahead : float
        How far the second one's monotonic clock is ahead of the first one's [s].

    Yields
    ------
    tuple of Host, Host, Cable
        10.77.0.1, 10.77.0.2 and what joins them; `NoRightsError` is raised where this machine does
        not allow it.
    """
    with contextlib.ExitStack() as stack:
        hosts = []
        for address, by in (("10.77.0.1", 0.0), ("10.77.0.2", ahead)):
            hosts.append(Host(address, by))
            stack.callback(hosts[-1].close)
        cable = Cable((hosts[0], hosts[1]), delay, jitter, loss)
        cable.start()
        stack.callback(cable.close)
        yield hosts[0], hosts[1], cable
