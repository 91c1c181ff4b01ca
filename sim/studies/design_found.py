"""What a design found: laws with their figures, proofs and files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim.design.demand import Demand
from sim.design.families import Tuned, latest_delay
from sim.design.hands import JudgedGrasps
from sim.design.landing import ProvenLanding, drops
from sim.design.passive import Passive
from sim.experiments.rest_map import RestFound
from sim.stability.every_delay import Certificate
from sim.studies.result import Findings


def describe(demand: Demand) -> str:
    """Return a demand in one line."""
    mass, delay = demand.mass, demand.delay
    return (
        f"m {mass[0]:g}..{mass[1]:g} kg, b {_span(demand.dampings)} N s/m, delay"
        f" {delay[0]:.4g}..{delay[1]:.4g} ticks at {1.0 / demand.period:g} Hz, pole radius <="
        f" {demand.radius:g}, |H(-1)| <= {demand.nyquist:g} N/m, hand"
        f" {demand.stiffness[0]:g}..{demand.stiffness[1]:g} N/m"
    )


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g}" if ends[0] == ends[1] else f"{ends[0]:g}..{ends[1]:g}"


def _wanted(demand: Demand) -> dict[str, Any]:
    return {
        "mass_kg": list(demand.mass),
        "damping_n_s_per_m": demand.damping,
        "damping_max_n_s_per_m": demand.damping_max,
        "delay_ticks": list(demand.delay),
        "rate_hz": 1.0 / demand.period,
        "radius_limit": demand.radius,
        "h_nyquist_limit_n_per_m": demand.nyquist,
        "hand_n_per_m": list(demand.stiffness),
        "lands": bool(demand.lands),
    }


@dataclass(frozen=True)
class Judged:
    """A tuned law and its figures; without taps no law keeps the demand."""

    family: str
    law: dict[str, Any] | None = None
    taps_n_per_m: Sequence[float] | None = None
    h1_n_per_m: float | None = None
    h_nyquist_n_per_m: float = math.nan
    pole_radius: float = math.nan
    worst_mass_kg: float = math.nan
    stable_up_to_delay_ticks: float | None = None
    drops_settled: Mapping[str, bool] = field(default_factory=dict)

    @classmethod
    def of(cls, tuned: Tuned, demand: Demand) -> Judged:
        """Compute the figures of a tuned law."""
        if (found := tuned.found) is None:
            return cls(tuned.family)
        return cls(
            tuned.family,
            tuned.law,
            found.taps.tolist(),
            found.h1_n_per_m,
            found.h_nyquist_n_per_m,
            found.radius,
            found.worst[0],
            latest_delay(found.law, demand),
            drops(found.law, demand),
        )

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name; without a law only its family."""
        named = vars(self)
        return (
            named if self.law is not None else {name: named[name] for name in _NO_LAW}
        )

    @property
    def line(self) -> str:
        """The figures in one line."""
        if self.law is None or self.taps_n_per_m is None:
            return f"{self.family:13}  keeps the demand with no stiffness at all"
        limit, dropped = self.stable_up_to_delay_ticks, self.drops_settled
        keys = [key for key in ("stiffness", "damping", "order") if key in self.law]
        tuning = ", ".join(f"{key} {self.law[key]:.5g}" for key in keys)
        return (
            f"{self.family:13}  H(1) {self.h1_n_per_m:9.2f} N/m  H(-1)"
            f" {self.h_nyquist_n_per_m:9.1f} N/m  radius {self.pole_radius:.6f}  stable up to"
            f" {'100 ticks, and on' if limit is None else f'{limit:.3f} ticks'}  drops settled"
            f" {sum(dropped.values())}/{len(dropped)} "
            f" {tuning or 'taps ' + ', '.join(f'{tap:.6g}' for tap in self.taps_n_per_m)}"
        )


_NO_LAW = ("family", "law", "h1_n_per_m")


