"""The node kind ``ros2``: a chain on a ROS 2 graph at a reduced rate, and its input.

It only subscribes: the loop does not wait for it, and a slow or missing graph does not affect the
loop. Input from the graph reaches the driver as any client's request does: a force through
`nodes.driver.external` and all limits behind it, a target through the hand of a virtual device, at
its limited speed. Both expire if not renewed within the age that the driver states.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Annotated, Any, ClassVar

import msgspec

from messages import topics
from messages.codec import Decoder, MessageRefusedError
from messages.errors import HapticError
from messages.transport.context import new_context
from messages.transport.requests import Connection
from messages.types import Force, NodeStatus, Receipt
from nodes.base.node import Node
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.client.launches import roles
from nodes.driver.pointer import PointerWriter, awaited_pointer
from nodes.launcher.runs import RunInfo, read_chain
from nodes.parameters.store import ParameterError, convert
from nodes.recording.ros2_messages import (
    FRAME,
    POSE,
    TEXT,
    WRENCH,
    RosMessages,
    frames_of,
    ros2_messages,
    ros2_topics,
    stamp_offset,
    standing_messages,
)
from nodes.ros2.chain_control import ChainControl
from nodes.ros2.graph import Graph
from nodes.ros2.ros_library import Backend, choose, join

MAX_FRAMES = 16  # foreign frames that are reported
SELDOM = 1.0  # period of publishing law, wall and parameters, which rarely change [s]
READING = 2.0  # period of reading parameters that others may have changed [s]
ASKING = 0.5  # longest wait for a node's answer [s]


class Ros2Parameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of a ros2 node.

    rate: Publishing rate of the newest messages [Hz].
    prefix: Prefix of the topics, after the namespace of the chain: ``/left/haptic/device/pose``.
    frame: Frame of positions and forces; input from the graph in any other named frame is refused.
    backend: ``rclpy``, ``cyclonedds``, or ``auto``: rclpy if it can be imported.
    control: Whether the graph may set parameters of driver, environment and coupling, and switch
        the law, as far as each node grants it; it may always read them. Needs rclpy.
    wrench: Topic of a WrenchStamped, after the namespace of the chain, whose force is added to the
        law's; empty for none. The driver must allow it (``external``).
    target: Topic of a PoseStamped, after that namespace too, to which the hand of a virtual device
        is pulled; empty for none. It needs a ``pointer``.
    age_limit: Largest difference between stamp and arrival of an accepted message [s]; a stamp of 0
        is not checked.
    """

    rate: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 100.0
    prefix: Annotated[
        str, msgspec.Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$")
    ] = "haptic"
    frame: str = FRAME
    backend: Backend = "auto"
    control: bool = False
    wrench: Annotated[str, msgspec.Meta(pattern=r"^(/[A-Za-z_][A-Za-z0-9_/]*)?$")] = ""
    target: Annotated[str, msgspec.Meta(pattern=r"^(/[A-Za-z_][A-Za-z0-9_/]*)?$")] = ""
    age_limit: Annotated[float, msgspec.Meta(gt=0.0, le=60.0)] = 0.1


