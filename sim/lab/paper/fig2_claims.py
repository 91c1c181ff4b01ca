"""The paper's figure 2 and its claims: normalised f(ω) of Grünwald–Letnikov terms.

Frequencies are in units of ω_N, f in units of a term's f(ω_N). The sum to n is the one that
renders, as in eq. (9) (THEORY.md §1).
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nodes.laws.derivatives.gl import coefficients
from nodes.laws.fields import alternating_sum
from sim.arrays import Array
from sim.lab.paper.claims import Claim, verdict
from sim.lab.paper.descent import damping_curve

# orders of figure 2 (a) and (b)
LOW_ORDERS, HIGH_ORDERS = (0.3, 0.5, 0.7, 1.0), (1.0, 1.3, 1.5, 1.7)
# FIR orders n over which a claim is judged: the paper states none
MEMORIES = (1, 2, 3, 4, 5, 8, 10, 20, 50, 100, 1000)
MIDDLE = 0.5  # upper end of the low and middle frequencies, in units of ω_N


def term_curve(theta: Array, order: float) -> Array:
    """Return f of one term with unlimited memory, (sin(θ/2))^{α−1} cos((α+1)(π−θ)/2)."""
    shape = np.sin(theta / 2.0) ** (order - 1.0) * np.cos(
        0.5 * (order + 1.0) * (math.pi - theta)
    )
    return np.asarray(shape, dtype=np.float64)


@dataclass(frozen=True)
class TermCurve:
    """One curve of figure 2."""

    order: float  # α
    curve: Array  # f with the taps of the figure, 1 at ω_N
    unlimited: Array  # f with unlimited memory
    zero: float  # last zero before f stays positive, ω/ω_N; NaN if f is never negative


def figure_2(
    taps: int, points: int = 400
) -> tuple[Array, list[TermCurve], list[TermCurve]]:
    """Compute f(ω) of single terms."""
    theta = np.pi * np.arange(1, points + 1) / points

    def term(order: float) -> TermCurve:
        curve = one_term(theta, order, taps)
        return TermCurve(
            order, curve, term_curve(theta, order), _last_zero(theta, curve)
        )

    return (
        theta,
        [term(order) for order in LOW_ORDERS],
        [term(order) for order in HIGH_ORDERS],
    )


def one_term(theta: Array, order: float, taps: int) -> Array:
    """Return f of one term of n + 1 taps, normalised by its own f(ω_N)."""
    return damping_curve(theta, np.ones(1), np.array([order]), taps)


def curve_of(theta: Array, order: float, memory: float) -> Array:
    """Return f of one term with memory n, or infinite memory."""
    return (
        term_curve(theta, order)
        if memory == math.inf
        else one_term(theta, order, int(memory) + 1)
    )


def _last_zero(theta: Array, curve: Array) -> float:
    """Interpolate the highest sign change of a curve that ends positive [ω_N]."""
    below = np.flatnonzero(curve < 0.0)
    if not below.size:
        return math.nan
    i = int(below[-1])
    share = curve[i] / (curve[i] - curve[i + 1])
    return float((theta[i] + share * (theta[i + 1] - theta[i])) / math.pi)


def order_of_signs(difference: Array) -> str:
    """Return the signs of a curve from low to high frequency, without repeats.

    '-+' is first below, then above.
    """
    signs = np.sign(difference)[np.abs(difference) > 1e-9]
    return "".join(
        "+" if s > 0 else "-"
        for i, s in enumerate(signs)
        if i == 0 or s != signs[i - 1]
    )


def for_which(holds: dict[int, bool]) -> str:
    """Return the memories for which a claim holds, in words."""
    good, bad = (
        [n for n, yes in holds.items() if yes],
        [n for n, yes in holds.items() if not yes],
    )
    return f"n = {', '.join(map(str, good)) or 'none'}" + (
        f"; not n = {', '.join(map(str, bad))}" if bad else ""
    )


def _by_memory(
    source: str, claim: str, judge: Callable[[float], bool], number: str
) -> Claim:
    """Judge a claim at every memory of `MEMORIES` and with unlimited memory."""
    holds, unlimited = {n: judge(n) for n in MEMORIES}, judge(math.inf)
    everywhere = all(holds.values()) and unlimited
    which = "every n looked at" if all(holds.values()) else for_which(holds)
    found = f"{which}; unlimited memory: {'yes' if unlimited else 'no'}" + (
        f"; {number}" if number else ""
    )
    return Claim(
        source, claim, verdict(everywhere, any(holds.values()) or unlimited), found
    )


def claims_2(taps: int) -> list[Claim]:
    """Judge the claims of the paper's section 3.2 on figure 2 and those of THEORY.md."""
    theta, low, high = figure_2(taps)
    pd = -np.cos(theta)
    orders = {*LOW_ORDERS, *HIGH_ORDERS}
    curves = {
        (a, n): curve_of(theta, a, n) for a in orders for n in (*MEMORIES, math.inf)
    }
    finite = [curve for (_, n), curve in curves.items() if n < math.inf]
    return [
        Claim(
            "paper, fig. 2 and eq. (9)",
            "per term, B_α is chosen such that f(ω_N) = 1",
            verdict(all(abs(curve[-1] - 1.0) < 1e-12 for curve in finite)),
            "gains: paper is that of the sum to n; |f(ω_N) − 1| ≤"
            f" {max(abs(c[-1] - 1.0) for c in finite):.0e}",
        ),
        *_below_1(theta, curves, [*low, *high[1:]], taps),
        *_above_1(theta, curves, high[1:], taps),
        _by_memory(
            "paper, section 3.2",
            "a single term is not enough: none is more passive than PD at low and middle"
            " frequencies both",
            lambda n: all(
                _worse_somewhere(theta, curve_of(theta, a, n), pd) for a in _OTHERS
            ),
            f"α = {_OTHERS[0]} to {_OTHERS[-1]} but 1, up to {MIDDLE:g} ω_N; at n = 1 the leak"
            " passes for damping",
        ),
        Claim(
            "paper, eq. (1) and (9)",
            "PD: f = −B cos ωT",
            verdict(float(np.abs(low[-1].curve - pd).max()) < 1e-12),
            f"largest difference {np.abs(low[-1].curve - pd).max():.0e}",
        ),
        *_ours_2(theta, taps),
    ]


