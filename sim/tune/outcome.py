"""What the knocks on a device say of the law that was tried: whether it holds, where its edge is, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sim.tune.knock import STEP, KnockedEdge

AGREES = 0.1
"""An edge so far from the predicted one is another device's: then the model tells nothing of this one's poles either."""
MARGIN = 1.05
"""A law holds when it rests up to so many times itself: what dry friction lends a small knock, a large one lacks."""


def verified(predicted: Mapping[str, Any], edge: KnockedEdge) -> dict[str, Any]:
    """Judge a law by the knocks on its device.

    Knocks see the edge a little early where a motion dies slowly, and late where friction is strong. How much is known from the
    model, on which edges by knocks and by poles are both known: the edge that the poles of the device have is the measured one,
    times the ratio of these two. Where device and model do not agree about the edge, that ratio is worth nothing: dry friction
    may hold a mode that the model does not have. Such a law is not delivered, even if small knocks on it come to rest.
    """
    h1, factor, rested = predicted["h1_n_per_m"], edge.factor, edge.rested
    expected = predicted["edge_factor"]
    agrees = factor is expected is None or (factor and expected and abs(factor / expected - 1.0) <= AGREES)
    correction = predicted["edge_linear_factor"] / predicted["edge_factor"] if predicted["edge_factor"] else 1.0
    # Between the last that rests and the first that does not.
    by_poles = None if factor is None or rested is None or not agrees else correction * factor
    below_law = [step for step in edge.steps if step.factor <= 1.0 + 1e-12]
    climbed = bool(below_law) and all(step.rests for step in below_law) and below_law[-1].factor > 1.0 / STEP
    rests = climbed and rested is not None and rested >= 1.0
    holds = bool(rests and agrees and (by_poles is None or by_poles >= MARGIN))
    ended = edge.ended
    if rests and not agrees and (factor is not None or edge.ended.startswith("every")):
        ended = f"{ended}, where the model has {expected or 0.0:.3f}: the device is not the one that was identified"
    return {
        "holds": holds,
        "agrees": bool(agrees),
        "edge_factor": factor,
        "edge_h1_n_per_m": None if factor is None else factor * h1,
        "edge_by_poles_h1_n_per_m": None if by_poles is None else by_poles * h1,
        "stiffest_at_rest_n_per_m": None if rested is None else rested * h1,
        **compared(predicted["edge_factor"], factor),
        "ended": ended,
        "steps": [asdict(step) for step in edge.steps],
    }


def compared(predicted: float | None, measured: float | None) -> dict[str, Any]:
    """Compare the two edges: as a share, and in words, which know that both come in steps of 2 %."""
    if predicted is None or measured is None:
        return {"edge_error": None, "edge_compared": "not both have an edge"}
    error = measured / predicted - 1.0
    same = abs(error) < 0.5 * (STEP - 1.0)
    words = f"the same step of {100 * (STEP - 1.0):.0f} %" if same else f"{100 * error:+.0f} % from the predicted one"
    return {"edge_error": error, "edge_compared": words}


def headline(told: Mapping[str, Any]) -> str:
    """Say in one sentence what came of a tuning, the worst first."""
    designed, after = told.get("designed"), told.get("verified")
    stopped = told.get("refused") or (f"interrupted during {told['interrupted']}" if told.get("interrupted") else "")
    if designed is None:
        return f"No law: {stopped or 'none was designed'}."
    lands = "" if designed["lands"] else "; it does not bear a landing"
    if after is None or not (after["steps"] or after["ended"]):
        why = f" ({stopped})" if stopped else ""
        return f"Not tried: a law of {designed['h1_n_per_m']:.4g} N/m was designed, but not tried on the device{why}{lands}."
    if after["holds"]:
        edge = after["edge_by_poles_h1_n_per_m"]
        until = f"its edge is at {edge:.4g} N/m" if edge else f"no edge was found up to {_most(after):.4g} N/m"
        broken = f", {stopped}" if stopped else ""
        return f"The law holds: {designed['h1_n_per_m']:.4g} N/m were tried on the device{broken}, {until}{lands}."
    rested = after["stiffest_at_rest_n_per_m"]
    softer = "nothing softer came to rest either" if rested is None else f"it came to rest up to {rested:.4g} N/m"
    if stopped and after["edge_factor"] is None:
        return (
            f"Not verified: {stopped}; {softer}, the law has {designed['h1_n_per_m']:.4g} N/m. Nothing was delivered."
        )
    return f"The law does NOT hold: {after['ended']}; {softer}. Nothing was delivered."


def _most(after: Mapping[str, Any]) -> float:
    return float(after["stiffest_at_rest_n_per_m"] or 0.0)
