"""Endpoints of the nodes of a launch: ipc on this machine, tcp to and from other machines."""

from __future__ import annotations

from pathlib import Path

import msgspec

from messages.transport.endpoints import is_remote
from messages.transport.keys import KeyRefusedError, identity, key_of
from nodes.base.setup import Setup
from nodes.launcher.launch_spec import Launch
from nodes.parameters.store import ParameterError


class _Places:
    """Endpoints over tcp, and their ports."""

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
                        f"{place[1]} is taken by {other}",
                        path=f"{launch.scenario}.nodes.{name}.port",
                    )
            if spec.open_port and spec.host:
                raise ParameterError(
                    "only for a node on this machine",
                    path=f"{launch.scenario}.nodes.{name}.open_port",
                )

    def _tcp(self, host: str, port: int, key: str, where: str) -> str:
        bare = f"tcp://{f'[{host}]' if ':' in host else host}:{port}"
        try:
            return f"{bare}#{key_of(key) if key else identity().public}"
        except KeyRefusedError as error:
            others = (
                "other machines" if is_remote(bare) else "all users of this machine"
            )
            raise ParameterError(
                f"{others} can reach {host}: {error}",
                path=f"{self._launch.scenario}.{where}",
            ) from error

    def far(self, name: str, offset: int = 0) -> str:
        """Return the endpoint of a node on another machine; empty for one on this machine."""
        spec = self._launch.nodes[name]
        if not spec.host:
            return ""
        # On loopback without a key name, this user starts the node.
        key = spec.key or (spec.host if is_remote(f"tcp://{spec.host}:1") else "")
        return self._tcp(
            spec.host, self._ports[name] + offset, key, f"nodes.{name}.key"
        )

    def reach(self, name: str, offset: int) -> str:
        """Return the endpoint at which other machines reach a node on this one."""
        hosts = [spec.host for spec in self._launch.nodes.values() if spec.host]
        address = self._launch.run.host
        if not address:
            if any(is_remote(f"tcp://{host}:1") for host in hosts):
                raise ParameterError(
                    f"needed, the address under which {hosts[0]} reaches this machine",
                    path=f"{self._launch.scenario}.run.host",
                )
            address = "127.0.0.1"
        return self._tcp(address, self._ports[name] + offset, "", "run.host")


class Endpoints:
    """Where each node publishes, listens and is controlled, and where others reach it."""

    def __init__(self, launch: Launch, run_dir: Path) -> None:
        self._run_dir = run_dir
        self._places = _Places(launch)
        self._far = {name: self._places.far(name) for name in launch.nodes}
        self._reached: dict[tuple[str, bool], str] = {}

    def _local(self, name: str, apart: bool) -> str:
        return f"ipc://{self._run_dir}/{name}.{'listen' if apart else 'pub'}"

    def publish(self, name: str) -> str:
        """Return the endpoint of a node's publisher."""
        return self._far[name] or self._local(name, apart=False)

    def listen(self, name: str) -> str:
        """Return the endpoint for listeners outside the loop; empty where they share the other."""
        return "" if self._far[name] else self._local(name, apart=True)

    def control(self, name: str) -> str:
        """Return the endpoint of a node's requests."""
        return self._places.far(name, 1) or f"ipc://{self._run_dir}/{name}.ctl"

    def of(self, source: str, listener: str, apart: bool) -> str:
        """Return the endpoint at which a node gets the messages of another.

        `apart`: as a listener outside the loop.
        """
        if self._far[source]:
            return self._far[source]
        if not self._far[listener]:
            return self._local(source, apart)
        if (source, apart) not in self._reached:
            self._reached[source, apart] = self._places.reach(source, int(apart))
        return self._reached[source, apart]

    def with_reach(self, setups: dict[str, Setup]) -> dict[str, Setup]:
        """Return the setups with the endpoints at which nodes on other machines reach each."""
        return {
            name: msgspec.structs.replace(
                setup,
                reach=self._reached.get((name, False), ""),
                listen_reach=self._reached.get((name, True), ""),
            )
            for name, setup in setups.items()
        }