# f of one term by its order and memory n; n infinite for unlimited memory
Curves = Mapping[tuple[float, float], Array]


def _below_1(
    theta: Array, curves: Curves, shown: Sequence[TermCurve], taps: int
) -> list[Claim]:
    """Judge the claims on orders below 1, and on the zero of all orders."""
    pd, below = -np.cos(theta), LOW_ORDERS[:-1]

    def rises(n: float, orders: Sequence[float] = below) -> bool:
        return all(bool((np.diff(curves[a, n]) > 0.0).all()) for a in orders)

    def moves(n: float) -> bool:
        return _rising(
            [_last_zero(theta, curves[a, n]) for a in (*below, *HIGH_ORDERS)]
        )

    def crosses(n: float) -> bool:
        return all(order_of_signs(curves[a, n] - pd) == "-+" for a in below)

    zeros = ", ".join(f"{term.order:g} at {term.zero:.3f}" for term in shown)
    return [
        _by_memory(
            "paper, section 3.2, fig. 2(a)",
            "0 < α < 1: f rises monotonically with ω",
            rises,
            f"α = 0.7 alone: {for_which({n: rises(n, (0.7,)) for n in MEMORIES})}",
        ),
        _by_memory(
            "paper, section 3.2, fig. 2",
            "the zero of f moves right as α grows",
            moves,
            f"n = {taps - 1}: {zeros} ω_N; unlimited: α/(α+1)",
        ),
        _by_memory(
            "paper, section 3.2, fig. 2(a)",
            "0 < α < 1: more passive than PD at low frequencies, less at middle ones",
            crosses,
            "α = 0.3 needs n ≥ 5, 0.5 n ≥ 3, 0.7 n ≥ 2",
        ),
    ]


