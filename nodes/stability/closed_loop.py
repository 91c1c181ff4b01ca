"""The rendered impedance of a law and the exact poles of its loop with a known device.

The force is held between two ticks, so device, delay and taps form one polynomial in z without
approximation (THEORY.md §3): the loop is stable iff its largest root lies inside the unit circle.
Nothing here runs in the loop: a law is judged when it is parsed, displayed, changed or designed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.effective_damping import damping_needed, least
from nodes.stability.pair import as_one, held_pair, reduced_mass
from nodes.stability.plant import Plant, held_plant, held_step
from nodes.stability.roots import largest_root


@dataclass(frozen=True)
class Rendered:
    """What a law renders at one sampling period and delay."""

    h1_n_per_m: float  # H(1), the stiffness at rest [N/m]
    h_nyquist_n_per_m: float  # H(−1), which amplifies encoder noise [N/m]
    # least f(ω) over 0 < ω ≤ ω_N of the law without delay [N s/m]; a lower one damps more (paper,
    # eq. 9)
    f_min_n_s_per_m: float
    f_min_rad_per_s: float  # frequency of that minimum [rad/s]
    # f(ω_N) with H(1) as the spring, or `nominal` if given; with K, as in the paper, larger by the
    # leak D(1)·T/2 [N s/m]
    f_nyquist_n_s_per_m: float
    # mean of f over (0, ω_N): T·D(1)/2 (waterbed, THEORY.md §2) [N s/m]
    f_mean_n_s_per_m: float
    # least device damping with which the law is passive at this delay (Colgate) [N s/m]
    damping_needed_n_s_per_m: float
    # largest factor on the whole law that is passive on this device; None without a declared
    # damping
    passive_scale: float | None
    # largest pole of the closed loop; None without a declared mass
    pole_radius: float | None


def closed_loop(law: CompiledLaw, plant: Plant) -> NDArray[np.float64]:
    """Return the characteristic polynomial of taps, delay and device, highest power first.

    Raises ValueError for laws with sections and for pairs, whose polynomial is ill-conditioned.
    """
    plant = as_one(plant)
    if plant.partner is not None:
        raise ValueError(
            "plant: a pair has no well-conditioned polynomial; use pole_radius"
        )
    if law.sections:
        raise ValueError(
            "law: recursive sections have no well-conditioned polynomial; use pole_radius"
        )
    held = held_plant(plant)
    numerator = np.array(held.numerator)
    # a damping of 1e300 N s/m leaves no motion
    numerator = np.trim_zeros(numerator, "b") if numerator.any() else numerator
    # With z² N + z N' the loop has one common factor z if the delay is whole.
    padding = held.whole + len(numerator) - 2 + len(law.taps) - 1
    total = np.concatenate([held.denominator, np.zeros(padding)])
    feedback = np.convolve(numerator, law.taps)
    total[len(total) - len(feedback) :] += feedback
    return total


def pole_radius(law: CompiledLaw, plant: Plant) -> float:
    """Return the largest pole radius of the loop; stable iff below 1, inf if it overflows."""
    try:
        plant = as_one(plant)
        if not law.sections and plant.partner is None:
            return largest_root(closed_loop(law, plant))
        return float(np.abs(np.linalg.eigvals(state_matrix(law, plant))).max())
    except (ArithmeticError, np.linalg.LinAlgError):
        # a loop that overflows, e.g. with a mass of 1e-300 kg, counts as unstable
        return math.inf


def state_matrix(law: CompiledLaw, plant: Plant) -> NDArray[np.float64]:
    """Return one tick of the closed loop as a matrix: device, history, sections, forces.

    The state is [x, v·T, x₋₁ … x₋ₙ, (y₋₁, y₋₂) per section, u₋₁ … u₋ᵢ₋₁]; forces are scaled to
    lengths by T²/m for balance. A pair has the states of both bodies
    (`nodes.stability.pair.held_pair`) in place of x and v·T.
    """
    plant = as_one(plant)
    if plant.partner is not None:
        return tick_matrix(
            law, plant.period**2 / reduced_mass(plant), *held_pair(plant)
        )
    whole, (a11, a12, a21, a22), new, old = held_step(plant)
    period = plant.period
    device = np.array([[a11, a12 / period], [a21 * period, a22]])
    pushes = [
        (lag, np.array([of[0], of[1] * period]))
        for lag, of in ((whole, new), (whole + 1, old))
    ]
    return tick_matrix(law, period * period / plant.mass, device, pushes)


def tick_matrix(
    law: CompiledLaw,
    unit: float,
    device: NDArray[np.float64],
    pushes: Sequence[tuple[int, NDArray[np.float64]]],
) -> NDArray[np.float64]:
    """Return one tick of the loop of a law and any linear device with position as first state.

    `unit`: T²/m, which scales forces to lengths [m/N]. `device`, shape (s, s): its own matrix.
    `pushes`: age of a force [ticks] and its effect on the state, shape (s,). The state is [device
    state, x₋₁ … x₋ₙ, (y₋₁, y₋₂) per section, u₋₁ … of the longest lag].
    """
    states = len(device)
    history = max(len(law.taps) - 1, 1 if law.sections else 0)
    first_section = states + history
    first_force = states + history + 2 * len(law.sections)
    size = first_force + max(lag for lag, _ in pushes)
    force = np.zeros(size)
    force[0] = -law.taps[0] * unit
    force[states : states - 1 + len(law.taps)] = -np.array(law.taps[1:]) * unit
    step = np.zeros((size, size))
    for s, (b0, b1, a1, a2) in enumerate(law.sections):
        row = first_section + 2 * s
        step[row, 0] = b0 * unit
        step[row, states] = b1 * unit
        step[row, row] = -a1
        step[row, row + 1] = -a2
        step[row + 1, row] = 1.0
        force -= step[row]
    step[:states, :states] = device
    for lag, push in pushes:
        if lag == 0:
            step[:states] += np.outer(push / unit, force)
        else:
            step[:states, first_force + lag - 1] += push / unit
    if history:
        step[states, 0] = 1.0
        step[
            np.arange(states + 1, states + history),
            np.arange(states, states + history - 1),
        ] = 1.0
    if size > first_force:
        step[first_force] += force
    step[np.arange(first_force + 1, size), np.arange(first_force, size - 1)] = 1.0
    return step


def rendered(
    law: CompiledLaw, loop: Plant | float, nominal: float | None = None
) -> Rendered:
    """Return what a law renders, in a loop with a device or for a sampling period [s] alone.

    `nominal` is the K that f(ω) uses as the spring [N/m]; by default H(1), the actual stiffness.
    With the law's nominal K, f is the paper's and its mean shows the leak.
    """
    plant = loop if isinstance(loop, Plant) else None
    period, delay = (
        (loop.period, loop.delay) if isinstance(loop, Plant) else (loop, 0.0)
    )
    spring = law.h1 if nominal is None else nominal
    offset = 0.5 * period * (law.h1 - spring)
    where, lowest = least(law, period)
    needed = damping_needed(law, period, delay)
    return Rendered(
        h1_n_per_m=law.h1,
        h_nyquist_n_per_m=law.h_nyquist,
        f_min_n_s_per_m=lowest + offset,
        f_min_rad_per_s=where,
        f_nyquist_n_s_per_m=0.5 * period * (law.h_nyquist - spring),
        f_mean_n_s_per_m=offset,
        damping_needed_n_s_per_m=needed,
        passive_scale=(
            None
            if plant is None or needed <= 0.0
            else plant.damping_of_any_hand / needed
        ),
        pole_radius=None if plant is None else pole_radius(law, plant),
    )


def law_figures(law: CompiledLaw, loop: Plant | float) -> dict[str, Any]:
    """Return `rendered` with taps and delay as JSON values.

    For a law with own code only H(1) is known.
    """
    delay = loop.delay if isinstance(loop, Plant) else 0.0
    figures: dict[str, Any] = {
        "taps_n_per_m": list(law.taps),
        "sections": len(law.sections),
        "delay_ticks": delay,
    }
    linear = asdict(rendered(law, loop))
    if law.evaluate is not None:
        linear = {
            key: value if key == "h1_n_per_m" else None for key, value in linear.items()
        }
    return figures | linear
