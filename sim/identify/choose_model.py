"""Choose the model: a rigid device plus the terms that the data support.

The possible terms occur in devices and can be designed for: actuator lag, one flexible mode,
quadratic damping, an averaging sensor. Each starts at the values from the scan of the residual, is
fitted in full, and is kept if it explains held-out windows. If the residual is still significant,
the model is refuted and the most likely missing term is named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sim.arrays import Array
from sim.identify.experiment import Experiment
from sim.identify.identified_motion import (
    AVERAGE,
    DELAY,
    FREQUENCY,
    LAG,
    LOSS,
    QUADRATIC,
    SHARE,
)
from sim.identify.judge_fit import (
    FINEST,
    IMPROBABLE,
    SURE,
    Evidence,
    left,
    scan,
    unsteady,
    whiteness,
)
from sim.identify.output_error import Fit, fit
from sim.identify.remainder import (
    CLEAR,
    NAMED,
    NOTHING,
    REFUSED,
    Remainder,
    likeliest,
    remainder,
)
from sim.identify.suspects import describe
from sim.identify.windows import Windows, late_windows, undisturbed

# Terms the model can have, and their unknowns.
TERMS = {
    "quadratic damping": (QUADRATIC,),
    "actuator lag": (LAG,),
    "sensor filter": (AVERAGE,),
    "flexible mode": (SHARE, FREQUENCY, LOSS),
}
# mass ratio of a joint with a quarter of the mass beyond it, for which bounds are reported
QUARTER = 1.0 / 3.0
# largest share of the remainder that a term may leave to be kept, if the model still leaves one
HALVES = 0.5
PROMISES = 0.15  # share a term must explain in the scan to be fitted in full
# standard errors, over held-out windows, by which a joint's three unknowns must beat a term with
# one
BETTER = 3.0
CLOSE = 1.1  # or factor of the error, if the windows differ much
JOINT = "flexible mode"


@dataclass(frozen=True)
class Choice:
    """A model and its judgement."""

    model: Fit  # over all undisturbed windows
    test: Fit  # its held-out windows
    whiteness: float  # of the held-out windows
    terms: tuple[str, ...]  # terms beyond a rigid device
    why: str  # what refutes it; empty if it holds
    # jitter of the sample instants, root mean square [s]; 0 if not significant
    unsteady: float
    # frequency above which a joint with a quarter of the mass beyond it would not be detected [Hz]
    mode_bound: float
    # largest undetectable lag [s] and quadratic damping per mass [1/m]
    lag_bound: float
    quadratic_bound: float
    dropped: int  # number of disturbed windows
    remainder: Remainder = NOTHING  # significant remaining term and its effect


class RicherFit(NamedTuple):
    """A fit with one term more."""

    errors: Array  # of its held-out windows, squared and summed in each
    fit: Fit  # over the searched windows
    term: str

    @property
    def error(self) -> float:
        """Sum over the held-out windows."""
        return float(self.errors.sum())


def choose(
    experiment: Experiment,
    found: Fit,
    windows: Windows,
    scale: float,
    step: float | None,
) -> Choice:
    """Judge a rigid fit, and add terms while the data support them.

    The remainder of the last model is weighed by its effect on K_max.
    """
    choice, evidence, kept = _judge(experiment, found, windows, (), scale, step)
    tried = [(choice, evidence)]
    while _is_doubtful(choice, evidence) and len(choice.terms) < len(TERMS):
        richer = _fit_richer(experiment, choice, evidence, kept, scale)
        if richer is None:
            break
        choice, evidence, kept = _judge(
            experiment, richer.fit, kept, (*choice.terms, richer.term), scale, step
        )
        tried.append((choice, evidence))
    return (
        _choose_by_remainder(experiment, tried, step)
        if _is_doubtful(choice, evidence)
        else choice
    )


def _choose_by_remainder(
    experiment: Experiment,
    tried: list[tuple[Choice, list[Evidence]]],
    step: float | None,
) -> Choice:
    """Return the model whose remainder matters least, or the rigid one, refuted.

    A richer model must leave much less.
    """
    rigid, first = tried[0]
    best: tuple[Choice, float] | None = None
    for choice, evidence in tried:
        left_out = remainder(experiment, choice.model, evidence, step)
        beyond = max(choice.model.rms**2 - (step or FINEST) ** 2 / 12.0, 0.0)
        if JOINT in choice.terms and left_out.explained < NAMED:
            # A joint beside an unexplained residual only imitates it (a gap, say): its frequency
            # would be reported with an interval, but belongs to no joint.
            continue
        if left_out.k_max_change <= REFUSED and (
            best is None or beyond <= HALVES * best[1]
        ):
            best = _with_remainder(choice, left_out), beyond
    if best is not None:
        return best[0]
    left_out = remainder(experiment, rigid.model, first, step)
    why = (
        f"{_explain(experiment, rigid.model, first, step)}; it may change K_max by"
        f" {_percent(left_out.k_max_change)}"
    )
    return replace(rigid, remainder=left_out, unsteady=0.0, why=why)


def _with_remainder(choice: Choice, left_out: Remainder) -> Choice:
    """Return a choice with its remainder; a term that explains it replaces jitter."""
    return replace(
        choice,
        remainder=left_out,
        unsteady=0.0 if left_out.explained >= CLEAR else choice.unsteady,
    )


def _percent(change: float) -> str:
    return f"{100.0 * change:.2g} %" if change <= 1.0 else "more than its half"


def _is_doubtful(choice: Choice, evidence: list[Evidence]) -> bool:
    return choice.whiteness < IMPROBABLE or any(one.strength > SURE for one in evidence)


def _judge(
    experiment: Experiment,
    found: Fit,
    windows: Windows,
    terms: tuple[str, ...],
    scale: float,
    step: float | None,
) -> tuple[Choice, list[Evidence], Windows]:
    """Fit all windows, judge by the held-out ones, and scan the residual."""
    free, length = tuple(found.free.tolist()), windows.length
    test = fit(experiment, windows.unseen, length, found.theta, (), scale)
    starts = np.concatenate([windows.seen, windows.unseen])
    order = np.argsort(starts)
    # All windows together for the reported values; the held-out ones are for judging.
    model = fit(
        experiment,
        starts[order],
        length,
        found.theta,
        free,
        scale,
        np.concatenate([found.states, test.states])[order],
    )
    kept = undisturbed(experiment, model, scale, step)
    if not kept.all():
        model = fit(
            experiment,
            model.starts[kept],
            length,
            model.theta,
            free,
            scale,
            model.states[kept],
        )
        # Divided again, because all held-out windows may have been disturbed.
        windows = Windows.of(model.starts, length)
    # The search may have stopped early: restart from the fit of all windows, without the held-out
    # ones.
    seen = np.isin(model.starts, windows.seen)
    again = fit(
        experiment,
        model.starts[seen],
        length,
        model.theta,
        free,
        scale,
        model.states[seen],
    )
    test = fit(
        experiment, windows.unseen, length, again.theta, (), scale, model.states[~seen]
    )
    what = left(experiment, model, step)
    evidence = scan(experiment, model, what)
    spread, sure = unsteady(experiment, what)
    # The effect of a lag beyond its mean delay grows with its square.
    lags = [
        one
        for one in evidence
        if one.suspect.term == "actuator lag" and one.visible <= 1.0
    ]
    lag_bound = min(
        (one.suspect.start[0] * math.sqrt(one.visible) for one in lags),
        default=math.inf,
    )
    quadratic = min(
        (one.visible for one in evidence if one.suspect.term == "quadratic damping"),
        default=math.inf,
    )
    white, dropped = whiteness(left(experiment, test, step)), int(np.sum(~kept))
    bounds = _mode_bound(evidence), lag_bound * experiment.period, quadratic
    return (
        Choice(
            model,
            test,
            white,
            terms,
            "",
            spread if sure > SURE else 0.0,
            *bounds,
            dropped,
        ),
        evidence,
        windows,
    )


def _mode_bound(evidence: list[Evidence]) -> float:
    """Return the frequency up to which every joint would have been detected [Hz]."""
    modes = sorted(
        (one for one in evidence if one.suspect.term == "flexible mode"),
        key=lambda one: one.suspect.size,
    )
    seen = 0.0
    for one in modes:
        if one.visible > QUARTER:
            break
        seen = one.suspect.size
    return seen


def _fit_richer(
    experiment: Experiment,
    choice: Choice,
    evidence: list[Evidence],
    windows: Windows,
    scale: float,
) -> RicherFit | None:
    """Fit every remaining term; return the fit that best explains held-out windows, or None."""
    tried: list[RicherFit] = []
    before = choice.model
    at = np.isin(before.starts, windows.seen)
    for term, unknowns in TERMS.items():
        asked = next((one for one in evidence if one.suspect.term == term), None)
        if (
            term in choice.terms
            or asked is None
            or asked.strength < SURE
            or asked.share < PROMISES
        ):
            continue
        theta = before.theta.copy()
        theta[list(unknowns)] = _initial_values(asked)
        # An averaging sensor delays by its mean, which was part of the delay.
        theta[DELAY] = max(theta[DELAY] - theta[AVERAGE] + before.theta[AVERAGE], 0.0)
        free = (*before.free.tolist(), *unknowns)
        found = fit(
            experiment,
            windows.seen,
            windows.length,
            theta,
            free,
            scale,
            before.states[at],
            steps=30,
        )
        errors = fit(
            experiment, windows.unseen, windows.length, found.theta, (), scale
        ).errors
        tried.append(RicherFit(errors, found, term))
    best = _best(tried)
    if best is None or best.error > 1.02 * float(choice.test.errors.sum()):
        return None
    return best


def _best(tried: list[RicherFit]) -> RicherFit | None:
    """Return the fit with the smallest held-out error; a joint only if significantly better."""
    best = min(tried, key=lambda one: one.error, default=None)
    if best is None or best.term != JOINT:
        return best

    def is_as_good(one: RicherFit) -> bool:
        more = one.errors - best.errors
        is_close = one.error <= CLOSE * best.error
        chance = BETTER * float(more.std(ddof=1)) / math.sqrt(len(more))
        return is_close and float(more.mean()) <= chance

    # Each other term has one unknown, and a blur resembles a stiff, well-damped joint.
    others = [one for one in tried if one.term != JOINT and is_as_good(one)]
    return min(others, key=lambda one: one.error, default=best)


def _initial_values(asked: Evidence) -> tuple[float, ...]:
    """Return the initial values of a term."""
    if asked.suspect.term == "quadratic damping":
        return (max(asked.factor, 1e-3),)
    if asked.suspect.term == "actuator lag":
        return asked.suspect.start
    if asked.suspect.term == "sensor filter":
        return (0.4,)
    # The mode moves the motor side by the ratio of the mass beyond to its own.
    ratio = max(asked.factor, 0.05)
    return (min(ratio / (1.0 + ratio), 0.7), *asked.suspect.start[1:])


def _explain(
    experiment: Experiment, found: Fit, evidence: list[Evidence], step: float | None
) -> str:
    """Describe what refutes a model and which term is missing."""
    size = (
        f"{found.rms * 1e6:.3g} µm"
        if step is None
        else f"{found.rms / step:.2f} encoder steps (rounding: 0.29)"
    )
    strong = [one for one in evidence if one.strength > SURE]
    asked = likeliest(strong)
    if asked is None or asked.share < NAMED:
        cause = "no term that was tried explains it"
        if asked is not None:
            cause += (
                f" (nearest: {describe(asked.suspect.term, asked.suspect.size)},"
                f" {100 * asked.share:.0f} % of it)"
            )
    else:
        cause = f"the data ask for {describe(asked.suspect.term, asked.suspect.size)}"
    late = int(np.count_nonzero(late_windows(experiment, found)))
    if late:
        cause += (
            f"; in {late} of {len(found.starts)} windows answers came late, and only their mean is"
            " known"
        )
    return f"it leaves {size} that are not white noise; {cause}"
