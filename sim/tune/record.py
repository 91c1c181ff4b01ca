"""The record of a tuning: what each step found, kept in ``tune.json`` for later steps."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self, get_type_hints

import msgspec

from messages.errors import UsageError
from sim.design.demand import Demand
from sim.design.hands import JudgedGrasps
from sim.design.landing import ProvenLanding
from sim.identify.identified import Identified
from sim.identify.identified_text import figures, from_figures
from sim.stability.every_delay import Certificate
from sim.stability.rest import ComesToRest
from sim.studies.result import plain
from sim.tune.knocking import KnockVerdict, Plan


@dataclass(frozen=True)
class IdentifiedStep:
    """The identified device, and the push that it was identified by."""

    recording: str
    stopped: str  # why the push ended
    found: Identified
    # lighter and heavier in other poses; None: unknown
    poses_kg: tuple[float, float] | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the figures, those of the device at the top level."""
        poses = {} if self.poses_kg is None else {"poses_kg": self.poses_kg}
        told = {"recording": self.recording, "stopped": self.stopped}
        return told | figures(self.found) | poses

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Self:
        """Read the figures."""
        low, high = record.get("poses_kg") or (0.0, 0.0)
        poses = (low, high) if "poses_kg" in record else None
        return cls(record["recording"], record["stopped"], from_figures(record), poses)


@dataclass(frozen=True)
class ForceLimits:
    """Limits of the driver; None: no limit."""

    peak_n: float | None
    slew_n: float | None  # per tick


@dataclass(frozen=True)
class DesignedStep:
    """The designed law and its demand."""

    law: dict[str, Any]
    taps_n_per_m: tuple[float, ...]
    h1_n_per_m: float
    lands: bool  # whether every drop settles
    demand: Demand
    family: str
    worst: tuple[float, float]  # mass [kg] and delay [ticks] of the largest pole radius
    landing_proof: ProvenLanding
    best_pd_h1_n_per_m: float | None  # None: one of the two fails the drop test
    # why the recording refutes the model; None or empty: it does not
    model_refuted: str | None
    poses_kg: tuple[float, float]

    @property
    def gain_over_pd(self) -> float | None:
        """H(1) over that of the best PD for the same demand."""
        known = self.best_pd_h1_n_per_m
        return None if known is None else self.h1_n_per_m / known

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        return vars(self) | {"gain_over_pd": self.gain_over_pd}


@dataclass(frozen=True)
class PredictedStep:
    """What the law does on the identified device."""

    h1_n_per_m: float
    h_nyquist_n_per_m: float
    pole_radius: float
    edge_linear_factor: float  # on all taps, at which a pole reaches the unit circle
    edge_factor: float | None  # by knocks; None: all came to rest
    knock_m: float
    stable_up_to_delay_ticks: float | None  # None: 100 ticks or more
    drops_settled: int
    drops: int
    grasp: JudgedGrasps  # like a stylus
    # largest pole radius on what the recording leaves open, and the term; None: the residual is
    # noise
    remainder_pole_radius: float | None
    remainder_worst: str | None
    every_delay: Certificate
    limit_cycle_free: ComesToRest | None  # None: encoder or friction is unknown
    friction_n: float | None = None
    friction_for_rest_bound_n: float | None = None
    friction_for_rest_estimated_n: float | None = None
    buzz_hz: float | None = None

    @property
    def edge_linear_h1_n_per_m(self) -> float:
        """The edge by poles."""
        return self.edge_linear_factor * self.h1_n_per_m

    @property
    def edge_h1_n_per_m(self) -> float | None:
        """The edge by knocks on the model."""
        return None if self.edge_factor is None else self.edge_factor * self.h1_n_per_m

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        edges = ("edge_linear_h1_n_per_m", "edge_h1_n_per_m")
        return vars(self) | {name: getattr(self, name) for name in edges}


@dataclass(frozen=True)
class PlannedKnocks:
    """Knocks on the model, and which are tried on the device."""

    steps: tuple[KnockVerdict, ...]
    ended: str  # why the climb on the model ended
    plan: Plan


@dataclass(frozen=True)
class VerifiedStep:
    """Knocks on the device, and whether the law holds."""

    holds: bool
    agrees: bool  # whether the edge is the predicted one, within 10 %
    complete: bool  # whether the climb reached its own end
    edge_factor: float | None
    edge_h1_n_per_m: float | None
    edge_by_poles_h1_n_per_m: float | None  # one figure, where it is known to 5 %
    edge_by_poles_between_n_per_m: tuple[float, float] | None
    stiffest_at_rest_n_per_m: float | None
    edge_error: float | None  # relative to the prediction; None: not both have an edge
    edge_compared: str
    ended: str
    steps: tuple[KnockVerdict, ...]


@dataclass(frozen=True)
class AppliedStep:
    """The switch of the running coupling to the law."""

    seq: int
    ramp_ticks: int
    force_step_n: float
    law: str
    before: str  # the law that was active


@dataclass
class TuneRecord:
    """Results of the steps, each None until it is done; empty texts are left out of the file."""

    identified: IdentifiedStep | None = None
    limits: ForceLimits | None = None
    designed: DesignedStep | None = None
    predicted: PredictedStep | None = None
    predicted_steps: PlannedKnocks | None = None
    verified: VerifiedStep | None = None
    applied: AppliedStep | None = None
    refused: str = ""  # why a step was refused
    interrupted: str = ""  # during which step
    not_put_back: str = ""  # why law or surface could not be restored
    headline: str = ""
    command: str = ""
    date: str = ""
    device: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return what there is."""
        return {name: one for name, one in vars(self).items() if one not in (None, "")}

    def write(self, file: Path) -> None:
        """Write the record."""
        file.write_text(json.dumps(plain(self), indent=1), encoding="utf-8")

    @classmethod
    def read(cls, file: Path) -> Self:
        """Read the steps of an earlier tuning; raises UsageError for another file."""
        try:
            found = msgspec.json.decode(file.read_bytes(), type=dict[str, Any])
            kinds = get_type_hints(cls)
            known = {
                one.name: found[one.name] for one in fields(cls) if one.name in found
            }
            if "identified" in known:
                known["identified"] = IdentifiedStep.of(known["identified"])
            return cls(
                **{
                    name: one
                    if name == "identified"
                    else msgspec.convert(one, kinds[name])
                    for name, one in known.items()
                }
            )
        except (msgspec.DecodeError, LookupError, TypeError, ValueError) as error:
            raise UsageError(
                f"{file}: is not what haptic tune wrote ({error}); remove it, and begin with"
                " identify"
            ) from error

    def came_through(self) -> bool:
        """Return whether no law was tried, or the law holds."""
        return self.verified is None or self.verified.holds
