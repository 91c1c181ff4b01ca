"""The verdict of the step tests: whether the law holds, where its edge is, how precisely."""

from sim.tune.knocking import STEP, KnockedEdge
from sim.tune.record import PredictedStep, TuneRecord, VerifiedStep
from sim.tune.tuning_text import number

# An edge further from the predicted one belongs to another device, and the model's poles do not
# describe this one.
AGREES = 0.1
# A law holds if it rests up to this factor: friction stabilises small knocks, but not large ones.
MARGIN = 1.05
# The edge by poles gets a single value if both ends of its interval are within this factor;
# otherwise the interval alone.
CERTAIN = 1.05


def verified(predicted: PredictedStep, edge: KnockedEdge) -> VerifiedStep:
    """Judge a law by the knocks on its device.

    Only a complete climb gives an edge. Knocks find it too low if a motion decays slowly, too high
    if friction is strong (`by_poles`). If device and model disagree about the edge, friction may
    damp a mode that the model lacks: such a law is not delivered, even if small knocks come to
    rest.
    """
    h1, factor, rested = predicted.h1_n_per_m, edge.factor, edge.rested
    expected = predicted.edge_factor
    agrees = factor is expected is None or (
        factor and expected and abs(factor / expected - 1.0) <= AGREES
    )
    ends = None
    if factor is not None and expected is not None and rested is not None and agrees:
        ends = by_poles(factor, expected, predicted.edge_linear_factor)
    certain = ends is not None and ends[1] <= ends[0] * CERTAIN**2
    below_law = [step for step in edge.steps if step.factor <= 1.0 + 1e-12]
    climbed = (
        bool(below_law)
        and all(step.rests for step in below_law)
        and below_law[-1].factor > 1.0 / STEP
    )
    rests = climbed and edge.complete and rested is not None and rested >= 1.0
    # Without an edge, the stiffest factor that rested decides.
    surely = rested if ends is None else ends[0]
    holds = bool(rests and agrees and surely is not None and surely >= MARGIN)
    ended = edge.ended
    if rests and not agrees:
        ended = (
            f"{ended}, where the model has {expected or 0.0:.3f}: the device differs from the "
            "identified one"
        )
    if rests and ends is not None and not holds:
        ended = (
            f"{ended}; a large motion may be unstable from {ends[0]:.3f} times on, and "
            f"{MARGIN:g} is required"
        )
    error, words = compared(expected, factor)
    return VerifiedStep(
        holds=holds,
        agrees=bool(agrees),
        complete=edge.complete,
        edge_factor=factor,
        edge_h1_n_per_m=None if factor is None else factor * h1,
        # The lower end: the middle would be above the true edge half of the time.
        edge_by_poles_h1_n_per_m=(
            min(ends[0], rested or ends[0]) * h1 if ends and certain else None
        ),
        edge_by_poles_between_n_per_m=None
        if ends is None
        else (ends[0] * h1, ends[1] * h1),
        stiffest_at_rest_n_per_m=None if rested is None else rested * h1,
        edge_error=error,
        edge_compared=words,
        ended=ended,
        steps=tuple(edge.steps),
    )


def by_poles(measured: float, expected: float, linear: float) -> tuple[float, float]:
    """Return the interval of the factor at which a pole of the device reaches the unit circle.

    An error in friction moves the measured knocks, times the ratio of poles and knocks on the
    model, by several steps; a wrong model that was not refuted moves its own poles. The interval
    covers both estimates, and one step more on either side.
    """
    corrected = measured * linear / expected
    return min(linear, corrected) / STEP, max(linear, corrected) * STEP


def compared(
    predicted: float | None, measured: float | None
) -> tuple[float | None, str]:
    """Compare the two edges: as a ratio, and in words that respect the steps of 2 %."""
    if predicted is None or measured is None:
        return None, "not both have an edge"
    error = measured / predicted - 1.0
    same = abs(error) < 0.5 * (STEP - 1.0)
    words = (
        f"the same step of {100 * (STEP - 1.0):.0f} %"
        if same
        else f"{100 * error:+.0f} % from the predicted one"
    )
    return error, words


def headline(record: TuneRecord) -> str:
    """Return the outcome of a tuning in one sentence, the worst first."""
    designed, after = record.designed, record.verified
    stopped = record.refused or (
        f"interrupted during {record.interrupted}" if record.interrupted else ""
    )
    if designed is None:
        return f"No law: {stopped or 'none was designed'}."
    law = number(designed.h1_n_per_m, "N/m")
    lands = designed.lands
    falls = "" if lands else "; it fails the drop test"
    if after is None or not (after.steps or after.ended):
        why = f" ({stopped})" if stopped else ""
        return f"Not tried: a law of {law} was designed, but not tried on the device{why}{falls}."
    if after.holds:
        tried = f"{law} were tried on the device{f', {stopped}' if stopped else ''}"
        return f"The law holds: {tried}, {edge_in_words(after)}{falls}."
    rested = after.stiffest_at_rest_n_per_m
    softer = (
        "nothing softer came to rest either"
        if rested is None
        else f"it came to rest up to {number(rested, 'N/m')}"
    )
    if not after.complete:
        return (
            f"Not verified: {stopped or after.ended}; {softer}, the law has {law}. Nothing was"
            " delivered."
        )
    return f"The law does NOT hold: {after.ended}; {softer}. Nothing was delivered."


def edge_in_words(after: VerifiedStep) -> str:
    """Describe the edge: its lower end if the interval is within 5 %, else the interval."""
    ends, edge = after.edge_by_poles_between_n_per_m, after.edge_by_poles_h1_n_per_m
    if ends is None:
        return f"no edge was found up to {number(after.stiffest_at_rest_n_per_m or 0.0, 'N/m')}"
    between = f"between {number(ends[0])} and {number(ends[1], 'N/m')}"
    return (
        f"its edge lies {between}"
        if edge is None
        else f"its edge is at {number(edge, 'N/m')} or above ({between})"
    )
