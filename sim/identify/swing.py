"""K_max from the recorded swing of a device in contact, with an interval (THEORY.md §9).

A swing is a pole of the loop. Law, delay and damping are known, so its frequency gives the mass,
and the exact loop with this mass gives K_max. Dry friction changes the decay, but hardly the
frequency: with known damping the decay is not used. Unknown damping lies between zero and the value
that explains the decay.

Windows of the contact are fitted one by one; their spread gives the interval. A motion that is not
a swing of the linear loop is refused. The coverage of the interval is counted on random devices
with friction and an encoder.
"""

import cmath
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from messages.errors import HapticError
from messages.topics import DEVICE_STATE, FORCE
from nodes.laws import CompiledLaw, Law
from nodes.laws.parse import parse_law
from nodes.parameters.store import convert
from nodes.recording.reader import Recording
from nodes.stability.k_max import edge_of, without_spring
from nodes.stability.occurring import Edge, position_over_force
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.design.recorded_loop import measure, node_with
from sim.device.model import DeviceModel

_SHORTEST = 40
# Fitted parts of the contact; the transient of the impact decays in the first eighth.
_WINDOWS = ((0.12, 1.0), (0.25, 1.0), (0.12, 0.6), (0.4, 1.0))
# smallest half-width of the interval: over 360 drops of random devices the windows alone miss by
# less, except with PDα
_MARGIN = 0.01
_RESIDUAL = 0.1  # largest residual of the fit [share of the swing]


class CannotTellError(HapticError, ValueError):
    """A recorded contact from which K_max cannot be estimated; the text gives the reason."""


@dataclass(frozen=True)
class Swing:
    """Result for a recorded contact."""

    omega_rad_per_s: float  # frequency of the swing [rad/s]
    decay_per_tick: float  # factor of the amplitude per tick; 1 at the stability limit
    ticks: int  # length of the contact measured
    stiffness_n_per_m: float  # nominal K of the rendered law [N/m]
    k_max_n_per_m: tuple[float, float]  # interval of K_max [N/m], shape (2,)
    # interval of the moving mass [kg], shape (2,)
    mass_kg: tuple[float, float]
    # damping used: the known value twice, or from zero to the value that explains the decay [N
    # s/m], shape (2,)
    damping_n_s_per_m: tuple[float, float]
    # stiffness of the hand assumed to hold the device, as during the recording [N/m]
    hand_n_per_m: float
    # behaviour of the loop at the middle of the interval, by Colgate's condition at its frequency
    edge: Edge


@dataclass(frozen=True)
class Decay:
    """A decaying swing: ωT and decay per tick, standard deviations and relative residual."""

    theta: float
    decay: float
    theta_off: float
    decay_off: float
    residual: float


def ringing(position: Array) -> Decay:
    """Fit one decaying swing about a slowly moving rest position."""
    from scipy.optimize import least_squares

    size = float(np.ptp(position))
    if len(position) < _SHORTEST:
        raise CannotTellError(
            f"{len(position)} ticks of contact before it bounces, at least {_SHORTEST} are needed"
        )
    if size < 1e-9:
        raise CannotTellError(
            f"{len(position)} ticks of contact that move by {size:.2g} m: nothing swings"
        )
    x, k = (position - position.mean()) / size, np.arange(len(position))

    def misfit(guess: Array) -> Array:
        decay, theta = guess
        envelope = np.clip(decay, 0.3, 1.05) ** k
        parts = np.column_stack(
            [
                envelope * np.cos(theta * k),
                envelope * np.sin(theta * k),
                np.ones(len(k)),
                k / len(k),
            ]
        )
        return np.asarray(parts @ np.linalg.lstsq(parts, x, rcond=None)[0] - x)

    found = least_squares(misfit, _start(x), x_scale=(0.01, 0.01))
    spread = float(found.fun @ found.fun)
    slopes = np.asarray(found.jac, dtype=np.float64)
    covariance = np.linalg.pinv(slopes.T @ slopes) * spread / max(len(x) - 6, 1)
    decay_off, theta_off = np.sqrt(np.diag(covariance)).tolist()
    decay, theta = found.x.tolist()
    return Decay(abs(theta), decay, theta_off, decay_off, math.sqrt(spread / len(x)))


