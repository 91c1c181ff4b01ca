"""Predict the motion of a recorded hand and device with another law.

A model replaces the device: a virtual device as declared, or one identified from this or another
recording. The external force on the recorded device besides the law (a hand) is estimated tick by
tick as the force missing in the model, and is applied again. The remaining error is corrected by
nudges, the smallest changes that keep the model within the encoder step that was read. With nudges,
the same law reproduces the recording; the deviation of the model without them is the error of every
prediction.
"""

from dataclasses import dataclass, replace

import numpy as np

from nodes.laws import CompiledLaw
from sim.arrays import Array
from sim.device.model import coefficients
from sim.experiments.settling import Criterion, settled
from sim.identify.recorded_scene import RecordedScene
from sim.play.chain import Instead
from sim.play.given import Given
from sim.play.one_axis import run
from sim.play.player import play

# largest motion over the last quarter of a run that counts as settled, as in the drop test [m]
STILL = Criterion().tolerance


@dataclass(frozen=True)
class Felt:
    """One replayed run."""

    measured: Array  # encoder reading at each tick [m], shape (N,)
    force: Array  # force the driver hands over in answer [N], shape (N,)
    # whether it comes to rest: by the verdict of the drop test if the run is a drop, else by the
    # motion of the last quarter
    settled: bool
    peak_force: float  # largest magnitude of the force [N]
    rest: float  # mean position over the last quarter [m]


def replay(
    recorded: RecordedScene,
    law: CompiledLaw | None = None,
    external: Array | None = None,
    nudged: Array | None = None,
) -> Felt:
    """Replay a recorded scene, by default with the recorded laws.

    law: another law for the whole run.
    external: from `missing_force`.
    nudged: from `nudges`.
    """
    played, ticks = recorded.scene, len(recorded.position)
    first = played.law if law is None else law
    swaps = [swap for swap in played.swaps if swap.tick < ticks] if law is None else []
    # In lockstep the delay follows from the launch file.
    arrivals = (
        None if recorded.lockstep else (recorded.came, recorded.answers, recorded.given)
    )
    given = Given(
        force=external, target=recorded.target, arrivals=arrivals, nudged=nudged
    )
    # Interpreted: compiling the loop takes as long as a million of its ticks.
    trace = play(
        recorded.launch,
        ticks=ticks,
        instead=Instead(law=first, swaps=swaps),
        given=given,
        how="interpreted",
    ).along()
    return _judged(recorded, first, trace.measured, trace.force)


def nudges(recorded: RecordedScene, external: Array | None = None) -> Array:
    """Find the smallest jumps that keep the model within the positions read, shape (N, 3).

    Columns: position [m], velocity [m/s] and reading [m].
    """
    ticks = len(recorded.position)
    jumps = np.zeros((ticks, 3))
    arrivals = (
        recorded.came,
        np.full(len(recorded.came), -1, dtype=np.int64),
        recorded.given,
    )
    given = Given(
        force=external,
        target=recorded.target,
        arrivals=arrivals,
        nudged=jumps,
        read=recorded.position.astype(np.float64),
    )
    run(
        replace(recorded.scene.scene, passivity=None),
        CompiledLaw((0.0,)),
        ticks,
        interpreted=True,
        given=given,
    )
    return jumps


def _judged(
    recorded: RecordedScene, law: CompiledLaw, measured: Array, force: Array
) -> Felt:
    scene = recorded.scene.scene
    last = measured[-(len(measured) // 4) :]
    with np.errstate(invalid="ignore"):
        still = bool(np.ptp(last) <= STILL)
    if (
        scene.device.gravity is not None
        and scene.device.hand is None
        and scene.surface.kind == "plane"
    ):
        still = settled(scene, law, measured, force, Criterion(ticks=len(measured)))
    return Felt(
        measured, force, still, float(np.max(np.abs(force))), float(np.mean(last))
    )


def missing_force(recorded: RecordedScene, noise: float) -> Array:
    """Estimate the force missing in the model, tick by tick [N].

    noise: standard deviation of a measured position [m].
    """
    device, y = recorded.scene.scene.device, recorded.position
    step = coefficients(
        device.moving_mass,
        device.moving_damping,
        device.grip,
        recorded.scene.scene.period,
    )
    known = _known(recorded)
    best, chosen = -np.inf, np.zeros(len(y))
    # The force is a random walk, smoothed over the whole recording (Rauch–Tung–Striebel); its size
    # maximises the likelihood.
    for walk in np.geomspace(1e-5, 1.0, 11).tolist():
        likelihood, force = _smooth(y, known, step, noise, walk)
        if likelihood > best:
            best, chosen = likelihood, force
    return chosen


def _known(recorded: RecordedScene) -> Array:
    """Return the effect of a tick's forces, load and friction from rest, shape (N, 2).

    Columns: position [m] and velocity [m/s].
    """
    scene = recorded.scene.scene
    device, period, ticks = scene.device, scene.period, len(recorded.position)
    mass, damping, grip = device.moving_mass, device.moving_damping, device.grip
    speed = (
        np.gradient(np.convolve(recorded.position, np.ones(9) / 9.0, "same")) / period
    )
    slow = (device.resolution or 1e-7) / (9.0 * period)
    rubbing = -(device.friction or 0.0) * np.clip(speed / slow, -1.0, 1.0)
    arrivals = list(
        zip(
            (recorded.took + device.delay).tolist(),
            recorded.given.tolist(),
            strict=True,
        )
    )
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


def _smooth(
    y: Array, known: Array, step: tuple[float, ...], noise: float, walk: float
) -> tuple[float, Array]:
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
