"""A launch file played in one process: the same scene, law, swaps and conventions, thousands of times faster.

This is what holds the project together: a lockstep run through four processes and the same launch
file played here give the same bits, for every scenario (tests/sim/play/test_lockstep.py).
"""

from dataclasses import dataclass
from typing import Any

import msgspec

from nodes.base.setup import AXIS_INDEX
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import lower
from nodes.environment.node import EnvironmentParameters
from nodes.environment.surfaces import parse_surface
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from nodes.stability.plant import Plant
from sim.device.driver import NO_END, SimDriverParameters, along
from sim.play.one_axis import Given, PlannedSwap, Scene, SceneSurface, Trace, run


@dataclass(frozen=True)
class LaunchedScene:
    """A launch file as the one-process loop takes it."""

    scene: Scene  # device, surface, period and conventions
    law: CompiledLaw  # law of tick 0
    swaps: tuple[PlannedSwap, ...]  # scheduled swaps
    ticks: int  # ticks of the run
    memory: int  # deflections that the coupling remembers
    axis: int  # the one axis that the scene computes: 0, 1 or 2

    @property
    def last_law(self) -> CompiledLaw:
        """The law after all swaps."""
        return self.swaps[-1].law if self.swaps else self.law

    @property
    def plant(self) -> Plant:
        """Device and hand as the linear loop sees them: what moves, its delay with that of the loop."""
        body = self.scene.device
        return Plant(
            self.scene.period,
            body.moving_mass,
            body.moving_damping,
            body.delay + float(self.scene.next_tick),
            body.grip,
        )

    def play(
        self, ticks: int | None = None, interpreted: bool = False, given: Given | None = None
    ) -> Trace:
        """Play the scene, for as many ticks as the launch file says when none are given; see `sim.play.one_axis.run`."""
        return run(
            self.scene, self.law, ticks or self.ticks, self.swaps, self.memory, interpreted, given
        )


def parameters_of(launch: Launch, kind: str, target: type) -> tuple[str, Any]:
    """Find the one node of a kind in a launch: its name and its parameters."""
    found = [(name, spec) for name, spec in launch.nodes.items() if spec.kind == kind]
    if len(found) != 1:
        raise ParameterError(
            f"{launch.scenario}.nodes: {len(found)} nodes of kind {kind}; one process plays"
            " exactly one"
        )
    name, spec = found[0]
    return name, convert(spec.parameters, target, name)


def from_launch(launch: Launch) -> LaunchedScene:
    """Translate a launch file; ParameterError where it has several axes, other surfaces or swaps of a law with its own code."""
    if len(launch.run.axes) != 1:
        raise ParameterError(
            f"{launch.scenario}.run.axes: {launch.run.axes}; one process plays one axis here;"
            " sim.play.chain plays several"
        )
    axis = launch.run.axes[0]
    period = launch.run.period
    _, driver = parameters_of(launch, "sim_driver", SimDriverParameters)
    device = along(driver.device, launch.run.axes)[0]
    if device.mass_by_position:
        raise ParameterError(
            f"{launch.scenario}: device.mass_by_position: one process plays one mass here; launch"
            " it, or take sim.play.chain"
        )
    if any(spec.kind == "world" for spec in launch.nodes.values()):
        raise ParameterError(
            f"{launch.scenario}.nodes: a body of kind world; one process plays surfaces here;"
            " sim.play.chain plays it"
        )
    name, environment = parameters_of(launch, "environment", EnvironmentParameters)
    coupling_name, coupling = parameters_of(launch, "coupling", CouplingParameters)
    surface = parse_surface(environment.surface, f"{name}.surface")
    reduced = surface.on_axis(axis)
    if reduced is None:
        raise ParameterError(
            f"{name}.surface.kind: {surface.kind!r} has no form on one axis (on_axis), so one"
            " process cannot play it; launch it"
        )
    safety = driver.safety
    limits = lower(safety, DeviceLimits(), period)
    if safety.workspace is not None:
        # Of one axis only the first counts.
        safety = msgspec.structs.replace(
            safety, workspace=(safety.workspace[AXIS_INDEX[axis]], *NO_END[1:])
        )
    book = LawBook(coupling_name, period)

    def law(name: str) -> CompiledLaw:
        compiled = book.compile(coupling, name)
        if compiled.evaluate is not None and coupling.schedule:
            raise ParameterError(
                f"{coupling_name}.laws.{name}: has code of its own, which one process cannot swap;"
                " launch it"
            )
        return compiled

    swaps = sorted(coupling.schedule, key=lambda swap: swap.at)
    return LaunchedScene(
        scene=Scene(
            device=device,
            surface=SceneSurface(reduced.shape, reduced.position, reduced.side),
            period=period,
            raw=coupling.history == "position",
            clamp=coupling.clamp,
            peak=limits.peak,
            slew=limits.slew,
            workspace=None if safety.workspace is None else safety.workspace[0],
            next_tick=launch.run.apply == "next_tick",
            passivity=driver.passivity,
            ease=round(coupling.ease / period),
            safety=safety,
        ),
        law=law(coupling.law),
        swaps=tuple(
            PlannedSwap(round(swap.at / period), law(swap.law), swap.ramp) for swap in swaps
        ),
        ticks=launch.run.ticks or round(10.0 / period),
        memory=coupling.memory,
        axis=AXIS_INDEX[axis],
    )
