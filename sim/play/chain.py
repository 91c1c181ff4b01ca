"""Play a chain of any launch file in one process, with its own nodes.

Driver, environment and coupling are built as in their processes, without sockets: the tick is that
of nodes/driver/tick.py in lockstep, with `ChainNodes` as its port. So every feature of the nodes is
available (shapes, moving bodies, pairs of devices, laws with code of their own, swaps, the driver's
safety), and no rule is repeated here. The nodes run interpreted; `sim.play.player` uses the
compiled loop of one axis instead where it gives the same bits.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from messages import topics
from messages.codec import Decoder
from messages.types import ZERO, DeviceState, Event, Force, Message, Proxy
from nodes.base.node import Node
from nodes.base.node_kinds import load
from nodes.coupling.node import Coupling
from nodes.driver.node import Driver
from nodes.driver.plain_tick import state_message
from nodes.driver.state import DriverState
from nodes.driver.tick import GOT, Port, make_ticks
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoEnvironment, load_world
from nodes.environment.meet import Numbers
from nodes.environment.node import Environment
from nodes.environment.shapes.scene import FeltRegion, Solid, new_memory, scene_table
from nodes.environment.shapes.touchable import Touchable
from nodes.environment.state import SHAPES
from nodes.environment.surfaces import parse_surface
from nodes.environment.touched_surface import TouchedSurface
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from sim.device.state import AxisState
from sim.play.chain_rows import Rows, parts_of_device
from sim.play.given import Given
from sim.play.hops import Hops, hops_of, setup_of
from sim.play.one_axis import PlannedSwap
from sim.play.trace import ChainTrace


@dataclass(frozen=True)
class Instead:
    """Replacements for parts of a launch file; None leaves a part unchanged."""

    law: CompiledLaw | None = None  # the law of tick 0
    swaps: Sequence[PlannedSwap] = ()  # swaps to further laws
    solids: Sequence[Solid] | None = None  # touched solids
    regions: Sequence[FeltRegion] | None = None  # regions without a surface
    world: MovingScene | None = None  # scene of moving bodies
    # Changes of the environment's parameters, each with its first tick.
    environment: Sequence[tuple[int, Mapping[str, Any]]] = ()

    @property
    def is_scenery(self) -> bool:
        """Whether the environment is replaced or changed."""
        return (
            self.solids is not None
            or self.regions is not None
            or self.world is not None
            or bool(self.environment)
        )


N = TypeVar("N", bound=Node)


def _made(launch: Launch, name: str, kind: type[N]) -> N:
    """Build a node of a class without output on standard error."""
    setup = setup_of(launch, name)
    node = load(setup.factory)(setup)
    if not isinstance(node, kind):
        raise ParameterError(
            f"kind {setup.kind} is no {kind.__name__}, which one process plays; launch it",
            path=name,
        )
    node.events.quiet = True
    return node


class ChainNodes:
    """The driver's port: passes messages from node to node in place of sockets."""

    def __init__(
        self, launch: Launch, hops: Hops, ticks: int, instead: Instead, given: Given
    ):
        self.driver = _made(launch, hops.driver, Driver)
        self.environment = _made(launch, hops.environment, Node)
        self.coupling = _made(launch, hops.coupling, Coupling)
        self.driver.configure()
        _begin_environment(self.environment, instead)
        self.coupling.configure()
        if instead.law is not None:
            swaps = [(swap.tick, swap.law, swap.ramp) for swap in instead.swaps]
            self.coupling.begin_with(instead.law, swaps)
        self.device = self.driver.device
        self.parts = parts_of_device(self.device)
        self.axes = tuple(self.driver.driving.axis[: self.driver.driving.axes])
        self._given = given.along(self.axes, ticks, launch.scenario)
        if self._given.any and list(self.parts) != [""]:
            raise ParameterError(
                "forces, targets and nudges are given to one virtual device, not"
                f" to a {self.driver.setup.kind}",
                path=hops.driver,
            )
        self._changes = sorted(instead.environment, key=lambda change: change[0])
        self._proxies, self._forces = Decoder(Proxy), Decoder(Force)
        self._state = DeviceState(seq=-1, stamp=0.0, position=ZERO)
        self.rows = Rows(self, ticks)

    # -- the port
    def read(self, s: DriverState, seq: int) -> bool:
        """Read the encoders, or the given path instead."""
        given = self._given
        for state in self.parts.get("", ()):
            self._disturb(state, seq)
        x, y, z = self.device.read_position(seq)
        place = [x, y, z]
        if given.nudged is not None:
            for i in self.axes:
                place[i] += float(given.nudged[seq, i, 2])
        s.place[:] = place if given.path is None else given.path[seq].tolist()
        s.target[:] = self.driver.target
        return True

    def _disturb(self, d: AxisState, seq: int) -> None:
        """Apply given forces, targets and nudges to an axis for the tick that begins."""
        given, i = self._given, d.axis
        if given.force is not None:
            d.push = float(given.force[seq, i])
        if given.target is not None:
            d.led, d.pull = 1, float(given.target[seq, i])
        if given.nudged is None:
            return
        d.x += float(given.nudged[seq, i, 0])
        d.v += float(given.nudged[seq, i, 1])

    def publish(self, s: DriverState, seq: int, stamp: float) -> None:
        """Pass the state of a tick to the environment."""
        self._state = state_message(s, seq, stamp)
        while self._changes and self._changes[0][0] <= seq:
            parameters = self._changes.pop(0)[1]
            node = self.environment
            changed = {**node.setup.parameters, **parameters}
            wanted = convert(changed, node.Parameters, node.setup.name)
            node.prepare(wanted)(seq)
            node.store.accept(wanted)

    def receive(self, s: DriverState, until: float) -> int:
        """Get the answers of environment and coupling."""
        del until
        state = self._state
        proxy = self._proxies.decode(answer(self.environment, state))
        force = self._forces.decode(answer(self.coupling, proxy))
        s.got_seq = force.seq
        s.got[:], s.got_normal[:], s.got_credit = (
            force.force,
            force.normal,
            force.credit,
        )
        self.rows.note(state, proxy, force)
        return GOT

    def write(self, s: DriverState, seq: int, offset: float) -> bool:
        """Pass a force to the device; the tick ends."""
        x, y, z = s.handed
        self.rows.forces[s.seq] = x, y, z
        self.device.write_force((x, y, z), seq, offset)
        return True

    def events(self) -> tuple[Event, ...]:
        """Return the events that the nodes published, in the order of ticks."""
        found = []
        for node in (self.driver, self.environment, self.coupling):
            prefix = topics.event(node.setup.name).encode()
            decoder = Decoder(Event)
            found += [
                decoder.decode(load_)
                for topic, load_ in node.events.outbox
                if topic == prefix
            ]
        return tuple(sorted(found, key=lambda event: event.seq))


