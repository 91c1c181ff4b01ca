"""A virtual device with the defects of hardware: joints, lags, backlash and others.

It is integrated in 64 small steps per tick (midpoint rule, Coulomb friction exact within a step),
because no closed form covers all defects. `sim.device.model` is the exact rigid device.

This is no scene of the player: it is the truth that identification and tuning are judged by, so it
shares no integrator with the device that they assume, and one push is half a million small steps.
Without defects it moves as the player's device (tests/sim/play/test_nonideal.py).
"""

import math
from dataclasses import dataclass

import numpy as np

from nodes.laws.excitation import held_back
from nodes.stability.flexible import FlexiblePlant
from sim.arrays import Array
from sim.device.friction import slide
from sim.device.model import DeviceModel, coefficients, quantise
from sim.play.compiled import compiled


@dataclass(frozen=True)
class NonidealDevice:
    """A rigid device with defects; 0 for an absent defect."""

    rigid: DeviceModel  # mass of both sides of the joint, damping, Coulomb friction, delay, encoder
    kind: str = "rigid"  # name of the kind of device
    # damping that grows with speed: force per speed squared [N s²/m²]
    quadratic: float = 0.0
    lag: float = 0.0  # time constant of the actuator [s]
    # Share of the mass beyond a joint, frequency [Hz] and damping ratio of the two masses against
    # each other.
    share: float = 0.0
    frequency: float = 0.0
    loss: float = 0.0
    gap: float = 0.0  # backlash of the joint [m]
    hardening: float = 0.0  # cubic centring spring [N/m³]
    presliding: float = 0.0  # deflection over which friction builds up (LuGre) [m]
    # relative increase of friction at rest; it vanishes over 0.02 m/s
    stribeck: float = 0.0
    # relative difference of friction between the two directions
    uneven: float = 0.0
    cogging: float = 0.0  # force of the motor's poles, 8 mm apart [N]
    ripple: float = 0.0  # error of the encoder with period `pitch` [m]
    noise: float = 0.0  # noise of the position before rounding, root mean square [m]
    jitter: float = 0.0  # largest delay of a sample [ticks]
    late: float = 0.0  # largest additional delay of a force [ticks]
    warming: float = 0.0  # relative decrease of damping during the run
    # forces below it have no effect, larger ones are reduced by it [N]
    deadband: float = 0.0
    # weight of the previous sample in each reading: 0.5 for a sensor that averages two samples
    average: float = 0.0
    sensor_lag: float = 0.0  # time constant of a filter at the sensor [s]
    # relative increase of positive forces and decrease of negative ones
    gain_by_sign: float = 0.0
    force_step: float = 0.0  # resolution of the motor's force [N]
    pitch: float = 0.0013  # period of the encoder's error [m]

    @property
    def plant(self) -> FlexiblePlant:
        """The equivalent linear device, for poles of its loop, without a sensor's averaging.

        The filter at the sensor counts as a lag of the actuator.
        """
        rigid = self.rigid
        joint = (
            {"share": self.share, "frequency": self.frequency, "loss": self.loss}
            if self.share
            else {}
        )
        return FlexiblePlant(
            rigid.mass,
            rigid.damping,
            rigid.delay,
            lag=self.lag + self.sensor_lag,
            **joint,
        )


_ODD = (
    "quadratic", "lag", "gap", "hardening", "presliding", "stribeck", "uneven", "cogging",
    "ripple", "warming", "deadband", "average", "sensor_lag", "gain_by_sign", "force_step",
    "pitch",
)  # fmt: skip


