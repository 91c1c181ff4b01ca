"""Random devices outside the model class: false certainty, needless refusals, by kind."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from sim.identify.alterations import stiffest
from sim.identify.identified import Identified
from sim.identify.identified_text import ROWS
from sim.identify.identify import identify
from sim.identify.remainder import reference_gain
from sim.lab.monte_carlo.study import ASKED, FAR, GOOD, NAMED, WRONG, truths
from sim.lab.monte_carlo.virtual import KINDS, draw_outside, excite_outside
from sim.play.nonideal import NonidealDevice


def study_outside(job: Mapping[str, Any]) -> dict[str, Any]:
    """Draw, excite and identify one non-rigid device."""
    period = 1.0 / job["rate"]
    device = draw_outside(job["kind"], job["number"], job["seed"])
    found = identify(excite_outside(device, period, job["seconds"], job["number"]))
    row: dict[str, Any] = {
        "kind": job["kind"],
        "refuted": found.refuted,
        "why": found.why,
        "terms": list(found.terms),
        "remainder": found.remainder,
        "remainder_k_max": found.remainder_k_max
        if math.isfinite(found.remainder_k_max)
        else None,
        "k_max_off": k_max_off(device, found, period),
        "residual_steps": found.steps(found.residual),
        "whiteness": found.whiteness,
        "off": {},
    }
    for name, truth in truths(device, found, period).items():
        estimate = getattr(found, name)
        # A parameter that is 0 because the data do not need it has a bound, no interval.
        if estimate.value is not None and not (
            name in ("quadratic", "lag", "average") and estimate.value == 0.0
        ):
            half = 0.5 * (estimate.high - estimate.low)
            row["off"][name] = abs(estimate.value - truth) / max(half, 1e-300)
    return row


def k_max_off(device: NonidealDevice, found: Identified, period: float) -> float | None:
    """Return the relative K_max error of the best fit against the linear device.

    None if a fit gives no K_max.
    """
    believed = found.anyway() if found.refuted else found
    try:
        fitted = believed.plant()
    except ValueError:
        return None
    truth = replace(
        device.plant,
        lag=device.lag + device.sensor_lag,
        delay=max(device.plant.delay + 0.5 * device.late - 0.5 * device.jitter, 0.0),
    )
    gain = reference_gain(truth, period)
    known = stiffest(truth, period, gain, device.average)
    told = stiffest(fitted, period, gain)
    return abs(told / known - 1.0) if told is not None and known is not None else None


def named(row: Mapping[str, Any]) -> bool:
    """Return whether a device was identified as its true kind."""
    if row["kind"] in ASKED:
        return not row["refuted"] and set(row["terms"]) == ASKED[row["kind"]]
    said = row["why"] if row["refuted"] else row["remainder"]
    return row["kind"] in NAMED and NAMED[row["kind"]] in said


def outcome(row: Mapping[str, Any]) -> str:
    """Return the outcome of a device in one word."""
    if row["refuted"]:
        return "refused"
    if (
        any(off > FAR for off in row["off"].values())
        or (row["k_max_off"] or 0.0) > WRONG
    ):
        return "false"
    if row["remainder"]:
        return "reported"
    return "richer" if set(row["terms"]) - {"sampling jitter"} else "rigid"


@dataclass(frozen=True)
class KindCount:
    """Outcomes of the devices of one kind, or of all."""

    devices: int
    rigid: int
    richer: int
    reported: int
    refused: int
    false: int  # devices with a false result
    named: int  # identified as their true kind
    intervals: int
    missed: int  # intervals that miss the truth
    false_of: tuple[str, ...]  # quantities with false results
    good: int  # devices whose fit has K_max within `GOOD`
    needless: int  # of these, refused


@dataclass(frozen=True)
class OutsidePopulation:
    """Counts over devices that are not rigid, in total and kind by kind."""

    total: KindCount
    kinds: dict[str, KindCount]

    def as_json(self) -> dict[str, Any]:
        """Return the figures, the counts of all kinds at the top level."""
        figures = asdict(self)
        total = figures.pop("total")
        named = ("rigid", "richer", "false_of")
        return {name: one for name, one in total.items() if name not in named} | figures


def summary_outside(rows: Sequence[Mapping[str, Any]]) -> OutsidePopulation:
    """Count the results of a population, kind by kind."""
    of = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    kinds = {kind: _counted(some) for kind, some in of.items() if some}
    return OutsidePopulation(_counted(rows), kinds)


def _counted(of: Sequence[Mapping[str, Any]]) -> KindCount:
    labels = {name: label.strip() for _, name, label, _ in ROWS}
    offs = [(name, off) for row in of for name, off in row["off"].items()]
    far = {labels[name] for name, off in offs if off > FAR}
    if any(not row["refuted"] and (row["k_max_off"] or 0.0) > WRONG for row in of):
        far.add("K_max")
    words = Counter(map(outcome, of))
    return KindCount(
        devices=len(of),
        rigid=words["rigid"],
        richer=words["richer"],
        reported=words["reported"],
        refused=words["refused"],
        false=words["false"],
        named=sum(map(named, of)),
        intervals=len(offs),
        missed=sum(off > 1.0 for _, off in offs),
        false_of=tuple(sorted(far)),
        good=sum(map(_good, of)),
        needless=sum(_good(row) and row["refuted"] for row in of),
    )


def _good(row: Mapping[str, Any]) -> bool:
    return row["k_max_off"] is not None and row["k_max_off"] <= GOOD