def answer(node: Node, message: Message) -> bytes:
    """Return a node's answer to a message, as nodes/base/follow.py does."""
    counters = node.counters
    counters.seq = message.seq
    payload: bytes | None = node.respond(message)
    if payload is None:
        raise ParameterError(f"no answer to tick {message.seq}", path=node.setup.name)
    counters.answered = message.seq
    counters.ticks += 1
    return payload


def _begin_environment(node: Node, instead: Instead) -> None:
    """Build the environment, as the node does or from `instead`."""
    if isinstance(node, MujocoEnvironment):
        parameters = node.store.current
        setup = node.setup
        node.begin_with(
            load_world(parameters, setup.period, setup.name)
            if instead.world is None
            else instead.world
        )
        return
    node.configure()
    if (instead.solids, instead.regions) != (None, None) and isinstance(
        node, Environment
    ):
        where = f"{node.setup.name}.surface"
        surface = parse_surface(node.store.current.surface, where)
        radius = getattr(surface, "tool_radius", 0.0)
        solids, regions = instead.solids, instead.regions
        if isinstance(surface, Touchable):
            solids = surface.solids(where) if solids is None else solids
            regions = surface.regions(where) if regions is None else regions
        solids = solids or ()
        table = scene_table(solids, radius, node.setup.period, regions or ())
        numbers = Numbers(SHAPES, table, new_memory(len(solids)))
        node.begin_with(TouchedSurface.of(numbers, node.counters.met))


def play_chain(
    launch: Launch, namespace: str, ticks: int, instead: Instead, given: Given
) -> ChainTrace:
    """Play a chain of a launch file with its own nodes; bit-identical to a lockstep run.

    Parameters
    ----------
    launch : Launch
        The launch file, read.
    namespace : str
        Namespace of the chain; empty for a launch of one chain.
    ticks : int
        Length of the run.
    instead : Instead
        Replacements for parts of the launch file.
    given : Given
        Additional inputs of the chain.

    Returns
    -------
    ChainTrace
        Every tick.

    Raises
    ------
    ParameterError
        As a launch raises it, or if one process cannot play a node.
    """
    hops = hops_of(launch, namespace)
    wire = ChainNodes(launch, hops, ticks, instead, given)
    s = wire.driver.driving
    s.until, s.most = ticks, ticks
    port = Port(
        clock=lambda _: 0.0,
        sleep_until=lambda _, deadline: deadline,
        read=wire.read,
        write=wire.write,
        publish=wire.publish,
        receive=wire.receive,
        aside=lambda _: None,
        called=lambda _: False,
    )
    run: Callable[[Any], int] = make_ticks(port)[0]
    while s.seq < ticks:
        run(s)
        wire.driver.report_notes()
    return wire.rows.trace()
