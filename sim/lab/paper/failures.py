"""Limits of methods: each boundary checked inside and outside, and known traps.

A boundary is accepted only if two independent methods, pole radius and simulation, change their
verdict at the same place. The traps are those that THEORY.md names: methods that look right and
fail; each failure is reproduced here.
"""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.derivatives import realise
from nodes.laws.derivatives.cfe import whole_order
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha, combine
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene, free_scene, held
from sim.experiments.settling import Criterion, settles
from sim.lab.charts.integrators import euler, spring_limit
from sim.lab.paper.claims import Claim, verdict
from sim.lab.paper.descent import paper_targets, starting, steepest_descent
from sim.play.one_axis import run

MARGIN = 0.002  # relative distance of the checks from a boundary, in K
# ticks of those swings: enough to separate e^{−x} from e^{+x} at that margin on every boundary
# below
HORIZON = 400_000


@dataclass(frozen=True)
class FailureEdge:
    """A stability boundary, checked on both sides."""

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
        """Whether both methods place the boundary between the two points."""
        return (
            self.inside < 1.0 < self.outside
            and self.settled_inside
            and not self.settled_outside
        )


# name of a law, its derivative part, and the device
Boundary = tuple[str, CompiledLaw, Plant]


def boundaries() -> list[Boundary]:
    """Return the boundaries to check."""
    spring = CompiledLaw((0.0,))
    recursive = without_spring(
        PDAlpha(
            stiffness=1.0,
            damping=2.0,
            order=0.8,
            taps=6,
            gains="paper",
            derivative="oustaloup_matched",
        ),
        PERIOD,
    )
    short = without_spring(
        PDAlpha(stiffness=1.0, damping=2.0, order=1.5, taps=8, gains="paper"), PERIOD
    )
    pd = without_spring(PD(stiffness=1.0, damping=2.0), PERIOD)
    return [
        ("spring", spring, Plant(PERIOD, 0.1, 1.0)),
        *(
            ("PD, B 2 N s/m", pd, Plant(PERIOD, 0.1, 1.0, delay))
            for delay in (0.0, 1.0, 0.4)
        ),
        (
            "PD, B 40 N s/m",
            without_spring(PD(stiffness=1.0, damping=40.0), PERIOD),
            Plant(PERIOD, 0.1, 1.0),
        ),
        ("PDα, α 1.5, 8 taps", short, Plant(PERIOD, 0.05, 1.0)),
        ("PDα, α 0.8, Oustaloup", recursive, Plant(PERIOD, 0.1, 1.0, 1.0)),
        ("paper's optimum, B 3 N s/m", optimum(3.0), Plant(PERIOD, 0.1, 1.0)),
        ("paper's optimum, B 3 N s/m", optimum(3.0), Plant(PERIOD, 0.1, 1.0, 1.0)),
        ("paper's optimum, B 30 N s/m", optimum(30.0), Plant(PERIOD, 0.1, 1.0)),
        (
            "paper's optimum, B 3 N s/m, hand 300 N/m",
            optimum(3.0),
            Plant(PERIOD, 0.1, 1.0, 0.0, 300.0),
        ),
    ]


def both_sides(boundary: Boundary) -> FailureEdge | None:
    """Check a boundary on both sides; None if there is no limit."""
    name, derivative, device = boundary
    limit = k_max(derivative, device).k_max_n_per_m
    if limit is None or not math.isfinite(limit):
        return None
    laws = [
        with_spring(derivative, limit * share) for share in (1.0 - MARGIN, 1.0 + MARGIN)
    ]
    inside, outside = (pole_radius(law, device) for law in laws)
    settled = settles(free_scene(held(device), PERIOD), laws, Criterion(HORIZON))
    return FailureEdge(
        f"{name}, m {device.mass:g} kg, d {device.delay:g} ticks",
        limit,
        inside,
        outside,
        settled[0],
        settled[1],
    )


