"""The results page: each section is one command, its output, date and machine.

A measured section is a record, ``sim/figures/measured/NAME.json``; an older section from before
records existed is Markdown, ``NAME.md``, and the page marks it. `page` renders all sections;
`measure` runs a command and replaces its section's file. Nothing on the page is written by hand.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from messages.errors import HapticError
from sim.measure.stopwatch import machine

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "sim" / "RESULTS.md"
MEASURED: Final = ROOT / "sim" / "figures" / "measured"
COLUMNS: Final = 100


class ResultsError(HapticError):
    """A section cannot be measured or written; the text gives the reason."""


class ResultSection(NamedTuple):
    """One section of the page."""

    title: str
    asks: str  # question of the reader
    command: str
    minutes: float  # rough duration on two idle cores [min]


SECTIONS: Final[dict[str, ResultSection]] = {
    "k_max": ResultSection(
        "K_max",
        "The largest stable stiffness of PD, one tick late.",
        "haptic study kmax --law pd --gain 3 --delay 1",
        0.1,
    ),
    "world": ResultSection(
        "Worlds that move",
        "How stiff PD may be before a wall, a spring, any world, in any hand.",
        "haptic study world --law pd --gain 3 --mass 0.1 --damping 1 --delay 1",
        0.1,
    ),
    "hands": ResultSection(
        "Two hands far apart",
        "The stiffest spring that is passive for any two hands, against the one-way delay.",
        "haptic study hands",
        1.0,
    ),
    "designs": ResultSection(
        "Designs",
        "The stiffest taps for a device and its delay, beside the best-tuned known laws.",
        "haptic study design --compare",
        30.0,
    ),
    "any_hand": ResultSection(
        "Designs for any hand",
        "The stiffest laws for any hand and any world, one tick late.",
        "haptic study design --for any_hand --delay 1 --taps 5",
        1.0,
    ),
    "relatives": ResultSection(
        "Relatives of a law",
        "The nearest relatives of a fractional law, tuned to one demand.",
        "haptic lab relatives",
        30.0,
    ),
    "price": ResultSection(
        "The price of not knowing",
        "What stiffness it costs not to know a joint of the device.",
        "haptic lab price",
        60.0,
    ),
    "identification": ResultSection(
        "Identification",
        "How often intervals contain the truth, and what designs for identified devices reach.",
        "haptic lab coverage --devices 240 --tune",
        120.0,
    ),
    "outside": ResultSection(
        "Devices that are not rigid",
        "False certainty and needless refusals, kind by kind, on a seed that no rule was made on.",
        "haptic lab coverage --outside --devices 252 --seconds 4 --seed 8",
        600.0,
    ),
    "tuned": ResultSection(
        "Tuning",
        "Random devices tuned end to end, judged by their true poles.",
        "haptic lab tuned --devices 40",
        120.0,
    ),
    "paper": ResultSection(
        "The paper's drop test",
        "Whether the paper's optimum is stiffer than PD, claim by claim.",
        "haptic lab fig4",
        30.0,
    ),
    "chart": ResultSection(
        "Speed against accuracy",
        "Which realisation, integrator, rate and proxy is worth its time.",
        "haptic study chart",
        60.0,
    ),
    "proxies": ResultSection(
        "Proxies in three axes",
        "How exact and how fast the proxy on shapes and meshes is.",
        "haptic lab proxies",
        10.0,
    ),
    "meshes": ResultSection(
        "Meshes of other people",
        "How a scene feels the meshes of ten Python packages, and whether rightly.",
        "haptic lab meshes pybullet robosuite example-robot-data dm-control rtb-data"
        " metaworld gymnasium-robotics gym-aloha gym-xarm safety-gymnasium --most 80"
        " --workers 2",
        5.0,
    ),
    "loop": ResultSection(
        "The loop",
        "Ticks a second and response, beside bare pyzmq + msgpack and bare C.",
        "haptic bench loop",
        10.0,
    ),
    "page": ResultSection(
        "The page", "What an open page costs the loop.", "haptic bench view", 5.0
    ),
    "faults": ResultSection(
        "Faults",
        "What each injected fault did to the loop, and how fast it was safe.",
        "haptic drill",
        5.0,
    ),
    "soak": ResultSection(
        "Soak",
        "Ten minutes in which loggers come and go, parameters change and nodes respawn.",
        "haptic drill soak",
        10.0,
    ),
    "mutations": ResultSection(
        "Mutations",
        "How many changes of a line, drawn from each room, its tests notice, some by a launch.",
        "python -m tests.support.mutations --only-drawn --near --drawn 180 --seed 7",
        90.0,
    ),
    "named_mutations": ResultSection(
        "Named mutations",
        "Changes of rules that a test must notice, those of safety among them.",
        "python -m tests.support.mutations",
        15.0,
    ),
}


class MeasuredOutput(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """Output of one command, with date and machine.

    Attributes
    ----------
    command : str
        Command as typed.
    date : str
        UTC, ISO 8601.
    commit : str
        Commit of the sources; ``+`` appended if they had changed.
    machine : str
        Processor, cores, system, Python.
    load : tuple of float
        Mean number of running processes in the minute before the start, and at the end.
    seconds : float
        Duration [s].
    printed : str
        Standard output.
    """

    command: str
    date: str
    commit: str
    machine: str
    load: tuple[float, float]
    seconds: float
    printed: str


def commit() -> str:
    """Return the commit of this checkout, with ``+`` appended if tracked files have changed."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        # Measured records are added to the tree while others are measured.
        changed = git(
            "status", "--porcelain", "--untracked-files=no", "--", "*.py", "*.yaml"
        )
        return git("rev-parse", "--short=8", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError) as error:
        raise ResultsError(
            f"{ROOT}: results are measured in a git checkout: {error}"
        ) from None


