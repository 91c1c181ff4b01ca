"""Arithmetic of one tick on one axis, as plain functions on floats.

The nodes call these functions interpreted; the one-process simulator compiles *the same functions*
with numba (no fastmath), with equal bits. So they use only floats, comparisons and indexing, and
add in a fixed order. Absent terms are None: numba compiles a separate version without them.
"""

from collections.abc import MutableSequence, Sequence

from nodes.compiled.rules import rule

# Weight of each tick in the measured delay: a mean over 64 ticks, robust against a late one.
SMOOTHING = 1.0 / 64.0


@rule
def plane_distance(position: float, surface: float, normal: float) -> float:
    """Return the signed distance to a plane across an axis [m], negative inside the wall.

    `normal` is ±1.
    """
    return (position - surface) * normal


@rule
def deflection(
    position: float,
    proxy: float,
    distance: float,
    normal: float,
    contact: bool,
    raw: bool,
) -> float:
    """Return the deflection from the device to its proxy [m].

    `raw` selects what enters the derivative's history outside contact: the raw distance (True) or
    zero (False). The paper does not specify it; the choice changes the K_max of the drop test by up
    to 17 %. `distance` is negative inside, `normal` the component of the outward normal on this
    axis.
    """
    if contact or not raw:
        return proxy - position
    return -distance * normal


@rule
def push(history: MutableSequence[float], head: int, length: int, value: float) -> int:
    """Insert the newest deflection into a history of `length` values; return the new head.

    The history is a ring buffer written twice, ``length`` apart, so that the newest ``length``
    values are always contiguous: ``history[head]`` is the newest, ``history[head + m]`` is m ticks
    old.
    """
    head = head - 1 if head > 0 else length - 1
    history[head] = value
    history[head + length] = value
    return head


@rule
def fir(taps: Sequence[float], history: Sequence[float], head: int) -> float:
    """Return the force of taps h_0 … h_n [N/m] over the history [N], summed newest first."""
    force = 0.0
    for m in range(len(taps)):
        force += taps[m] * history[head + m]
    return force


@rule
def one_sided(
    force: float, normal: float, along: float, contact: bool, raw: bool, clamp: bool
) -> float:
    """Apply the contact conventions to a law's force on an axis [N].

    Outside a raw-history wall the force is zero; if `clamp`, it never pulls to the wall. What pulls
    is the part of the force along the normal (`along`, summed over all axes), not single
    components: on an inclined surface a tangential force has components against the normal's. A
    two-sided coupling has the normal 0.
    """
    if raw and not contact:
        return 0.0
    if clamp and along < 0.0:
        return force - along * normal
    return force


@rule
def limit(
    force: float, previous: float, peak: float | None, slew: float | None
) -> float:
    """Limit a force and its change from the previous tick's [N]; None is no limit."""
    if peak is not None:
        if force > peak:
            force = peak
        elif force < -peak:
            force = -peak
    if slew is not None:
        if force > previous + slew:
            force = previous + slew
        elif force < previous - slew:
            force = previous - slew
    return force


@rule
def limit_within_tick(
    force: float, previous: float, peak: float | None, slew: float | None, slewed: float
) -> float:
    """Limit a force like `limit` if several in one tick share a slew, `slewed` of it used [N]."""
    if slew is None:
        return limit(force, previous, peak, None)
    return limit(force, previous, peak, max(slew - slewed, 0.0))


@rule
def sections(
    coefficients: Sequence[float],
    state: MutableSequence[float],
    newest: float,
    previous: float,
) -> float:
    """Return the force of parallel second-order recursive sections [N], summed in order.

    Each is y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂. `coefficients` holds b0, b1 [N/m], a1, a2 of each
    section, `state` y₋₁, y₋₂ [N] of each, updated in place.
    """
    force = 0.0
    for i in range(len(state) // 2):
        y = (
            coefficients[4 * i] * newest
            + coefficients[4 * i + 1] * previous
            - coefficients[4 * i + 2] * state[2 * i]
            - coefficients[4 * i + 3] * state[2 * i + 1]
        )
        state[2 * i + 1] = state[2 * i]
        state[2 * i] = y
        force += y
    return force


@rule
def newest_gain(taps: Sequence[float], coefficients: Sequence[float]) -> float:
    """Return the gain of taps and parallel sections on the newest deflection, dF/dx₀ [N/m]."""
    gain = taps[0]
    for i in range(len(coefficients) // 4):
        gain += coefficients[4 * i]
    return gain


@rule
def revise_sections(
    coefficients: Sequence[float], state: MutableSequence[float], by: float
) -> None:
    """Correct sections in place after a newest deflection that was too large by `by` [m]."""
    for i in range(len(state) // 2):
        state[2 * i] -= coefficients[4 * i] * by


def warm_up(
    coefficients: Sequence[float],
    state: MutableSequence[float],
    history: Sequence[float],
    head: int,
    length: int,
) -> None:
    """Initialise recursive sections by replaying the history, so that they swap smoothly.

    Called between two ticks with a zero state; afterwards `sections` may be called with the next
    deflection. A history has at least two values.
    """
    for m in range(length - 2, -1, -1):
        sections(coefficients, state, history[head + m], history[head + m + 1])


@rule
def cross_fade(old: float, new: float, done: int, ramp: int) -> float:
    """Return the force during a cross-fade between laws over the same history [N].

    `done` counts the ticks since the swap from 0; tick ``ramp`` − 1 has the new law only.
    """
    weight = (done + 1) / ramp
    return (1.0 - weight) * old + weight * new


def settle(
    coefficients: Sequence[float], state: MutableSequence[float], value: float
) -> None:
    """Set recursive sections to their equilibrium under a constant deflection, in place.

    A section that does not forget (its poles sum to 1) has none and starts at zero.
    """
    for i in range(len(state) // 2):
        left = 1.0 + coefficients[4 * i + 2] + coefficients[4 * i + 3]
        y = 0.0
        if left > 1e-12:
            y = (coefficients[4 * i] + coefficients[4 * i + 1]) * value / left
        state[2 * i] = state[2 * i + 1] = y


@rule
def eased(asked: float, felt: float, offset: float, done: int, ramp: int) -> float:
    """Return the force between what was felt at a jump and what is requested now [N].

    `offset` is felt − asked at the jump; it fades over `ramp` ticks, of which `done` have passed.
    The loop has the law's full stiffness and damping meanwhile. The force stays between both, so
    that an offset never pulls where neither does.
    """
    if done + 1 >= ramp:
        return asked
    force = asked + offset * (1.0 - (done + 1) / ramp)
    low, high = (asked, felt) if asked < felt else (felt, asked)
    if force < low:
        return low
    return high if force > high else force
