"""Compiled motion of the identified device over windows, and its derivatives.

Within a window the device moves by the exact map with Coulomb friction (`sim.device.friction`),
from the instants at which forces arrive. Further terms are integrated in quarters of a tick: the
lag of the actuator by its exact mean, quadratic damping at the midpoint, a joint by the series of
its exact map. All quantities are per unit of mass.

All compiled functions that call each other are in this file, because numba looks up its cache by
the file of the outermost function.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array, WholeArray
from sim.device.friction import slide
from sim.device.model import Coefficients, coefficients
from sim.play.compiled import compiled

(
    MOBILITY,
    DAMPING,
    FRICTION,
    STIFFNESS,
    LOAD,
    DELAY,
    QUADRATIC,
    LAG,
    SHARE,
    FREQUENCY,
    LOSS,
    AVERAGE,
) = range(12)
# The unknowns: 1/m [1/kg]; b/m [1/s]; c/m [m/s²]; k/m of a hand [1/s²]; load/m [m/s²]; delay
# [ticks]; quadratic damping per mass [1/m]; lag [ticks]; share of the mass beyond a joint;
# frequency [Hz] and damping ratio of the joint; weight of the previous sample in each reading.
NAMES = (
    "mobility",
    "damping",
    "friction",
    "stiffness",
    "load",
    "delay",
    "quadratic",
    "lag",
    "share",
    "frequency",
    "loss",
    "average",
)
# position [m] and velocity [m/s] of the motor side, then stretch of the joint [m] and its rate
# [m/s]
STATES = 4
_PARTS = 4  # steps per tick of a richer model
# terms of the series of the joint's map: error 1e-9 for a quarter of a tick at the highest
# frequency searched
_ORDER = 10


@compiled()
def _flow(
    state: Array,
    u: float,
    duration: float,
    stuck: bool,
    damping: float,
    stiffness: float,
    share: float,
    pulse: float,
    loss: float,
) -> None:
    """Advance two masses on a joint under a held force by the series of the exact map.

    `stuck` holds the first mass.
    """
    own = 1.0 - share
    spring, damper = share * own * pulse * pulse, 2.0 * loss * share * own * pulse
    x, v, y, w = state[0], state[1], state[2], state[3]
    dx, dv, dy, dw = x, v, y, w
    push = u
    for n in range(1, _ORDER + 1):
        pull = spring * (dx - dy) + damper * (dv - dw)
        ax, ay = (push - pull - damping * dv - stiffness * dx) / own, pull / share
        push = 0.0
        h = duration / n
        dx, dv, dy, dw = h * dv, h * ax, h * dw, h * ay
        if stuck:
            dx = dv = 0.0
        x += dx
        v += dv
        y += dy
        w += dw
    state[0], state[1], state[2], state[3] = x, v, y, w


@compiled()
def _slide_joint(
    state: Array,
    before: Array,
    u: float,
    duration: float,
    damping: float,
    stiffness: float,
    friction: float,
    share: float,
    pulse: float,
    loss: float,
) -> None:
    """Advance two masses with Coulomb friction on the first; `before` is scratch space."""
    remaining = duration
    spring, damper = (
        share * (1.0 - share) * pulse * pulse,
        2.0 * loss * share * (1.0 - share) * pulse,
    )
    for _ in range(4):
        if state[1] == 0.0:
            net = (
                u
                - stiffness * state[0]
                - spring * (state[0] - state[2])
                + damper * state[3]
            )
            if abs(net) <= friction:
                _flow(state, u, remaining, True, damping, stiffness, share, pulse, loss)
                return
            direction = 1.0 if net > 0.0 else -1.0
        else:
            direction = 1.0 if state[1] > 0.0 else -1.0
        for i in range(STATES):
            before[i] = state[i]
        _flow(
            state,
            u - direction * friction,
            remaining,
            False,
            damping,
            stiffness,
            share,
            pulse,
            loss,
        )
        if state[1] * direction >= 0.0:
            return
        # The velocity changed sign: find its zero by secants and continue from there.
        low, high, at_low, at_high = 0.0, remaining, before[1], state[1]
        halt = 0.0
        for _ in range(3):
            halt = (
                low + (high - low) * at_low / (at_low - at_high)
                if at_low != 0.0
                else 0.5 * (low + high)
            )
            for i in range(STATES):
                state[i] = before[i]
            _flow(
                state,
                u - direction * friction,
                halt,
                False,
                damping,
                stiffness,
                share,
                pulse,
                loss,
            )
            if state[1] * direction > 0.0:
                low, at_low = halt, state[1]
            else:
                high, at_high = halt, state[1]
        state[1] = 0.0
        remaining -= halt
        if remaining <= 1e-9 * duration:
            return


@compiled()
def _slide(
    x: float,
    v: float,
    u: float,
    duration: float,
    coefs: Coefficients,
    damping: float,
    stiffness: float,
    friction: float,
) -> tuple[float, float]:
    """Advance a unit mass by one step; a single compiled copy for all callers."""
    return slide(x, v, u, duration, coefs, 1.0, damping, stiffness, friction)


@compiled()
def _rigid(
    theta: Array,
    state: Array,
    start: int,
    length: int,
    period: float,
    at: Array,
    force: Array,
    out: Array,
) -> None:
    """Compute the positions of one window of a rigid device from its initial state."""
    mobility, damping, friction, stiffness, load, delay = (
        theta[0],
        theta[1],
        theta[2],
        theta[3],
        theta[4],
        theta[5],
    )
    x, v = state[0], state[1]
    # The force that acts at the start of the window: the last one in effect by then.
    j = np.searchsorted(at, start - delay, "right") - 1
    acting = force[j] if j >= 0 else 0.0
    known = period
    coefs = coefficients(1.0, damping, stiffness, known)
    for k in range(length):
        out[k] = x
        now = 0.0
        arrives = True
        while arrives:
            # To the next force, or to the end of the tick.
            arrives = j + 1 < len(at) and at[j + 1] + delay < start + k + 1
            until = at[j + 1] + delay - (start + k) if arrives else 1.0
            duration = (until - now) * period
            if until > now and (arrives or duration > 1e-12 * period):
                if abs(duration - known) > 1e-12 * period:
                    coefs = coefficients(1.0, damping, stiffness, duration)
                    known = duration
                u = mobility * acting + load
                x, v = _slide(x, v, u, duration, coefs, damping, stiffness, friction)
                now = until
            if arrives:
                j += 1
                acting = force[j]


# Long: one compiled function.
@compiled()
def _richer(  # noqa: PLR0915
    theta: Array,
    initial: Array,
    start: int,
    length: int,
    period: float,
    at: Array,
    force: Array,
    out: Array,
) -> None:
    """Compute the positions of one window of a device with lag, quadratic damping or a joint."""
    mobility, damping, friction, stiffness, load, delay = (
        theta[0],
        theta[1],
        theta[2],
        theta[3],
        theta[4],
        theta[5],
    )
    quadratic, lag, share, pulse, loss = (
        theta[6],
        theta[7],
        theta[8],
        2.0 * math.pi * theta[9],
        theta[10],
    )
    state, before = np.empty(STATES), np.empty(STATES)
    state[0], state[1] = initial[0], initial[1]
    state[2], state[3] = state[0] - initial[2], state[1] - initial[3]
    j = np.searchsorted(at, start - delay, "right") - 1
    acting = force[j] if j >= 0 else 0.0
    given = acting
    if lag > 0.0:
        # Actuator output at this point, from the forces of the last twelve time constants.
        i = max(np.searchsorted(at, start - delay - 12.0 * lag, "right") - 1, 0)
        given = force[i] if j >= 0 else 0.0
        while i <= j:
            end = at[i + 1] + delay if i < j else float(start)
            given = force[i] + (given - force[i]) * math.exp(
                -max(end - max(at[i] + delay, start - 12.0 * lag), 0.0) / lag
            )
            i += 1
    known = -1.0
    coefs = coefficients(1.0, damping, stiffness, period)
    for k in range(length):
        out[k] = state[0]
        now = 0.0
        while now < 1.0:
            until = 1.0
            arrives = j + 1 < len(at) and at[j + 1] + delay < start + k + 1
            if arrives:
                until = at[j + 1] + delay - (start + k)
            span = until - now
            if span > 1e-12:
                parts = max(math.ceil(span * _PARTS - 1e-9), 1)
                h = span / parts
                for _ in range(parts):
                    mean = acting
                    if lag > 0.0:
                        decay = math.exp(-h / lag)
                        mean = acting + (given - acting) * (1.0 - decay) * lag / h
                        given = acting + (given - acting) * decay
                    u = mobility * mean + load
                    if quadratic > 0.0:
                        u -= quadratic * state[1] * abs(state[1])
                    if share > 0.0:
                        _slide_joint(
                            state,
                            before,
                            u,
                            h * period,
                            damping,
                            stiffness,
                            friction,
                            share,
                            pulse,
                            loss,
                        )
                    else:
                        if abs(h - known) > 1e-12:
                            coefs = coefficients(1.0, damping, stiffness, h * period)
                            known = h
                        middle = state[1]
                        for again in range(2 if quadratic > 0.0 else 1):
                            # Quadratic damping at the midpoint velocity: a first trial step
                            # estimates it.
                            held = u + quadratic * (
                                state[1] * abs(state[1]) - middle * abs(middle)
                            )
                            x, v = _slide(
                                state[0],
                                state[1],
                                held,
                                h * period,
                                coefs,
                                damping,
                                stiffness,
                                friction,
                            )
                            middle = 0.5 * (state[1] + v) if again == 0 else middle
                        state[0], state[1] = x, v
            now = max(until, now)
            if arrives:
                j += 1
                acting = force[j]


@compiled()
def window(
    theta: Array,
    state: Array,
    start: int,
    length: int,
    period: float,
    at: Array,
    force: Array,
    out: Array,
) -> None:
    """Compute the positions read in one window from its initial state."""
    if theta[6] == 0.0 and theta[7] == 0.0 and theta[8] == 0.0:
        _rigid(theta, state, start, length, period, at, force, out)
    else:
        _richer(theta, state, start, length, period, at, force, out)
    part = theta[11]
    if part != 0.0:
        # The sample before the window is unknown: extrapolated with constant acceleration and
        # never compared.
        before = 3.0 * out[0] - 3.0 * out[1] + out[2]
        for k in range(length):
            here = out[k]
            out[k] = here + part * (before - here)
            before = here


@compiled()
def slopes(
    theta: Array,
    free: WholeArray,
    steps: Array,
    own: int,
    states: Array,
    starts: WholeArray,
    period: float,
    position: Array,
    missing: NDArray[np.bool_],
    at: Array,
    force: Array,
    scale: float,
    residuals: Array,
    out: Array,
) -> None:
    """Compute residuals of windows and their derivatives by unknowns and initial states.

    Shapes: residuals (W, L), derivatives (W, p + s, L).
    """
    # Explicit loops: compiled array slices and products take three times as long to compile.
    length, p = residuals.shape[1], len(free)
    here, there = np.empty(length), np.empty(length)
    moved, near = np.empty(len(theta)), np.empty(STATES)
    first = 1 if theta[11] != 0.0 else 0
    for i in range(p):
        if free[i] == 11:
            first = 1
    for w in range(len(starts)):
        start = starts[w]
        for i in range(STATES):
            near[i] = states[w, i]
        for i in range(len(theta)):
            moved[i] = theta[i]
        window(moved, near, start, length, period, at, force, here)
        for i in range(p + own):
            if i < p:
                step = steps[free[i]]
                moved[free[i]] += step
            else:
                step = (
                    0.01 * scale
                    if (i - p) % 2 == 0
                    else 0.1 * scale / (length * period)
                )
                near[i - p] += step
            window(moved, near, start, length, period, at, force, there)
            for k in range(length):
                out[w, i, k] = (
                    0.0
                    if missing[start + k] or k < first
                    else (there[k] - here[k]) / step
                )
            if i < p:
                moved[free[i]] = theta[free[i]]
            else:
                near[i - p] = states[w, i - p]
        for k in range(length):
            residuals[w, k] = (
                0.0
                if missing[start + k] or k < first
                else position[start + k] - here[k]
            )
