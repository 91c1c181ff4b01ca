"""Where methods fail: each boundary from just inside and just outside, by pole radius and by simulation, and known traps.

A boundary is only believed when two independent methods change their mind at the same place. The traps are those that
THEORY.md names: methods that look right and are not, each made to fail here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.experiments.drop import Criterion, free_scene, settles
from sim.paper.claims import Claim, verdict
from sim.paper.traps import (
    PERIOD,
    chatter_bound,
    descent_outcomes,
    euler_bias,
    fragility,
    gamma_coefficient,
    leak_boundary,
    leak_law,
    model,
    optimum,
    recursive_coefficient,
    tustin_split,
    tustin_whole,
)

MARGIN = 0.002
"""How far inside and outside a boundary is looked at, as a share of K."""
HORIZON = 400_000
"""Ticks of those swings: enough to tell e^{−x} from e^{+x} at that margin on every boundary below."""


@dataclass(frozen=True)
class FailureEdge:
    """A stability boundary, seen from both sides."""

    name: str  # law, device and delay
    stiffness: float  # K at the boundary [N/m]
    # Pole radius at K·(1 ∓ MARGIN).
    inside: float
    outside: float
    # Whether the simulated free swing settled there.
    settled_inside: bool
    settled_outside: bool

    @property
    def agreed(self) -> bool:
        """Whether both methods put the boundary between the two points."""
        return self.inside < 1.0 < self.outside and self.settled_inside and not self.settled_outside


Boundary = tuple[str, CompiledLaw, Plant]
"""Name of a law, its derivative part, and the device."""


def boundaries() -> list[Boundary]:
    """List the boundaries that are looked at."""
    spring = CompiledLaw((0.0,))
    recursive = without_spring(
        PDAlpha(stiffness=1.0, damping=2.0, order=0.8, taps=6, gains="paper", derivative="oustaloup_matched"),
        PERIOD,
    )
    short = without_spring(PDAlpha(stiffness=1.0, damping=2.0, order=1.5, taps=8, gains="paper"), PERIOD)
    return [
        ("spring", spring, Plant(PERIOD, 0.1, 1.0)),
        ("PD, B 2 N s/m", without_spring(PD(stiffness=1.0, damping=2.0), PERIOD), Plant(PERIOD, 0.1, 1.0)),
        ("PD, B 2 N s/m", without_spring(PD(stiffness=1.0, damping=2.0), PERIOD), Plant(PERIOD, 0.1, 1.0, 1.0)),
        ("PD, B 2 N s/m", without_spring(PD(stiffness=1.0, damping=2.0), PERIOD), Plant(PERIOD, 0.1, 1.0, 0.4)),
        ("PD, B 40 N s/m", without_spring(PD(stiffness=1.0, damping=40.0), PERIOD), Plant(PERIOD, 0.1, 1.0)),
        ("PDα, α 1.5, 8 taps", short, Plant(PERIOD, 0.05, 1.0)),
        ("PDα, α 0.8, Oustaloup", recursive, Plant(PERIOD, 0.1, 1.0, 1.0)),
        ("paper's optimum, B 3 N s/m", optimum(3.0), Plant(PERIOD, 0.1, 1.0)),
        ("paper's optimum, B 3 N s/m", optimum(3.0), Plant(PERIOD, 0.1, 1.0, 1.0)),
        ("paper's optimum, B 30 N s/m", optimum(30.0), Plant(PERIOD, 0.1, 1.0)),
        ("paper's optimum, B 3 N s/m, hand 300 N/m", optimum(3.0), Plant(PERIOD, 0.1, 1.0, 0.0, 300.0)),
    ]


def both_sides(boundary: Boundary) -> FailureEdge | None:
    """Look at a boundary from both sides; None where there is no limit."""
    name, derivative, device = boundary
    limit = k_max(derivative, device).k_max_n_per_m
    if limit is None or not math.isfinite(limit):
        return None
    laws = [with_spring(derivative, limit * share) for share in (1.0 - MARGIN, 1.0 + MARGIN)]
    inside, outside = (pole_radius(law, device) for law in laws)
    settled = settles(free_scene(model(device), PERIOD), laws, Criterion(HORIZON))
    return FailureEdge(
        f"{name}, m {device.mass:g} kg, d {device.delay:g} ticks", limit, inside, outside, settled[0], settled[1]
    )


def edges() -> Iterator[FailureEdge]:
    """Look at every boundary from both sides."""
    yield from filter(None, map(both_sides, boundaries()))


def traps() -> list[Claim]:
    """Make every named trap spring."""
    first = next(m for m in range(1, 400) if gamma_coefficient(0.5, m) == 0.0)
    whole, split = tustin_whole(500.0, 0.05), tustin_split(500.0, 0.05)
    bad, good = (pole_radius(law, Plant(PERIOD, 0.1, 1.0)) for law in (whole, split))
    noisy = {name: chatter_bound(name) for name in ("pd", "optimum")}
    passive = 2.0 * (1.0 - 2.0) / PERIOD
    really = k_max(without_spring(PD(stiffness=1.0, damping=2.0), PERIOD), Plant(PERIOD, 0.1, 1.0)).k_max_n_per_m or 0.0
    slow, fast = descent_outcomes(0.03), descent_outcomes(3.0)
    return [
        _euler_claim(),
        Claim(
            "THEORY.md §1",
            "the printed Gamma ratio gives 0 from m = 171 on",
            verdict(first == 171),
            f"first zero at m = {first}; the recursion gives {recursive_coefficient(0.5, first):.3e} there (α = 0.5)",
        ),
        _leak_claim(),
        Claim(
            "THEORY.md §7",
            "Tustin-CFE of the whole α > 1 is unstable; split off the integer part",
            verdict(not whole.stable_sections() and split.stable_sections() and bad > 1.0 > good),
            f"α = 1.5, degree 2, in the loop: pole radius {bad:.3f} whole, {good:.5f} split",
        ),
        _fragile_claim(fragility()),
        Claim(
            "THEORY.md §5",
            "encoder noise is multiplied with H(−1): chatter iff f_c < Δ·H(−1)/2",
            verdict(False, all(ratio <= 1.0 for _, _, ratio in noisy.values())),
            "only if read as a bound: friction that stops a mass of 0.1 kg at rest on the floor, over Δ·H(−1)/2: "
            + ", ".join(f"{n} {ratio:.2f} (H(−1) = {h:.0f} N/m)" for n, (h, _, ratio) in noisy.items()),
        ),
        Claim(
            "THEORY.md §2",
            "the passivity limit is far below what really is stable on a known device",
            verdict(really > 2.0 / PERIOD),
            f"PD, B = 2 N s/m, b = 1: passive for K < 2(b − B)/T = {passive:.0f} N/m, so never; stable up to {really:.0f}",
        ),
        Claim(
            "THEORY.md §2; paper, eq. (13)–(15)",
            "steepest descent on the cost (13) ends in many places, or runs away",
            verdict("diverged" in fast or "out_of_range" in fast),
            f"starts by outcome: rate 0.03 {slow}, rate 3 {fast}",
        ),
    ]


def _euler_claim() -> Claim:
    biases = {n: euler_bias(n) for n in (2, 4, 10, 50)}
    worst = max(abs(found / predicted - 1.0) for found, predicted in biases.values())
    return Claim(
        "THEORY.md §3",
        "semi-implicit Euler with n_sub sub-steps overstates K_max by 1/(1 − 1/n_sub)",
        verdict(worst < 0.01, worst < 0.1),
        "heavy device (10 kg), found/predicted: "
        + ", ".join(f"n={n} {found:.3f}/{predicted:.3f}" for n, (found, predicted) in biases.items()),
    )


def _leak_claim() -> Claim:
    limit = leak_boundary()
    inside, outside = leak_law(0.999 * limit), leak_law(1.001 * limit)
    # A hand heavy enough that only the leak, not the damping, can make it unstable.
    radii = [pole_radius(law, Plant(PERIOD, 5.0, 1.0)) for law in (inside, outside)]
    return Claim(
        "THEORY.md §1",
        "truncation leaks until H(1) ≤ 0",
        verdict(inside.h1 > 0.0 > outside.h1 and radii[0] < 1.0 < radii[1]),
        f"PDα 1.5, 4 taps, K = 1000: at B = {limit:.1f} N s/m nothing is felt; pole radius − 1 at B ∓ 0.1 %: "
        f"{radii[0] - 1.0:+.1e}, {radii[1] - 1.0:+.1e}",
    )


def _fragile_claim(fragile: dict[str, dict[str, tuple[float, bool]]]) -> Claim:
    def shown(name: str) -> str:
        return ", ".join(f"{loop} {radius:.3f}" for loop, (radius, _) in fragile[name].items())

    optimum_fails = fragile["optimum"]["one tick of delay"][0] > 1.0 and fragile["optimum"]["half the mass"][0] > 1.0
    return Claim(
        "THEORY.md §2, §3",
        "what multi-term gains at d = 0 does not survive one tick of delay, or half the mass",
        verdict(optimum_fails),
        f"B = 30, 0.9 K_max, pole radius: optimum {shown('optimum')}; nor does PD tuned as tightly: {shown('pd')}",
    )
