"""A chain of a launch file as inputs of the one-axis loop: device, surface, laws, swaps.

`NotOneAxisError` is raised if the chain is more than that (several axes, shapes, moving bodies, two
devices, a swapped law with code of its own); `sim.play.player` then plays its nodes.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nodes.base.setup import AXIS_INDEX
from nodes.coupling.force_fields import NoField
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import SafetyParameters, lower
from nodes.environment.node import EnvironmentParameters
from nodes.environment.surfaces import Surface, numbers_of, parse_surface
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.device.driver import SimDriverParameters, along
from sim.play.hops import Hops, hops_of
from sim.play.one_axis import PlannedSwap, Trace
from sim.play.one_axis_inputs import Scene, SceneSurface
from sim.play.trace import ChainTrace


class LawsOfRun(NamedTuple):
    """Laws of a coupling."""

    names: tuple[str, ...]  # names of all laws, in the order in which they are rendered
    law: CompiledLaw  # law of tick 0
    swaps: tuple[PlannedSwap, ...]  # scheduled swaps

    @property
    def all(self) -> list[CompiledLaw]:
        """All laws, in the order in which they are rendered."""
        return [self.law, *(swap.law for swap in self.swaps)]


class NotOneAxisError(ParameterError):
    """The loop of one axis cannot play this chain."""


@dataclass(frozen=True)
class LaunchedScene:
    """A chain of a launch file as inputs of the loop of one axis."""

    scene: Scene  # device, surface, period and conventions
    law: CompiledLaw  # law of tick 0
    swaps: tuple[PlannedSwap, ...]  # scheduled swaps
    ticks: int  # length of the run
    memory: int  # length of the coupling's history [ticks]
    axis: int  # the computed axis: 0, 1 or 2
    names: tuple[str, ...]  # names of all laws, in the order in which they are rendered
    surface: Surface  # touched surface, in space
    # Driver's safety; if it intervenes beyond lowering forces, the nodes play the chain.
    safety: SafetyParameters

    @property
    def laws(self) -> list[CompiledLaw]:
        """All laws, in the order in which they are rendered."""
        return [self.law, *(swap.law for swap in self.swaps)]

    def rendering(
        self, law: CompiledLaw, swaps: tuple[PlannedSwap, ...]
    ) -> "LaunchedScene":
        """Return the scene with other laws."""
        names = ("given", *(f"given_{n}" for n in range(1, 1 + len(swaps))))
        return replace(self, law=law, swaps=swaps, names=names)

    @property
    def last_law(self) -> CompiledLaw:
        """The law after all swaps."""
        return self.swaps[-1].law if self.swaps else self.law

    @property
    def plant(self) -> Plant:
        """Device and hand as the linear loop has them: moving mass, and total delay."""
        body = self.scene.device
        return Plant(
            self.scene.period,
            body.moving_mass,
            body.moving_damping,
            body.delay + float(self.scene.next_tick),
            body.grip,
        )

    def in_space(self, trace: Trace) -> ChainTrace:
        """Convert the trace of the loop of one axis to that of a chain."""
        ticks = len(trace.position)
        measured = self._along(trace.measured)
        proxy, normal, contact = self._met(measured)
        rendered = np.zeros(ticks, dtype=np.intp)
        for swap in self.swaps:
            rendered[swap.tick :] += 1
        final = np.zeros((2, 3))
        final[:, self.axis] = trace.final
        return ChainTrace(
            period=trace.period,
            axes=(self.axis,),
            position=self._along(trace.position),
            velocity=self._along(trace.velocity),
            measured=measured,
            deflection=self._along(trace.deflection),
            proxy=proxy,
            normal=normal,
            contact=contact,
            force=self._along(trace.force),
            law=tuple(self.names[i] for i in rendered.tolist()),
            final=final,
        )

    def _along(self, values: Array) -> Array:
        spread = np.zeros((len(values), 3))
        spread[:, self.axis] = values
        return spread

    def _met(self, measured: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return proxy [m], normal and contact at each tick, by the environment's rules."""
        proxy = measured.copy()
        normal = np.zeros(measured.shape)
        kind = self.scene.surface.kind
        contact = np.full(len(measured), kind == "anchor")
        numbers = numbers_of(self.surface, self.scene.period)
        if kind == "anchor" and numbers is not None:
            proxy[:] = numbers.table[:3]
        elif kind == "plane":
            place = self.scene.surface.position
            side = self.scene.surface.normal
            i = self.axis
            contact = (measured[:, i] - place) * side < 0.0
            proxy[contact, i] = place
            normal[:, i] = side
        return proxy, normal, contact


