"""From a launch to one setup per node: endpoints, who listens to whom, cores and priorities."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import msgspec

from messages import topics
from messages.transport.endpoints import is_remote
from messages.transport.keys import KeyRefusedError, identity, key_of
from nodes.base import realtime
from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Scheduling, Setup
from nodes.compiled.choose_tick import SCARCE, choose
from nodes.launcher.chain_load import estimated, spread
from nodes.launcher.external_child import ARRIVAL_TIMEOUT, LEASE
from nodes.launcher.launch_spec import Launch, NodeSpec, unusual
from nodes.launcher.plants import has_plant, known_peak, known_plant
from nodes.parameters.refusals import choices
from nodes.parameters.store import ParameterError, convert

FORWARDER = "forwarder"  # the kind of node at which strangers may listen
# priority of the chain in real time: above what a desktop runs, below the kernel's own threads
FIFO = 50


def chains_of(launch: Launch) -> list[str]:
    """List the namespaces of a launch's chains: of the nodes that publish a device's state."""
    factories = node_kinds()
    drives = [
        name
        for name, spec in launch.nodes.items()
        if topics.DEVICE_STATE in load(factories[spec.kind]).publishes
    ]
    return list(dict.fromkeys(name.rpartition("/")[0] for name in drives))


def is_hop(kind: type[Node]) -> bool:
    """Whether a node of this kind is one of the loop, and not a listener."""
    return any(topic in kind.publishes for topic in topics.LOOP)


def _cores(launch: Launch) -> dict[str, int | None]:
    """Choose each chain's processor, once for all nodes; chains share one where that leaves none for the rest.

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
            cores = [first, *others] if len(others) >= len(chains) else [first] * len(chains)
            return dict(zip(chains, cores, strict=False))
        return dict(spread(chains, [first, *others], estimated(launch, chains, launch.run.tick)))
    if cpu in available:
        return dict.fromkeys(chains, cpu)
    raise ParameterError(
        f"{launch.scenario}.run.cpu: {cpu}, available: {', '.join(map(str, available))}"
    )


def _rank(namespace: str, cores: Mapping[str, int | None]) -> int:
    """Return how many chains on the same processor go before this one.

    Were they equal, the drivers of all chains would go before every environment and coupling: on a
    processor with too many chains nobody would be answered at all. So each chain goes before the
    next as a whole, and only the last ones lose ticks.
    """
    together = [chain for chain, core in cores.items() if core == cores.get(namespace)]
    return together.index(namespace) if namespace in together else 0


def _scheduling(
    launch: Launch, kind: type[Node], namespace: str, cores: dict[str, int | None]
) -> Scheduling:
    run, core = launch.run, cores.get(namespace)
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
    # Who has sent must not hold up who has received: coupling above environment, and the driver,
    # which waits for both, on top.
    urgency = fifo + (hops[0] or len(topics.LOOP)) if fifo else 0
    return (
        Scheduling(fifo=urgency)
        if core is None
        else Scheduling(cpus=[core], aside=others, fifo=urgency)
    )


def _roles(launch: Launch) -> tuple[dict[str, type[Node]], dict[str, str], dict[str, str]]:
    """Classes by node, and by the full name of a loop topic the node that publishes it and the one that relays it, if any."""
    factories = node_kinds()
    classes = {name: load(factories[spec.kind]) for name, spec in launch.nodes.items()}
    publisher: dict[str, str] = {}
    for name, kind in classes.items():
        for topic in _full(name, kind.publishes):
            if topic in publisher:
                raise ParameterError(
                    f"{launch.scenario}.nodes.{name}: {topic} is already published by"
                    f" {publisher[topic]}; a second chain needs a namespace of its own, as in"
                    " right/driver"
                )
            publisher[topic] = name
    for name, kind in classes.items():
        remap = launch.nodes[name].remap
        for topic, instead in remap.items():
            where = f"{launch.scenario}.nodes.{name}.remap"
            if topic not in kind.listens_to:
                raise ParameterError(
                    f"{where}: the node does not listen to {topic!r};"
                    f" {choices(topic, kind.listens_to)}"
                    if kind.listens_to not in ((), ("*",))
                    else (
                        f"{where}: a {launch.nodes[name].kind} listens to no single topic that"
                        " could be another"
                    )
                )
            if topics.message_type(topic) is not topics.message_type(instead):
                raise ParameterError(
                    f"{where}.{topic}: {instead!r} does not carry the same messages"
                )
        for topic in kind.listens_to:
            if topic != "*" and (full := _takes(launch, name, topic)) not in publisher:
                raise ParameterError(
                    f"{launch.scenario}.nodes.{name}: listens to {full}, which no node publishes;"
                    f" {choices(full, publisher)}"
                )
    relays: dict[str, str] = {}
    for name, kind in classes.items():
        for topic in _full(name, kind.relays):
            if topic in relays:
                raise ParameterError(
                    f"{launch.scenario}.nodes.{name}: {topic} is already relayed by {relays[topic]}"
                )
            relays[topic] = name
    return classes, publisher, relays


