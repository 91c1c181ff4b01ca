"""ROS 2 habits: option names, HAPTIC_RUN, haptic stop, completion, status line, colours."""

from __future__ import annotations

import fcntl
import io
import json
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.base.kept_line import ERASE
from nodes.cli import main
from nodes.cli.completion import candidates
from nodes.cli.launch import _into
from nodes.cli.main import VERBS, coloured
from nodes.cli.param import _struct_of
from nodes.cli.status_line import ORDER, PRIORITY, fitted
from nodes.coupling.parameters import CouplingParameters, PlantParameters
from nodes.launcher.launch_file import read as read_launch
from nodes.laws.multi_term import MultiTerm
from nodes.parameters.describe import names_below
from nodes.recording.logger import file_of
from nodes.recording.reader import Recording
from tests.support import slowly
from tests.support.launching import (
    HAPTIC,
    Running,
    exit_code,
    private_runtime_dir,
    running,
    typed,
    typed_in,
    wait_for,
)


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    # Nothing here is a matter of the rate, and each tick of four processes costs.
    with running(
        tmp_path_factory.mktemp("launch"), "floor_drop", "duration:=0", "rate:=250"
    ) as found:
        yield found


def told(launch: Running, *words: str, code: int = 0) -> Any:
    return json.loads(
        typed(launch, *words, "--json", code=code).stdout.splitlines()[-1]
    )


# -- topic
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_topic_options_of_ros2(launch: Running) -> None:
    assert (
        launch.haptic("topic", "echo", DEVICE_STATE, "--once").stdout.count("---") == 1
    )
    assert (
        f"{FORCE} [haptic.Force]"
        in typed(launch, "topic", "list", "-t").stdout.splitlines()
    )
    # Of 60 messages, the interval figures are those of the last 20.
    found = told(launch, "topic", "hz", DEVICE_STATE, "-w", "20", "-n", "60")
    assert found["messages"] == 20


# -- bag
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_a_topic_that_nobody_publishes_is_an_error(
    launch: Running, tmp_path: Path
) -> None:
    out = tmp_path / "r.mcap"
    for topic, hint in (
        ("/nosuch", "there are /device/state"),
        ("/device/stat", "did you mean /device/state?"),
    ):
        done = typed(
            launch,
            "bag",
            "record",
            topic,
            "--out",
            str(out),
            "--duration",
            "0.2",
            code=2,
        )
        assert f"no topic '{topic}'" in done.stderr
        assert hint in done.stderr
        assert not out.exists()


@pytest.mark.process
def test_topics_are_whole_names(launch: Running, tmp_path: Path) -> None:
    # As a prefix, ZeroMQ's way, /driver/status would be all that begins like it.
    found = told(
        launch,
        "bag",
        "record",
        PROXY,
        "--out-dir",
        str(tmp_path / "new" / "folder"),
        "--duration",
        "0.3",
    )
    path = Path(found["recording"])
    assert path.parent == tmp_path / "new" / "folder"
    assert set(Recording(path).topics) == {PROXY}
    out = tmp_path / "all.mcap"
    told(launch, "bag", "record", "-a", "--out", str(out), "--duration", "0.3")
    assert {DEVICE_STATE, PROXY, FORCE} <= set(Recording(out).topics)
    assert "choose one" in typed(launch, "bag", "record", "-a", PROXY, code=2).stderr


def test_a_launch_refuses_a_logger_of_topics_that_nothing_publishes(
    tmp_path: Path,
) -> None:
    scenario = tmp_path / "x.yaml"
    text = (Path(main.__file__).parents[2] / "launch" / "two_loggers.yaml").read_text(
        encoding="utf-8"
    )
    assert "[/device/state, /environment/proxy" in text
    for wrong in ("/device", "/nobody/status"):
        scenario.write_text(
            text.replace("[/device/state, ", f"[{wrong}, /device/state, "),
            encoding="utf-8",
        )
        with private_runtime_dir() as runtime:
            environment = {"HAPTIC_RUNTIME_DIR": str(runtime)}
            done = typed_in(
                tmp_path, "launch", str(scenario), code=2, environment=environment
            )
        assert f"topics[0]: nothing publishes '{wrong}'" in done.stderr