# Long because it is one compiled function; calls would cost the gained speed.
@compiled()
def _push(  # noqa: C901, PLR0915
    wanted: Array,
    taps: Array,
    law: tuple[float, float, float, float],
    body: tuple[float, float, float, float, float, float],
    odd: Array,
    sample: Array,
    arrive: Array,
    noise: Array,
    resolution: float,
    period: float,
    slew: float,
    positions: Array,
    forces: Array,
) -> None:
    """Push in closed loop, as the nodes do in lockstep; forces act at the middle of a step."""
    centre, reach, peak, start = law
    mass, damping, friction, share, joint, loss = body
    (
        grip,
        quadratic,
        lag,
        gap,
        hardening,
        presliding,
        stribeck,
        uneven,
        cogging,
        ripple,
        warming,
        deadband,
    ) = odd[:12]
    average, sensor_lag, by_sign, force_step, pitch = odd[12:]
    seen, before = start, start
    own = mass * (1.0 - share)
    applied = 0.0
    beyond = mass * share
    step = period / 64.0
    x = start
    v = 0.0
    y = start
    w = 0.0
    given, acting, bristle = 0.0, 0.0, 0.0
    deflections = np.zeros(len(taps))
    arrived = 0
    ticks = len(wanted)
    for k in range(ticks):
        now = 0.0
        sampled = False
        while now < 1.0:
            until, what = 1.0, 0
            if not sampled and sample[k] <= until:
                until = max(sample[k], now)
                what = 1
            if (
                arrived < ticks
                and (arrived < k or (arrived == k and sampled))
                and arrive[arrived] - k < until
            ):
                until = max(arrive[arrived] - k, now)
                what = 2
            count = math.ceil((until - now) * period / step - 1e-9)
            for _ in range(count):
                h = (until - now) * period / count
                # The actuator's exact mean over the step.
                mean = acting
                if lag > 0.0:
                    decay = math.exp(-h / lag)
                    mean = acting + (given - acting) * (1.0 - decay) * lag / h
                    given = acting + (given - acting) * decay
                u = mean
                if deadband > 0.0:
                    u = math.copysign(max(abs(mean) - deadband, 0.0), mean)
                mx = x + 0.5 * h * v
                my = y + 0.5 * h * w
                if by_sign != 0.0:
                    u *= 1.0 + math.copysign(by_sign, u)
                if sensor_lag > 0.0:
                    seen = mx + (seen - mx) * math.exp(-h / sensor_lag)
                speed = abs(v)
                u -= quadratic * v * speed + (grip + hardening * mx * mx) * mx
                if cogging > 0.0:
                    u += cogging * math.sin(2.0 * math.pi * mx / 0.008)
                if share > 0.0:
                    stretch = mx - my
                    if gap > 0.0:
                        free = 0.5 * gap
                        stretch = math.copysign(max(abs(stretch) - free, 0.0), stretch)
                    pull = joint * stretch + (loss * (v - w) if stretch != 0.0 else 0.0)
                    u -= pull
                    w += h * pull / beyond
                    y += h * (w - 0.5 * h * pull / beyond)
                b = damping * (1.0 - warming * k / ticks)
                c = friction * (1.0 + stribeck * math.exp(-((speed / 0.02) ** 2)))
                c += friction * uneven * (1.0 if v > 0.0 else -1.0)
                if presliding > 0.0:
                    # LuGre: bristles stretch with the motion, at most by the presliding deflection.
                    rate = speed / presliding
                    end = math.copysign(presliding, v)
                    after = end + (bristle - end) * math.exp(-rate * h)
                    stiff = c / presliding
                    u -= (
                        stiff * 0.5 * (bristle + after)
                        + 0.3 * math.sqrt(stiff * own) * (after - bristle) / h
                    )
                    bristle = after
                    c = 0.0
                x, v = slide(x, v, u, h, coefficients(own, b, 0.0, h), own, b, 0.0, c)
            now = until
            if what == 1:
                sampled = True
                read = (x if sensor_lag == 0.0 else seen) + noise[k]
                if ripple > 0.0:
                    read += ripple * math.sin(2.0 * math.pi * x / pitch)
                if average > 0.0:
                    now_read = read
                    read = (1.0 - average) * read + average * before
                    before = now_read
                measured = quantise(read, resolution)
                deflections[1:] = deflections[:-1].copy()
                deflections[0] = centre - measured
                force = held_back(wanted[k], deflections[0], reach)
                for m in range(len(taps)):
                    force += taps[m] * deflections[m]
                positions[k] = measured
                applied = min(
                    max(min(max(force, -peak), peak), applied - slew), applied + slew
                )
                forces[k] = applied
            elif what == 2:
                acting = forces[arrived]
                if force_step > 0.0:
                    acting = round(acting / force_step) * force_step
                arrived += 1


def pushed(
    device: NonidealDevice,
    period: float,
    wanted: Array,
    taps: Array,
    law: tuple[float, float, float, float],
    seed: int,
    slew: float = math.inf,
) -> tuple[Array, Array]:
    """Push a device by wanted forces and a law [N]; return readings [m] and forces [N].

    `law` is the point that the law pulls to and the reach within which forces are wanted [m], the
    largest force [N] and the device's position [m]; `slew` is the largest change of the force per
    tick [N].
    """
    ticks = len(wanted)
    rng = np.random.default_rng([seed, 7])
    sample = (
        rng.uniform(0.0, device.jitter, ticks) if device.jitter else np.zeros(ticks)
    )
    late = rng.uniform(0.0, device.late, ticks) if device.late else np.zeros(ticks)
    arrive = np.maximum.accumulate(np.arange(ticks) + device.rigid.delay + late)
    noise = rng.normal(0.0, device.noise, ticks) if device.noise else np.zeros(ticks)
    rigid = device.rigid
    joint, loss = device.plant.joint if device.share else (0.0, 0.0)
    positions = np.zeros(ticks)
    forces = np.zeros(ticks)
    odd = np.array([rigid.grip, *(getattr(device, name) for name in _ODD)])
    _push(
        wanted, np.asarray(taps, dtype=np.float64), law,
        (rigid.mass, rigid.damping, rigid.friction or 0.0, device.share, joint, loss), odd, sample,
        arrive, noise, rigid.resolution or 1e-9, period, slew, positions, forces,
    )  # fmt: skip
    return positions, forces
