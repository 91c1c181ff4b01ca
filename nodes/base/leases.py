"""What a node puts back by itself when somebody who changed it is heard of no more: a lease is a change that must be kept up.

Who takes over a running launch (pushes its device, tries laws) takes a lease at the nodes that he changes, and renews it. When
his process is gone, however it went, the lease runs out, and the node does what was agreed. A lease is that of its `holder`:
to another one it has run out. Whoever names none speaks for whoever holds it.
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
        self._held: dict[str, tuple[float, float, str, str, dict[str, Any]]] = {}

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Offer taking, renewing and giving back."""
        return {"lease.take": self._take, "lease.renew": self._renew, "lease.end": self._end}

    def _take(self, name: str, seconds: float, then: str, args: Mapping[str, Any], holder: str = "") -> dict[str, Any]:
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
        self._held[name] = (time.monotonic() + seconds, seconds, holder, then, dict(args))
        return {"held": True}

    def _is_held(self, name: str, holder: str) -> bool:
        return name in self._held and holder in ("", self._held[name][2])

    def _renew(self, names: list[str], holder: str = "") -> dict[str, Any]:
        """Begin anew with the time that was agreed; tells which have run out."""
        for name in names:
            if self._is_held(name, holder):
                _, seconds, who, then, args = self._held[name]
                self._held[name] = (time.monotonic() + seconds, seconds, who, then, args)
        return {"run_out": [name for name in names if not self._is_held(name, holder)]}

    def _end(self, names: list[str], holder: str = "") -> dict[str, Any]:
        """Give leases back: nothing will be put back any more."""
        gone = [name for name in names if not self._is_held(name, holder)]
        for name in set(names) - set(gone):
            del self._held[name]
        return {"run_out": gone}

    def run_out(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Take out what has run out, the oldest first: name, operation and its arguments."""
        now = time.monotonic()
        over = sorted((until, name) for name, (until, *_) in self._held.items() if until <= now)
        return [(name, *self._held.pop(name)[3:]) for _, name in over]