def from_launch(launch: Launch, namespace: str = "") -> LaunchedScene:
    """Convert a chain of a launch file to inputs of the loop of one axis.

    Parameters
    ----------
    launch : Launch
        The launch file, read.
    namespace : str
        Namespace of the chain; empty for a launch of one chain.

    Raises
    ------
    NotOneAxisError
        If the chain is more than one rigid device on one axis at a surface.
    ParameterError
        As a launch raises it.
    """
    hops = hops_of(launch, namespace)
    axes = launch.axes.get(namespace) or launch.run.axes
    _refuse_more(launch, hops, list(axes))
    axis = axes[0]
    period = launch.run.period
    driver: SimDriverParameters = convert(
        launch.nodes[hops.driver].parameters, SimDriverParameters, hops.driver
    )
    environment: EnvironmentParameters = convert(
        launch.nodes[hops.environment].parameters,
        EnvironmentParameters,
        hops.environment,
    )
    coupling: CouplingParameters = convert(
        launch.nodes[hops.coupling].parameters, CouplingParameters, hops.coupling
    )
    if not isinstance(coupling.field, NoField):
        raise NotOneAxisError("a force field", path=f"{hops.coupling}.field")
    device = along(driver.device, axes)[0]
    if device.mass_by_position:
        raise NotOneAxisError(
            "not one mass", path=f"{hops.driver}.device.mass_by_position"
        )
    surface = parse_surface(environment.surface, f"{hops.environment}.surface")
    reduced = surface.on_axis(axis)
    if reduced is None:
        raise NotOneAxisError(
            f"{surface.kind!r} has no form on one axis (on_axis)",
            path=f"{hops.environment}.surface.kind",
        )
    laws = laws_of(launch, hops)
    limits = lower(driver.safety, DeviceLimits(), period)
    return LaunchedScene(
        scene=Scene(
            device=device,
            surface=SceneSurface(reduced.shape, reduced.position, reduced.side),
            period=period,
            raw=coupling.history == "position",
            clamp=coupling.clamp,
            peak=limits.peak,
            slew=limits.slew,
            workspace=driver.safety.workspace
            and driver.safety.workspace[AXIS_INDEX[axis]],
            next_tick=launch.run.apply == "next_tick",
            passivity=driver.passivity,
            ease=round(coupling.ease / period),
        ),
        law=laws.law,
        swaps=laws.swaps,
        ticks=launch.run.ticks or round(10.0 / period),
        memory=coupling.memory,
        axis=AXIS_INDEX[axis],
        names=laws.names,
        surface=surface,
        safety=driver.safety,
    )


def laws_of(launch: Launch, hops: Hops) -> LawsOfRun:
    """Return the compiled laws of a chain's coupling."""
    coupling: CouplingParameters = convert(
        launch.nodes[hops.coupling].parameters, CouplingParameters, hops.coupling
    )
    book = LawBook(hops.coupling, launch.run.period)
    period = launch.run.period
    swaps = sorted(coupling.schedule, key=lambda swap: swap.at)
    names = (coupling.law, *(swap.law for swap in swaps))
    first, *later = (book.compile(coupling, name) for name in names)
    planned = tuple(
        PlannedSwap(round(swap.at / period), law, swap.ramp)
        for swap, law in zip(swaps, later, strict=True)
    )
    return LawsOfRun(names, first, planned)


def _refuse_more(launch: Launch, hops: Hops, axes: list[str]) -> None:
    """Raise NotOneAxisError for a chain that the loop of one axis cannot play."""
    if len(axes) != 1:
        raise NotOneAxisError(
            f"{axes}, not one axis", path=f"{launch.scenario}.run.axes"
        )
    for name, kind in ((hops.driver, "sim_driver"), (hops.environment, "environment")):
        if launch.nodes[name].kind != kind:
            raise NotOneAxisError(f"{launch.nodes[name].kind}, not {kind}", path=name)
    if launch.nodes[hops.coupling].kind != "coupling":
        raise NotOneAxisError(
            f"{launch.nodes[hops.coupling].kind}, not coupling", path=hops.coupling
        )


def parameters_of(launch: Launch, kind: str, target: type) -> tuple[str, Any]:
    """Return name and parameters of the only node of a kind in a launch."""
    found = [(name, spec) for name, spec in launch.nodes.items() if spec.kind == kind]
    if len(found) != 1:
        raise ParameterError(
            f"{len(found)} nodes of kind {kind}, expected exactly one",
            path=f"{launch.scenario}.nodes",
        )
    name, spec = found[0]
    return name, convert(spec.parameters, target, name)