@pytest.mark.process
def test_play_loops_until_it_is_ended(launch: Running, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    told(launch, "bag", "record", FORCE, "--out", str(path), "--duration", "0.2")
    once = Recording(path).topics[FORCE].messages
    with subprocess.Popen(
        [
            *HAPTIC,
            "bag",
            "play",
            str(path),
            "-l",
            "-r",
            "inf",
            "--endpoint",
            f"ipc://{tmp_path}/p",
            "--json",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        try:
            assert "publishing" in process.stderr.readline()
            # It never ends by itself: what has been published when it is interrupted is more than
            # the file holds.
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(1.0)
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=30.0)
        finally:
            process.kill()
        published = json.loads(out.splitlines()[-1])["published"][FORCE]
    assert published > once


# -- param describe, launch -s, --out-dir
# ----------------------------------------------------------------------------


@pytest.mark.process
def test_param_describe(launch: Running) -> None:
    found = told(
        launch,
        "param",
        "describe",
        "coupling",
        "laws.pd.stiffness",
        "memory",
        "stability",
        "plant",
    )
    stiffness = found["parameters"]["laws.pd.stiffness"]
    assert stiffness["unit"] == "N/m"
    assert (stiffness["type"], stiffness["limits"], stiffness["required"]) == (
        "number",
        "above 0",
        True,
    )
    assert found["parameters"]["memory"]["limits"] == "at least 2, at most 1e+06"
    assert found["parameters"]["memory"]["default"] == 2048
    assert (
        found["parameters"]["stability"]["type"] == "one of changes, off, refuse, warn"
    )
    assert found["parameters"]["plant"]["type"] == "parameters or nothing"
    done = typed(launch, "param", "set", "coupling", "laws.pd.stiffness=900", code=2)
    assert "did you mean laws.pd.stiffness 900?" in done.stderr
    text = typed(launch, "param", "describe", "environment").stdout
    assert "surface.position: number" in text
    assert "[" in typed(launch, "param", "describe", "driver").stdout
    done = typed(launch, "param", "describe", "coupling", "laws.pd.stifness", code=2)
    assert "coupling.laws.pd.stifness: no such parameter" in done.stderr
    assert "did you mean stiffness?" in done.stderr
    assert (
        "nothing below memory"
        in typed(launch, "param", "describe", "coupling", "memory.x", code=2).stderr
    )


@pytest.mark.process
def test_every_parameter_of_every_node_is_described(launch: Running) -> None:
    for node, values in told(launch, "param", "list")["nodes"].items():
        found = told(launch, "param", "describe", node)["parameters"]
        assert list(found) == list(values)
        for name, one in found.items():
            assert one["type"] != "anything", f"{node}.{name}"
            assert one["meaning"], f"{node}.{name}"


@pytest.mark.parametrize("name", ["laws.aside", "laws.preset", "plant", "laws", "law"])
def test_a_branch_describes_what_is_below_it(name: str) -> None:
    laws = {"aside": {"kind": "pd", "stiffness": 900.0}, "preset": "paper_optimum"}
    below = names_below(
        CouplingParameters, {"law": "pd", "laws": laws}, name, _struct_of
    )
    fields = {
        "laws.aside": ["stiffness", "damping"],
        "laws.preset": [
            field.encode_name for field in msgspec.structs.fields(MultiTerm)
        ],
        "plant": [
            field.encode_name for field in msgspec.structs.fields(PlantParameters)
        ],
        "laws": ["aside", "preset"],
        "law": [],
    }[name]
    assert below == [f"{name}.{field}" for field in fields]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["--replay", "run.mcap", "--foxglove"],
            "haptic bag export run.mcap --format foxglove",
        ),
        (
            ["--replay", "run.mcap", "--foxglove", "9000"],
            "--foxglove serves a running launch",
        ),
    ],
)
def test_a_replay_refuses_what_it_would_not_serve(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["view", *words]) == 2
    assert text in capsys.readouterr().err


def test_out_dir_names_a_chain_once(tmp_path: Path) -> None:
    launch = _into(read_launch("two_hands", {}), tmp_path)
    names = {
        file_of(s.parameters["path"], "run", n)
        for n, s in launch.nodes.items()
        if s.kind == "logger"
    }
    assert names == {str(tmp_path / f"run-{chain}.mcap") for chain in ("left", "right")}


def test_launch_shows_its_arguments_by_s(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["launch", "-s", "floor_drop"]) == 0
    assert "stiffness:=" in capsys.readouterr().out


@pytest.mark.slow
def test_out_dir_takes_all_recordings_and_the_plot(tmp_path: Path) -> None:
    with private_runtime_dir() as runtime:
        done = subprocess.run(
            [
                *HAPTIC,
                "launch",
                "two_loggers",
                "pace:=lockstep",
                "duration:=0.2",
                "--out-dir",
                "there/below",
                "--json",
            ],
            cwd=tmp_path,
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime)},
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
    figures = json.loads(done.stdout.splitlines()[-1])
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    there = sorted(path.suffix for path in (tmp_path / "there" / "below").iterdir())
    assert there == [".mcap", ".mcap", ".png"]
    assert all(
        path.startswith("there/below/")
        for path in [*figures["recordings"], figures["plot"]]
    )


