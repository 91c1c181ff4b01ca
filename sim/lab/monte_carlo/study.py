"""Monte Carlo: identify and tune random devices and compare with the truth."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.families import best_pd, designed
from sim.device.model import DeviceModel
from sim.identify.identified import Identified
from sim.identify.identify import identify
from sim.lab.monte_carlo.virtual import draw, excite
from sim.play.nonideal import NonidealDevice
from sim.tune.design import Wanted, demand

# compared quantities; the stiffness is the hand's
PARAMETERS = ("mass", "damping", "friction", "delay", "encoder", "stiffness")
TAPS = 4
RADIUS = 0.99
NYQUIST = 1e4  # largest |H(−1)| of a design [N/m]
# mass uncertainty factor in either direction: the margin of every design here
SPREAD = 1.25


def study_device(job: Mapping[str, Any]) -> dict[str, Any]:
    """Draw, excite and identify one device; tune a law for the estimate and the true device."""
    period = 1.0 / job["rate"]
    model = draw(job["number"], job["seed"], job["held"])
    found = identify(excite(model, period, job["seconds"], job["number"]))
    truths = (
        model.moving_mass,
        model.moving_damping,
        model.friction or 0.0,
        model.delay,
        model.resolution,
        model.grip,
    )
    told = zip(PARAMETERS, truths, strict=True)
    row: dict[str, Any] = {
        name: {"truth": truth, **asdict(getattr(found, name))} for name, truth in told
    }
    row |= {"held": job["held"], "refuted": found.refuted}
    row |= {
        "residual_steps": found.steps(found.residual),
        "held_out_steps": found.steps(found.held_out),
    }
    if job["tune"]:
        row["tuned"] = _tuned(model, found, period)
    return row


def _tuned(model: DeviceModel, found: Identified, period: float) -> dict[str, Any]:
    try:
        asked = demand(found, Wanted(TAPS, SPREAD, RADIUS, NYQUIST))
    except ValueError as error:
        return {"why": str(error)}
    # In lockstep the delay is a single number, known to a thousandth of a tick: use the
    # interval's upper end.
    latest = (
        found.delay_range[1] if found.delay.high is None else found.delay.high,
    ) * 2
    grip = (found.stiffness.value or 0.0,) * 2
    asked = Demand(asked.mass, asked.damping, latest, period, RADIUS, NYQUIST, grip)
    masses, delays = (
        (model.moving_mass / SPREAD, model.moving_mass * SPREAD),
        (model.delay, model.delay),
    )
    known = Demand(
        masses,
        model.moving_damping,
        delays,
        period,
        RADIUS,
        NYQUIST,
        (model.grip, model.grip),
    )
    result: dict[str, Any] = {}
    for name, law in (
        ("tuned", designed(asked, TAPS)),
        ("known", designed(known, TAPS)),
        ("pd", best_pd(asked)),
    ):
        result[name] = None
        if law.found is not None:
            taps = CompiledLaw(tuple(law.found.taps.tolist()))
            result[name] = {
                "h1_n_per_m": taps.h1,
                "radius": pole_radius(
                    taps,
                    Plant(
                        period,
                        model.moving_mass,
                        model.moving_damping,
                        model.delay,
                        model.grip,
                    ),
                ),
            }
    return result


@dataclass(frozen=True)
class ParameterCoverage:
    """How often the interval of one parameter contains the truth."""

    told: int  # devices with a value
    cannot_tell: int
    coverage: float | None  # fraction of the intervals; None without any
    median_error: float | None
    median_relative_error: float | None


@dataclass(frozen=True)
class TunedCoverage:
    """Laws tuned for the estimates, against those for the true device and tuned PD."""

    laws: int
    unstable: int  # on the true device
    of_known_min: float
    of_known_median: float
    of_known_at_least_90_percent: float
    of_pd_min: float
    of_pd_median: float
    of_pd_at_least_1_2: float


@dataclass(frozen=True)
class Population:
    """Counts over identified devices."""

    devices: int
    refused: int
    parameters: dict[str, ParameterCoverage]
    residual_steps_median: float
    tuned: TunedCoverage | None  # None: no laws were tuned


def summary(rows: Sequence[Mapping[str, Any]]) -> Population:
    """Count the results of a population."""
    laws = [
        row["tuned"] for row in rows if row.get("tuned") and row["tuned"].get("tuned")
    ]
    return Population(
        devices=len(rows),
        refused=sum(row["refuted"] for row in rows),
        parameters={name: _covered(rows, name) for name in PARAMETERS},
        residual_steps_median=float(np.median([row["residual_steps"] for row in rows])),
        tuned=_compared(laws) if laws else None,
    )


def _covered(rows: Sequence[Mapping[str, Any]], name: str) -> ParameterCoverage:
    known = [row[name] for row in rows if row[name]["value"] is not None]
    if name == "stiffness":
        known = [one for one in known if one["truth"] > 0.0]
    holds = [one["low"] <= one["truth"] <= one["high"] for one in known]
    errors = [abs(one["value"] - one["truth"]) for one in known]
    relative = [
        e / one["truth"]
        for e, one in zip(errors, known, strict=True)
        if one["truth"] > 0.0
    ]
    return ParameterCoverage(
        told=len(known),
        cannot_tell=sum(row[name]["value"] is None for row in rows),
        coverage=sum(holds) / len(known) if known else None,
        median_error=float(np.median(errors)) if errors else None,
        median_relative_error=float(np.median(relative)) if relative else None,
    )


def _compared(laws: Sequence[Mapping[str, Any]]) -> TunedCoverage:
    def over(other: str) -> list[float]:
        both = [law for law in laws if law[other]]
        return [law["tuned"]["h1_n_per_m"] / law[other]["h1_n_per_m"] for law in both]

    def least(values: list[float], limit: float) -> float:
        return (
            sum(value >= limit for value in values) / len(values)
            if values
            else math.nan
        )

    known, pd = over("known"), over("pd")
    return TunedCoverage(
        laws=len(laws),
        unstable=sum(not law["tuned"]["radius"] < 1.0 for law in laws),
        of_known_min=min(known, default=math.nan),
        of_known_median=float(np.median(known)) if known else math.nan,
        of_known_at_least_90_percent=least(known, 0.9),
        of_pd_min=min(pd, default=math.nan),
        of_pd_median=float(np.median(pd)) if pd else math.nan,
        of_pd_at_least_1_2=least(pd, 1.2),
    )


# half-widths of a 95 % interval beyond which an estimate is false certainty; by chance this
# happens once in ten thousand
FAR = 2.0
ALLOWED = 0.05  # largest allowed fraction of devices with any false result
NEEDLESS = 0.10  # largest allowed fraction of refusals among devices with a good fit
GOOD = 0.01  # relative K_max error up to which a fit is good enough for a design
WRONG = 0.05  # relative K_max error above which an accepted fit is false certainty
# Terms that identification should find for a kind.
ASKED = {
    "flexible mode": {"flexible mode"},
    "actuator lag": {"actuator lag"},
    "quadratic damping": {"quadratic damping"},
    "sampling jitter": {"sampling jitter"},
    "lag and mode": {"actuator lag", "flexible mode"},
    "sensor average": {"sensor filter"},
    # At the sensor or the actuator: the linear loop is the same.
    "sensor lag": {"actuator lag"},
}
# Phrases expected in the refusal of a kind that no model covers.
NAMED = {
    "presliding": "presliding",
    "backlash": "backlash",
    "hardening spring": "a spring of the device",
    "stribeck": "friction that falls",
    "cogging": "a force that repeats",
    "encoder ripple": "an encoder error",
    "eccentricity": "an encoder error",
    "gain by sign": "more force one way",
    "force steps": "a force that comes in steps",
    "warming up": "changes during the run",
    "deadband": "dead band",
}


def truths(
    device: NonidealDevice, found: Identified, period: float
) -> dict[str, float]:
    """Return the true value of each parameter that a run can identify."""
    rigid = device.rigid
    # An unidentified lag is part of the delay, and so is the mean lateness of forces.
    late = device.lag + device.sensor_lag
    unseen = device.average + (0.0 if "actuator lag" in found.terms else late / period)
    return {
        "mass": rigid.mass,
        "damping": rigid.damping * (1.0 - 0.5 * device.warming),
        "friction": rigid.friction or 0.0,
        "delay": rigid.delay + unseen + 0.5 * device.late,
        "quadratic": device.quadratic,
        "lag": late,
        # A slower filter looks like an average of two samples; that average has no true
        # value.
        **({} if device.sensor_lag else {"average": device.average}),
        "frequency": device.frequency,
        "share": device.share,
        "loss": device.loss,
    }
