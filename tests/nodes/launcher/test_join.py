"""A node waiting for its launcher over tcp: who may set it up, and what a set-up may ask."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from messages.transport.endpoints import split
from messages.transport.keys import Identity
from messages.transport.requests import ControlError, Request, call
from nodes.base.node import Node
from nodes.launcher.external_child import command
from nodes.parameters.paths import LocalPath, check_paths, needed
from nodes.parameters.store import ParameterError
from nodes.recording.logger import LoggerParameters
from sim.measure.free_ports import free_ports
from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    haptic,
    private_runtime_dir,
    typed_in,
    wait_for,
)
from tests.support.setups import setup_of

if TYPE_CHECKING:
    from messages.transport.endpoints import Context

EVIL = """\
#include <stdio.h>
__attribute__((constructor)) static void run(void) {{ FILE *file = fopen("{mark}", "w");
  if (file) fclose(file); }}
"""

PLAIN = """\
import os, sys, zmq
if os.getuid() == 0:
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
socket = zmq.Context().socket(zmq.REQ)
socket.linger = 0
socket.connect(sys.argv[1])
socket.send(bytes.fromhex(sys.argv[2]))
sys.exit(3 if socket.poll(1500) else 0)
"""
"""A client without a key, as another user if possible; exit code 3 if it was answered."""


class Waiting:
    """A ``haptic node start NAME --bind`` that waits for its launcher."""

    def __init__(
        self, folder: Path, runtime: Path, me: Identity, name: str, *words: str
    ) -> None:
        port = free_ports(2)
        self.name, self.folder = name, folder
        self.publish = f"tcp://127.0.0.1:{port}#{me.public}"
        self.control = f"tcp://127.0.0.1:{port + 1}#{me.public}"
        with open(folder / "node.txt", "wb") as errors:
            self.process = subprocess.Popen(
                [*HAPTIC, "node", "start", name, "--bind", f"127.0.0.1:{port}", *words],
                env={**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime)},
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stderr=errors,
            )
        wait_for(lambda: "waiting for its launcher" in self.errors, "the node waits")

    @property
    def errors(self) -> str:
        """Its standard error."""
        return (self.folder / "node.txt").read_text()

    def setup(self, kind: str, **parameters: object) -> dict[str, Any]:
        """Return a set-up, valid except for the tested change."""
        made = setup_of(
            run="r-1",
            name=self.name,
            kind=kind,
            publish=self.publish,
            control=self.control,
            lease=5.0,
            parameters=parameters,
        )
        found: dict[str, Any] = msgspec.to_builtins(made)
        return found


@pytest.fixture
def waiting(tmp_path: Path, me: Identity) -> Iterator[Callable[..., Waiting]]:
    started: list[Waiting] = []
    with private_runtime_dir() as runtime:

        def start(name: str, *words: str) -> Waiting:
            started.append(Waiting(tmp_path, runtime, me, name, *words))
            return started[-1]

        yield start
        for one in started:
            one.process.terminate()
            one.process.wait(DEADLINE)


@pytest.fixture
def evil(tmp_path: Path) -> tuple[Path, Path]:
    """Return a library that leaves a mark when loaded, and the mark's path."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path / "lib"
    folder.mkdir()
    mark = tmp_path / "executed"
    (folder / "evil.c").write_text(EVIL.format(mark=mark))
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-o", folder / "evil.so", folder / "evil.c"],
        check=True,
    )
    return folder / "evil.so", mark


# -- who
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_another_user_of_this_machine_hands_it_nothing(
    waiting: Callable[..., Waiting], context: Context, evil: tuple[Path, Path]
) -> None:
    node = waiting("coupling")
    setup = node.setup("touch_driver", touch={"library": str(evil[0])})
    request = msgspec.msgpack.encode(Request("configure", {"setup": setup})).hex()
    words = [sys.executable, "-c", PLAIN, split(node.control)[0], request]
    asked = subprocess.run(words, cwd="/", env={}, timeout=DEADLINE, check=False)
    assert asked.returncode == 0, "nobody may be answered without a key"
    wait_for(lambda: "denied" in node.errors, "the refusal is told")
    assert not evil[1].exists()
    assert call(context, node.control, "status")["state"] == "unconfigured"


# -- what
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_it_becomes_only_what_it_was_started_for(
    waiting: Callable[..., Waiting], context: Context, evil: tuple[Path, Path]
) -> None:
    node = waiting("coupling")
    with pytest.raises(ControlError, match="--kind touch_driver"):
        call(
            context,
            node.control,
            "configure",
            DEADLINE,
            setup=node.setup("touch_driver", touch={"library": str(evil[0])}),
        )
    assert not evil[1].exists()


@pytest.mark.process
def test_a_library_from_the_wire_is_loaded_only_where_the_command_line_allows_it(
    waiting: Callable[..., Waiting], context: Context, evil: tuple[Path, Path]
) -> None:
    library, mark = evil
    node = waiting("driver", "--kind", "touch_driver")
    setup = node.setup("touch_driver", touch={"library": str(library)})
    setup["sources"] = {
        "/coupling/force": f"tcp://127.0.0.1:{free_ports(1)}#{'ab' * 32}"
    }
    with pytest.raises(ControlError, match=f"--allow-path {library.parent}"):
        call(context, node.control, "configure", DEADLINE, setup=setup)
    assert not mark.exists()
    assert call(context, node.control, "status")["state"] == "unconfigured"
    # The same setup where it is allowed: what was refused above would have been executed.
    node = waiting(
        "driver", "--kind", "touch_driver", "--allow-path", str(library.parent)
    )
    setup |= {"publish": node.publish, "control": node.control}
    call(context, node.control, "configure", DEADLINE, setup=setup)
    wait_for(mark.exists, "the library is loaded")