def _start(x: Array) -> tuple[float, float]:
    """Estimate decay and ωT from x[k] = a x[k−1] + b x[k−2] + c."""
    # Instrumental variables two ticks further back avoid the bias by encoder noise.
    rows = np.column_stack([x[3:-1], x[2:-2], np.ones(len(x) - 4)])
    tools = np.column_stack([x[1:-3], x[:-4], np.ones(len(x) - 4)])
    a, b, _ = np.linalg.lstsq(tools.T @ rows, tools.T @ x[4:], rcond=None)[0]
    if a * a + 4.0 * b >= 0.0 or b >= 0.0:
        raise CannotTellError(
            "the contact creeps to rest, it does not swing: raise the stiffness or lower the"
            " damping"
        )
    decay = math.sqrt(-b)
    return min(decay, 1.0), math.acos(max(-1.0, min(1.0, a / (2.0 * decay))))


def recorded_swing(
    path: Path, damping: float | None = None, hand: float | None = None
) -> Swing:
    """Measure the swing of a recording's longest contact and estimate K_max.

    Damping [N s/m] and hand stiffness [N/m] of a virtual device default to the recorded values.
    """
    loop = measure(path)
    recording = Recording(path)
    law = _law(recording, path)
    axis, inside = _contact(recording)
    body = virtual_device(recording, axis)
    if body is not None:
        damping, hand = (
            (body.moving_damping if damping is None else damping),
            (body.grip if hand is None else hand),
        )
    return swing_of(
        law, Plant(loop.period, 1.0, 0.0, loop.median, hand or 0.0), inside, damping
    )


def virtual_device(recording: Recording, axis: int) -> DeviceModel | None:
    """Return the recorded virtual device along an axis; None for a real one."""
    told = node_with(recording, "device")
    return (
        convert(told["device"], DeviceModel, "device").along("xyz"[axis])
        if told
        else None
    )