@dataclass(frozen=True)
class DesignedLaw:
    """A designed law, its proofs and its file."""

    judged: Judged
    yaml: Path
    lands: bool
    every_delay: Certificate
    landing_proof: ProvenLanding
    grasp: JudgedGrasps | None = None  # None: not asked for
    rest: RestFound | None = None  # None: not asked for

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name, those of the law at the top level."""
        found = vars(self) | self.judged.as_json()
        left_out = {name for name in ("grasp", "rest") if found[name] is None} | {
            "judged"
        }
        return {name: one for name, one in found.items() if name not in left_out}


@dataclass(frozen=True)
class PassiveLaw:
    """A law that is passive for any mass and hand, and its file."""

    found: Passive
    pole_radius: float
    yaml: Path

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        figures = vars(self.found) | {
            "pole_radius": self.pole_radius,
            "yaml": self.yaml,
        }
        return {
            {"taps": "taps_n_per_m"}.get(name, name): one
            for name, one in figures.items()
        }

    def line(self, demand: Demand) -> str:
        """Return the figures in one line."""
        one, bound = (
            self.found,
            self.found.bound_n_per_m * demand.period / demand.damping,
        )
        return (
            f"passive        H(1) {one.h1_n_per_m:9.2f} N/m  H(-1) {one.h_nyquist_n_per_m:9.1f}"
            f" N/m  radius {self.pole_radius:.6f}  K T/b {one.ratio:.4f} (bound"
            f" {bound:.4f})  {self.yaml}"
        )


@dataclass(frozen=True)
class Replayed:
    """A recording's delays, and the designed law under them one by one."""

    from_run: Path
    delay_median_ticks: float
    jitter_ticks: float
    unanswered_ticks: int
    replayed_radius: float | None


@dataclass(frozen=True, repr=False, kw_only=True)
class DesignFound(Findings):
    """The stiffest law of a demand, a passive one, and PD to compare."""

    demand: Demand
    designed: DesignedLaw | None  # None: no law of this length keeps the demand
    passive: PassiveLaw | None  # None: nothing is passive without damping
    best_pd: Judged
    replayed: Replayed | None  # None: no recording was given

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        figures = super().answer
        return (
            figures | {"demand": _wanted(self.demand)} | (figures.pop("replayed") or {})
        )


@dataclass(frozen=True)
class Compared:
    """Families of laws tuned to one demand."""

    demand: Demand
    laws: list[Judged]
    pd_windowed: dict[str, Any] | None  # None: no stiffness

    @property
    def best_other(self) -> Judged | None:
        """The stiffest law beside the designed one."""
        others = [
            law for law in self.laws if law.family != "designed" and law.h1_n_per_m
        ]
        return max(others, key=lambda law: law.h1_n_per_m or 0.0, default=None)

    @property
    def gain(self) -> float | None:
        """H(1) of the designed law over the stiffest other; None if either is missing."""
        mine = next(
            (law.h1_n_per_m for law in self.laws if law.family == "designed"), None
        )
        rival = None if self.best_other is None else self.best_other.h1_n_per_m
        return None if mine is None or rival is None else mine / rival

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        return {
            "demand": _wanted(self.demand),
            "laws": self.laws,
            "best_other": self.best_other and self.best_other.family,
            "gain": self.gain,
            "pd_windowed": self.pd_windowed,
        }

    @property
    def lines(self) -> list[str]:
        """The figures as lines."""
        if self.gain is None or self.best_other is None:
            only = self.best_other is None and any(law.h1_n_per_m for law in self.laws)
            why = "only the designed law keeps the demand" if only else "no law does"
            verdict = f"nothing to compare: {why}"
        else:
            # A search for laws that survive landing ends on a ragged limit.
            verb = "stiffer than" if self.gain > 1.005 else "no stiffer than"
            rival = self.best_other.family
            verdict = f"designed is {verb} the best of the others ({rival}): x {self.gain:.3f}"
        windowed = self.pd_windowed
        tuned = (
            "no stiffness"
            if windowed is None
            else "K {stiffness:.0f} N/m, B {damping:.3g} N s/m".format(**windowed)
        )
        return [
            describe(self.demand),
            *(f"  {law.line}" for law in self.laws),
            f"  {verdict}",
            f"  pd_windowed has no poles, so no radius: {tuned} by its drops alone, all of which"
            " settle",
        ]


@dataclass(frozen=True, repr=False, kw_only=True)
class ComparedFound(Findings):
    """Families of laws tuned to each demand of a range of delays and margins."""

    demand: Demand
    cases: list[Compared]

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return super().answer | {"demand": _wanted(self.demand)}
