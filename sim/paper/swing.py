"""The swing of a device in contact, from a recording: which frequency occurs, and what K_max it predicts (THEORY.md §9).

Colgate's condition at the frequency that one sees needs the law, the delay and the device's damping, but no mass. A swing below
the edge of stability is near the one at the edge, so a recording of a stable loop tells how stiff the law may get.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from messages.topics import DEVICE_STATE
from nodes.laws import CompiledLaw, Law
from nodes.laws.parse import parse_law
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.reader import Recording
from nodes.stability.k_max import without_spring
from nodes.stability.occurring import Edge, edge_at
from nodes.stability.plant import Plant
from sim.design.recorded_loop import measure

Vector = NDArray[np.float64]

_SHORTEST = 40


@dataclass(frozen=True)
class Swing:
    """What a recorded contact tells.

    Attributes
    ----------
    omega_rad_per_s : float
        Frequency of the swing [rad/s].
    decay_per_tick : float
        Factor by which it shrinks per tick; 1 at the edge.
    ticks : int
        Length of the contact that it was measured over.
    edge : Edge
        Colgate's condition at that frequency, for the law of the recording.
    stiffness_n_per_m : float
        Nominal K that was rendered [N/m].
    """

    omega_rad_per_s: float
    decay_per_tick: float
    ticks: int
    edge: Edge
    stiffness_n_per_m: float


def ringing(position: Vector) -> tuple[float, float]:
    """Fit one decaying swing about a constant: x[k] = a x[k−1] + b x[k−2] + c."""
    centred = position - position.mean()
    size = float(np.abs(centred).max())
    if len(position) < _SHORTEST or size < 1e-9:
        raise ValueError(f"{len(position)} ticks of contact that move by {size:.2g} m: nothing swings")
    x = centred / size
    # Instrumental variables two ticks further back: noise of the encoder does not bias the fit.
    rows = np.column_stack([x[3:-1], x[2:-2], np.ones(len(x) - 4)])
    tools = np.column_stack([x[1:-3], x[:-4], np.ones(len(x) - 4)])
    a, b, _ = np.linalg.lstsq(tools.T @ rows, tools.T @ x[4:], rcond=None)[0]
    if a * a + 4.0 * b >= 0.0 or b >= 0.0:
        raise ValueError("the contact creeps to rest, it does not swing: raise the stiffness or lower the damping")
    decay = math.sqrt(-b)
    return math.acos(max(-1.0, min(1.0, a / (2.0 * decay)))), decay


def recorded_swing(path: Path, damping: float | None = None) -> Swing:
    """Measure the swing of the longest contact of a recording, and what it says of K_max."""
    loop = measure(path)
    known = loop.damping if damping is None else damping
    if known is None:
        raise ValueError(f"{path}: not a virtual device: give its --damping")
    recording = Recording(path)
    law = _law(recording, path)
    compiled = law.compile(loop.period)
    states = recording.messages(DEVICE_STATE)
    force = np.array([state.force for state in states])
    axis = int(np.abs(force).max(axis=0).argmax())
    position = np.array([state.position[axis] for state in states])
    first, last = _longest(np.abs(force[:, axis]) > 0.0)
    # What is left of the impact dies first: the later half of the contact, or as much of it as still moves.
    inside = position[first:last]
    moving = np.flatnonzero(np.abs(inside - inside[-len(inside) // 8 :].mean()) > 1e-9)
    end = int(moving[-1]) + 1 if moving.size else len(inside)
    theta, decay = ringing(inside[min(end // 4, max(end - _SHORTEST, 0)) : end])
    derivative = without_spring(law, loop.period)
    edge = edge_at(derivative, Plant(loop.period, 1.0, known, loop.median), theta / loop.period, light=True)
    return Swing(theta / loop.period, decay, end, edge, _nominal(law, compiled))


def _nominal(law: Law, compiled: CompiledLaw) -> float:
    return float(getattr(law, "stiffness", compiled.h1))


def _longest(contact: NDArray[np.bool_]) -> tuple[int, int]:
    """Longest run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], contact.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return 0, 0
    longest = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
    return int(longest[0]), int(longest[1])


def _law(recording: Recording, path: Path) -> Law:
    for text in recording.metadata.get("parameters", {}).values():
        node = parse_yaml(text, "parameters")
        if isinstance(node, dict) and isinstance(node.get("laws"), dict):
            return parse_law(node["laws"][node["law"]], f"laws.{node['law']}")
    raise ValueError(f"{path}: holds no coupling, so no law")
