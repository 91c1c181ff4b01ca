"""The setup of each node of a launch: graph, endpoints, cores and priorities."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from messages import topics
from nodes.base import realtime
from nodes.base.node import Node
from nodes.base.node_kinds import drives, is_hop, load, node_kinds
from nodes.base.setup import Scheduling, Setup
from nodes.compiled.choose_tick import SCARCE, choose
from nodes.launcher.chain_endpoints import Endpoints
from nodes.launcher.chain_load import estimated, spread
from nodes.launcher.external_child import ARRIVAL_TIMEOUT, LEASE
from nodes.launcher.launch_spec import Launch, NodeSpec, unusual
from nodes.launcher.node_graph import NodeGraph, full_names
from nodes.launcher.plants import has_plant, known_effects, known_peak, known_plant
from nodes.parameters.store import ParameterError

FORWARDER = "forwarder"  # kind of node to which other users may subscribe
# priority of the chain in real time: above what a desktop runs, below the kernel's own threads
FIFO = 50


def chains_of(launch: Launch) -> list[str]:
    """Return the namespaces of a launch's chains: of its drivers."""
    factories = node_kinds()
    drivers = [
        name
        for name, spec in launch.nodes.items()
        if drives(load(factories[spec.kind]))
    ]
    return list(dict.fromkeys(name.rpartition("/")[0] for name in drivers))


def _cores(launch: Launch) -> dict[str, int | None]:
    """Choose each chain's processor; chains share one if that leaves none for the rest.

    Chains that one processor does not carry, by what their ticks cost here before, are spread over
    all.
    """
    factories = node_kinds()
    # Not the namespaces of listeners alone, which would take the last processors that are left for
    # them.
    loops = (
        name.rpartition("/")[0]
        for name, spec in launch.nodes.items()
        if is_hop(load(factories[spec.kind]))
    )
    chains = dict.fromkeys([*chains_of(launch), *loops])
    available = sorted(os.sched_getaffinity(0))
    cpu = launch.run.cpu
    if cpu == "any" or (cpu == "auto" and len(available) < 2):
        return dict.fromkeys(chains)
    if cpu == "auto":
        first = realtime.quietest_processor()
        others = [other for other in available if other != first]
        if len(others) >= len(chains) or launch.run.pace == "lockstep":
            cores = (
                [first, *others]
                if len(others) >= len(chains)
                else [first] * len(chains)
            )
            return dict(zip(chains, cores, strict=False))
        return dict(
            spread(chains, [first, *others], estimated(launch, chains, launch.run.tick))
        )
    if cpu in available:
        return dict.fromkeys(chains, cpu)
    raise ParameterError(
        f"{cpu}, available: {', '.join(map(str, available))}",
        path=f"{launch.scenario}.run.cpu",
    )


def _rank(namespace: str, cores: Mapping[str, int | None]) -> int:
    """Return how many chains on the same processor take precedence over this one.

    With equal priorities, the drivers of all chains would run before every environment and
    coupling, and on an overloaded processor no tick would be answered. So chains take precedence as
    a whole, and only the last ones lose ticks.
    """
    together = [chain for chain, core in cores.items() if core == cores.get(namespace)]
    return together.index(namespace) if namespace in together else 0


def _scheduling(
    launch: Launch, kind: type[Node], namespace: str, cores: dict[str, int | None]
) -> Scheduling:
    run = launch.run
    core = cores.get(namespace)
    available = sorted(os.sched_getaffinity(0))
    others = [cpu for cpu in available if cpu not in cores.values()] or available
    hops = [hop for hop, topic in enumerate(topics.LOOP) if topic in kind.publishes]
    if not hops:
        return Scheduling(cpus=others)
    # In saturated lockstep the kernel throttles FIFO tasks, which shows as gaps of 50 ms; without
    # pinning they gain nothing.
    automatic = FIFO if launch.run.pace == "realtime" and run.cpu != "any" else 0
    fifo = automatic if run.fifo == "auto" else run.fifo
    fifo = max(1, fifo - len(topics.LOOP) * _rank(namespace, cores)) if fifo else 0
    # A sender must not delay its receiver: coupling above environment, and the driver, which waits
    # for both, on top.
    urgency = fifo + (hops[0] or len(topics.LOOP)) if fifo else 0
    return (
        Scheduling(fifo=urgency)
        if core is None
        else Scheduling(cpus=[core], aside=others, fifo=urgency)
    )