def _full(name: str, names: Iterable[str]) -> Iterator[str]:
    """Full names of topics inside the chain of a node."""
    return (topics.within(name.rpartition("/")[0], topic) for topic in names)


def _takes(launch: Launch, name: str, topic: str) -> str:
    """Full name of the topic that a node takes for one inside its chain."""
    return launch.nodes[name].remap.get(topic) or next(_full(name, [topic]))


class _Places:
    """Endpoints of the nodes of one launch: ipc on this machine, tcp to and from nodes on others."""

    def __init__(self, launch: Launch) -> None:
        self._launch = launch
        self._ports = {
            name: spec.port or launch.run.port + 2 * i
            for i, (name, spec) in enumerate(launch.nodes.items())
        }
        taken: dict[tuple[str, int], str] = {}
        for name, spec in launch.nodes.items():
            ports = [(spec.host, self._ports[name]), (spec.host, self._ports[name] + 1)]
            for place in [*ports, *([("", spec.open_port)] if spec.open_port else [])]:
                other = taken.setdefault(place, name)
                if other != name:
                    raise ParameterError(
                        f"{launch.scenario}.nodes.{name}.port: {place[1]} is taken by {other}"
                    )
            if spec.open_port and spec.host:
                raise ParameterError(
                    f"{launch.scenario}.nodes.{name}.open_port: only for a node on this machine"
                )

    def _tcp(self, host: str, port: int, key: str, where: str) -> str:
        bare = f"tcp://{f'[{host}]' if ':' in host else host}:{port}"
        try:
            return f"{bare}#{key_of(key) if key else identity().public}"
        except KeyRefusedError as error:
            others = "other machines" if is_remote(bare) else "all users of this machine"
            raise ParameterError(
                f"{self._launch.scenario}.{where}: {others} can reach {host}: {error}"
            ) from error

    def far(self, name: str, offset: int = 0) -> str:
        """Endpoint of a node on another machine; empty for one on this machine."""
        spec = self._launch.nodes[name]
        if not spec.host:
            return ""
        # On loopback without a key's name it is this user who starts it.
        key = spec.key or (spec.host if is_remote(f"tcp://{spec.host}:1") else "")
        return self._tcp(spec.host, self._ports[name] + offset, key, f"nodes.{name}.key")

    def reach(self, name: str, offset: int) -> str:
        """Endpoint at which other machines reach a node on this one."""
        hosts = [spec.host for spec in self._launch.nodes.values() if spec.host]
        address = self._launch.run.host
        if not address:
            if any(is_remote(f"tcp://{host}:1") for host in hosts):
                raise ParameterError(
                    f"{self._launch.scenario}.run.host: needed, the address under which {hosts[0]}"
                    " reaches this machine"
                )
            address = "127.0.0.1"
        return self._tcp(address, self._ports[name] + offset, "", "run.host")


def kernel_modules(launch: Launch) -> list[str]:
    """Name the compiled ticks that the nodes of this machine could take."""
    factories = node_kinds()
    here = [
        (load(factories[spec.kind]), spec.parameters)
        for spec in launch.nodes.values()
        if not spec.host
    ]
    return sorted({module for kind, parameters in here for module in kind.modules(parameters)})


def settle_tick(launch: Launch, say: Callable[[str], None]) -> Launch:
    """Settle which tick the nodes take, and have it compiled where it is asked for."""
    scarce = launch.run.pace == "realtime" and launch.run.rate >= SCARCE
    tick = choose(launch.run.tick, kernel_modules(launch), say, scarce)
    return msgspec.structs.replace(launch, run=msgspec.structs.replace(launch.run, tick=tick))


def free_name(launch: Launch, name: str) -> str:
    """Name a node that is added to a launch: as wanted, or with a number behind."""
    return next(
        free for free in (name, *(f"{name}_{i}" for i in range(2, 100))) if free not in launch.nodes
    )


def with_forwarder(launch: Launch) -> Launch:
    """Add the process at which strangers may listen, where a node allows it; in the loop's own they have no business."""
    ports = {name: spec.open_port for name, spec in launch.nodes.items() if spec.open_port}
    if not ports:
        return launch
    spec = NodeSpec(
        kind=FORWARDER, parameters={"ports": ports}, required=False, respawn=True, respawn_max=-1
    )
    return msgspec.structs.replace(
        launch, nodes={**launch.nodes, free_name(launch, FORWARDER): spec}
    )


def _audible(launch: Launch, name: str) -> set[str]:
    """Nodes that one which listens to everything may hear: those of its namespace; outside of any, all."""
    namespace = name.rpartition("/")[0]
    return {
        other
        for other in launch.nodes
        if other != name and (not namespace or other.startswith(f"{namespace}/"))
    }


