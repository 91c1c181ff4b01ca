"""Random devices tuned end to end without knowing them, and judged by their true poles.

The chain is that of `haptic tune`: excite, identify, refuse a refuted model, design, predict, raise
the stiffness by step tests, judge. Only the loop between law and device is played in one process.
The judge knows the device, including joint and lag, and computes the poles of its loop.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.flexible import flexible_radius
from sim.identify.identified import refusal
from sim.identify.identify import identify
from sim.lab.monte_carlo.virtual import draw, draw_outside, excite, excite_outside
from sim.play.nonideal import NonidealDevice
from sim.tune.design import Wanted, design, predict, remainder_refusal
from sim.tune.knocking import KnockVerdict, climb, knocked, scaled
from sim.tune.outcome import verified

PEAK = 3.3  # peak force of every driver [N]
INSIDE = "inside the model"


def tune_device(job: Mapping[str, Any]) -> dict[str, Any]:
    """Draw, excite, identify and tune one device; return the law and its true performance."""
    period, kind = 1.0 / job["rate"], job["kind"]
    row: dict[str, Any] = {
        "kind": kind,
        "number": job["number"],
        "delivered": False,
        "holds": None,
    }
    if kind == INSIDE:
        model = draw(job["number"], job["seed"], held=False)
        device = NonidealDevice(model, "rigid")
        experiment = excite(model, period, job["seconds"], job["number"], PEAK)
    else:
        device = draw_outside(kind, job["number"], job["seed"])
        experiment = excite_outside(device, period, job["seconds"], job["number"], PEAK)
    found = identify(experiment)
    row["refuted"] = refusal(found)
    if row["refuted"] and not job["refuted"]:
        return row | {"stopped": f"refused: {row['refuted']}"}
    try:
        law, _, asked = design(
            found, Wanted(job["taps"], land=job["land"], nyquist=job["nyquist"])
        )
        if law.found is None:
            return row | {"stopped": "no law keeps the demand"}
        compiled = law.found.law
        row["h1_n_per_m"], row["taps_n_per_m"] = compiled.h1, list(compiled.taps)
        if risk := remainder_refusal(compiled, found):
            return row | {"stopped": f"refused: {risk}"}
        figures, planned = predict(compiled, asked, found, PEAK, None)
    except ValueError as error:
        return row | {"stopped": str(error)}
    trials = knocks(device, compiled, figures.knock_m, period)
    verdict = verified(figures, climb(planned.plan, trials))
    row |= {
        "holds": verdict.holds,
        "delivered": verdict.holds,
        "edge_n_per_m": verdict.edge_by_poles_h1_n_per_m,
        "edge_between_n_per_m": verdict.edge_by_poles_between_n_per_m,
        "predicted_edge_n_per_m": figures.edge_linear_h1_n_per_m,
        "true_radius": true_radius(compiled, device, period),
        "true_edge_n_per_m": true_edge(compiled, device, period),
        "knocks": len(verdict.steps),
        "ended": verdict.ended,
    }
    return row


def knocks(
    device: NonidealDevice, law: CompiledLaw, knock: float, period: float
) -> Callable[[int], KnockVerdict]:
    """Return a function that runs step tests on the true device."""
    if device.kind == "rigid":
        return knocked(law, device.rigid, period, knock, PEAK, None)
    # Two step tests, as on a real device, start at a random position within an encoder step.
    return knocked(law, device, period, knock, PEAK, None, (0.1, 0.6))


def true_radius(law: CompiledLaw, device: NonidealDevice, period: float) -> float:
    """Return the largest pole radius of the loop with the true device.

    It is taken at the shortest and longest delay, without dry friction.
    """
    plants = (
        replace(device.plant, delay=device.plant.delay + late)
        for late in {0.0, device.late}
    )
    return max(
        flexible_radius(_as_read(law, device), period, plant) for plant in plants
    )


def _as_read(law: CompiledLaw, device: NonidealDevice) -> CompiledLaw:
    """Return a law of taps as seen through the device's sensor, which may average samples."""
    if device.average == 0.0:
        return law
    if law.sections:
        raise ValueError(
            "law: has sections; behind a sensor that averages only taps are judged"
        )
    return CompiledLaw(
        tuple(np.convolve(law.taps, [1.0 - device.average, device.average]).tolist())
    )


def true_edge(law: CompiledLaw, device: NonidealDevice, period: float) -> float | None:
    """Return the true stiffness limit of a law [N/m]; None outside 0.02 to 20 times the law."""
    low = high = 1.0
    if true_radius(law, device, period) < 1.0:
        while true_radius(scaled(law, high), device, period) < 1.0:
            low, high = high, high * 1.02
            if high > 20.0:
                return None
    else:
        while true_radius(scaled(law, low), device, period) >= 1.0:
            low, high = low / 1.02, low
            if low < 0.02:
                return None
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high)
            if true_radius(scaled(law, middle), device, period) < 1.0
            else (low, middle)
        )
    return low * law.h1


@dataclass(frozen=True)
class TunedPopulation:
    """Delivered laws of a population, and the wrong ones."""

    devices: int
    refused: int
    tried: int  # laws tried
    unstable_laws_designed: int  # of these, unstable on the true device
    delivered: int
    delivered_unstable: int
    edges: int  # edges reported as one value
    edge_error_largest: float | None  # relative
    edges_within_5_percent: int
    intervals: int  # edges reported as an interval
    intervals_that_hold_the_edge: int

    @property
    def held(self) -> bool:
        """Whether no unstable law was delivered and all reported edges are true."""
        missed = self.edges - self.edges_within_5_percent
        missed += self.intervals - self.intervals_that_hold_the_edge
        return not self.delivered_unstable and not missed


def summary(rows: Sequence[Mapping[str, Any]]) -> TunedPopulation:
    """Count the delivered laws and the wrong ones."""
    tried = [row for row in rows if row["holds"] is not None]
    judged = [
        row for row in tried if row["edge_between_n_per_m"] and row["true_edge_n_per_m"]
    ]
    edges = [
        row["edge_n_per_m"] / row["true_edge_n_per_m"] - 1.0
        for row in judged
        if row["edge_n_per_m"]
    ]
    inside = [
        low <= row["true_edge_n_per_m"] <= high
        for row in judged
        for low, high in [row["edge_between_n_per_m"]]
    ]
    return TunedPopulation(
        devices=len(rows),
        refused=sum(bool(row["refuted"]) for row in rows),
        tried=len(tried),
        unstable_laws_designed=sum(row["true_radius"] >= 1.0 for row in tried),
        delivered=sum(row["delivered"] for row in rows),
        delivered_unstable=sum(
            row["delivered"] and row["true_radius"] >= 1.0 for row in tried
        ),
        edges=len(edges),
        edge_error_largest=max(map(abs, edges), default=None),
        edges_within_5_percent=sum(abs(error) <= 0.05 for error in edges),
        intervals=len(inside),
        intervals_that_hold_the_edge=sum(inside),
    )