def _above_1(
    theta: Array, curves: Curves, shown: Sequence[TermCurve], taps: int
) -> list[Claim]:
    """Judge the claims on orders above 1."""
    pd, above = -np.cos(theta), HIGH_ORDERS[1:]

    def dips(n: float) -> bool:
        return all(0 < int(np.argmin(curves[a, n])) < theta.size - 1 for a in above)

    def starts_at_zero(n: float) -> bool:
        # With unlimited memory f(0) is 0 for all, and does not rise.
        starts = (
            [] if n == math.inf else [_at_zero(a, int(n) + 1) for a in (*above, 2.0)]
        )
        return bool(starts) and _rising(starts) and abs(starts[-1]) < 1e-9

    def crosses(n: float) -> bool:
        return all(order_of_signs(curves[a, n] - pd) == "+-" for a in above)

    lowest = ", ".join(
        f"{term.order:g} at {theta[int(np.argmin(term.curve))] / math.pi:.2f} ω_N"
        for term in shown
    )
    starts = ", ".join(f"{a:g}: {_at_zero(a, taps):+.3f}" for a in (*above, 2.0))
    return [
        _by_memory(
            "paper, section 3.2, fig. 2(b)",
            "1 < α < 2: f has a minimum between 0 and ω_N",
            dips,
            f"n = {taps - 1}: {lowest}",
        ),
        _by_memory(
            "paper, section 3.2, fig. 2(b)",
            "1 < α < 2: f(0) rises to zero with α",
            starts_at_zero,
            f"n = {taps - 1}: {starts}; unlimited: f(0) = 0 for all",
        ),
        _by_memory(
            "paper, section 3.2, fig. 2(b)",
            "1 < α < 2: less passive than PD at low frequencies, more at middle ones",
            crosses,
            "",
        ),
    ]


_OTHERS = tuple(round(0.1 * i, 1) for i in range(1, 40) if i != 10)


def _rising(values: Sequence[float]) -> bool:
    return all(a < b for a, b in itertools.pairwise(values))


def _worse_somewhere(theta: Array, curve: Array, pd: Array) -> bool:
    inside = theta <= MIDDLE * math.pi
    return bool((curve[inside] > pd[inside] + 1e-9).any())


def _at_zero(order: float, taps: int) -> float:
    """Return f(0) of a normalised term: T Σ c_m (½ + m) in units of f(ω_N)."""
    total = sum(
        coefficient * (0.5 + m)
        for m, coefficient in enumerate(coefficients(order, taps))
    )
    return 2.0 * total / alternating_sum(order, taps)


def _ours_2(theta: Array, taps: int) -> list[Claim]:
    """Judge the additions of THEORY.md to figure 2: the closed form and the leak."""
    # 4096 taps against the closed form, away from ω = 0, where no finite memory converges.
    inside = theta >= 0.05 * math.pi
    long = max(
        float(np.abs(one_term(theta, a, 4096) - term_curve(theta, a))[inside].max())
        for a in HIGH_ORDERS
    )
    leaks = {a: leak_of(a, taps) for a in (*LOW_ORDERS, *HIGH_ORDERS, 2.5, 3.5)}
    worst = max(leaks, key=lambda a: abs(leaks[a]))
    return [
        Claim(
            "THEORY.md §2",
            "f = T^(1−α) (2 sin(ωT/2))^(α−1) cos((α+1)(π−ωT)/2) for unlimited memory",
            verdict(long < 1e-2),
            f"4096 taps, 1 ≤ α < 2, ω ≥ 0.05 ω_N: largest difference {long:.1e}",
        ),
        Claim(
            "THEORY.md §1",
            "a truncated derivative leaks: D(1) > 0 for 0<α<1 and 2<α<3, < 0 for 1<α<2 and 3<α<4",
            verdict(all(_leak_sign(a, leak) for a, leak in leaks.items())),
            f"with {taps} taps the largest is at α = {worst}: D(1) = {leaks[worst]:+.3f} of"
            " f(ω_N)·2/T",
        ),
    ]


def leak_of(order: float, taps: int) -> float:
    """Return D(1) of a normalised term, in units of 2/T."""
    return sum(coefficients(order, taps)) / alternating_sum(order, taps)


def _leak_sign(order: float, leak: float) -> bool:
    if order == math.floor(order):
        return abs(leak) < 1e-12
    return leak > 0.0 if math.floor(order) % 2 == 0 else leak < 0.0
