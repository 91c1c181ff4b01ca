"""Misbehaving nodes, as of a foreign package, and a launch file for them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

PACKAGE = '''
import os, signal, time
from typing import ClassVar
import msgspec
from nodes.base.node import IDLE_MS, Node
from nodes.driver.device import DeviceLimits
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters

class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    after: int = 0
    diary: str = ""

class Crasher(Node):
    """Ends with exit code 7 after some states."""
    Parameters = Parameters
    listens_to = ("/device/state",)
    def loop(self):
        self.state = "running"
        with open(self.store.current.diary, "a") as diary:
            diary.write(f"{time.monotonic()}\\n")
        for _ in range(self.store.current.after):
            while self.inbox.receive(IDLE_MS) is None and not self.stopping:
                pass
        if not self.stopping:
            with open(self.store.current.diary, "a") as diary:
                diary.write(f"{time.monotonic()}\\n")
                diary.flush()
                os._exit(7)

class Stubborn(Node):
    """Hears no signal."""
    listens_to = ("/device/state",)
    def loop(self):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        self.state = "running"
        while True:
            time.sleep(1.0)

class Arm:
    """Held 1 mm inside the floor; logs every force, and fails after 100 ticks as ordered."""
    limits = DeviceLimits(peak_force=10.0, hold=0.1, workspace=((-0.1, 0.1),) * 3)
    def __init__(self, path, fails):
        self.diary, self.fails, self.ticks = open(path, "a"), fails, 0
    def open(self):
        self.write("open")
    def write(self, text):
        self.diary.write(f"{text}\\n")
        self.diary.flush()
    def read_position(self, seq):
        self.ticks += 1
        if self.ticks > 100 and self.fails == "device":
            raise OSError("the cable is out; plug it in")
        if self.ticks > 100 and self.fails == "exit":
            os._exit(0)
        if self.ticks > 100 and self.fails == "bug":
            return 1 / 0
        return (0.0, 0.0, -0.001)
    def write_force(self, force, seq, offset):
        self.write(force[2])
    def close(self):
        self.write("close")

class ArmParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    diary: str
    fails: str

class Arms(Driver):
    """A driver of such an arm."""
    Parameters = ArmParameters
    def make_device(self):
        return Arm(self.store.current.diary, self.store.current.fails)

class Broken(Node):
    """Cannot be configured."""
    listens_to = ("/device/state",)
    def configure(self):
        raise ValueError("the sensor is not there; plug it in")
'''

DIST_INFO = {
    "METADATA": "Metadata-Version: 2.1\nName: odd-nodes\nVersion: 0\n",
    "entry_points.txt": (
        "[haptic.nodes]\n"
        + "".join(
            f"{kind.lower()} = odd_nodes:{kind}\n"
            for kind in ("Crasher", "Stubborn", "Broken", "Arms")
        )
    ),
}


@pytest.fixture
def odd_nodes(tmp_path: Path) -> dict[str, str]:
    """Install misbehaving nodes by PYTHONPATH; return the environment for a launch."""
    folder = tmp_path / "site"
    info = folder / "odd_nodes-0.dist-info"
    info.mkdir(parents=True)
    (folder / "odd_nodes.py").write_text(PACKAGE)
    for name, text in DIST_INFO.items():
        (info / name).write_text(text)
    return {"PYTHONPATH": f"{folder}:{os.environ.get('PYTHONPATH', '')}"}


def scenario(
    folder: Path, duration: float = 0.0, loop: dict[str, Any] | None = None, **more: Any
) -> str:
    """Write a launch file: a mass in free fall onto a floor, a logger, and more nodes.

    `loop` is added to the chain.
    """
    chain = loop or {}
    content = {
        "summary": "for a test",
        "run": {"duration": duration},
        "nodes": {
            "driver": {
                "kind": "sim_driver",
                "parameters": {
                    "device": {
                        "mass": 0.1,
                        "damping": 1.0,
                        "gravity": 9.81,
                        "position": 0.001,
                    }
                },
                **chain,
            },
            "environment": {
                "kind": "environment",
                "parameters": {"surface": {"kind": "plane", "axis": "z"}},
                **chain,
            },
            "coupling": {
                "kind": "coupling",
                "parameters": {
                    "law": "pd",
                    "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}},
                },
                **chain,
            },
            "logger": {
                "kind": "logger",
                "required": False,
                "parameters": {"path": "run.mcap"},
            },
            **more,
        },
    }
    path = folder / "odd.yaml"
    path.write_bytes(msgspec.json.encode(content))  # JSON is YAML
    return str(path)
