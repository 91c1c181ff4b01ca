"""What a recorded hand and device would have felt with another law.

The model takes the device's place: a virtual device as it was declared, or one identified from this recording or another.
What moved the recorded device besides the law (a hand) is estimated tick by tick as the force that the model lacks, and acts
again. What is left are nudges: the least that keep the model in the encoder step that was read. With them the same law comes
back to what was recorded; how far the model alone does not is the error of every prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.driver.passivity import control, forget, observe
from nodes.kernels import cross_fade, limit, one_sided, warm_up
from nodes.laws import CompiledLaw
from sim.device.friction import move
from sim.device.model import DeviceModel, coefficients, quantise, saturate
from sim.experiments.drop import Criterion, settled
from sim.identify.recorded_scene import RecordedScene
from sim.scene.loop import Swap, run
from sim.scene.tick_loop import evaluate, respond

__all__ = [
    "STILL",
    "Array",
    "Felt",
    "missing_force",
    "nudges",
    "replay",
]

Array = NDArray[np.float64]

STILL = Criterion().tolerance
"""Largest motion over the last quarter of a run that counts as settled: that of the drop test [m]."""
NUDGE = 0.1
"""Part of a nudge that the velocity takes as an error of its own, made within a tick."""


@dataclass(frozen=True)
class Felt:
    """One replayed run.

    Attributes
    ----------
    measured : ndarray, shape (N,)
        What the encoder reads at each tick [m].
    force : ndarray, shape (N,)
        Force that the driver hands over in answer [N].
    settled : bool
        Whether it comes to rest: by the drop test's verdict where the run is a drop, else by the motion of the last quarter.
    peak_force : float
        Largest magnitude of the force [N].
    rest : float
        Mean position over the last quarter [m].
    """

    measured: Array
    force: Array
    settled: bool
    peak_force: float
    rest: float


def replay(
    recorded: RecordedScene,
    law: CompiledLaw | None = None,
    external: Array | None = None,
    nudged: Array | None = None,
) -> Felt:
    """Play a recorded scene again.

    Parameters
    ----------
    recorded : RecordedScene
        The recording.
    law : CompiledLaw or None
        What renders from the first tick on; None for what did, its swaps included.
    external : ndarray, shape (N,), optional
        Force on the device besides the law's at each tick [N], from `missing_force`.
    nudged : ndarray, shape (N, 3), optional
        Jumps of position [m], velocity [m/s] and reading [m] at each tick, from `nudges`.

    Returns
    -------
    Felt
        What comes of it.
    """
    played = recorded.scene
    first = played.law if law is None else law
    swaps = played.swaps if law is None else ()
    ticks = len(recorded.position)
    if recorded.lockstep and external is None and nudged is None:
        trace = run(played.scene, first, ticks, [swap for swap in swaps if swap.tick < ticks], played.memory)
        return _judged(recorded, first, trace.measured, trace.force)
    return _judged(recorded, first, *_tick_by_tick(recorded, first, swaps, external, nudged)[:2])


def nudges(recorded: RecordedScene, external: Array | None = None) -> Array:
    """Find what keeps the model, under the recorded forces, in the encoder step that was read.

    Parameters
    ----------
    recorded : RecordedScene
        The recording, its device the model.
    external : ndarray, shape (N,), optional
        Force on the device besides the law's at each tick [N], from `missing_force`.

    Returns
    -------
    ndarray, shape (N, 3)
        Jumps of position [m] and velocity [m/s] at each tick, zero wherever the model reads what was read; and how far the
        recorded reading lies off the model's grid [m].
    """
    return _tick_by_tick(recorded, recorded.scene.law, (), external, None, track=True)[2]


def _judged(recorded: RecordedScene, law: CompiledLaw, measured: Array, force: Array) -> Felt:
    scene = recorded.scene.scene
    last = measured[-(len(measured) // 4) :]
    with np.errstate(invalid="ignore"):
        still = bool(np.ptp(last) <= STILL)
    if scene.device.gravity is not None and scene.device.hand is None and scene.surface.kind == "plane":
        still = settled(scene, law, measured, force, Criterion(ticks=len(measured)))
    return Felt(measured, force, still, float(np.max(np.abs(force))), float(np.mean(last)))


def _tick_by_tick(
    recorded: RecordedScene,
    law: CompiledLaw,
    swaps: tuple[Swap, ...],
    external: Array | None,
    nudged: Array | None,
    track: bool = False,
) -> tuple[Array, Array, Array]:
    """Play with every force arriving when the recorded one of its tick did: the loop of `sim.scene.loop`, interpreted.

    Tracking, the recorded forces act instead of the law's, and the nudges are those that the recorded readings ask for.
    """
    scene, device, ticks = recorded.scene.scene, recorded.scene.scene.device, len(recorded.position)
    period, plane = scene.period, scene.surface.kind == "plane"
    normal = scene.surface.normal if plane else 0.0
    mass, damping, grip = device.moving_mass, device.moving_damping, device.grip
    ring = max(2, recorded.scene.memory, len(law.taps), *(len(swap.law.taps) for swap in swaps))
    history, head = [0.0] * (2 * ring), 0
    now, old, ramp, done = _Rendered(law), _Rendered(law), 0, 0
    waiting = list(swaps)
    # In lockstep the recorded delay is that of the rule; the device's own comes on top of both.
    arrivals = list(
        zip((recorded.at + device.delay).tolist(), recorded.answers.tolist(), recorded.given.tolist(), strict=True)
    )
    next_arrival, acting = 0, 0.0
    guard, energy, before, applied = scene.passivity, 0.0, 0.0, 0.0
    x, v = device.position, device.velocity
    measured, forces = np.empty(ticks), np.zeros(ticks)
    jumps = np.zeros((ticks, 3)) if nudged is None else nudged
    for k in range(ticks):
        if track:
            jumps[k] = _nudge(x, float(recorded.position[k]), device.resolution, period)
        jump_x, jump_v, off_grid = jumps[k].tolist()
        x, v = x + jump_x, v + jump_v
        while waiting and waiting[0].tick <= k:
            swap = waiting.pop(0)
            old, now, ramp, done = now, _Rendered(swap.law), swap.ramp, 0
            now.warm_up(history, head, ring)
        reading = quantise(x, device.resolution) + off_grid
        head, _, contact = respond(
            reading, scene.surface.code, scene.surface.position, normal, scene.raw, history, head, ring
        )
        force = now.force(history, head)
        if done < ramp:
            force = cross_fade(old.force(history, head), force, done, ramp)
            done += 1
        force = one_sided(force, normal, contact, scene.raw, scene.clamp)
        if guard is not None:
            step = reading - before if k else 0.0
            energy = forget(observe(energy, applied, step), force, guard.stiffness)
            force = control(energy, force, step, guard.damping / period)
            before = reading
        measured[k] = reading
        forces[k] = applied = limit(force, applied, scene.peak, scene.slew)
        load = device.load(k, period) + (0.0 if external is None else float(external[k]))
        at = 0.0
        while next_arrival < len(arrivals) and arrivals[next_arrival][0] < k + 1:
            when, answers, given = arrivals[next_arrival]
            until = max(when - k, at)
            x, v = _move(
                x, v, saturate(acting, device.peak_force) + load, (until - at) * period, mass, damping, grip, device
            )
            acting, at = float(forces[answers]) if 0 <= answers <= k and not track else given, until
            next_arrival += 1
        x, v = _move(x, v, saturate(acting, device.peak_force) + load, (1.0 - at) * period, mass, damping, grip, device)
    return measured, forces, jumps


def _nudge(x: float, read: float, resolution: float | None, period: float) -> tuple[float, float, float]:
    """Move a position the shortest way to where the encoder reads what it read, and the velocity with it."""
    if quantise(x, resolution) == read:
        return 0.0, 0.0, 0.0
    # A millionth short of the step's edges: on them rounding decides.
    room = 0.499999 * (resolution or 0.0)
    off = min(max(x, read - room), read + room) - x
    return off, NUDGE * off / period, read - quantise(x + off, resolution)


def _move(
    x: float, v: float, u: float, duration: float, mass: float, damping: float, grip: float, device: DeviceModel
) -> tuple[float, float]:
    if duration <= 0.0:
        return x, v
    return move(x, v, u, duration, coefficients(mass, damping, grip, duration), mass, damping, grip, device.friction)


class _Rendered:
    """A law with the state of its sections."""

    def __init__(self, law: CompiledLaw) -> None:
        self._taps = law.taps
        self._sections = [c for section in law.sections for c in section] or None
        self._state = [0.0] * (2 * len(law.sections))

    def warm_up(self, history: list[float], head: int, length: int) -> None:
        """Bring the sections up to date."""
        if self._sections is not None:
            warm_up(self._sections, self._state, history, head, length)

    def force(self, history: list[float], head: int) -> float:
        """Render the newest deflection."""
        return evaluate(self._taps, self._sections, self._state, history, head)


def missing_force(recorded: RecordedScene, noise: float) -> Array:
    """Estimate what moved the device besides the forces that were handed to it.

    A random walk of an unknown force is smoothed over the whole recording (Kalman filter and Rauch–Tung–Striebel smoother), its
    size chosen by the likelihood of the recording.

    Parameters
    ----------
    recorded : RecordedScene
        The recording, its device the model.
    noise : float
        Standard deviation of a measured position: of an encoder, its step over √12 [m].

    Returns
    -------
    ndarray, shape (N,)
        Force that the model lacks, one value per tick, the model's own load not included [N].
    """
    scene = recorded.scene.scene
    device, period = scene.device, scene.period
    mass, damping, grip = device.moving_mass, device.moving_damping, device.grip
    step = coefficients(mass, damping, grip, period)
    known = _known(recorded)
    y = recorded.position
    best, chosen = -np.inf, np.zeros(len(y))
    for walk in np.geomspace(1e-5, 1.0, 11).tolist():
        likelihood, force = _smooth(y, known, step, noise, walk)
        if likelihood > best:
            best, chosen = likelihood, force
    return chosen


def _known(recorded: RecordedScene) -> Array:
    """Tell what one tick of recorded forces, load and friction adds to position and velocity, from rest: (N, 2)."""
    scene = recorded.scene.scene
    device, period, ticks = scene.device, scene.period, len(recorded.position)
    mass, damping, grip = device.moving_mass, device.moving_damping, device.grip
    smooth = np.convolve(recorded.position, np.ones(9) / 9.0, "same")
    speed = np.gradient(smooth) / period
    slow = (device.resolution or 1e-7) / (9.0 * period)
    rubbing = -(device.friction or 0.0) * np.clip(speed / slow, -1.0, 1.0)
    arrivals = list(zip((recorded.at + device.delay).tolist(), recorded.given.tolist(), strict=True))
    added, j, acting = np.zeros((ticks, 2)), 0, 0.0
    for k in range(ticks):
        x = v = at = 0.0
        load = device.load(k, period) + float(rubbing[k])
        ends = []
        while j < len(arrivals) and arrivals[j][0] < k + 1:
            ends.append((max(arrivals[j][0] - k, 0.0), arrivals[j][1]))
            j += 1
        for until, following in [*ends, (1.0, acting)]:
            duration = (until - at) * period
            if duration > 0.0:
                a = coefficients(mass, damping, grip, duration)
                u = acting + load
                x, v = a[0] * x + a[1] * v + a[4] * u, a[2] * x + a[3] * v + a[5] * u
            at = until
            if (until, following) in ends:
                acting = following
        added[k] = x, v
    return added


def _smooth(y: Array, known: Array, step: tuple[float, ...], noise: float, walk: float) -> tuple[float, Array]:
    a11, a12, a21, a22, b1, b2 = step
    transition = np.array([[a11, a12, b1], [a21, a22, b2], [0.0, 0.0, 1.0]])
    wandering = np.zeros((3, 3))
    wandering[2, 2] = walk**2
    ticks, likelihood = len(y), 0.0
    state, spread = np.array([y[0], 0.0, 0.0]), np.diag([noise**2, 1.0, 1.0])
    means, spreads = np.zeros((ticks, 3)), np.zeros((ticks, 3, 3))
    before, ahead = np.zeros((ticks, 3)), np.zeros((ticks, 3, 3))
    for k in range(ticks):
        if k:
            state = transition @ state
            state[:2] += known[k - 1]
            spread = transition @ spread @ transition.T + wandering
        before[k], ahead[k] = state, spread
        surprise, size = y[k] - state[0], spread[0, 0] + noise**2
        likelihood -= 0.5 * (np.log(size) + surprise**2 / size)
        gain = spread[:, 0] / size
        state = state + gain * surprise
        spread = spread - np.outer(gain, spread[0])
        means[k], spreads[k] = state, spread
    force = np.zeros(ticks)
    later = means[-1]
    force[-1] = later[2]
    for k in range(ticks - 2, -1, -1):
        pull = np.linalg.solve(ahead[k + 1], transition @ spreads[k]).T
        later = means[k] + pull @ (later - before[k + 1])
        force[k] = later[2]
    return float(likelihood), force
