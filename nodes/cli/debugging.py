"""Output of ``haptic launch --debug``: the resolved launch, and each process as it starts."""

import shlex
from collections.abc import Callable

from nodes.launcher.child import PYTHON
from nodes.launcher.launch_spec import Launch, unusual
from nodes.launcher.supervisor import Supervisor
from nodes.parameters.yaml_io import write_yaml


class Debugging:
    """Prints the launch once, and each process when it is new."""

    def __init__(self, launch: Launch, say: Callable[[str], None]) -> None:
        self._say = say
        self._pids: dict[str, int] = {}
        nodes = {node: unusual(spec) for node, spec in launch.nodes.items()}
        facts = {
            "file": launch.path,
            "arguments": launch.arguments,
            "run": unusual(launch.run),
            "nodes": nodes,
        }
        for line in write_yaml(facts).splitlines():
            say(line)

    def __call__(self, supervisor: Supervisor) -> None:
        """Print new processes."""
        for name, child in supervisor.children.items():
            process = child.process
            if process is None or self._pids.get(name) == process.pid:
                continue
            self._pids[name] = process.pid
            setup = child.setup
            where = f"processors {', '.join(map(str, setup.scheduling.cpus)) or 'any'}"
            how = (
                f"FIFO {setup.scheduling.fifo}" if setup.scheduling.fifo else "no FIFO"
            )
            command = shlex.join(
                [*PYTHON, "-m", "nodes", f"{setup.run_dir}/{name}.json"]
            )
            self._say(
                f"{name}: pid {process.pid}, {where}, {how}, tick {setup.tick}: {command}"
            )
            for topic, source in setup.sources.items():
                self._say(f"  receives {topic} from {source}")
            self._say(f"  publishes at {setup.publish}, replies at {setup.control}")
