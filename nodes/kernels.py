"""The arithmetic of one tick on one axis, as plain functions on floats.

The nodes call these functions as they stand; the one-process simulator compiles *the same functions* with numba (no
fastmath), which gives the same bits. So they use nothing but floats, comparisons and indexing, and they add in a fixed order.
A term that a scene does not have is passed as None: numba compiles a separate version without it.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence

SMOOTHING = 1.0 / 64.0
"""Part of each tick's delay in the measured one: a mean over some 64 ticks, which one late tick does not throw."""


def plane_distance(position: float, surface: float, normal: float) -> float:
    """Signed distance to a plane across one axis.

    Parameters
    ----------
    position, surface : float
        Coordinates of the device and of the plane on this axis [m].
    normal : float
        +1 or -1: the side of the plane that is free.

    Returns
    -------
    float
        Distance along the normal, negative inside the wall [m].
    """
    return (position - surface) * normal


def deflection(position: float, proxy: float, distance: float, normal: float, contact: bool, raw: bool) -> float:
    """Deflection of the coupling: from the device to its proxy.

    Parameters
    ----------
    position, proxy : float
        Coordinates of the device and its proxy on this axis [m].
    distance : float
        Signed distance to the surface, negative inside [m].
    normal : float
        Component of the outward normal on this axis.
    contact : bool
        Whether the surface is touched.
    raw : bool
        What feeds the derivative's history outside contact: the raw distance (True) or zero (False). The paper does not
        say; the choice moves the K_max of the drop test by up to 17 %.

    Returns
    -------
    float
        Deflection [m], in the direction in which the coupling pushes the device.
    """
    if contact or not raw:
        return proxy - position
    return -distance * normal


def push(history: MutableSequence[float], head: int, length: int, value: float) -> int:
    """Put the newest deflection in front of the history.

    The history is a ring written twice, ``length`` apart, so that the newest ``length`` values are always contiguous:
    ``history[head]`` is the newest, ``history[head + m]`` is m ticks old.

    Parameters
    ----------
    history : sequence of float, shape (2 * length,)
        The ring, changed in place.
    head : int
        Index of the newest value so far.
    length : int
        How many values the ring remembers.
    value : float
        The new value.

    Returns
    -------
    int
        The new head.
    """
    head = head - 1 if head > 0 else length - 1
    history[head] = value
    history[head + length] = value
    return head


def fir(taps: Sequence[float], history: Sequence[float], head: int) -> float:
    """Force of a tap vector over the history, added from the newest value to the oldest.

    Parameters
    ----------
    taps : sequence of float, shape (n + 1,)
        Taps h_0 ... h_n [N/m], h_0 for the newest deflection.
    history : sequence of float
        Ring as written by `push`, remembering at least n + 1 values.
    head : int
        Index of the newest value.

    Returns
    -------
    float
        Force [N].
    """
    force = 0.0
    for m in range(len(taps)):
        force += taps[m] * history[head + m]
    return force


def one_sided(force: float, normal: float, along: float, contact: bool, raw: bool, clamp: bool) -> float:
    """Contact conventions: no force outside a raw-history wall, and no pull towards the wall when clamped.

    What pulls is the part of the force along the normal, not what its axes do each for themselves: on a surface that leans, a
    force that draws the device along it has components against the normal's, and is none that pulls.

    Parameters
    ----------
    force : float
        Force of the law on this axis [N].
    normal : float
        Component of the outward normal on this axis; 0 for a two-sided coupling.
    along : float
        The law's force along the normal, summed over all axes [N].
    contact : bool
        Whether the surface is touched.
    raw : bool
        Whether the history holds the raw distance (see `deflection`).
    clamp : bool
        Whether the part of the force that leads into the wall is taken off.

    Returns
    -------
    float
        Force to render [N].
    """
    if raw and not contact:
        return 0.0
    if clamp and along < 0.0:
        return force - along * normal
    return force


def limit(force: float, previous: float, peak: float | None, slew: float | None) -> float:
    """Limit magnitude and rate of the force handed to the device.

    Parameters
    ----------
    force : float
        Force asked for on this axis [N].
    previous : float
        Force of the tick before, after limits [N].
    peak : float or None
        Largest magnitude [N]; None for no limit.
    slew : float or None
        Largest change per tick [N]; None for no limit.

    Returns
    -------
    float
        Force within both limits [N].
    """
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


def sections(coefficients: Sequence[float], state: MutableSequence[float], newest: float, previous: float) -> float:
    """Force of parallel second-order recursive sections, y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂ each, summed in order.

    Parameters
    ----------
    coefficients : sequence of float, shape (4 * s,)
        b0, b1 [N/m], a1, a2 of each section.
    state : sequence of float, shape (2 * s,)
        y₋₁, y₋₂ [N] of each section, changed in place.
    newest, previous : float
        Deflection at this tick and the one before [m].

    Returns
    -------
    float
        Force [N].
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


def warm_up(
    coefficients: Sequence[float],
    state: MutableSequence[float],
    history: Sequence[float],
    head: int,
    length: int,
) -> None:
    """Bring recursive sections up to date by replaying the history, so that they swap as smoothly as taps do.

    Called between two ticks: after it, `sections` may be called with the next deflection.

    Parameters
    ----------
    coefficients : sequence of float, shape (4 * s,)
        As for `sections`.
    state : sequence of float, shape (2 * s,)
        Fresh state (zeros), changed in place.
    history : sequence of float, shape (2 * length,)
        Ring as written by `push`.
    head : int
        Index of the newest value.
    length : int
        How many values the ring remembers, at least 2.
    """
    for m in range(length - 2, -1, -1):
        sections(coefficients, state, history[head + m], history[head + m + 1])


def cross_fade(old: float, new: float, done: int, ramp: int) -> float:
    """Force during a cross-fade from one law to another, both evaluated over the same history.

    Parameters
    ----------
    old, new : float
        Forces of the two laws [N].
    done : int
        Ticks since the swap, 0 for the first one.
    ramp : int
        Length of the cross-fade [ticks], at least 1: tick ramp − 1 has all of the new law.

    Returns
    -------
    float
        Force [N].
    """
    weight = (done + 1) / ramp
    return (1.0 - weight) * old + weight * new
