"""The arithmetic of one tick on one axis, as plain functions on floats.

The nodes call these functions as they stand; the one-process simulator compiles *the same
functions* with numba (no fastmath), which gives the same bits. So they use nothing but floats,
comparisons and indexing, and they add in a fixed order. A term that a scene does not have is passed
as None: numba compiles a separate version without it.
"""

from collections.abc import MutableSequence, Sequence

from nodes.compiled.rules import rule

# part of each tick's delay in the measured one: a mean over some 64 ticks, not thrown by a late one
SMOOTHING = 1.0 / 64.0


@rule
def plane_distance(position: float, surface: float, normal: float) -> float:
    """Signed distance to a plane across one axis [m]: along its normal, ±1, negative inside the wall."""
    return (position - surface) * normal


@rule
def deflection(
    position: float, proxy: float, distance: float, normal: float, contact: bool, raw: bool
) -> float:
    """Deflection of the coupling [m], in the direction in which it pushes the device: from the device to its proxy.

    `raw` says what feeds the derivative's history outside contact: the raw distance (True) or zero
    (False). The paper does not say; the choice moves the K_max of the drop test by up to 17 %.
    `distance` is negative inside, `normal` the component of the outward normal on this axis.
    """
    if contact or not raw:
        return proxy - position
    return -distance * normal


@rule
def push(history: MutableSequence[float], head: int, length: int, value: float) -> int:
    """Put the newest deflection in front of a history that remembers so many, in place; the new head.

    The history is a ring written twice, ``length`` apart, so that the newest ``length`` values are
    always contiguous: ``history[head]`` is the newest, ``history[head + m]`` is m ticks old.
    """
    head = head - 1 if head > 0 else length - 1
    history[head] = value
    history[head + length] = value
    return head


@rule
def fir(taps: Sequence[float], history: Sequence[float], head: int) -> float:
    """Force [N] of taps h_0 ... h_n [N/m] over the history, added from the newest value to the oldest."""
    force = 0.0
    for m in range(len(taps)):
        force += taps[m] * history[head + m]
    return force


@rule
def one_sided(
    force: float, normal: float, along: float, contact: bool, raw: bool, clamp: bool
) -> float:
    """Contact conventions for a law's force on an axis [N]: none outside a raw-history wall, no pull to the wall when clamped.

    What pulls is the part of the force along the normal (`along`, summed over all axes), not what
    its axes do by themselves: on a surface that leans, a force that draws the device along it has
    components against the normal's, and is none that pulls. A two-sided coupling has the normal 0.
    """
    if raw and not contact:
        return 0.0
    if clamp and along < 0.0:
        return force - along * normal
    return force


@rule
def limit(force: float, previous: float, peak: float | None, slew: float | None) -> float:
    """Limit the magnitude of a force [N], and its change from the one of the tick before; None is no limit."""
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
    """Limit a force as `limit` does where several in one tick share one slew, of which `slewed` is spent [N]."""
    if slew is None:
        return limit(force, previous, peak, None)
    return limit(force, previous, peak, max(slew - slewed, 0.0))


@rule
def sections(
    coefficients: Sequence[float], state: MutableSequence[float], newest: float, previous: float
) -> float:
    """Force of parallel second-order recursive sections, y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂ each, summed in order [N].

    `coefficients` holds b0, b1 [N/m], a1, a2 of each section, `state` y₋₁, y₋₂ [N] of each, changed
    in place.
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
    """Correct sections in place that have seen a newest deflection which is too large by `by` [m]."""
    for i in range(len(state) // 2):
        state[2 * i] -= coefficients[4 * i] * by


def warm_up(
    coefficients: Sequence[float],
    state: MutableSequence[float],
    history: Sequence[float],
    head: int,
    length: int,
) -> None:
    """Bring recursive sections up to date by replaying the history, so that they swap as smoothly as taps do.

    Called between two ticks, with a fresh state (zeros): after it, `sections` may be called with
    the next deflection. A history remembers at least two values.
    """
    for m in range(length - 2, -1, -1):
        sections(coefficients, state, history[head + m], history[head + m + 1])


@rule
def cross_fade(old: float, new: float, done: int, ramp: int) -> float:
    """Force during a cross-fade from one law to another, both evaluated over the same history [N].

    `done` are the ticks since the swap, 0 for the first one; tick ``ramp`` − 1 has all of the new
    law.
    """
    weight = (done + 1) / ramp
    return (1.0 - weight) * old + weight * new


def settle(coefficients: Sequence[float], state: MutableSequence[float], value: float) -> None:
    """Put recursive sections where they come to rest under a deflection that has always been `value`, in place.

    A section whose recursion does not forget (its poles add up to 1) has no such place: it begins
    at zero.
    """
    for i in range(len(state) // 2):
        left = 1.0 + coefficients[4 * i + 2] + coefficients[4 * i + 3]
        y = 0.0
        if left > 1e-12:
            y = (coefficients[4 * i] + coefficients[4 * i + 1]) * value / left
        state[2 * i] = state[2 * i + 1] = y


@rule
def eased(asked: float, felt: float, offset: float, done: int, ramp: int) -> float:
    """Force on its way from what was felt at a jump to what is asked now [N].

    `offset` is felt − asked at the jump; it fades out over `ramp` ticks, of which `done` are over.
    The loop keeps the whole stiffness and damping of its law meanwhile. The force stays between
    both, so that an offset never pulls where neither does.
    """
    if done + 1 >= ramp:
        return asked
    force = asked + offset * (1.0 - (done + 1) / ramp)
    least, most = (asked, felt) if asked < felt else (felt, asked)
    if force < least:
        return least
    return most if force > most else force