def windows(inside: Array) -> tuple[list[Decay], int]:
    """Fit parts of a contact, longest first; also return how many ticks of it move."""
    moving = np.flatnonzero(np.abs(inside - inside[-len(inside) // 8 :].mean()) > 1e-9)
    end = int(moving[-1]) + 1 if moving.size else len(inside)
    fits: list[Decay] = []
    for begin, stop in _WINDOWS:
        first = min(int(begin * end), max(end - _SHORTEST, 0))
        window = inside[first : max(int(stop * end), min(first + _SHORTEST, end))]
        if not fits or len(window) >= _SHORTEST:
            fits.append(ringing(window))
    whole = fits[0]
    if whole.residual > _RESIDUAL:
        raise CannotTellError(
            f"no single swing: {100.0 * whole.residual:.0f} % of the motion is something else"
        )
    if whole.decay - 2.0 * whole.decay_off > 1.0 - 1e-9:
        raise CannotTellError(
            "the swing does not decay: the loop is unstable, or in a limit cycle"
        )
    return fits, end


def swing_of(law: Law, loop: Plant, inside: Array, damping: float | None) -> Swing:
    """Estimate K_max from the positions of a contact [m].

    Period, delay and hand of the loop are known, its mass is not.
    """
    compiled = law.compile(loop.period)
    if compiled.evaluate is not None:
        raise CannotTellError(f"{law.kind} has code of its own, so no poles")
    fits, ticks = windows(inside)
    derivative = without_spring(law, loop.period)
    plants = []
    for fit in (fit for fit in fits if fit.residual <= _RESIDUAL):
        for theta in (fit.theta - 2.0 * fit.theta_off, fit.theta + 2.0 * fit.theta_off):
            if damping is not None:
                plants.append(_by_frequency(compiled, loop, theta, fit.decay, damping))
            else:
                plants.append(_by_frequency(compiled, loop, theta, fit.decay, 0.0))
                plants += [
                    _by_pole(compiled, loop, theta, fit.decay + off)
                    for off in (-2.0 * fit.decay_off, 0.0)
                ]
    known = [plant for plant in plants if plant is not None]
    edges = [
        edge for plant in known if (edge := edge_of(derivative, plant)) is not None
    ]
    if len(edges) < len(plants) or not edges:
        raise CannotTellError(
            "no mass gives a loop that oscillates at its edge a pole at this swing"
        )
    edges.sort(key=lambda edge: edge.k_exact_n_per_m)
    low, high = edges[0].k_exact_n_per_m, edges[-1].k_exact_n_per_m
    wider = _MARGIN * 0.5 * (low + high) + 0.5 * (high - low)
    masses, dampings = (
        [getattr(plant, name) for plant in known] for name in ("mass", "damping")
    )
    intervals = (
        (max(low - wider, 0.0), high + wider),
        (min(masses), max(masses)),
        (min(dampings), max(dampings)),
    )
    stiffness = float(getattr(law, "stiffness", compiled.h1))
    middle = edges[len(edges) // 2]
    return Swing(
        fits[0].theta / loop.period,
        fits[0].decay,
        ticks,
        stiffness,
        *intervals,
        loop.stiffness,
        middle,
    )


def _by_frequency(
    law: CompiledLaw, loop: Plant, theta: float, decay: float, damping: float
) -> Plant | None:
    """Find the mass with which the loop has a pole at an angle, with any decay."""
    return _solved(
        law, loop, decay, lambda second: (damping, second * cmath.exp(1j * theta))
    )


def _by_pole(law: CompiledLaw, loop: Plant, theta: float, decay: float) -> Plant | None:
    """Find mass and damping with which the loop has a given pole."""
    return _solved(
        law, loop, 1.0, lambda second: (max(second, 0.0), decay * cmath.exp(1j * theta))
    )


def _solved(
    law: CompiledLaw,
    loop: Plant,
    start: float,
    trial: Callable[[float], tuple[float, complex]],
) -> Plant | None:
    from scipy.optimize import root

    _, z = trial(start)
    half = 0.5 * abs(cmath.phase(z))
    # Start: a lossless mass on a spring of this size (THEORY.md §9).
    mass = (
        abs(law.response(z) + loop.stiffness)
        * loop.period**2
        / (4.0 * math.sin(half) * math.tan(half))
    )

    def plant(unknown: Array) -> Plant:
        return replace(
            loop, mass=math.exp(min(unknown[0], 50.0)), damping=trial(unknown[1])[0]
        )

    def balance(unknown: Array) -> tuple[float, float]:
        z = trial(unknown[1])[1]
        law_there = complex(law.response(z))
        off = (1.0 / position_over_force(z, plant(unknown)) + law_there) / abs(
            law_there
        )
        return off.real, off.imag

    for second in (start, 0.3 * start, 0.97):
        found = root(balance, (math.log(mass), second), tol=1e-12)
        if found.success and max(map(abs, balance(found.x))) < 1e-8:
            return plant(found.x)
    return None


def _contact(recording: Recording) -> tuple[int, Array]:
    """Return the axis with most force and the positions of its longest contact.

    Raise CannotTellError if the law changed or the driver limited the force meanwhile.
    """
    states = recording.messages(DEVICE_STATE)
    force = np.array([state.force for state in states])
    if not force.any():
        raise CannotTellError("nothing was touched: there was no force")
    axis = int(np.abs(force).max(axis=0).argmax())
    first, last = _contact_without_gaps(
        np.abs(force[:, axis]) > 0.0, np.array([state.seq for state in states])
    )
    inside = states[first:last]
    rendered = {message.seq: message for message in recording.messages(FORCE)}
    answers = [
        rendered[state.force_seq] for state in inside if state.force_seq in rendered
    ]
    if inside and not answers:
        raise CannotTellError(
            "the coupling's forces of the longest contact were not recorded, so the law is not"
            " known"
        )
    # The known law is that of the launch; revisions count from its start, whenever recording began.
    if any(answer.revision != 0 for answer in answers):
        raise CannotTellError("the law changed before the end of the longest contact")
    fresh = [
        state for state in inside if state.force_seq in rendered and state.age == 0
    ]
    pairs = [
        (state.force[axis], rendered[state.force_seq].force[axis]) for state in fresh
    ]
    limited = any(
        abs(given - asked) > 1e-9 * max(1.0, abs(asked)) for given, asked in pairs
    )
    if limited or any(state.safety != "active" for state in inside):
        raise CannotTellError("the driver limited the force during the longest contact")
    return axis, np.array([state.position[axis] for state in inside])


def _contact_without_gaps(
    contact: NDArray[np.bool_], seq: NDArray[np.int64]
) -> tuple[int, int]:
    """Find the longest contact without missing ticks, as the fit requires."""
    ends = [0, *(np.flatnonzero(np.diff(seq) != 1) + 1).tolist(), len(seq)]
    runs = [
        (begin, longest(contact[begin:end])) for begin, end in itertools.pairwise(ends)
    ]
    begin, (first, last) = max(runs, key=lambda run: run[1][1] - run[1][0])
    return begin + first, begin + last


def longest(contact: NDArray[np.bool_]) -> tuple[int, int]:
    """Return begin and end of the longest run of True."""
    runs = (
        np.flatnonzero(np.diff(np.concatenate([[0], contact.astype(int), [0]])))
        .reshape(-1, 2)
        .tolist()
    )
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    return first, last


def _law(recording: Recording, path: Path) -> Law:
    node = node_with(recording, "laws")
    if not node:
        raise ValueError(f"{path}: contains no coupling, so the law is unknown")
    return parse_law(node["laws"][node["law"]], f"laws.{node['law']}")


TICKS = 500  # ticks of a drop
RESOLUTION = 2.3e-5  # encoder step [m]
