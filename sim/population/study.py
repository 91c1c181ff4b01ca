"""Many random devices, identified and tuned without knowing them, and then compared with what they are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from sim.population.virtual import draw, excite
from sim.tune.design import Wanted, demand

PARAMETERS = ("mass", "damping", "friction", "delay", "encoder", "stiffness")
"""What is compared; the stiffness is a hand's."""
TAPS = 4
RADIUS = 0.99
NYQUIST = 1e4
"""Largest |H(−1)| of a design [N/m]."""
SPREAD = 1.25
"""Factor by which the mass may be off in either direction: the margin of every design here."""


def study_device(job: Mapping[str, Any]) -> dict[str, Any]:
    """Draw, push and identify one device; tune a law for it and one for the truth."""
    period = 1.0 / job["rate"]
    model = draw(job["number"], job["seed"], job["held"])
    found = identify(excite(model, period, job["seconds"], job["number"]))
    truth = {
        "mass": model.moving_mass,
        "damping": model.moving_damping,
        "friction": model.friction or 0.0,
        "delay": model.delay,
        "encoder": model.resolution,
        "stiffness": model.grip,
    }
    row: dict[str, Any] = {
        name: {
            "truth": truth[name],
            "value": getattr(found, name).value,
            "low": getattr(found, name).low,
            "high": getattr(found, name).high,
            "why": getattr(found, name).why,
        }
        for name in PARAMETERS
    }
    row |= {
        "held": job["held"],
        "residual_steps": found.residual_steps,
        "held_out_steps": found.held_out_steps,
        "refuted": found.refuted,
    }
    if job["tune"]:
        row["tuned"] = _tuned(model, found, period)
    return row


def _tuned(model: DeviceModel, found: Identified, period: float) -> dict[str, Any]:
    try:
        asked = demand(found, Wanted(TAPS, SPREAD, RADIUS, NYQUIST))
    except ValueError as error:
        return {"why": str(error)}
    # In lockstep the delay is one number, known to a thousandth of a tick: its upper end stands for the interval.
    latest = (found.delay_range[1] if found.delay.high is None else found.delay.high,) * 2
    grip = (found.stiffness.value or 0.0,) * 2
    asked = Demand(asked.mass, asked.damping, latest, period, RADIUS, NYQUIST, grip)
    known = Demand(
        mass=(model.moving_mass / SPREAD, model.moving_mass * SPREAD),
        damping=model.moving_damping,
        delay=(model.delay, model.delay),
        period=period,
        radius=RADIUS,
        nyquist=NYQUIST,
        stiffness=(model.grip, model.grip),
    )
    result: dict[str, Any] = {}
    for name, law in (("tuned", designed(asked, TAPS)), ("known", designed(known, TAPS)), ("pd", best_pd(asked))):
        result[name] = None
        if law.found is not None:
            taps = CompiledLaw(tuple(law.found.taps.tolist()))
            result[name] = {
                "h1_n_per_m": taps.h1,
                "radius": pole_radius(
                    taps, Plant(period, model.moving_mass, model.moving_damping, model.delay, model.grip)
                ),
            }
    return result


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count over a population."""
    refused = sum(row["refuted"] for row in rows)
    result: dict[str, Any] = {"devices": len(rows), "refused": refused, "parameters": {}}
    for name in PARAMETERS:
        known = [row[name] for row in rows if row[name]["value"] is not None]
        if name == "stiffness":
            known = [one for one in known if one["truth"] > 0.0]
        holds = [one["low"] <= one["truth"] <= one["high"] for one in known]
        errors = [abs(one["value"] - one["truth"]) for one in known]
        relative = [e / one["truth"] for e, one in zip(errors, known, strict=True) if one["truth"] > 0.0]
        result["parameters"][name] = {
            "told": len(known),
            "cannot_tell": sum(row[name]["value"] is None for row in rows),
            "coverage": sum(holds) / len(known) if known else None,
            "median_error": float(np.median(errors)) if errors else None,
            "median_relative_error": float(np.median(relative)) if relative else None,
        }
    result["residual_steps_median"] = float(np.median([row["residual_steps"] for row in rows]))
    laws = [row["tuned"] for row in rows if row.get("tuned") and row["tuned"].get("tuned")]
    if laws:
        both = [law for law in laws if law["known"]]
        share = [law["tuned"]["h1_n_per_m"] / law["known"]["h1_n_per_m"] for law in both]
        gain = [law["tuned"]["h1_n_per_m"] / law["pd"]["h1_n_per_m"] for law in laws if law["pd"]]
        result["tuned"] = {
            "laws": len(laws),
            "unstable": sum(not law["tuned"]["radius"] < 1.0 for law in laws),
            "of_known_min": min(share, default=math.nan),
            "of_known_median": float(np.median(share)),
            "of_known_at_least_90_percent": sum(s >= 0.9 for s in share) / len(share),
            "of_pd_min": min(gain, default=math.nan),
            "of_pd_median": float(np.median(gain)),
            "of_pd_at_least_1_2": sum(g >= 1.2 for g in gain) / len(gain),
        }
    return result