def measure(name: str, folder: Path = MEASURED) -> MeasuredOutput:
    """Run the command of a section and store its output.

    Parameters
    ----------
    name : str
        Name of the section.
    folder : Path
        Folder of the record.

    Returns
    -------
    MeasuredOutput
        The stored record.

    Raises
    ------
    ResultsError
        If the command fails, or this is no checkout. The section is unchanged.
    """
    line = SECTIONS[name].command
    of, host = commit(), machine()
    before = os.getloadavg()[0]
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="results-") as place:
        done = subprocess.run(
            [sys.executable, *_program(line)],
            cwd=place,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
            env={**os.environ, "NO_COLOR": "1", "PYTHONPATH": str(ROOT)},
        )
    if done.returncode != 0:
        # What it found may not come again.
        print(done.stdout, file=sys.stderr)
        raise ResultsError(
            f"{name}: {line} ended with exit code {done.returncode}; not recorded"
        )
    record = MeasuredOutput(
        command=line,
        date=time.strftime("%Y-%m-%dT%H:%MZ", time.gmtime()),
        commit=of,
        machine=f"{host['cpu']}, {host['cores']} cores, {host['system']}, Python {host['python']}",
        load=(round(before, 1), round(os.getloadavg()[0], 1)),
        seconds=round(time.monotonic() - began, 1),
        printed=done.stdout,
    )
    folder.mkdir(parents=True, exist_ok=True)
    text = msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"
    (folder / f"{name}.json").write_bytes(text)
    (folder / f"{name}.md").unlink(missing_ok=True)
    return record


def _program(line: str) -> list[str]:
    """Return what the interpreter runs for a command line: `haptic`, or `python` itself."""
    program, *words = shlex.split(line)
    return words if program == "python" else ["-m", "nodes.cli.command", *words]


def recorded(name: str, folder: Path = MEASURED) -> MeasuredOutput | str | None:
    """Return a section's record, its older Markdown, or None."""
    path = folder / f"{name}.json"
    if path.exists():
        return msgspec.json.decode(path.read_bytes(), type=MeasuredOutput)
    earlier = path.with_suffix(".md")
    return earlier.read_text(encoding="utf-8") if earlier.exists() else None


def _wrapped(printed: str) -> list[str]:
    lines = []
    for line in printed.rstrip().splitlines():
        # The study's files are in a deleted folder.
        if line.startswith("studies/"):
            continue
        within = textwrap.wrap(
            line,
            COLUMNS,
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
            replace_whitespace=False,
            drop_whitespace=True,
        )
        lines += [line] if len(line) <= COLUMNS else within
    return lines


def _typed(command: str) -> str:
    """Return a command as it is typed, over several lines if it is long."""
    lines = textwrap.wrap(
        f"$ {command}", COLUMNS - 2, subsequent_indent="    ", break_on_hyphens=False
    )
    return " \\\n".join(lines)


def section(name: str, folder: Path = MEASURED) -> str:
    """Render one section as Markdown."""
    told, found = SECTIONS[name], recorded(name, folder)
    head = f"## {told.title}\n\n{told.asks}\n\n"
    typed = f"```console\n{_typed(told.command)}\n"
    if isinstance(found, MeasuredOutput):
        where = (
            f"*{found.date}, commit {found.commit}, {found.seconds:g} s at a load of"
            f" {found.load[0]:g} to {found.load[1]:g}: {found.machine}.*"
        )
        typed = f"```console\n{_typed(found.command)}\n"
        printed = "\n".join(_wrapped(found.printed))
        return f"{head}{textwrap.fill(where, COLUMNS)}\n\n{typed}{printed}\n```\n"
    earlier = (
        "*Not measured yet.*" if found is None else f"{EARLIER}\n\n{found.strip()}"
    )
    return f"{head}{typed}```\n\n{earlier}\n"


EARLIER: Final = (
    "*Not measured with this command yet. What follows was measured in November 2026; machine, load"
    " and\ncommit are known only where the text names them.*"
)

HEAD: Final = """# Results

Written by `haptic lab results`; do not edit. Each section names its command, and where and when
it ran. *Xeon* is a quiet virtual machine (Intel Xeon, 2 cores, Linux 6.18, SCHED_FIFO, CPython
3.11.7 without PGO), *EPYC* an AMD EPYC, also 2 cores. Absolute times move by 20 % from run to run:
compare within one section, and between machines compare ratios only. All devices are virtual, or
emulators of real ones.
"""


def page(folder: Path = MEASURED) -> str:
    """Render the page from all measured sections."""
    return "\n".join([HEAD, *(section(name, folder) for name in SECTIONS)])