def kernel_modules(launch: Launch) -> list[str]:
    """Return the compiled ticks that nodes on this machine could use."""
    factories = node_kinds()
    here = [
        (load(factories[spec.kind]), spec.parameters)
        for spec in launch.nodes.values()
        if not spec.host
    ]
    return sorted(
        {module for kind, parameters in here for module in kind.modules(parameters)}
    )


def settle_tick(
    launch: Launch, say: Callable[[str], None], warn: Callable[[str], None]
) -> Launch:
    """Decide which tick the nodes use, and compile it if requested."""
    scarce = launch.run.pace == "realtime" and launch.run.rate >= SCARCE
    tick = choose(launch.run.tick, kernel_modules(launch), say, scarce, warn)
    return msgspec.structs.replace(
        launch, run=msgspec.structs.replace(launch.run, tick=tick)
    )


def free_name(launch: Launch, name: str) -> str:
    """Return the wanted name for an additional node, numbered if it is in use."""
    return next(
        free
        for free in (name, *(f"{name}_{i}" for i in range(2, 100)))
        if free not in launch.nodes
    )


def with_forwarder(launch: Launch) -> Launch:
    """Add the process at which strangers may listen, if a node has an open port."""
    ports = {
        name: spec.open_port for name, spec in launch.nodes.items() if spec.open_port
    }
    if not ports:
        return launch
    spec = NodeSpec(
        kind=FORWARDER,
        parameters={"ports": ports},
        required=False,
        respawn=True,
        respawn_max=-1,
    )
    return msgspec.structs.replace(
        launch, nodes={**launch.nodes, free_name(launch, FORWARDER): spec}
    )


def wire(
    launch: Launch, run: str, run_dir: Path, manifest: dict[str, str]
) -> dict[str, Setup]:
    """Return the setup of each node of a launch."""
    graph = NodeGraph(launch)
    endpoints = Endpoints(launch, run_dir)
    cores = _cores(launch)
    setups = {}
    for name in launch.nodes:
        _check_respawn(launch, name, graph.classes[name])
        setup = _setup(launch, name, graph, endpoints, cores)
        everything = graph.classes[name].listens_to == ("*",)
        setups[name] = msgspec.structs.replace(
            setup,
            run=run,
            run_dir=str(run_dir),
            manifest=(
                chain_manifest(launch, manifest, name.rpartition("/")[0])
                if everything
                else {}
            ),
        )
        graph.classes[name].check(setups[name])
    return endpoints.with_reach(setups)


def _check_respawn(launch: Launch, name: str, kind: type[Node]) -> None:
    spec = launch.nodes[name]
    listens_only = kind.listens_to == ("*",)
    if (
        spec.respawn
        and launch.run.pace == "lockstep"
        and kind.publishes
        and not listens_only
    ):
        raise ParameterError(
            "a respawned node has lost its state, so a"
            " lockstep run would no longer be deterministic; use pace realtime",
            path=f"{launch.scenario}.nodes.{name}.respawn",
        )


def _sources(name: str, graph: NodeGraph, endpoints: Endpoints) -> dict[str, str]:
    """Return the endpoint of each topic that a node follows, or of each node that it hears."""
    topics_ = graph.classes[name].listens_to
    if topics_ == ("*",):
        return {
            other: endpoints.of(other, name, apart=True)
            for other in graph.heard_by(name)
        }
    return {
        topic: endpoints.of(graph.source_of(name, topic), name, apart=False)
        for topic in topics_
    }


