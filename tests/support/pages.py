"""Run the commands of a page as typed by a reader: blocks of ``sh``, line by line.

A block of ``text`` right after one of ``sh`` shows the output: each of its lines must be printed,
with any numbers in place of its numbers and anything in place of ``…``.

A launch started with ``&`` runs until its block ends. Long commands are run with the options that
their own ``--help`` offers for shortening; nothing else is changed.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import zmq

from messages.transport.requests import ControlError, call
from nodes.launcher.runs import RunInfo
from sim.measure.haptic_commands import COMPILE_TIMEOUT
from tests.support.launching import DEADLINE, assert_nothing_left, wait_for

_BLOCK = re.compile(
    r"^```sh\n(.*?)^```$(?:\n+^```text\n(.*?)^```$)?", re.MULTILINE | re.DOTALL
)
_FILE = re.compile(
    r"^`([\w./-]+/[\w.-]+)`\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
_NUMBER = re.compile(r"[-+−]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?")
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_OPERATORS = "&|;<>"


@dataclass(frozen=True)
class Block:
    """One block of commands.

    Attributes
    ----------
    lines : tuple of str
        The commands; continued lines are joined, comments and empty lines left out.
    prints : tuple of str
        What the page says they print.
    """

    lines: tuple[str, ...]
    prints: tuple[str, ...]


def blocks(text: str) -> list[Block]:
    """Return the blocks of commands of a page.

    Parameters
    ----------
    text : str
        Markdown.

    Returns
    -------
    list of Block
        In order.
    """
    found = []
    for block, printed in _BLOCK.findall(text):
        lines = block.replace("\\\n", " ").splitlines()
        found.append(
            Block(
                tuple(
                    line
                    for line in lines
                    if line.strip() and not line.lstrip().startswith("#")
                ),
                tuple(line.strip() for line in printed.splitlines() if line.strip()),
            )
        )
    return found


def promised(prints: Iterable[str], said: str) -> list[str]:
    """Return the promised lines that were not printed.

    Parameters
    ----------
    prints : iterable of str
        Lines of the page.
    said : str
        What the commands printed.

    Returns
    -------
    list of str
        Promises that were not kept.
    """
    broken = []
    for line in prints:
        parts = [_NUMBER.sub("0", part) for part in re.split("…", line)]
        pattern = ".*".join(
            re.escape(part).replace("0", _NUMBER.pattern) for part in parts
        )
        if not re.search(pattern, said):
            broken.append(line)
    return broken


def written_files(text: str) -> dict[str, str]:
    """Return the files that a page shows: a path alone on a line, then a block of code.

    Parameters
    ----------
    text : str
        Markdown.

    Returns
    -------
    dict of str to str
        Path to content.
    """
    return dict(_FILE.findall(text))


def links(text: str) -> list[str]:
    """Return the targets of links and pictures.

    Parameters
    ----------
    text : str
        Markdown.

    Returns
    -------
    list of str
        Targets outside code, in order.
    """
    return _LINK.findall(re.sub(r"`[^`\n]*`", "", _FENCED.sub("", text)))


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings.

    Parameters
    ----------
    text : str
        Markdown.

    Returns
    -------
    set of str
        Lower case, blanks as hyphens, punctuation left out.
    """
    headings = _HEADING.findall(_FENCED.sub("", text))
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in headings
    }


@dataclass(frozen=True)
class Command:
    """One line of a block.

    Attributes
    ----------
    line : str
        As it is run.
    background : bool
        Whether it ended with ``&``.
    """

    line: str
    background: bool

    @property
    def words(self) -> list[str]:
        """Return its words, up to the first shell operator."""
        lexer = shlex.shlex(self.line, posix=True, punctuation_chars=_OPERATORS)
        lexer.whitespace_split = True
        found = []
        for token in lexer:
            if set(token) <= set(_OPERATORS):
                break
            found.append(token)
        return found


