"""Many devices that are not rigid, identified: what is told of them that is not so, what is refused, what is named rightly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sim.identify.identified import Identified
from sim.identify.identified_text import ROWS
from sim.identify.identify import identify
from sim.population.outside import KINDS, draw_outside, excite_outside
from sim.scene.richer import RicherModel

FAR = 2.0
"""Half widths of a 95 % interval beyond which an estimate is false certainty: by chance one in ten thousand is."""
ALLOWED = 0.05
"""Largest part of devices of which anything may be told that is false."""
ASKED = {
    "flexible mode": {"flexible mode"},
    "actuator lag": {"actuator lag"},
    "quadratic damping": {"quadratic damping"},
    "sampling jitter": {"sampling jitter"},
    "lag and mode": {"actuator lag", "flexible mode"},
}
"""Terms that a kind should come out with."""
NAMED = {
    "presliding": "presliding",
    "backlash": "backlash",
    "hardening spring": "a spring of the device",
    "stribeck": "friction that falls",
    "cogging": "a force that repeats",
    "encoder ripple": "an encoder error",
    "warming up": "changes during the run",
    "deadband": "dead band",
}
"""Words by which a kind that no model has should be refused."""


def truths(device: RicherModel, found: Identified, period: float) -> dict[str, float]:
    """Say what each parameter is that a run could tell."""
    rigid = device.rigid
    # A lag that is not told apart belongs to the delay, and so does what forces come late by on average.
    unseen = 0.0 if "actuator lag" in found.terms else device.lag / period
    return {
        "mass": rigid.mass,
        "damping": rigid.damping * (1.0 - 0.5 * device.warming),
        "friction": rigid.friction or 0.0,
        "delay": rigid.delay + unseen + 0.5 * device.late,
        "quadratic": device.quadratic,
        "lag": device.lag,
        "frequency": device.frequency,
        "share": device.share,
        "loss": device.loss,
    }


def study_outside(job: Mapping[str, Any]) -> dict[str, Any]:
    """Draw, push and identify one device."""
    period = 1.0 / job["rate"]
    device = draw_outside(job["kind"], job["number"], job["seed"])
    found = identify(excite_outside(device, period, job["seconds"], job["number"]))
    row: dict[str, Any] = {
        "kind": job["kind"],
        "refuted": found.refuted,
        "why": found.why,
        "terms": list(found.terms),
        "residual_steps": found.residual_steps,
        "whiteness": found.held_out.whiteness,
        "off": {},
    }
    for name, truth in truths(device, found, period).items():
        estimate = getattr(found, name)
        # What is 0 because the data do not ask for it has a bound, no interval.
        if estimate.value is not None and not (name in ("quadratic", "lag") and estimate.value == 0.0):
            half = 0.5 * (estimate.high - estimate.low)
            row["off"][name] = abs(estimate.value - truth) / max(half, 1e-300)
    return row


def named(row: Mapping[str, Any]) -> bool:
    """Tell whether a device came out as what it is."""
    if row["kind"] in ASKED:
        return not row["refuted"] and set(row["terms"]) == ASKED[row["kind"]]
    return bool(row["refuted"] and row["kind"] in NAMED and NAMED[row["kind"]] in row["why"])


def outcome(row: Mapping[str, Any]) -> str:
    """Say in a word what became of a device."""
    if row["refuted"]:
        return "refused"
    if any(off > FAR for off in row["off"].values()):
        return "false"
    return "richer" if set(row["terms"]) - {"sampling jitter"} else "rigid"


def summary_outside(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count over a population, kind by kind."""
    labels = {name: label.strip() for _, name, label, _ in ROWS}
    result: dict[str, Any] = {"devices": len(rows), "kinds": {}}
    for kind in [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]:
        of = [row for row in rows if row["kind"] == kind]
        offs = [off for row in of for off in row["off"].values()]
        result["kinds"][kind] = {
            "devices": len(of),
            **{word: sum(outcome(row) == word for row in of) for word in ("rigid", "richer", "refused", "false")},
            "named": sum(named(row) for row in of),
            "intervals": len(offs),
            "missed": sum(off > 1.0 for off in offs),
            "false_of": sorted({labels[name] for row in of for name, off in row["off"].items() if off > FAR}),
        }
    for word in ("refused", "false", "named", "intervals", "missed"):
        result[word] = sum(one[word] for one in result["kinds"].values())
    return result
