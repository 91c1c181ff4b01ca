"""The environment node: for each device position, where the proxy is.

It holds no state but the surface, so a lost or repeated position costs nothing. It forwards position and measured delay, so
that the coupling needs one input only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from messages import topics
from messages.codec import Decoder, encode
from messages.types import DeviceState, Proxy
from nodes.base.follow import follow
from nodes.base.node import Node
from nodes.base.setup import Setup
from nodes.environment.surfaces import parse_surface

if TYPE_CHECKING:
    from nodes.tick.answering import CompiledTicks
    from nodes.tick.library import Kernel


class EnvironmentParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the environment.

    Attributes
    ----------
    surface : dict
        ``kind`` and parameters of the surface: see nodes/environment/surfaces.py.
    """

    surface: dict[str, Any] = msgspec.field(default_factory=lambda: {"kind": "free"})


class Environment(Node):
    """Answers device states with proxies."""

    Parameters: ClassVar[type[msgspec.Struct]] = EnvironmentParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.PROXY,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    answers: ClassVar[bool] = True
    kernel_module: ClassVar[str] = "nodes.tick.kernels.environment"

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Make the surface before anything is started.

        Parameters
        ----------
        setup : Setup
            The node as it would be started.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        parse_surface(setup.parameters.get("surface", {"kind": "free"}), f"{setup.name}.surface")

    def configure(self) -> None:
        """Build the surface."""
        self.surface = parse_surface(self.store.current.surface, f"{self.setup.name}.surface")
        self._meet = self.surface.meeting()

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare another surface.

        Parameters
        ----------
        parameters : EnvironmentParameters
            The parameters after the change.

        Returns
        -------
        callable
            Puts it in place between two ticks.
        """
        surface = parse_surface(parameters.surface, f"{self.setup.name}.surface")
        meet = surface.meeting()

        def apply(seq: int) -> dict[str, Any]:
            self.surface, self._meet = surface, meet
            return {"seq": seq, "surface": parameters.surface}

        return apply

    def compiled_ticks(self, kernel: Kernel) -> CompiledTicks:
        """Make the compiled ticks.

        Parameters
        ----------
        kernel : callable
            What does them.

        Returns
        -------
        CompiledTicks
            Of this node.
        """
        from nodes.environment.compiled_tick import EnvironmentTicks

        return EnvironmentTicks(self, kernel)

    def loop(self) -> None:
        """Answer until stopped."""
        self.state = "running"
        assert self.inbox is not None  # noqa: S101  # every kind that listens has one
        take = follow(self, self.inbox, Decoder(DeviceState), topics.DEVICE_STATE)
        topic, send, simulated = topics.PROXY.encode(), self.publisher.send, self._simulated
        send_again = self.publisher.send_hop
        while not self.stopping:
            state = take()
            if state is not None and state.seq == self.answered:
                # Asked again (lockstep, after a stall or a lost answer): the same answer, to who waits for it only.
                send_again(topic, self.answer)
            # In a fault the position is an old one; who follows bridges the gap. In lockstep somebody waits for an answer.
            elif state is not None and (simulated or state.safety != "fault"):
                position = state.position
                proxy, normal, distance, contact = self._meet(position)
                message = Proxy(
                    seq=state.seq,
                    stamp=state.stamp if simulated else self.now(),
                    position=position,
                    proxy=proxy,
                    normal=normal,
                    distance=distance,
                    contact=contact,
                    delay=state.delay,
                )
                self.answered, self.answer = state.seq, (payload := encode(message))
                send(topic, payload)
                self.ticks += 1
            if self.called:
                self.between_ticks(self.seq + 1)
