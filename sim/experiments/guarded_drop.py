"""Effect of the passivity guard: the drop with and without it, and its cost in stiffness.

Without the guard, a wall beyond K_max generates energy at every bounce; with it, the mass comes to
rest. The guard lowers forces on the way out, so the wall at rest (mean force over mean penetration)
is softer than nominal.
"""

from dataclasses import dataclass, replace

import numpy as np

from nodes.driver.passivity import PassivityParameters
from nodes.laws.pd import PD
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.play.one_axis import Trace, run

SHARE = 0.25  # last fraction of a run, evaluated as rest


@dataclass(frozen=True, kw_only=True)
class Drop:
    """Result of one drop."""

    stiffness: float  # nominal stiffness K [N/m]
    guarded: bool  # whether the guard was on
    # largest energy that the wall had generated at any time, net of the energy put in [J]
    energy_max_j: float
    unrest_m: float  # peak-to-peak position at the end [m]
    # Mean force over mean penetration at the end; None if the mass leaves the wall in that
    # time.
    felt_n_per_m: float | None
    impact_n_per_m: float  # largest force over largest penetration


def measure(trace: Trace, stiffness: float, guarded: bool, delay: float) -> Drop:
    """Measure a drop on a floor at height 0."""
    whole = int(delay)
    part = delay - int(delay)
    # During tick k first the force of tick k−i−1 acts for its fraction, then that of k−i.
    late = np.concatenate((np.zeros(whole + 1), trace.force))
    acting = (
        part * late[: len(trace.force)] + (1.0 - part) * late[1 : len(trace.force) + 1]
    )[:-1]
    energy = np.concatenate(([0.0], np.cumsum(acting * np.diff(trace.measured))))
    end = slice(int((1.0 - SHARE) * len(trace.position)), None)
    rest, force = trace.measured[end], trace.force[end]
    lies = bool(np.all(rest < 0.0))
    deepest = -float(trace.measured.min())
    return Drop(
        stiffness=stiffness,
        guarded=guarded,
        energy_max_j=max(float(energy.max()), 0.0),
        unrest_m=float(np.ptp(rest)),
        felt_n_per_m=float(force.mean() / -rest.mean()) if lies else None,
        impact_n_per_m=float(trace.force.max()) / deepest if deepest > 0.0 else 0.0,
    )


def compare(
    device: DeviceModel,
    wall: float,
    damping: float,
    period: float,
    guard_damping: float,
    next_tick: bool,
    ticks: int,
) -> list[Drop]:
    """Drop a mass on a PD wall, without and with the guard."""
    found = []
    for guard in (None, PassivityParameters(stiffness=wall, damping=guard_damping)):
        floor = drop_scene(device, period, height=device.position)
        scene = replace(floor, next_tick=next_tick, passivity=guard)
        trace = run(scene, PD(stiffness=wall, damping=damping).compile(period), ticks)
        found.append(
            measure(trace, wall, guard is not None, device.delay + float(next_tick))
        )
    return found
