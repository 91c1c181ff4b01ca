"""Leases: changes that a node reverts when the client that made them stops renewing.

A client that borrows a running launch (pushes its device, tests laws) takes a lease at each node
that it changes, renews it, and makes its changes under it. A client that is killed or delayed
renews nothing: the lease expires and the node performs the agreed operation. From then on the node
refuses changes of that client, which may wake up later and not know. A lease belongs to its
`holder`: for another client it has expired. A request without a holder acts for the present holder.
Leases survive the node's process, as its parameters do.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from nodes.base.status_report import write_whole
from nodes.parameters.store import ParameterError

MAX_LEASE = 60.0  # longest time without a renewal of a lease [s]
MAX_LEASES = 16  # leases of one node at a time


class _Lease(msgspec.Struct):
    """One lease.

    name: Its name.
    seconds: Longest time without a renewal [s].
    holder: Client that owns it.
    then, args: Operation that reverts the changes, and its arguments.
    until: Time of expiry, on this process's monotonic clock [s].
    """

    name: str
    seconds: float
    holder: str
    then: str
    args: dict[str, Any]
    until: float = 0.0

    def renew(self) -> None:
        self.until = time.monotonic() + self.seconds


class Leases:
    """Leases of one node, saved in `path` for a successor; for its control thread only."""

    def __init__(
        self,
        node: str,
        perform: Callable[[str, Mapping[str, Any]], Any],
        path: Path | None = None,
    ) -> None:
        self._node = node
        self._perform = perform
        self._path = path
        self._held: dict[str, _Lease] = {}
        self._read()

    def _read(self) -> None:
        """Continue the leases of the previous process, whose changes still apply."""
        if self._path is None or not self._path.exists():
            return
        for lease in msgspec.json.decode(self._path.read_bytes(), type=list[_Lease]):
            lease.renew()
            self._held[lease.name] = lease

    def save(self) -> None:
        """Save the leases for the next process."""
        if self._path is not None:
            write_whole(self._path, list(self._held.values()))

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the operations on leases, by name."""
        return {
            "lease.take": self._take,
            "lease.renew": self._renew,
            "lease.change": self._change,
            "lease.end": self._end,
        }

    def _take(
        self,
        name: str,
        seconds: float,
        then: str,
        args: Mapping[str, Any],
        holder: str = "",
    ) -> dict[str, Any]:
        if not (isinstance(seconds, int | float) and 0.0 < seconds <= MAX_LEASE):
            raise ParameterError(
                f"lease {name!r} of {seconds!r} s, expected more than 0, at most {MAX_LEASE:g} s",
                path=self._node,
            )
        if name in self._held:
            agreed = self._held[name].seconds
            raise ParameterError(
                f"lease {name!r} is held by another client; it ends when "
                f"released, or {agreed:g} s after its last renewal: try again then",
                path=self._node,
            )
        if len(self._held) >= MAX_LEASES:
            raise ParameterError(
                f"{MAX_LEASES} leases are held already; end one first", path=self._node
            )
        lease = _Lease(name, float(seconds), holder, then, dict(args))
        lease.renew()
        self._held[name] = lease
        try:
            self.save()
        except OSError:
            del self._held[name]
            raise
        return {"held": True}

    def _is_held(self, name: str, holder: str) -> bool:
        return name in self._held and holder in ("", self._held[name].holder)

    def _renew(self, names: list[str], holder: str = "") -> dict[str, Any]:
        """Restart the time of leases; return those that have expired."""
        for name in names:
            if self._is_held(name, holder):
                self._held[name].renew()
        return {"run_out": [name for name in names if not self._is_held(name, holder)]}

    def _change(
        self, name: str, operation: str, args: Mapping[str, Any], holder: str = ""
    ) -> Any:
        """Perform an operation under a lease; refuse it if the lease has expired."""
        if not self._is_held(name, holder):
            raise ParameterError(
                f"{operation} refused: its lease {name!r} has run out, because"
                " nothing renewed it in time; the node has reverted what was changed under it."
                " Start again",
                path=self._node,
            )
        return self._perform(operation, args)

    def _end(self, names: list[str], holder: str = "") -> dict[str, Any]:
        """End leases without reverting anything; return those that had expired."""
        gone = [name for name in names if not self._is_held(name, holder)]
        for name in set(names) - set(gone):
            del self._held[name]
        self.save()
        return {"run_out": gone}

    def run_out(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Remove expired leases; return name, operation and arguments of each, oldest first.

        The caller saves once it has reverted the changes: a process that ends before that leaves
        them to the next one.
        """
        now = time.monotonic()
        over = sorted(
            (lease for lease in self._held.values() if lease.until <= now),
            key=lambda lease: lease.until,
        )
        for lease in over:
            del self._held[lease.name]
        return [(lease.name, lease.then, lease.args) for lease in over]
