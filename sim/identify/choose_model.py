"""Choose the model: a rigid device, and one more term only while the data ask for it and are explained by it.

The terms are those that devices have and that a law can be designed for: an actuator lag, one
flexible mode, quadratic damping. Each is begun where the scan of the residual puts it, fitted in
full, and kept if it explains windows that the fit has not seen. Where the residual still does not
hold, the model is refuted, and the suspect that takes up most of it is named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array, WholeArray
from sim.identify.experiment import Experiment
from sim.identify.identified_motion import AVERAGE, DELAY, FREQUENCY, LAG, LOSS, QUADRATIC, SHARE
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
from sim.identify.remainder import CLEAR, NAMED, NOTHING, REFUSED, Remainder, likeliest, remainder
from sim.identify.suspects import describe

# Terms that the model can have, and their unknowns.
TERMS = {
    "quadratic damping": (QUADRATIC,),
    "actuator lag": (LAG,),
    "sensor filter": (AVERAGE,),
    "flexible mode": (SHARE, FREQUENCY, LOSS),
}
# a quarter of the mass beyond a joint, as a ratio of the two: what a bound on joints is told for
QUARTER = 1.0 / 3.0
# part of a remainder that a term must leave at most, to be kept where the model still leaves
# something
HALVES = 0.5
HELD_OUT = 4  # every so many windows one is held out, to judge the fit by what it has not seen
LEAST = 6  # fewer windows without such answers are too few to leave out the others
PROMISES = 0.15  # part that a term must take up by the scan to be fitted in full
# standard errors, over unseen windows, by which a joint's three unknowns must beat a term of one
BETTER = 3.0
CLOSE = 1.1  # or a factor of the error, where the windows differ much
JOINT = "flexible mode"


@dataclass(frozen=True)
class Choice:
    """A model and what the run says about it."""

    model: Fit  # over all windows that a stall has not spoilt
    test: Fit  # its windows that the search has not seen
    whiteness: float  # of those
    terms: tuple[str, ...]  # what it has beyond a rigid device
    why: str  # what refutes it; empty where it holds
    # spread of the instants of the samples, root mean square [s]; 0 where none is seen
    unsteady: float
    # joints above it, a quarter of the mass beyond them, would not have been seen [Hz]
    mode_bound: float
    # Largest lag [s] and quadratic damping per mass [1/m] that would not have been seen.
    lag_bound: float
    quadratic_bound: float
    dropped: int  # windows that a stall spoilt
    remainder: Remainder = NOTHING  # what is left that is not noise, and what it may do


@dataclass(frozen=True)
class Windows:
    """Windows of a run: first ticks of those that the search sees and of those that judge it, and the ticks of each."""

    seen: WholeArray
    unseen: WholeArray
    length: int

    @classmethod
    def of(cls, starts: WholeArray, length: int) -> Windows:
        """Hold some of them out."""
        unseen = starts[HELD_OUT - 1 :: HELD_OUT]
        return cls(np.setdiff1d(starts, unseen), unseen, length)


def choose(
    experiment: Experiment, found: Fit, windows: Windows, scale: float, step: float | None
) -> Choice:
    """Judge a rigid fit, and add terms while the data ask for them; what is left at last is weighed."""
    choice, evidence, kept = _judged(experiment, found, windows, (), scale, step)
    tried = [(choice, evidence)]
    while _doubted(choice, evidence) and len(choice.terms) < len(TERMS):
        richer = _richer(experiment, choice, evidence, kept, scale)
        if richer is None:
            break
        choice, evidence, kept = _judged(
            experiment, richer[0], kept, (*choice.terms, richer[1]), scale, step
        )
        tried.append((choice, evidence))
    return _weighed(experiment, tried, step) if _doubted(choice, evidence) else choice


def _weighed(
    experiment: Experiment, tried: list[tuple[Choice, list[Evidence]]], step: float | None
) -> Choice:
    """Return a model whose remainder changes little, a richer one only if it leaves much less; else the rigid one, refuted."""
    rigid, first = tried[0]
    best: tuple[Choice, float] | None = None
    for choice, evidence in tried:
        left_out = remainder(experiment, choice.model, evidence, step)
        beyond = max(choice.model.rms**2 - (step or FINEST) ** 2 / 12.0, 0.0)
        if JOINT in choice.terms and left_out.explained < NAMED:
            # A joint beside something that nothing explains stands in for it (a gap, say): its
            # frequency would be told with an interval, and is that of no joint.
            continue
        if left_out.k_max_change <= REFUSED and (best is None or beyond <= HALVES * best[1]):
            best = _with(choice, left_out), beyond
    if best is not None:
        return best[0]
    left_out = remainder(experiment, rigid.model, first, step)
    why = (
        f"{_why(experiment, rigid.model, first, step)}; it may change K_max by"
        f" {_percent(left_out.k_max_change)}"
    )
    return replace(rigid, remainder=left_out, unsteady=0.0, why=why)


def _with(choice: Choice, left_out: Remainder) -> Choice:
    """Return a choice with what it leaves: where a term explains that, it was no unsteady sampling."""
    return replace(
        choice, remainder=left_out, unsteady=0.0 if left_out.explained >= CLEAR else choice.unsteady
    )


def _percent(change: float) -> str:
    return f"{100.0 * change:.2g} %" if change <= 1.0 else "more than its half"


def _doubted(choice: Choice, evidence: list[Evidence]) -> bool:
    return choice.whiteness < IMPROBABLE or any(one.strength > SURE for one in evidence)


def _judged(
    experiment: Experiment,
    found: Fit,
    windows: Windows,
    terms: tuple[str, ...],
    scale: float,
    step: float | None,
) -> tuple[Choice, list[Evidence], Windows]:
    """Fit all windows, judge by those that the search has not seen, and scan what is left."""
    free, length = tuple(found.free.tolist()), windows.length
    test = fit(experiment, windows.unseen, length, found.theta, (), scale)
    starts = np.concatenate([windows.seen, windows.unseen])
    order = np.argsort(starts)
    # All windows together for what is reported: the held-out ones have judged.
    model = fit(
        experiment,
        starts[order],
        length,
        found.theta,
        free,
        scale,
        np.concatenate([found.states, test.states])[order],
    )
    undisturbed = _undisturbed(experiment, model, scale, step)
    if not undisturbed.all():
        model = fit(
            experiment,
            model.starts[undisturbed],
            length,
            model.theta,
            free,
            scale,
            model.states[undisturbed],
        )
        # Divided anew: what a stall spoilt may have been all that was held out.
        windows = Windows.of(model.starts, length)
    # The search may have stopped short: from where all windows lead, and again without those that
    # judge.
    seen = np.isin(model.starts, windows.seen)
    again = fit(
        experiment, model.starts[seen], length, model.theta, free, scale, model.states[seen]
    )
    test = fit(experiment, windows.unseen, length, again.theta, (), scale, model.states[~seen])
    what = left(experiment, model, step)
    evidence = scan(experiment, model, what)
    spread, sure = unsteady(experiment, what)
    # What a lag does beyond its mean delay grows with its square.
    lags = [one for one in evidence if one.suspect.term == "actuator lag" and one.visible <= 1.0]
    lag_bound = min(
        (one.suspect.start[0] * math.sqrt(one.visible) for one in lags), default=math.inf
    )
    quadratic = min(
        (one.visible for one in evidence if one.suspect.term == "quadratic damping"),
        default=math.inf,
    )
    white, dropped = whiteness(left(experiment, test, step)), int(np.sum(~undisturbed))
    bounds = _mode_bound(evidence), lag_bound * experiment.period, quadratic
    return (
        Choice(model, test, white, terms, "", spread if sure > SURE else 0.0, *bounds, dropped),
        evidence,
        windows,
    )


def _mode_bound(evidence: list[Evidence]) -> float:
    """Frequency up to which every joint would have been seen [Hz]."""
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


def _undisturbed(
    experiment: Experiment, found: Fit, scale: float, step: float | None
) -> NDArray[np.bool_]:
    """Tell which windows to keep: none with four times the error of the middle one, or of rounding; all if a third has it.

    Nor one with several late answers in a tick, of which only the mean is told, that does not fit a
    model of those without.
    """

    def fits(errors: Array, middle: float, grid: float) -> NDArray[np.bool_]:
        return np.asarray(errors <= (4.0 * max(middle, grid * math.sqrt(found.length / 12.0))) ** 2)

    kept = fits(found.errors, math.sqrt(float(np.median(found.errors))), scale)
    if np.mean(kept) <= 2.0 / 3.0:
        kept = np.ones_like(kept)
    late = _late(experiment, found)
    whole = kept & ~late
    if not late.any() or np.count_nonzero(whole) < LEAST:
        return kept
    free, length = tuple(found.free.tolist()), found.length
    theta = fit(
        experiment, found.starts[whole], length, found.theta, free, scale, found.states[whole]
    ).theta
    errors = fit(experiment, found.starts, length, theta, (), scale, found.states).errors
    return kept & (whole | fits(errors, math.sqrt(float(np.median(errors[whole]))), step or FINEST))


def _late(experiment: Experiment, found: Fit) -> NDArray[np.bool_]:
    """Tell which windows have a late answer."""
    rows = found.starts[:, None] + np.arange(found.length)
    return (
        np.zeros(len(rows), dtype=bool)
        if experiment.late is None
        else experiment.late[rows].any(axis=1)
    )


def _richer(
    experiment: Experiment, choice: Choice, evidence: list[Evidence], windows: Windows, scale: float
) -> tuple[Fit, str] | None:
    """Fit every term that is left from where the scan puts it; the one that explains unseen windows best, if any does."""
    tried: list[tuple[Array, Fit, str]] = []
    before = choice.model
    at = np.isin(before.starts, windows.seen)
    for term, unknowns in TERMS.items():
        asked = next((one for one in evidence if one.suspect.term == term), None)
        if term in choice.terms or asked is None or asked.strength < SURE or asked.share < PROMISES:
            continue
        theta = before.theta.copy()
        theta[list(unknowns)] = _start(asked)
        # A sensor that averages is late by its mean, which stood in the delay.
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
        errors = fit(experiment, windows.unseen, windows.length, found.theta, (), scale).errors
        tried.append((errors, found, term))
    best = _simplest(tried)
    if best is None or float(best[0].sum()) > 1.02 * float(choice.test.errors.sum()):
        return None
    return best[1], best[2]


def _simplest(tried: list[tuple[Array, Fit, str]]) -> tuple[Array, Fit, str] | None:
    """Return the fit with the least error in unseen windows; a joint only if it is better beyond chance."""
    best = min(tried, key=lambda one: float(one[0].sum()), default=None)
    if best is None or best[2] != JOINT:
        return best

    def as_good(errors: Array) -> bool:
        more = errors - best[0]
        close = float(errors.sum()) <= CLOSE * float(best[0].sum())
        chance = BETTER * float(more.std(ddof=1)) / math.sqrt(len(more))
        return close and float(more.mean()) <= chance

    # Each other term has one unknown, and a blur resembles a stiff joint with much loss.
    others = [one for one in tried if one[2] != JOINT and as_good(one[0])]
    return min(others, key=lambda one: float(one[0].sum()), default=best)


def _start(asked: Evidence) -> tuple[float, ...]:
    """Sizes of a term to begin with."""
    if asked.suspect.term == "quadratic damping":
        return (max(asked.factor, 1e-3),)
    if asked.suspect.term == "actuator lag":
        return asked.suspect.start
    if asked.suspect.term == "sensor filter":
        return (0.4,)
    # The mode moves the motor's side by as much as the mass beyond is of its own.
    ratio = max(asked.factor, 0.05)
    return (min(ratio / (1.0 + ratio), 0.7), *asked.suspect.start[1:])


def _why(experiment: Experiment, found: Fit, evidence: list[Evidence], step: float | None) -> str:
    """Say what refutes a model and what the data ask for."""
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
    late = int(np.count_nonzero(_late(experiment, found)))
    if late:
        cause += (
            f"; in {late} of {len(found.starts)} windows answers came late, and only their mean is"
            " known"
        )
    return f"it leaves {size} that are not white noise; {cause}"
