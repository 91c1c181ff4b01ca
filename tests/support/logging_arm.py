"""A launch of the arm that logs every call (tests/fixtures/installed), and what it logged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

STIFFNESS, DAMPING = 1000.0, 0.5


LAW_DAMPING = 3.0


def scene(
    folder: Path,
    run: dict[str, Any] | None = None,
    chain: dict[str, Any] | None = None,
    **arm: Any,
) -> str:
    """Write a launch file with the logging arm, by default 1 mm inside a floor of 1000 N/m."""
    more = chain or {}
    safety = {"damping": DAMPING, **arm.pop("safety", {})}
    content = {
        "summary": "for a test",
        "run": {"duration": 0.0, **(run or {})},
        "nodes": {
            "driver": {
                "kind": "logging_arm",
                "parameters": {"diary": str(folder / "diary"), "safety": safety, **arm},
            },
            "environment": {
                "kind": "environment",
                "parameters": {"surface": {"kind": "plane", "axis": "z"}},
                **more,
            },
            "coupling": {
                "kind": "coupling",
                "parameters": {
                    "law": "pd",
                    "laws": {
                        "pd": {
                            "kind": "pd",
                            "stiffness": STIFFNESS,
                            "damping": LAW_DAMPING,
                        }
                    },
                },
                **more,
            },
            "logger": {
                "kind": "logger",
                "required": False,
                "parameters": {"path": "run.mcap", "overwrite": True},
                **more,
            },
        },
    }
    path = folder / "enemy.yaml"
    path.write_text(json.dumps(content))  # JSON is YAML
    return str(path)


def diary(folder: Path) -> list[tuple[float, str, float]]:
    """Read what the arm has logged so far: whole lines only."""
    path = folder / "diary"
    text = path.read_text() if path.exists() else ""
    return [
        (when, call, value)
        for when, call, value in map(json.loads, text.splitlines()[: text.count("\n")])
    ]


def forces(folder: Path) -> list[float]:
    """List the forces that it was given."""
    return [value for _, call, value in diary(folder) if call == "write_force"]