def wire(launch: Launch, run: str, run_dir: Path, manifest: dict[str, str]) -> dict[str, Setup]:
    """Resolve a launch."""
    classes, publisher, relays = _roles(launch)
    factories = node_kinds()
    publish = {name: f"ipc://{run_dir}/{name}.pub" for name in launch.nodes}
    listen = {name: f"ipc://{run_dir}/{name}.listen" for name in launch.nodes}
    places = _Places(launch)
    far = {name: places.far(name) for name in launch.nodes}
    by_hand = {name for name, spec in launch.nodes.items() if spec.by_hand or spec.host}
    reached: dict[tuple[str, bool], str] = {}

    def endpoint(source: str, local: dict[str, str], listener: str) -> str:
        if far[source]:
            return far[source]
        if far[listener]:
            return reached.setdefault(
                (source, local is listen), places.reach(source, int(local is listen))
            )
        return local[source]

    def taken(listener: str, topic: str) -> str:
        full = _takes(launch, listener, topic)
        relay = relays.get(full, listener)  # it stands between the publisher and everybody else
        return publisher[full] if relay == listener else relay

    def takes(listener: str, source: str) -> bool:
        topics = (topic for topic in classes[listener].listens_to if topic != "*")
        return source in heard[listener] or any(
            taken(listener, topic) == source for topic in topics
        )

    setups = {}
    cores = _cores(launch)
    virtual = all(
        kind.is_virtual(launch.nodes[name].parameters, name)
        for name, kind in classes.items()
        if topics.DEVICE_STATE in kind.publishes
    )
    parameters = {
        name: convert(launch.nodes[name].parameters, kind.Parameters, name)
        for name, kind in classes.items()
    }
    subscribed = {name: len(kind.subscribes(parameters[name])) for name, kind in classes.items()}
    heard = {
        name: (
            kind.hears(parameters[name], _audible(launch, name))
            if "*" in kind.listens_to
            else frozenset()
        )
        for name, kind in classes.items()
    }
    for name, spec in launch.nodes.items():
        kind = classes[name]
        everything = kind.listens_to == ("*",)
        if spec.respawn and launch.run.pace == "lockstep" and kind.publishes and not everything:
            raise ParameterError(
                f"{launch.scenario}.nodes.{name}.respawn: a respawned node has lost its state, so a"
                " lockstep run would no longer be deterministic; use pace realtime"
            )
        if everything:
            sources = {
                other: endpoint(other, listen, name)
                for other in launch.nodes
                if other in heard[name]
            }
        else:
            sources = {
                topic: endpoint(taken(name, topic), publish, name) for topic in kind.listens_to
            }
        setups[name] = Setup(
            run=run,
            run_dir=str(run_dir),
            name=name,
            kind=spec.kind,
            factory=factories[spec.kind],
            period=launch.run.period,
            pace=launch.run.pace,
            apply=launch.run.apply,
            tick="compiled" if launch.run.tick == "compiled" and kind.kernel_module else "plain",
            axes=launch.axes.get(name.rpartition("/")[0]) or launch.run.axes,
            virtual=virtual,
            ticks=launch.run.ticks,
            publish=far[name] or publish[name],
            listen="" if far[name] else listen[name],
            control=places.far(name, 1) or f"ipc://{run_dir}/{name}.ctl",
            by_hand=name in by_hand,
            lease=LEASE if name in by_hand else 0.0,
            patience=ARRIVAL_TIMEOUT if by_hand else 10.0,
            sources=sources,
            remap=spec.remap,
            listeners=sum(
                subscribed[other] for other in launch.nodes if other != name and takes(other, name)
            ),
            scheduling=_scheduling(launch, kind, name.rpartition("/")[0], cores),
            parameters=spec.parameters,
            plant=known_plant(launch, name.rpartition("/")[0]) if has_plant(kind) else {},
            peak_force=known_peak(launch, name.rpartition("/")[0]) if has_plant(kind) else None,
            watch=os.path.abspath(spec.watch) if spec.watch else "",
            manifest=(
                chain_manifest(launch, manifest, name.rpartition("/")[0]) if everything else {}
            ),
        )
        kind.check(setups[name])
    return {
        name: msgspec.structs.replace(
            setup, reach=reached.get((name, False), ""), listen_reach=reached.get((name, True), "")
        )
        for name, setup in setups.items()
    }


def manifest_of(launch: Launch, run: str, wall_minus_monotonic: float) -> dict[str, str]:
    """Describe a run for its recordings."""
    uname = os.uname()
    factories = node_kinds()
    publishes = {
        name: list(_full(name, load(factories[spec.kind]).publishes))
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


def chain_manifest(launch: Launch, manifest: dict[str, str], namespace: str) -> dict[str, str]:
    """Describe one chain of a run as if it were alone; its launch file is written out, without arguments."""
    if not namespace:
        return manifest
    inside = {
        name.removeprefix(f"{namespace}/"): spec
        for name, spec in launch.nodes.items()
        if name.startswith(f"{namespace}/")
    }
    chain = msgspec.structs.replace(
        launch,
        run=msgspec.structs.replace(launch.run, axes=launch.axes.get(namespace) or launch.run.axes),
        nodes=inside,
        arguments={},
    )
    nodes = {node: unusual(spec) for node, spec in inside.items()}
    text = {"summary": launch.summary, "run": unusual(chain.run), "nodes": nodes}
    # JSON is YAML
    chain = msgspec.structs.replace(
        chain, text=msgspec.json.format(msgspec.json.encode(text)).decode()
    )
    return manifest_of(chain, manifest["run"], float(manifest["wall_minus_monotonic_s"]))
