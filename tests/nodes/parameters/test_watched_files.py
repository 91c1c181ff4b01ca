"""Watched files: complete documents only, a bad one reported once, no change missed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import WatchedFile, parse_yaml

# -- watched files
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def sigio_ignored() -> Iterator[None]:
    before = signal.signal(signal.SIGIO, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGIO, before)


def polled(watched: WatchedFile, times: int = 4) -> list[Any]:
    return [found for _ in range(times) if (found := watched.poll()) is not None]


def test_a_pipe_is_told_once_and_waited_for_by_nobody(tmp_path: Path) -> None:
    """The thread for requests waited until somebody wrote to the pipe."""
    path = tmp_path / "coupling.yaml"
    os.mkfifo(path)
    watched = WatchedFile(str(path))
    told: list[str] = []

    def poll() -> None:
        for _ in range(4):
            try:
                assert watched.poll() is None
            except ParameterError as error:
                told.append(str(error))

    thread = threading.Thread(target=poll, daemon=True)
    thread.start()
    thread.join(10.0)
    assert not thread.is_alive()
    assert len(told) == 1
    assert "is not a regular file, and is not watched" in told[0]
    path.unlink()
    path.write_text("ramp: 3\n", encoding="ascii")
    assert polled(watched) == [{"ramp": 3}]


WRITER = """
import json, sys
with open(sys.argv[1], "w") as file:
    for line in sys.stdin:
        file.write(json.loads(line))
        file.flush()
        print("written", flush=True)
"""


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.usefixtures("sigio_ignored")
def test_half_written_files_are_never_applied(tmp_path: Path) -> None:
    path = tmp_path / "coupling.yaml"
    path.write_text("ramp: 1\n")
    watched = WatchedFile(str(path))
    assert polled(watched) == [{"ramp": 1}]
    lines = [
        "law: pd\n",
        "laws:\n",
        "  pd: {kind: pd, stiffness: 1500.0, damping: 3.0}\n",
        "ramp: 1",
        "00\n",
    ]
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as writer:
        assert writer.stdin is not None
        assert writer.stdout is not None
        for line in lines:
            writer.stdin.write(json.dumps(line) + "\n")
            writer.stdin.flush()
            assert writer.stdout.readline() == "written\n"
            # What stands there now is valid YAML of its own (ramp: 1, before it is 100), and still
            # not applied.
            assert polled(watched) == []
        writer.stdin.close()
        writer.wait()
    assert polled(watched) == [parse_yaml("".join(lines), "test")]
    assert polled(watched) == []


MANY = """
import os, sys
path, count = sys.argv[1], int(sys.argv[2])
for k in range(1, count + 1):
    with open(path, "w") as file:
        for part in (f"first: {k}", f"{k}", "\\nsecond: ", f"{k}", f"{k}\\n"):
            file.write(part)
            file.flush()
    replaced = path + ".new"
    with open(replaced, "w") as file:
        file.write(f"first: {k}{k}")
        file.flush()
        file.write(f"\\nsecond: {k}{k}\\n")
    os.replace(replaced, path)
"""


@pytest.mark.process
@pytest.mark.usefixtures("sigio_ignored")
def test_a_reader_beside_a_busy_writer_sees_whole_documents_only(
    tmp_path: Path,
) -> None:
    # The writer opens the file anew as soon as it has closed it, so leases are broken all the time;
    # without SIGIO ignored the first broken one would end this process.
    path = tmp_path / "busy.yaml"
    path.write_text("first: 0\nsecond: 0\n")
    watched = WatchedFile(str(path))
    seen = []
    with subprocess.Popen([sys.executable, "-c", MANY, str(path), "400"]) as writer:
        while writer.poll() is None:
            seen += polled(watched, 1)
    seen += polled(watched)
    assert all(document["first"] == document["second"] for document in seen)
    assert seen[-1] == {"first": 400400, "second": 400400}


@pytest.mark.process
def test_a_lease_that_is_broken_is_survived_by_a_node_that_ignores_sigio(
    tmp_path: Path,
) -> None:
    code = (
        "import signal, fcntl, os, sys\nsignal.signal(signal.SIGIO, signal.SIG_IGN if sys.argv[2]"
        " == 'ignored' else signal.SIG_DFL)\nfile = open(sys.argv[1]); fcntl.fcntl(file,"
        " fcntl.F_SETLEASE, fcntl.F_RDLCK)\nprint('leased', flush=True); sys.stdin.readline()\n"
    )
    path = tmp_path / "file"
    path.write_text("a")
    codes = {}
    for how in ("ignored", "default"):
        with subprocess.Popen(
            [sys.executable, "-c", code, str(path), how],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as holder:
            assert holder.stdout is not None
            assert holder.stdin is not None
            assert holder.stdout.readline() == "leased\n"
            with pytest.raises(BlockingIOError):
                os.open(path, os.O_WRONLY | os.O_NONBLOCK)
            if how == "ignored":
                holder.stdin.close()
            codes[how] = holder.wait()
    # The second line is what the first one protects from: it is the reason for the handler in
    # nodes/base/node.py.
    assert codes == {"ignored": 0, "default": -signal.SIGIO}


def test_replacing_touching_and_removing(tmp_path: Path) -> None:
    path = tmp_path / "coupling.yaml"
    watched = WatchedFile(str(path))
    assert polled(watched) == []
    path.write_text("a: 1\n")
    assert polled(watched) == [{"a": 1}]
    other = tmp_path / "other"
    other.write_text("a: 2\n")
    os.replace(other, path)
    assert polled(watched) == [{"a": 2}]
    os.utime(path, ns=(1, 1))
    assert polled(watched) == [{"a": 2}]
    path.unlink()
    assert polled(watched) == []


@pytest.mark.parametrize("content", [b"a: [1", b"\xff\xfe", b"{a: 1, a: 2}"])
def test_a_bad_file_is_told_once_and_the_next_good_one_applied(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "coupling.yaml"
    path.write_bytes(content)
    watched = WatchedFile(str(path))
    assert watched.poll() is None
    with pytest.raises(ParameterError, match=r"coupling\.yaml"):
        watched.poll()
    assert polled(watched) == []
    path.write_text("good: 1\n")
    assert polled(watched) == [{"good": 1}]
