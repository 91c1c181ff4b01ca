"""The three nodes of a chain, their setup, and why one process cannot play some."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from messages import topics
from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Setup
from nodes.driver.node import Driver
from nodes.launcher.launch_spec import Launch
from nodes.launcher.plants import has_plant, known_effects, known_peak, known_plant
from nodes.parameters.interface_words import interface
from nodes.parameters.store import ParameterError

HOPS = (topics.DEVICE_STATE, topics.PROXY, topics.FORCE)
_WHAT = ("drives a device", "says what it meets", "renders forces")


# Parameters of a coupling without a stability check: the played device may differ from the launched
# one, or oscillate.
UNJUDGED: Mapping[str, Any] = {"plant": None, "stability": "off"}


@dataclass(frozen=True)
class Hops:
    """Names of the three nodes of a chain."""

    driver: str
    environment: str
    coupling: str


def hops_of(launch: Launch, namespace: str) -> Hops:
    """Return the nodes of a chain that one process plays.

    Raises
    ------
    ParameterError
        With the node, why one process cannot play it, and the remedy.
    """
    kinds = node_kinds()
    classes = {
        name: load(kinds[spec.kind])
        for name, spec in launch.nodes.items()
        if name.rpartition("/")[0] == namespace
    }
    found = []
    for topic, what in zip(HOPS, _WHAT, strict=True):
        those = [name for name, kind in classes.items() if topic in kind.publishes]
        if len(those) != 1:
            where = f"{launch.scenario}.nodes" + (
                f" of chain {namespace}" if namespace else ""
            )
            raise ParameterError(
                f"{len(those)} nodes publish {topic}; one process plays a chain in which"
                f" exactly one {what}",
                path=where,
            )
        found += those
    driver, environment, coupling = found
    if not issubclass(classes[driver], Driver) or not classes[driver].is_virtual(
        launch.nodes[driver].parameters, driver
    ):
        raise ParameterError(
            f"{launch.nodes[driver].kind} drives a real device, which one process does"
            " not play; name a virtual one (kind: sim_driver), or launch it",
            path=driver,
        )
    if topics.PARTNER in classes[environment].listens_to:
        raise ParameterError(
            "hears a partner over a network in real time, which one process does"
            f" not play; {interface.get().study('hands')} plays two hands and a network, or"
            " launch it",
            path=environment,
        )
    for name in (environment, coupling):
        if classes[name].respond is Node.respond:
            raise ParameterError(
                f"kind {launch.nodes[name].kind} answers ticks in a loop of its own, which"
                " one process does not play; launch it",
                path=name,
            )
    return Hops(driver, environment, coupling)


def setup_of(launch: Launch, name: str) -> Setup:
    """Return the setup of a played node: in lockstep, without connections."""
    spec = launch.nodes[name]
    namespace = name.rpartition("/")[0]
    factory = node_kinds()[spec.kind]
    judges = has_plant(load(factory))
    return Setup(
        run=launch.scenario,
        run_dir="",
        name=name,
        kind=spec.kind,
        factory=factory,
        period=launch.run.period,
        pace="lockstep",
        apply=launch.run.apply,
        axes=launch.axes.get(namespace) or launch.run.axes,
        virtual=True,
        ticks=launch.run.ticks,
        publish="",
        control="",
        sources={},
        parameters=spec.parameters,
        plant=known_plant(launch, namespace) if judges else {},
        effects=known_effects(launch, namespace) if judges else [],
        peak_force=known_peak(launch, namespace) if judges else None,
    )


def check_chain(launch: Launch, hops: Hops) -> None:
    """Check the nodes of a chain, as a launch does before its start."""
    for name in (hops.driver, hops.environment, hops.coupling):
        setup = setup_of(launch, name)
        load(setup.factory).check(setup)
