"""Facts of this installation for a bug report: versions, machine, load, configuration.

Markdown to paste. Paths below the user's home directory begin with ``~``, so that a report names
nobody; of keys only their number is reported.
"""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from messages.errors import HapticError
from messages.transport.keys import key_dir
from nodes.launcher.runs import runs
from nodes.parameters.installed import OURS, version

PACKAGES: Final = (
    "pyzmq",
    "msgspec",
    "msgpack",
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "mcap",
    "zstandard",
    "pyyaml",
    "websockets",
    "matplotlib",
    "mujoco",
    "rclpy",
)
"""Packages that a fault may come from; those that are not installed are left out."""

SETTINGS: Final = (
    "CC",
    "COLUMNS",
    "LANG",
    "LC_ALL",
    "NO_COLOR",
    "NUMBA_CACHE_DIR",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "PYTHONPATH",
    "ROS_DISTRO",
    "TMPDIR",
    "XDG_CACHE_HOME",
    "XDG_RUNTIME_DIR",
)
"""Environment variables that affect us, besides those that begin with ``HAPTIC_``."""


def without_home(text: str) -> str:
    """Return a text in which the user's home directory is ``~``."""
    home = str(Path.home())
    return text.replace(home, "~") if len(home) > 1 else text


def _commit() -> str:
    """Return the commit of a checkout; empty for an installed package."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=8"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "a checkout whose commit git does not tell"
    return done.stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    named = (
        line.partition(":")[2].strip()
        for line in lines
        if line.startswith("model name")
    )
    return next(named, platform.machine())


def _system() -> str:
    with open("/etc/os-release", encoding="utf-8") as file:
        fields = dict(line.rstrip().partition("=")[::2] for line in file)
    return fields.get("PRETTY_NAME", "").strip('"')


def _keys() -> str:
    try:
        folder = key_dir()
        return f"{len(list((folder / 'allowed').glob('*.key')))} machines are allowed"
    except (HapticError, OSError) as error:
        return str(error)


def gathered() -> dict[str, dict[str, str]]:
    """Gather what a report needs.

    Returns
    -------
    dict
        By section, ``versions``, ``machine`` and ``configuration``: name to value.
    """
    import zmq

    found = {name: version(name) for name in PACKAGES}
    ours = version(OURS) or "not installed as a package"
    commit = _commit()
    try:
        system = _system()
    except OSError:
        system = ""
    load = ", ".join(f"{mean:.2f}" for mean in os.getloadavg())
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    try:
        launched = [
            f"{run.scenario} ({len(run.nodes)} nodes)" for run in runs().values()
        ]
    except (HapticError, OSError) as error:
        launched = [str(error)]
    settings = {
        name: value
        for name, value in sorted(os.environ.items())
        if name in SETTINGS or name.startswith("HAPTIC_")
    }
    return {
        "versions": {
            "haptic-nodes": f"{ours}{f', commit {commit}' if commit else ''}",
            "Python": f"{platform.python_implementation()} {platform.python_version()}",
            "libzmq": zmq.zmq_version(),
            **{name: one for name, one in found.items() if one is not None},
        },
        "machine": {
            "processor": f"{_processor()}, {os.cpu_count()} cores,"
            f" {len(os.sched_getaffinity(0))} to be used",
            "memory": f"{memory:.1f} GiB",
            "system": ", ".join(
                filter(None, (system, platform.release(), platform.machine()))
            ),
            "load over 1, 5 and 15 min": load,
        },
        "configuration": {
            "launches that run": ", ".join(launched) or "none",
            "keys": without_home(_keys()),
            **{name: without_home(value) for name, value in settings.items()},
        },
    }


def markdown(
    found: Mapping[str, Mapping[str, str]], checks: Iterable[Mapping[str, Any]]
) -> str:
    """Render a report, with what `haptic doctor` found, as Markdown."""
    lines = []
    for section, rows in found.items():
        lines += [f"### {section.capitalize()}", ""]
        lines += [f"- {name}: {value}" for name, value in rows.items()] + [""]
    lines += ["### haptic doctor", ""]
    lines += [
        f"- {check['state']}: {check['name']}: {without_home(check['found'])}"
        for check in checks
    ]
    return "\n".join(lines)
