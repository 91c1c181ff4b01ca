"""A tuning record whose law was given, not designed: for ``tune --steps verify`` to try."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sim.design.demand import Demand
from sim.design.hands import STYLUS, JudgedGrasps, WorstGrasp
from sim.design.landing import ProvenLanding
from sim.stability.every_delay import Certificate
from sim.stability.grasp import Grasp
from sim.tune.knocking import Plan
from sim.tune.record import DesignedStep, PlannedKnocks, PredictedStep, TuneRecord


def given_design(
    taps: Sequence[float], period: float, mass: float = 0.1, **known: Any
) -> DesignedStep:
    """Return a design of given taps [N/m]; nothing of it is proven."""
    given: dict[str, Any] = {
        "law": {"kind": "fir", "taps": list(taps), "period": period},
        "taps_n_per_m": tuple(taps),
        "h1_n_per_m": sum(taps),
        "lands": False,
        "demand": Demand((mass, mass), 1.0, (0.0, 1.0), period, 1.0, 1e4),
        "family": "given",
        "worst": (mass, 1.0),
        "landing_proof": ProvenLanding(False, 0, 0.0, "", "not looked for"),
        "best_pd_h1_n_per_m": None,
        "model_refuted": None,
        "poses_kg": (0.0, 0.0),
    }
    return DesignedStep(**given | known)


def given_prediction(h1: float, linear: float = 1.0, **known: Any) -> PredictedStep:
    """Return a prediction of a law of H(1) [N/m] with an edge by poles at `linear` times it."""
    grasp = WorstGrasp(1.0, Grasp(0.2, 500.0, 1.0), Certificate.UNDECIDED, 0)
    given: dict[str, Any] = {
        "h1_n_per_m": h1,
        "h_nyquist_n_per_m": 0.0,
        "pole_radius": 1.0,
        "edge_linear_factor": linear,
        "edge_factor": None,
        "knock_m": 1e-3,
        "stable_up_to_delay_ticks": None,
        "drops_settled": 0,
        "drops": 0,
        "grasp": JudgedGrasps(STYLUS, grasp, 0.1, 1.0),
        "remainder_pole_radius": None,
        "remainder_worst": None,
        "every_delay": Certificate.UNDECIDED,
        "limit_cycle_free": None,
    }
    return PredictedStep(**given | known)


def given_record(
    designed: DesignedStep, predicted: PredictedStep, plan: Plan
) -> TuneRecord:
    """Return the record of both, with the steps that are tried."""
    return TuneRecord(
        designed=designed,
        predicted=predicted,
        predicted_steps=PlannedKnocks((), "", plan),
    )