def command(line: str, shorter: Mapping[str, str]) -> Command:
    """Parse a line, and shorten the command.

    Parameters
    ----------
    line : str
        As it stands in the block.
    shorter : mapping of str to str
        From the first words of a command to words that are added after its last one. The longest
        that fits is taken.

    Returns
    -------
    Command
        Without comment and ``&``.
    """
    lexer = shlex.shlex(line, posix=False, punctuation_chars=_OPERATORS)
    lexer.whitespace_split = True
    tokens = list(lexer)
    background = tokens[-1] == "&"
    if background:
        tokens.pop()
    end = next(
        (i for i, token in enumerate(tokens) if set(token) <= set(_OPERATORS)),
        len(tokens),
    )
    start = [key for key in shorter if tokens[: len(key.split())] == key.split()]
    if start and not background:
        tokens[end:end] = shorter[max(start, key=len)].split()
    return Command(" ".join(tokens), background)


class Shell:
    """Runs commands in one folder, as one user at one terminal.

    Parameters
    ----------
    folder : Path
        Working directory.
    runtime_dir : Path
        Private runtime directory.
    programs : Path
        Where ``haptic`` and ``python`` are.

    Attributes
    ----------
    background : list of subprocess.Popen
        What was started with ``&`` and has not been ended.
    """

    def __init__(self, folder: Path, runtime_dir: Path, programs: Path) -> None:
        self.folder = folder
        self.runtime_dir = runtime_dir
        self.background: list[subprocess.Popen[bytes]] = []
        self._log = folder / "background.txt"
        self._environment = {
            **os.environ,
            # As after `source .venv/bin/activate`.
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "HAPTIC_RUNTIME_DIR": str(runtime_dir),
            "HAPTIC_KEYS": str(folder / "keys"),
        }

    def run(self, wanted: Command) -> str:
        """Run a command to its end, or in the background until it is up; ``wait`` waits for it.

        Parameters
        ----------
        wanted : Command
            The command.

        Returns
        -------
        str
            What it wrote to standard output; nothing for one in the background.
        """
        shell = ["bash", "-euo", "pipefail", "-c"]
        if wanted.background:
            with open(self._log, "ab") as log:
                process = subprocess.Popen(
                    [*shell, f"exec {wanted.line}"],
                    cwd=self.folder,
                    env=self._environment,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    process_group=0,
                )
            self.background.append(process)
            if wanted.words[:2] == ["haptic", "launch"]:
                wait_for(
                    lambda: process.poll() is not None or self._ticks(),
                    f"{wanted.line}: the first tick",
                )
            assert process.poll() is None, (
                f"{wanted.line} ended: {self._log.read_text(encoding='utf-8')}"
            )
            return ""
        if wanted.words == ["wait"]:
            for process in self.background:
                assert process.wait(timeout=DEADLINE) == 0, self._log.read_text(
                    encoding="utf-8"
                )
            self.background.clear()
            return ""
        done = subprocess.run(
            [*shell, wanted.line],
            cwd=self.folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=COMPILE_TIMEOUT,
            check=False,
        )
        assert done.returncode == 0, (
            f"$ {wanted.line}\n{done.stdout}{done.stderr}exit code {done.returncode}"
        )
        return done.stdout

    def _ticks(self) -> bool:
        with contextlib.suppress(ControlError), zmq.Context() as context:
            for path in self.runtime_dir.glob("runs/*/run.json"):
                run = msgspec.json.decode(path.read_bytes(), type=RunInfo)
                drivers = [
                    setup.control
                    for name, setup in run.nodes.items()
                    if name.rpartition("/")[2] == "driver"
                ]
                if drivers and all(
                    call(context, driver, "status", timeout=1.0)["ticks"]
                    for driver in drivers
                ):
                    return True
        return False

    def end_background(self) -> None:
        """End background commands as Ctrl-C does, and assert that nothing is left."""
        for process in reversed(self.background):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            code = process.wait(timeout=DEADLINE)
            assert code in (0, 130), (
                f"exit code {code}: {self._log.read_text(encoding='utf-8')}"
            )
        self.background.clear()
        assert_nothing_left(self.runtime_dir)


@contextlib.contextmanager
def shell(
    folder: Path, runtime_dir: Path, programs: Path = Path(sys.executable).parent
) -> Iterator[Shell]:
    """Return a shell for a with block.

    Parameters
    ----------
    folder : Path
        Working directory.
    runtime_dir : Path
        Private runtime directory.
    programs : Path
        Where ``haptic`` and ``python`` are; those of this environment when left out.

    Yields
    ------
    Shell
        Where to run them; what was left in the background is ended at the end.
    """
    opened = Shell(folder, runtime_dir, programs)
    try:
        yield opened
    finally:
        opened.end_background()