def _setup(
    launch: Launch,
    name: str,
    graph: NodeGraph,
    endpoints: Endpoints,
    cores: dict[str, int | None],
) -> Setup:
    """Return the setup of a node, but for its run and manifest."""
    spec = launch.nodes[name]
    kind = graph.classes[name]
    run = launch.run
    namespace = name.rpartition("/")[0]
    is_by_hand = bool(spec.by_hand or spec.host)
    any_by_hand = any(other.by_hand or other.host for other in launch.nodes.values())
    virtual = all(
        one.is_virtual(launch.nodes[other].parameters, other)
        for other, one in graph.classes.items()
        if drives(one)
    )
    knows_plant = has_plant(kind)
    return Setup(
        run="",
        run_dir="",
        name=name,
        kind=spec.kind,
        factory=node_kinds()[spec.kind],
        period=run.period,
        pace=run.pace,
        apply=run.apply,
        tick="compiled" if run.tick == "compiled" and kind.kernel_module else "plain",
        axes=launch.axes.get(namespace) or run.axes,
        virtual=virtual,
        ticks=run.ticks,
        publish=endpoints.publish(name),
        listen=endpoints.listen(name),
        control=endpoints.control(name),
        by_hand=is_by_hand,
        lease=LEASE if is_by_hand else 0.0,
        patience=ARRIVAL_TIMEOUT if any_by_hand else 10.0,
        sources=_sources(name, graph, endpoints),
        remap=spec.remap,
        listeners=graph.listeners(name),
        scheduling=_scheduling(launch, kind, namespace, cores),
        parameters=spec.parameters,
        plant=known_plant(launch, namespace) if knows_plant else {},
        effects=known_effects(launch, namespace) if knows_plant else [],
        peak_force=known_peak(launch, namespace) if knows_plant else None,
        watch=os.path.abspath(spec.watch) if spec.watch else "",
        manifest={},
    )


def manifest_of(
    launch: Launch, run: str, wall_minus_monotonic: float
) -> dict[str, str]:
    """Return the manifest of a run for its recordings."""
    uname = os.uname()
    factories = node_kinds()
    publishes = {
        name: list(full_names(name, load(factories[spec.kind]).publishes))
        for name, spec in launch.nodes.items()
    }
    return {
        "run": run,
        "scenario": launch.scenario,
        "summary": launch.summary,
        "arguments": msgspec.json.encode(launch.arguments).decode(),
        "rate_hz": repr(launch.run.rate),
        "pace": launch.run.pace,
        "apply": launch.run.apply,
        "tick": launch.run.tick,
        "duration_s": repr(launch.run.duration),
        "axes": ",".join(launch.run.axes),
        "wall_minus_monotonic_s": repr(wall_minus_monotonic),
        "host": uname.nodename,
        "kernel": f"{uname.sysname} {uname.release} {uname.machine}",
        "launch_file": launch.text,
        "publishes": msgspec.json.encode(publishes).decode(),
        "nodes": (
            msgspec.json.encode(
                {name: spec.parameters for name, spec in launch.nodes.items()}
            ).decode()
        ),
    }


def chain_manifest(
    launch: Launch, manifest: dict[str, str], namespace: str
) -> dict[str, str]:
    """Describe one chain of a run as if it were alone, in a launch file without arguments."""
    if not namespace:
        return manifest
    inside = {
        name.removeprefix(f"{namespace}/"): spec
        for name, spec in launch.nodes.items()
        if name.startswith(f"{namespace}/")
    }
    chain = msgspec.structs.replace(
        launch,
        run=msgspec.structs.replace(
            launch.run, axes=launch.axes.get(namespace) or launch.run.axes
        ),
        nodes=inside,
        arguments={},
    )
    nodes = {node: unusual(spec) for node, spec in inside.items()}
    text = {"summary": launch.summary, "run": unusual(chain.run), "nodes": nodes}
    # JSON is YAML
    chain = msgspec.structs.replace(
        chain, text=msgspec.json.format(msgspec.json.encode(text)).decode()
    )
    return manifest_of(
        chain, manifest["run"], float(manifest["wall_minus_monotonic_s"])
    )
