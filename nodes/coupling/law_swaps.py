"""Swaps of the active law, between two ticks or after a failure, with a receipt of each.

All of this runs on the loop's thread.
"""

from __future__ import annotations

from typing import Any

import msgspec

from messages import topics
from messages.types import Proxy, Receipt, Vector
from nodes.base.node import Node
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.coupling.swap_schedule import SwapSchedule
from nodes.parameters.store import ParameterError

_LONGEST_REASON = 4000  # [characters]


class LawSwaps:
    """Swaps of one coupling's active law.

    Attributes
    ----------
    failed_text : str
        Description of the law that failed and was replaced by the fallback; empty if none.
    """

    def __init__(self, node: Node, renderer: Renderer, schedule: SwapSchedule) -> None:
        self._node, self._renderer, self._schedule = node, renderer, schedule
        self.failed_text = ""

    def swap(
        self, seq: int, law: ActiveLaw, ramp: int, action: str, reason: str
    ) -> dict[str, Any]:
        """Make a law active from tick `seq` on, over a `ramp` [ticks]. Return the reply.

        Raises ParameterError, and changes nothing, if the law fails.
        """
        old = self._renderer.law
        force_step = self._renderer.swap(law, ramp)
        self.failed_text = self.failed_text if law.name == "fallback" else ""
        self._publish_receipt(seq, action, old, law, reason, force_step, ramp)
        return {
            "seq": seq,
            "action": action,
            "from": old.name,
            "to": law.name,
            "force_step_n": force_step,
            "ramp": ramp,
            "revision": self._node.counters.revision,
        }

    def follow_schedule(self, seq: int) -> None:
        """Make the swaps that are due at tick `seq`; one that fails is reported, and left out."""
        node = self._node
        while swap := self._schedule.pop_due(seq):
            try:
                self.swap(seq, swap.law, swap.ramp, "switch", "schedule")
            except ParameterError as error:
                node.events.emit_each(
                    "refused",
                    f"scheduled swap at tick {seq}: {error}; the running law continues",
                )
            else:
                current = node.store.current
                node.store.accept(msgspec.structs.replace(current, law=swap.law.name))

    def fall_back(self, proxy: Proxy, reason: str, due: int = 0) -> Vector:
        """Replace a law that failed by the fallback. Return the force of the same tick [N]."""
        failed = self._renderer.law
        if not failed.watched and due:
            reason = f"a law that was fading out {reason}"
        force = self._renderer.fall_back(proxy, due)
        self.failed_text = failed.text
        self._publish_receipt(proxy.seq, "fallback", failed, self._renderer.law, reason)
        text = f"law {failed.name!r} at tick {proxy.seq}: {reason}; the fallback renders now"
        self._node.events.emit_each("fallback", text, {"tick": proxy.seq})
        return force

    def _publish_receipt(
        self,
        seq: int,
        action: str,
        old: ActiveLaw,
        new: ActiveLaw,
        reason: str,
        force_step: float = 0.0,
        ramp: int = 0,
    ) -> None:
        node = self._node
        node.counters.revision += 1
        receipt = Receipt(
            seq=seq,
            stamp=node.clock.now(),
            action=action,
            reason=reason[:_LONGEST_REASON],
            revision=node.counters.revision,
            before=old.text,
            after=new.text,
            force_step=force_step,
            ramp=ramp,
        )
        node.events.publish(node.setup.topic(topics.RECEIPT), receipt)
