"""What a history that turns with the surface costs: the coupling's compiled rendering in three axes, in both frames.

The kernel's own function on a coupling's own state, without sockets, along a way around a ball: the normal turns in every tick.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from nodes.compiled.kernels.machine import record_at
from nodes.compiled.kernels.sources import record_of
from nodes.coupling.kernel import _render as render
from nodes.coupling.render import begin_turning
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.coupling.state import CouplingState
from nodes.laws.pd import PD
from sim.measure.stopwatch import Timing, interleaved

FRAMES = ("world", "surface")

_TICKS = 20_000
_RADIUS, _DEEP, _STEP = 0.035, 2e-3, 4e-4
_look = record_at(record_of(CouplingState))


def _play(address: int, normals: Any, position: Any, proxy: Any, force: Any) -> float:
    """Render along a way: from the normals alone, so that little beside the tick is timed."""
    s = _look(address)
    felt = 0.0
    for k in range(len(normals)):
        normal = normals[k]
        for i in range(3):
            proxy[i] = _RADIUS * normal[i]
            position[i] = (_RADIUS - _DEEP) * normal[i]
        render(s, position, proxy, normal, -_DEEP, True, force, s.pushes[s.axes - 1] + 1)
        felt += force[2]
    return felt


_played: Any = numba.njit(_play)


def time_turning(rounds: int, step: Callable[[str], None]) -> dict[str, Timing]:
    """Time a tick of the coupling's compiled rendering on three axes, with the history in each frame."""
    angle = _STEP / _RADIUS * np.arange(_TICKS)
    normals = np.stack([np.cos(angle), 0.6 * np.sin(angle), 0.8 * np.sin(angle)], axis=1)
    law = PD(stiffness=800.0, damping=2.0).compile(0.002)
    kept = []

    def job(frame: str) -> Callable[[], object]:
        renderer = Renderer([0, 1, 2], 64, CouplingState())
        begin_turning(renderer.state, frame)
        renderer.law = ActiveLaw("pd", "", law, renderer.histories)
        kept.append(renderer)
        at, rooms = ctypes.addressof(renderer.state), [np.zeros(3) for _ in range(3)]
        return lambda: _played(at, normals, *rooms)

    return interleaved({frame: (job(frame), _TICKS) for frame in FRAMES}, rounds, step)