@pytest.mark.process
def test_a_file_of_mine_is_not_overwritten_from_the_wire(
    waiting: Callable[..., Waiting], context: Context, tmp_path: Path
) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    node = waiting("logger")
    for parameters in (
        {"path": str(precious), "overwrite": True},
        {"overwrite": True},
        {"path": "../x.mcap"},
    ):
        with pytest.raises(ControlError, match="--allow-path"):
            call(
                context,
                node.control,
                "configure",
                DEADLINE,
                setup=node.setup("logger", **parameters),
            )
    assert precious.read_text() == "mine"


def test_a_name_that_is_no_kind_says_which_there_are(
    tmp_path: Path, me: Identity
) -> None:
    told = typed_in(
        tmp_path, "node", "start", "driver", "--bind", "127.0.0.1:5790", code=2
    ).stderr
    assert "--kind" in told
    assert "sim_driver" in told


class _Third(msgspec.Struct, frozen=True, kw_only=True):
    model: str = ""
    settings: dict[str, Any] = {}


@pytest.mark.parametrize(
    ("parameters", "fits"),
    [
        (LoggerParameters(), True),
        (LoggerParameters(topics=["/device/state", "/a/status"]), True),
        (LoggerParameters(path="allowed/x.mcap", overwrite=True), True),
        (LoggerParameters(path="allowed/../x.mcap"), False),
        (LoggerParameters(path="x.mcap"), False),
        (LoggerParameters(path="allowed/link/x.mcap"), False),
        (LoggerParameters(topics=["/etc/passwd"]), False),
        (_Third(model="plain"), True),
        (_Third(model="allowed/model.bin"), True),
        (_Third(model="/usr/lib/x.so"), False),
        (_Third(settings={"a": [1, {"b": "~/x"}]}), False),
        (_Third(model="allowed/x\0/../../etc/passwd"), False),
    ],
)
def test_paths_in_parameters(
    parameters: msgspec.Struct,
    fits: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "allowed").mkdir()
    (tmp_path / "allowed" / "link").symlink_to("/")
    if fits:
        check_paths(parameters, [Path("allowed")], "n")
        return
    with pytest.raises(ParameterError, match=r"n\..*--allow-path"):
        check_paths(parameters, [Path("allowed")], "n")


def test_what_the_launcher_prints_allows_what_the_launch_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    parameters = LoggerParameters(path="far away/x.mcap", overwrite=True)
    assert needed(parameters) == ["far away", "."]
    check_paths(parameters, list(map(Path, needed(parameters))), "logger")
    setup = setup_of(
        name="disk",
        kind="logger",
        factory="nodes.recording.logger:Logger",
        publish="tcp://10.0.0.2:5600#" + "ab" * 32,
        control="tcp://10.0.0.2:5601#" + "ab" * 32,
        parameters={"path": "far away/x.mcap"},
    )
    told = (
        "on 10.0.0.2: haptic node start disk --bind 10.0.0.2:5600 --kind logger --allow-path 'far"
        " away'"
    )
    assert command(setup) == told


class _WithFile(msgspec.Struct, frozen=True, kw_only=True):
    path: LocalPath = "here"


class _Kind(Node):
    Parameters = _WithFile


def test_a_running_node_takes_no_path_from_the_wire_either(tmp_path: Path) -> None:
    setup = setup_of(name="n", kind="k", allow_paths=[str(tmp_path)])
    node = _Kind(setup)
    with pytest.raises(ParameterError, match="--allow-path /etc"):
        node.changes.change(
            lambda: node.store.changed({"path": "/etc/passwd"}), node.prepare
        )
    with pytest.raises(ParameterError, match="fixed while it runs"):
        node.changes.change(
            lambda: node.store.changed({"path": f"{tmp_path}/x"}), node.prepare
        )


# -- without keys
# --------------------------------------------------------------------------------------------------

SCENE = """\
summary: A coupling over tcp on loopback
run: {rate: 250.0, duration: 0.0, port: 5990}
nodes:
  driver: {kind: sim_driver, parameters: {device: {mass: 0.1, damping: 1.0}}}
  environment: {kind: environment}
  coupling: {kind: coupling, host: 127.0.0.1, parameters: {law: pd, laws: {pd: {kind: pd,
    stiffness: 100.0, damping: 1.0}}}}
"""


@pytest.mark.process
def test_who_has_no_keys_is_told_the_one_command_that_is_missing(
    tmp_path: Path,
) -> None:
    environment = {**os.environ, "HAPTIC_KEYS": str(tmp_path / "k")}
    (tmp_path / "scene.yaml").write_text(SCENE)
    for asked in (
        ("launch", "scene.yaml"),
        ("node", "start", "coupling", "--bind", "127.0.0.1:5994"),
    ):
        told = haptic(tmp_path, *asked, code=2, environment=environment).stderr
        assert "haptic keys new" in told
        assert len(told.splitlines()) == 1
    haptic(tmp_path, "keys", "new", environment=environment)
    # With it the node starts and waits.
    with private_runtime_dir() as runtime, open(tmp_path / "err", "wb") as errors:
        words = [
            *HAPTIC,
            "node",
            "start",
            "coupling",
            "--bind",
            f"127.0.0.1:{free_ports(2)}",
        ]
        environment["HAPTIC_RUNTIME_DIR"] = str(runtime)
        node = subprocess.Popen(words, env=environment, cwd=tmp_path, stderr=errors)
        wait_for(
            lambda: "waiting for its launcher" in (tmp_path / "err").read_text(),
            "the node waits",
        )
        node.terminate()
        assert node.wait(DEADLINE) == 130
