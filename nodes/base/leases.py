"""What a node puts back by itself when somebody who changed it is heard of no more: a lease is a change that must be kept up.

Who takes over a running launch (pushes its device, tries laws) takes a lease at the nodes that he changes, and renews it. When
his process is gone, however it went, the lease runs out, and the node does what was agreed.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any

from nodes.parameters.store import ParameterError

LONGEST = 60.0  # longest time without a renewal that may be asked for [s]
MOST = 16  # leases of one node at a time


class Leases:
    """The leases of one node; everything runs on its control thread."""

    def __init__(self, node: str) -> None:
        self._node = node
        self._held: dict[str, tuple[float, float, str, dict[str, Any]]] = {}

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Offer taking, renewing and giving back."""
        return {"lease.take": self._take, "lease.renew": self._renew, "lease.end": self._end}

    def _take(self, name: str, seconds: float, then: str, args: Mapping[str, Any]) -> dict[str, Any]:
        if not (isinstance(seconds, int | float) and 0.0 < seconds <= LONGEST):
            raise ParameterError(f"{self._node}: lease {name!r} of {seconds!r} s, expected more than 0, at most {LONGEST:g} s")
        if name in self._held:
            agreed = self._held[name][1]
            raise ParameterError(
                f"{self._node}: lease {name!r} is held by somebody else; it ends when they are done, or {agreed:g} s after "
                "they were heard of last: try again then"
            )
        if len(self._held) >= MOST:
            raise ParameterError(f"{self._node}: {MOST} leases are held already; end one first")
        self._held[name] = (time.monotonic() + seconds, seconds, then, dict(args))
        return {"held": True}

    def _renew(self, names: list[str]) -> dict[str, Any]:
        """Begin anew with the time that was agreed; tells which have run out."""
        gone = [name for name in names if name not in self._held]
        for name in names:
            if name in self._held:
                _, seconds, then, args = self._held[name]
                self._held[name] = (time.monotonic() + seconds, seconds, then, args)
        return {"run_out": gone}

    def _end(self, names: list[str]) -> dict[str, Any]:
        """Give leases back: nothing will be put back any more."""
        return {"run_out": [name for name in names if self._held.pop(name, None) is None]}

    def run_out(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Take out what has run out, the oldest first: name, operation and its arguments."""
        now = time.monotonic()
        over = sorted((until, name) for name, (until, *_) in self._held.items() if until <= now)
        return [(name, *self._held.pop(name)[2:]) for _, name in over]
