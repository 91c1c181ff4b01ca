"""The installed launch files as tests are parametrised by them, read once per process."""

from __future__ import annotations

from functools import cache

from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Launch


@cache
def every_launch() -> dict[str, Launch]:
    """Return every installed launch without arguments, by name."""
    return {
        name: launch_file.read(name, {}) for name in sorted(scenario_files.scenarios())
    }