def traps() -> list[Claim]:
    """Reproduce every named trap; return the verdicts."""
    first = next(m for m in range(1, 400) if gamma_coefficient(0.5, m) == 0.0)
    whole, split = tustin_whole(500.0, 0.05), tustin_split(500.0, 0.05)
    bad, good = (pole_radius(law, Plant(PERIOD, 0.1, 1.0)) for law in (whole, split))
    noisy = {name: chatter_bound(name) for name in ("pd", "optimum")}
    passive = 2.0 * (1.0 - 2.0) / PERIOD
    really = (
        k_max(
            without_spring(PD(stiffness=1.0, damping=2.0), PERIOD),
            Plant(PERIOD, 0.1, 1.0),
        ).k_max_n_per_m
        or 0.0
    )
    slow, fast = descent_outcomes(0.03), descent_outcomes(3.0)
    return [
        _euler_claim(),
        Claim(
            "THEORY.md §1",
            "the printed Gamma ratio gives 0 from m = 171 on",
            verdict(first == 171),
            f"first zero at m = {first}; the recursion gives"
            f" {coefficients(0.5, first + 1)[first]:.3e} there (α = 0.5)",
        ),
        _leak_claim(),
        Claim(
            "THEORY.md §7",
            "Tustin-CFE of the whole α > 1 is unstable; split off the integer part",
            verdict(
                not whole.stable_sections()
                and split.stable_sections()
                and bad > 1.0 > good
            ),
            f"α = 1.5, degree 2, in the loop: pole radius {bad:.3f} whole, {good:.5f} split",
        ),
        _fragile_claim(fragility()),
        Claim(
            "THEORY.md §5",
            "encoder noise is multiplied with H(−1): chatter iff f_c < Δ·H(−1)/2",
            # "Iff": the friction that stops it is the bound itself, to a percent.
            verdict(
                all(abs(ratio - 1.0) < 0.01 for _, _, ratio in noisy.values()),
                all(ratio <= 1.0 for _, _, ratio in noisy.values()),
            ),
            "read as a bound: friction that stops a mass of 0.1 kg at rest on the floor,"
            " over Δ·H(−1)/2: "
            + ", ".join(
                f"{n} {ratio:.2f} (H(−1) = {h:.0f} N/m)"
                for n, (h, _, ratio) in noisy.items()
            ),
        ),
        Claim(
            "THEORY.md §2",
            "the passivity limit is far below what really is stable on a known device",
            verdict(really > max(passive, 0.0) + 2.0 / PERIOD),
            f"PD, B = 2 N s/m, b = 1: passive for K < 2(b − B)/T = {passive:.0f} N/m;"
            f" stable up to {really:.0f}",
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
        + ", ".join(
            f"n={n} {found:.3f}/{predicted:.3f}"
            for n, (found, predicted) in biases.items()
        ),
    )


def _leak_claim() -> Claim:
    limit = leak_boundary()
    inside, outside = leak_law(0.999 * limit), leak_law(1.001 * limit)
    # A hand so heavy that only the leak, not the damping, can destabilise it.
    radii = [pole_radius(law, Plant(PERIOD, 5.0, 1.0)) for law in (inside, outside)]
    return Claim(
        "THEORY.md §1",
        "truncation leaks until H(1) ≤ 0",
        verdict(inside.h1 > 0.0 > outside.h1 and radii[0] < 1.0 < radii[1]),
        f"PDα 1.5, 4 taps, K = 1000: at B = {limit:.1f} N s/m nothing is felt; pole radius − 1 at B"
        f" ∓ 0.1 %: {radii[0] - 1.0:+.1e}, {radii[1] - 1.0:+.1e}",
    )


def _fragile_claim(fragile: dict[str, dict[str, tuple[float, bool]]]) -> Claim:
    def shown(name: str) -> str:
        return ", ".join(
            f"{loop} {radius:.3f}" for loop, (radius, _) in fragile[name].items()
        )

    optimum_fails = (
        fragile["optimum"]["one tick of delay"][0] > 1.0
        and fragile["optimum"]["half the mass"][0] > 1.0
    )
    return Claim(
        "THEORY.md §2, §3",
        "what multi-term gains at d = 0 does not survive one tick of delay, or half the mass",
        verdict(optimum_fails),
        f"B = 30, 0.9 K_max, pole radius: optimum {shown('optimum')}; nor does PD tuned as tightly:"
        f" {shown('pd')}",
    )


PERIOD = 0.002  # T of everything below [s]: the paper's


def optimum(damping: float) -> CompiledLaw:
    """Return the derivative part of the paper's optimum."""
    return without_spring(
        parse_law({"kind": "paper_optimum", "damping": damping}), PERIOD
    )


def euler_bias(substeps: int) -> tuple[float, float]:
    """Return the overestimate of K_max by semi-implicit Euler, found and predicted.

    The device is heavy.
    """
    mass, damping = 10.0, 1.0
    exact = k_max(CompiledLaw((0.0,)), Plant(PERIOD, mass, damping)).k_max_n_per_m
    assert exact is not None  # noqa: S101 - a spring on a damped mass always has a limit
    return spring_limit(euler(substeps, True, mass, damping)) / exact, 1.0 / (
        1.0 - 1.0 / substeps
    )


def gamma_coefficient(order: float, m: int) -> float:
    """Compute a Grünwald–Letnikov coefficient by the paper's Gamma ratio, in floating point."""
    from scipy.special import gamma

    with np.errstate(over="ignore", invalid="ignore"):
        return float(gamma(m - order) / (gamma(-order) * gamma(m + 1.0)))


def leak_law(damping: float, stiffness: float = 1000.0) -> CompiledLaw:
    """Return a PDα whose short memory leaks: α = 1.5, 4 taps, normalised gain."""
    return PDAlpha(
        stiffness=stiffness, damping=damping, order=1.5, taps=4, gains="paper"
    ).compile(PERIOD)


def leak_boundary(stiffness: float = 1000.0) -> float:
    """Return the B at which the leak of `leak_law` cancels the nominal stiffness: H(1) = 0."""
    return stiffness / (stiffness - leak_law(1.0, stiffness).h1)


def tustin_whole(stiffness: float, gain: float, order: float = 1.5) -> CompiledLaw:
    """Return a PDα with a Tustin CFE of degree 2 for the whole α, which fails above α = 1."""
    zeros, poles = whole_order(order, 2, 1.0)
    n1, n0 = -(zeros[0] + zeros[1]).real, (zeros[0] * zeros[1]).real
    a1, a2 = -(poles[0] + poles[1]).real, (poles[0] * poles[1]).real
    scale = gain * (2.0 / PERIOD) ** order
    direct = n0 / a2
    return CompiledLaw(
        (stiffness + scale * direct,),
        ((scale * (1.0 - direct), scale * (n1 - direct * a1), a1, a2),),
    )


def tustin_split(stiffness: float, gain: float, order: float = 1.5) -> CompiledLaw:
    """Return the same PDα with the integer part of α split off."""
    return combine(stiffness, [(gain, realise("tustin_cfe", order, 3, PERIOD))])


def fragility(
    damping: float = 30.0, share: float = 0.9
) -> dict[str, dict[str, tuple[float, bool]]]:
    """Tune PD and the paper's optimum to a fraction of K_max, then change the loop.

    K_max is that at 0.1 kg without delay.
    """
    loops = {
        "as tuned": Plant(PERIOD, 0.1, 1.0),
        "one tick of delay": Plant(PERIOD, 0.1, 1.0, 1.0),
        "half a tick of delay": Plant(PERIOD, 0.1, 1.0, 0.5),
        "half the mass": Plant(PERIOD, 0.05, 1.0),
        "twice the mass": Plant(PERIOD, 0.2, 1.0),
    }
    derivatives = {
        "pd": without_spring(PD(stiffness=1.0, damping=damping), PERIOD),
        "optimum": optimum(damping),
    }
    results: dict[str, dict[str, tuple[float, bool]]] = {}
    for name, derivative in derivatives.items():
        limit = k_max(derivative, loops["as tuned"]).k_max_n_per_m
        assert limit is not None  # noqa: S101 - both laws are stable at small K
        law = with_spring(derivative, share * limit)
        results[name] = {}
        for loop, device in loops.items():
            scene = free_scene(held(device), PERIOD)
            results[name][loop] = (
                pole_radius(law, device),
                settles(scene, [law], Criterion(20_000))[0],
            )
    return results


def chatter(
    law: CompiledLaw, friction: float, resolution: float = 2.3e-5, ticks: int = 5000
) -> bool:
    """Return whether a device at rest on a floor chatters across an encoder edge."""
    model = DeviceModel(mass=0.1, damping=1.0, friction=friction, resolution=resolution)
    trace = run(drop_scene(model, PERIOD, False, True, height=1e-4), law, ticks)
    return bool(np.ptp(trace.position[-(ticks // 4) :]) > 0.0)


def descent_outcomes(rate: float) -> dict[str, int]:
    """Count the outcomes of the paper's steepest descent from a grid of starts."""
    found = [
        steepest_descent(np.ones(2), orders, paper_targets(), 4, rate, 1000).outcome
        for orders in starting(5, 2)
    ]
    return dict(sorted(Counter(found).items()))


def chatter_bound(name: str) -> tuple[float, float, float]:
    """Compare the friction that stops chatter with the bound Δ·H(−1)/2."""
    derivative = (
        optimum(3.0)
        if name == "optimum"
        else without_spring(PD(stiffness=1.0, damping=3.0), PERIOD)
    )
    law = with_spring(derivative, 1000.0)
    bound = 0.5 * 2.3e-5 * law.h_nyquist
    low, high = 0.0, 4.0 * bound
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if chatter(law, middle) else (low, middle)
    return law.h_nyquist, high, high / bound
