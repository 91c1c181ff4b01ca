"""Records of a played chain: positions, contacts, forces, and other moving things."""

from typing import Protocol

import numpy as np

from messages.types import DeviceState, Event, Force, Proxy, Vector
from nodes.base.node import Node
from nodes.coupling.node import Coupling
from nodes.driver.device import Device
from nodes.driver.node import Driver
from nodes.driver.paired.paired_device import PairedDevice
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoEnvironment
from sim.arrays import Array
from sim.device.driver import SimDevice
from sim.device.state import AxisState
from sim.play.trace import BodyTrace, ChainTrace


class PlayedNodes(Protocol):
    """The nodes of a played chain."""

    driver: Driver
    environment: Node
    coupling: Coupling
    device: Device
    parts: dict[str, list[AxisState]]  # virtual devices, by name
    axes: tuple[int, ...]

    def events(self) -> tuple[Event, ...]:
        """Return the events that the nodes published."""
        ...


def parts_of_device(device: Device) -> dict[str, list[AxisState]]:
    """Return the virtual devices of a device by name: one without a name, or two."""
    if isinstance(device, SimDevice):
        return {"": [part.state for part in device.parts]}
    if isinstance(device, PairedDevice):
        both = {"first": device.first, "second": device.second}
        return {
            name: [part.state for part in one.parts]
            for name, one in both.items()
            if isinstance(one, SimDevice)
        }
    return {}


class Rows:
    """Records of a run, row by row."""

    def __init__(self, wire: PlayedNodes, ticks: int) -> None:
        self._wire = wire
        self.positions, self.velocities, self.measured, self.forces = (
            np.zeros((ticks, 3)) for _ in range(4)
        )
        self.deflections, self.proxies, self.normals = (
            np.zeros((ticks, 3)) for _ in range(3)
        )
        self.contacts, self.laws = np.zeros(ticks, dtype=np.bool_), list[str]()
        self.pair = {name: np.zeros((ticks, 3)) for name in wire.parts if name}
        self._world: MovingScene | None = None
        self._moving: dict[str, int] = {}
        if isinstance(wire.environment, MujocoEnvironment):
            self._world = wire.environment.world
            self._moving = moving_bodies(self._world)
        self.bodies = {
            name: (np.zeros((ticks, 3)), np.zeros((ticks, 4))) for name in self._moving
        }

    def note(self, state: DeviceState, proxy: Proxy, force: Force) -> None:
        """Record a tick, from its messages."""
        wire, k = self._wire, state.seq
        self.measured[k], self.proxies[k], self.normals[k] = (
            state.position,
            proxy.proxy,
            proxy.normal,
        )
        self.contacts[k] = proxy.contact
        self.laws.append(force.law)
        renderer = wire.coupling.rendering
        for i, history in zip(renderer.axes, renderer.histories, strict=True):
            self.deflections[k, i] = history.values[history.head]
        self.positions[k], self.velocities[k] = self._motion(state.position)
        for name, positions in self.pair.items():
            for d in wire.parts[name]:
                positions[k, d.axis] = d.x
        if self._world is not None:
            data = self._world.data
            for name, body in self._moving.items():
                places, turns = self.bodies[name]
                places[k], turns[k] = data.xpos[body], data.xquat[body]

    def _motion(self, measured: Vector) -> Array:
        """Return true position [m] and velocity [m/s]; of a pair, the difference."""
        found = np.zeros((2, 3))
        signs = (1.0, -1.0)
        if len(self._wire.parts) != 1:
            found[0] = measured
        for sign, (name, parts) in zip(signs, self._wire.parts.items(), strict=False):
            for d in parts:
                found[1, d.axis] += sign * d.v
                if not name:
                    found[0, d.axis] = d.x
        return found

    def trace(self) -> ChainTrace:
        """Return the records as a trace."""
        wire = self._wire
        s = self._wire.driver.driving
        bodies = {name: BodyTrace(positions) for name, positions in self.pair.items()}
        bodies |= {name: BodyTrace(*poses) for name, poses in self.bodies.items()}
        return ChainTrace(
            period=s.period,
            axes=wire.axes,
            position=self.positions,
            velocity=self.velocities,
            measured=self.measured,
            deflection=self.deflections,
            proxy=self.proxies,
            normal=self.normals,
            contact=self.contacts,
            force=self.forces,
            law=tuple(self.laws),
            final=self._motion(wire.device.read_position(len(self.positions))),
            bodies=bodies,
            events=wire.events(),
        )


def moving_bodies(world: MovingScene) -> dict[str, int]:
    """Return the movable bodies of a scene by name; an unnamed body has its number as name."""
    model = world.model
    return {
        model.body(i).name or f"body_{i}": i
        for i in range(1, model.nbody)
        if int(model.body_weldid[i]) != 0
    }