class Ros2(Node):
    """Publishes a chain on a ROS 2 graph."""

    Parameters: ClassVar[type[msgspec.Struct]] = Ros2Parameters
    listens_to: ClassVar[tuple[str, ...]] = ("*",)
    queue: ClassVar[int] = 1000  # only the newest are published

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check that a library is installed, and that a deterministic run has no outside input."""
        parameters: Ros2Parameters = convert(
            setup.parameters, Ros2Parameters, setup.name
        )
        choose(parameters.backend, setup.name)
        for name in ("wrench", "target"):
            if getattr(parameters, name) and setup.pace == "lockstep":
                raise ParameterError(
                    "lockstep is deterministic, so nothing from outside is"
                    f" taken; use pace realtime, or leave {name} out",
                    path=f"{setup.name}.{name}",
                )

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._simulated = setup.pace == "lockstep"
        self._offset = stamp_offset(setup.manifest)
        self._law, self._seldom, self._reading = "", 0.0, 0.0
        self._control: ChainControl | None = None
        self._changed = False  # whether the parameters shown are not yet published
        self._decoders: dict[str, Decoder[Any]] = {
            topic: Decoder(kind) for topic, kind in topics.LOOP.items()
        }
        self._lines: dict[str, Connection] = {}
        self._roles: dict[str, str] = {}
        self._hand: PointerWriter | None = None
        # kinds and frames of messages that were refused and reported
        self._foreign: set[tuple[str, str]] = set()
        # newest force from the graph that is not yet sent to the driver
        self._wrench: Any = None

    def configure(self) -> None:
        """Join the graph, which may take seconds, before the loop starts."""
        parameters: Ros2Parameters = self.store.current
        namespace = self._namespace = f"/{self.setup.namespace}".rstrip("/")
        backend = choose(parameters.backend, self.setup.name)
        self._graph: Graph = join(
            backend, self.setup.name.rpartition("/")[2], namespace or "/"
        )
        self._make = RosMessages(self._graph.look_up, parameters.frame)
        self._prefix = f"{namespace}/{parameters.prefix}"
        self._open_publishers()
        self.events.log(
            f"on the ROS 2 graph through {backend}: {self._prefix}/device/pose,"
            f" {parameters.rate:g} Hz"
        )

    def _open_publishers(self) -> None:
        """Create all publishers, which others then discover before there is anything to hear.

        A type whose package is not installed is left out, and reported.
        """
        self._publishers: dict[str, Callable[[Any], None]] = {}
        missing: dict[str, list[str]] = {}
        for topic, (kind, latched) in ros2_topics(
            self.setup.namespace, self.store.current.prefix, self._simulated
        ).items():
            try:
                self._graph.look_up(kind)
                self._publishers[topic] = self._graph.publisher(topic, kind, latched)
            except ImportError as error:
                missing.setdefault(str(error), []).append(topic)
        for why, left_out in missing.items():
            self.events.emit_each("ros2", f"{', '.join(left_out)}: left out: {why}")

    def _publish(self, topic: str, build: Callable[[], Any]) -> None:
        publish = self._publishers.get(topic)
        if publish is not None:
            publish(build())

    def _newest(self, newest: dict[str, bytes]) -> None:
        """Publish the newest message of each topic of the loop."""
        chain = self.setup.namespace
        prefix = self.store.current.prefix
        seldom = self._seldom <= time.monotonic()
        said = False
        for topic, payload in newest.items():
            try:
                message = self._decoders[topic].decode(payload)
            except MessageRefusedError as error:
                self.events.refuse(str(error))
                continue
            at = round(message.stamp * 1e9) + self._offset
            if isinstance(message, Receipt):
                self._reading = 0.0
            if isinstance(message, Force):
                changed = message.law != self._law
                self._law = message.law
                said = seldom or changed
            for name, kind, build in ros2_messages(
                self._make, message, at, chain, prefix, self._simulated
            ):
                if said or kind != TEXT:
                    self._publish(name, build)
        if seldom and self._control is not None:
            self._seldom = time.monotonic() + SELDOM
            self._publish_standing(self._control.trees)

    def _publish_standing(self, parameters: dict[str, Any]) -> None:
        # Named as in a recording, which has parameters and launch file beside its manifest.
        manifest = dict(self.setup.manifest)
        manifest.pop("nodes", None)
        about = {"launch_file": manifest.pop("launch_file", ""), "manifest": manifest}
        chain = self.setup.namespace
        prefix = self.store.current.prefix
        for topic, kind, build in standing_messages(
            self._make, parameters, about, chain, prefix
        ):
            # Kilobytes, for which late subscribers need no second time.
            if kind != TEXT or self._changed:
                self._publish(topic, build)
        self._changed = False

    def _read_parameters(self, control: ChainControl) -> None:
        """Show on the graph what the chain's parameters are now."""
        self._reading = time.monotonic() + READING
        if control.refresh():
            self._seldom, self._changed = 0.0, True
            try:
                control.offer_laws()
            except ImportError as error:
                self.events.emit("ros2", f"no services switch the law: {error}")

    def _ask(self, role: str, op: str, **args: object) -> Any:
        if role not in self._lines:
            self._lines[role] = Connection(
                self._context, self._run.nodes[self._roles.get(role, role)].control
            )
        return self._lines[role].call(op, ASKING, **args)

    def _fresh(self, name: str, stamp: Any) -> bool:
        """Return whether a message is recent enough, and report if not."""
        age = (
            time.time() - (stamp.sec + stamp.nanosec * 1e-9)
            if stamp.sec or stamp.nanosec
            else 0.0
        )
        if abs(age) <= self.store.current.age_limit:
            return True
        limit = self.store.current.age_limit
        self.events.emit(
            "stale",
            f"{name}: stamped {age:.3f} s before it came, limit {limit:g} s; refused",
            {"age_s": age, "limit_s": limit},
        )
        return False

    def _is_ours(self, name: str, frame: str) -> bool:
        """Return whether a message is in our frame or names none; report a foreign one once.

        A force in a tool's frame would push in some other direction. tf is not used, because its
        transform may be outdated. The frames of device and proxy are not turned: a force may name
        them.
        """
        # tf 1 used a leading slash.
        own = self.store.current.frame.removeprefix("/")
        named = frame.removeprefix("/")
        ours = named in ("", own) or (
            name == "wrench" and named in frames_of(own, self.setup.namespace)
        )
        if (
            not ours
            and (name, frame) not in self._foreign
            and len(self._foreign) < MAX_FRAMES
        ):
            self._foreign.add((name, frame))
            self.events.emit_each(
                "frame",
                f"{name}: in frame {frame[:100]!r}, expected {self.store.current.frame!r} or none;"
                " refused. Transform it into our frame before it is published",
            )
        return ours

    def _take_wrench(self, message: Any) -> None:
        self.received += 1
        if self._is_ours("wrench", message.header.frame_id):
            self._wrench = message

    def _push(self) -> None:
        """Send the newest force to the driver; one request per message would hold up the graph."""
        message = self._wrench
        self._wrench = None
        if message is not None and self._fresh("wrench", message.header.stamp):
            force = message.wrench.force
            # A sensor has components along all axes; discard those that the scene does not compute.
            computed = [
                AXIS_INDEX[axis] for axis in self._run.nodes[self._roles["driver"]].axes
            ]
            parts = [
                part if i in computed else 0.0
                for i, part in enumerate((force.x, force.y, force.z))
            ]
            try:
                self._ask("driver", "external", force=parts)
            except HapticError as error:
                self.events.emit("wrench", str(error))

    def _take_target(self, message: Any) -> None:
        point = message.pose.position
        self.received += 1
        if not self._is_ours("target", message.header.frame_id):
            return
        if self._hand is not None and self._fresh("target", message.header.stamp):
            try:
                self._hand.write((point.x, point.y, point.z))
            except ValueError as error:
                self.events.emit("target", str(error))

    def _listen(self, parameters: Ros2Parameters) -> None:
        """Subscribe to the enabled topics, and serve the nodes' parameters."""
        driver = self._roles.get("driver", "")
        if parameters.wrench:
            if not driver or not self._run.nodes[driver].parameters.get("external"):
                raise ParameterError(
                    "the driver takes no force from outside; allow it"
                    " with external: {peak: 1.0, age: 0.1}",
                    path=f"{self.setup.name}.wrench",
                )
            self._graph.listen(
                self._namespace + parameters.wrench, WRENCH, self._take_wrench
            )
        if parameters.target:
            no_hand = ParameterError(
                "no hand can be dragged; a sim_driver has one with device.hand and pointer: {}",
                path=f"{self.setup.name}.target",
            )
            if not driver:
                raise no_hand
            try:
                self._hand = PointerWriter(
                    awaited_pointer(self._run.nodes[driver], lambda: self.stopping)
                )
            except FileNotFoundError as error:
                raise no_hand from error
            self._graph.listen(
                self._namespace + parameters.target, POSE, self._take_target
            )
        refusal = (
            ""
            if parameters.control
            else f"{self.setup.name}: the graph may only read; control: true allows it in the"
            " launch file"
        )
        self._control = ChainControl(
            self._graph,
            self._run,
            self._roles,
            lambda node: self._ask(node, "param.dump"),
            refusal,
        )

    def loop(self) -> None:
        """Publish until stopped."""
        self.state = "running"
        parameters: Ros2Parameters = self.store.current
        names = {self.setup.topic(topic).encode(): topic for topic in topics.LOOP}
        self._context = new_context()
        try:
            self._run: RunInfo = read_chain(self.setup, lambda: self.stopping)
            self._roles = roles(self._run)
            # A set-up has the node's name with the namespace of its chain.
            for topic in (topics.status(one.name) for one in self._run.nodes.values()):
                names[topic.encode()] = topic
                self._decoders[topic] = Decoder(NodeStatus)
            names[self.setup.topic(topics.RECEIPT).encode()] = topics.RECEIPT
            self._decoders[topics.RECEIPT] = Decoder(Receipt)
            self._listen(parameters)
            self._serve(names, 1.0 / parameters.rate)
        finally:
            self._context.destroy(linger=0)

    def _serve(self, names: dict[bytes, str], period: float) -> None:
        newest: dict[str, bytes] = {}
        following = time.monotonic()
        inbox = self.inbox
        assert inbox is not None  # noqa: S101  # every subscribing kind has one
        while not self.stopping:
            left = following - time.monotonic()
            frames = inbox.receive(max(0, min(50, int(left * 1e3 + 1.0))))
            now = time.monotonic()
            due = now >= following
            # Before publishing, receive what waits, so that the newest is published; for a period
            # at most, because a fast loop in lockstep may send more than a busy machine receives.
            while frames is not None:
                if (topic := names.get(frames[0])) is not None:
                    newest[topic] = frames[1]
                is_late = time.monotonic() - now > period
                frames = inbox.receive(0) if due and not is_late else None
            if due:
                # Periods that were missed are skipped, never made up for.
                following = (
                    following + period if now < following + period else now + period
                )
                self._newest(newest)
                newest.clear()
                self._graph.take()
                self._push()
                if self._control is not None and self._reading <= now:
                    self._read_parameters(self._control)
                self.counters.ticks += 1
                self.between_ticks(0)

    def finish(self) -> None:
        """Leave the graph."""
        self._graph.close()
