"""A launch with a hand that holds the device below a floor, robust on a busy machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from messages.types import Receipt
from nodes.recording.reader import Recording


def recorded(launch_folder: Path, figures: dict[str, Any]) -> Recording:
    return Recording(launch_folder / figures["recording"])


def receipts(recording: Recording) -> list[Receipt]:
    found: list[Receipt] = recording.messages("/coupling/receipt")
    return found


HELD = """
summary: A hand holds the device 3 mm below a floor
run: {rate: 500.0, cpu: any, fifo: 0}
nodes:
  driver:
    kind: sim_driver
    parameters:
      device:
        mass: 0.1
        damping: 1.0
        hand: {mass: 0.1, damping: 12.0, stiffness: 300.0, path: [[0.0, -0.003]]}
  environment: {kind: environment, parameters: {surface: {kind: plane, position: 0.0}}}
  coupling:
    kind: coupling
    parameters:
      law: pd
      laws:
        pd: {kind: pd, stiffness: 500.0, damping: 3.0}
        pd_alpha:
          {kind: pd_alpha, stiffness: 500.0, damping: 3.0, order: 1.2, taps: 10, gains: paper}
      fallback: {damping: 5.0}
      stability: refuse
      plant: {mass: 0.1, damping: 1.0, delay: 2.0}
  logger: {kind: logger}
"""
"""The hand is damped and stays within 3 mm, whatever a busy machine does.

No core and no priority of its own, so that other loops are not starved. Laws are judged for a
device and delay worse than the real ones, so what is refused here would still be stable.
"""