# -- HAPTIC_RUN and stop
# ---------------------------------------------------------------------------------------------


@pytest.mark.process
def test_the_run_may_be_named_once_for_all(
    launch: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(launch.environment, "HAPTIC_RUN", "floor_drop")
    assert told(launch, "node", "list")["run"] == launch.run.run
    monkeypatch.setitem(launch.environment, "HAPTIC_RUN", "elsewhere")
    done = typed(launch, "node", "list", code=2)
    assert "no run is named 'elsewhere'" in done.stderr
    assert "HAPTIC_RUN" in done.stderr
    assert told(launch, "node", "list", "--run", "floor_drop")["run"] == launch.run.run


@pytest.mark.process
@pytest.mark.smoke
def test_stop_ends_a_launch_in_order(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        name = launch.run.run
        assert told(launch, "stop", "floor_drop") == {"stopped": [name]}
        # Whoever asked for the end has it: the launcher is gone, and its recording complete.
        # A run without an end of its own ends so.
        figures = launch.finish(code=0)
        assert figures["exit_reason"] == "stopped by haptic stop"
        (path,) = (tmp_path / "recordings").glob("*.mcap")
        assert Recording(path).complete
        assert "nothing is running" in launch.haptic("stop", code=2).stderr
        assert told(launch, "stop", "--all") == {"stopped": []}


# -- completion
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["fig2", "coverage", "two_rate"])
def test_a_former_name_of_a_study_answers_with_the_one_it_has_now(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code("study", name, "--json") == 2
    assert f"haptic study {name} is now haptic lab {name}" in capsys.readouterr().err
    assert f"lab.{name}" in VERBS.names()


@pytest.mark.parametrize(
    ("typed", "some"),
    [
        ("", {"launch", "bag", "topic", "study"}),
        ("bag pl", {"play", "plot"}),
        ("bag play x --ra", {"--rate"}),
        ("bag export x --format ", {"csv", "npz", "mat", "parquet"}),
        ("launch floor_d", {"floor_drop", "floor_drop_fast"}),
        ("launch floor_drop sti", {"stiffness:="}),
        ("launch floor_drop stiffness:=900 rate:=1000 dur", {"duration:="}),
        ("lab fig4 --ou", {"--out"}),
        ("study ", {"kmax", "chart"}),
        ("lab ", {"fig2", "fig4"}),
    ],
)
def test_completion(typed: str, some: set[str]) -> None:
    found = candidates(typed.split(" "))
    assert some <= set(found)
    assert all(word.startswith(typed.split(" ")[-1]) for word in found)


def test_completion_of_nonsense_is_nothing() -> None:
    assert candidates(["nosuch", "x"]) == []
    assert candidates(["launch", "nosuch", "x"]) == []
    # A file: the shell knows better.
    assert candidates(["bag", "info", ""]) == []


@given(st.lists(st.text(max_size=8), max_size=4))
def test_completion_never_fails(words: list[str]) -> None:
    last = words[-1] if words else ""
    assert all(word.startswith(last) for word in candidates(words))


@pytest.mark.process
def test_completion_knows_what_runs(launch: Running) -> None:
    for words, found in (
        (["topic", "echo", "/dev"], DEVICE_STATE),
        (["param", "get", "coup"], "coupling"),
        (["stop", "--json", "floor"], launch.run.run),
        (["law", "switch", ""], "pd"),
    ):
        assert (
            found
            in typed(launch, "completion", "words", "--", *words).stdout.splitlines()
        )


@pytest.mark.process
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_are_taken_by_their_shells(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    subprocess.run([shell, "-n"], input=script, text=True, check=True, timeout=30)
    if shell == "bash":
        ask = "COMP_WORDS=(haptic bag pl); COMP_CWORD=2; _haptic; echo ${COMPREPLY[@]}"
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-c", f"{script}\n{ask}"],
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        assert done.stdout.split() == ["play", "plot"]


# -- the status line, and colours
# ------------------------------------------------------------------------------------


@given(
    st.integers(1, 200), st.dictionaries(st.sampled_from(ORDER), st.text(max_size=30))
)
def test_what_is_shown_fits(width: int, parts: dict[str, str]) -> None:
    shown = fitted(parts, width)
    assert len("  ".join(parts[name] for name in shown)) <= width
    assert shown == [name for name in ORDER if name in shown]
    # The first of those to keep that fits is there.
    first = next(
        (name for name in PRIORITY if parts.get(name) and len(parts[name]) <= width),
        None,
    )
    assert first is None or first in shown


def resize(terminal: int, columns: int) -> None:
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))


def on_terminal(
    words: list[str],
    columns: int,
    environment: dict[str, str],
    folder: Path,
    narrow: int = 0,
) -> str:
    """Run a command with a terminal of some columns as standard error; return its output.

    `narrow`: columns to which it shrinks when a law is shown, which a bell marks.
    """
    ours, theirs = pty.openpty()
    resize(theirs, columns)
    with subprocess.Popen(
        [*HAPTIC, *words],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    ) as process:
        os.close(theirs)
        written = b""
        while process.poll() is None or select.select([ours], [], [], 0.0)[0]:
            if select.select([ours], [], [], 0.1)[0]:
                try:
                    written += os.read(ours, 65536)
                    if narrow and b"penetration" in written:
                        resize(ours, narrow)
                        written, narrow = written + b"\a", 0
                except OSError:
                    # The last one who could write has gone.
                    break
    os.close(ours)
    return written.decode()


@pytest.mark.process
@pytest.mark.parametrize("columns", slowly([40, 120], but=[40]))
def test_the_status_line_fits_its_terminal(tmp_path: Path, columns: int) -> None:
    with private_runtime_dir() as runtime:
        environment = {
            **os.environ,
            "HAPTIC_RUNTIME_DIR": str(runtime),
            "TERM": "xterm",
        }
        words = ["launch", "floor_drop", "duration:=2.4", "--no-plot"]
        written = on_terminal(
            words, columns, environment, tmp_path, narrow=40 if columns > 40 else 0
        )
    # Where a narrower terminal breaks the line, the cursor stays at the beginning of the first
    # piece: all of them are erased.
    for line in written.split(ERASE)[1:-1]:
        assert line.endswith(("\r", "\r\a", "\n"))
    # (One may have been under way.)
    for line in written.partition("\a")[2].split(ERASE)[2:]:
        assert "\n" in line or len(re.sub(r"\x1b\[[0-9;]*m", "", line)) <= 40
    lines = [
        re.sub(r"\x1b\[[0-9;]*m", "", line.strip("\r\a").split("\r\n")[0])
        for line in written.split(ERASE)
    ]
    shown = [
        line
        for line in lines
        if "mm" in line and "position" not in line and not line.startswith("[")
    ]
    assert shown
    assert max(map(len, shown)) < columns
    # The mass comes to rest on the floor, 1 mm deep.
    assert any(re.search(r"penetration \d\.\d\d mm", line) for line in shown)
    if columns > 100:
        assert any("law pd" in line for line in shown)
        assert "\x1b[32mactive\x1b[0m" in written


def test_colour_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert coloured("x", "red", Terminal()) == "\x1b[31mx\x1b[0m"
    assert coloured("x", "red", io.StringIO()) == "x"
    monkeypatch.setenv("NO_COLOR", "1")
    assert coloured("x", "red", Terminal()) == "x"


@pytest.mark.process
def test_nothing_is_coloured_in_a_pipe(launch: Running) -> None:
    for words, code in (
        (["topic", "list"], 0),
        (["topic", "echo", "/nosuch"], 2),
        (["node", "list"], 0),
    ):
        done = typed(launch, *words, code=code)
        assert "\x1b" not in done.stdout + done.stderr


def test_stop_of_what_is_gone(tmp_path: Path) -> None:
    with private_runtime_dir() as runtime:
        typed_in(
            tmp_path,
            "stop",
            "x",
            code=2,
            environment={"HAPTIC_RUNTIME_DIR": str(runtime)},
        )
    wait_for(lambda: not list(tmp_path.iterdir()), "nothing written")


# -- what a verb starts
# ------------------------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.smoke("None-1")
@pytest.mark.parametrize(("asked", "had"), [(None, "1"), ("4", "4")])
def test_linear_algebra_has_one_thread_unless_somebody_asks_for_more(
    asked: str | None, had: str
) -> None:
    code = "import os, sys; sys.argv = ['haptic', '--version']\n"
    code += "from nodes.cli.command import main\n"
    code += "try: main()\nexcept SystemExit: pass\nprint(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {
        name: value
        for name, value in os.environ.items()
        if name != "OPENBLAS_NUM_THREADS"
    }
    environment |= {} if asked is None else {"OPENBLAS_NUM_THREADS": asked}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == had
