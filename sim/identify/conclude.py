"""Turn a fit into estimates with 95 % intervals, or reasons why there are none."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.arrays import Array
from sim.identify import identified_motion as motion
from sim.identify.choose_model import Choice
from sim.identify.experiment import Experiment, encoder
from sim.identify.identified import Estimate, Identified
from sim.identify.identified_text import ROWS
from sim.identify.output_error import Fit, own_states

CONFIDENCE = 0.95


def nothing(experiment: Experiment, length: int, why: str) -> Identified:
    """Return what a run without a changing force yields: its delays and its encoder step."""
    _, *delays, jitter = _delays(experiment)
    estimates: dict[str, Any] = dict.fromkeys(
        (name for _, name, _, _ in ROWS), Estimate(None, why=why)
    )
    estimates |= {
        "encoder": encoder(experiment.position[~experiment.missing]),
        "jitter": jitter,
    }
    figures: dict[str, Any] = {
        "delay_range": tuple(delays),
        "held": False,
        "residual": math.nan,
    }
    figures |= {
        "dropped": 0,
        "windows": 0,
        "ticks": length,
        "axis": experiment.axis,
        "period": experiment.period,
    }
    return Identified(**estimates, **figures)


def covariance_of(found: Fit) -> Array:
    """Return the covariance of the unknowns from the differences between windows.

    Rounding errors are not white, so the residual alone would underestimate it.
    """
    matrix = found.matrices.sum(axis=0)
    size = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-60))
    values, vectors = np.linalg.eigh(matrix * np.outer(size, size))
    # A direction without information gets a very large error in place of a division by zero.
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T * np.outer(size, size)
    windows, p = len(found.starts), len(found.free)
    # Score of each window without its own influence on the estimate (first-order jackknife).
    scores = np.empty((windows, p))
    identity = np.eye(p)
    for w in range(windows):
        scores[w] = np.linalg.lstsq(
            identity - (found.matrices[w] @ inverse), found.sides[w], rcond=None
        )[0]
    between = inverse @ (scores.T @ scores) @ inverse * (windows - 1) / windows
    white = inverse * max(found.rms, 1e-12) ** 2
    # The larger variance of each unknown counts.
    wider = np.sqrt(
        np.maximum(
            np.diag(white) / np.maximum(np.diag(between), 1e-12 * np.diag(white)), 1.0
        )
    )
    return np.asarray(between * np.outer(wider, wider), dtype=np.float64)


class _Widths:
    """Values of a fit's unknowns with the half-widths of their 95 % intervals."""

    def __init__(self, found: Fit, moved: Sequence[float] = ()) -> None:
        from scipy.special import stdtrit  # scipy.stats takes 0.5 s to load

        self._found, self._covariance = found, covariance_of(found)
        # The effect of unmodelled terms on each unknown is not random, so it is added to the width.
        self._moved = np.array(moved) if len(moved) else np.zeros(len(found.free))
        self._quantile = float(
            stdtrit(max(1, len(found.starts) - len(found.free)), 0.5 + 0.5 * CONFIDENCE)
        )
        self._index = {int(which): i for i, which in enumerate(found.free)}
        self.mobility = float(found.theta[motion.MOBILITY])
        self.mass_off = (
            self._quantile * math.sqrt(self._covariance[0, 0]) + float(self._moved[0])
        ) / self.mobility

    def __contains__(self, which: int) -> bool:
        return which in self._index

    def per_mass(self, which: int) -> tuple[float, float]:
        """Return an unknown times mass, and its half-width."""
        index, g = self._index, self.mobility
        value = float(self._found.theta[which]) / g
        slope = np.zeros(len(self._found.free))
        slope[index[which]] = 1.0 / g
        slope[index[motion.MOBILITY]] -= value / g
        chance = self._quantile * math.sqrt(
            max(float(slope @ self._covariance @ slope), 0.0)
        )
        return value, chance + float(np.abs(slope) @ self._moved)

    def direct(self, which: int, unit: float = 1.0) -> tuple[float, float]:
        """Return an unknown and its half-width."""
        i = self._index[which]
        width = self._quantile * math.sqrt(self._covariance[i, i]) + float(
            self._moved[i]
        )
        return float(self._found.theta[which]) * unit, width * unit

    def total_delay(self) -> tuple[float, float]:
        """Return the device's delay including the mean delay of an averaging sensor [ticks]."""
        late, width = self.direct(motion.DELAY)
        if motion.AVERAGE not in self:
            return late, width
        pair = [self._index[motion.DELAY], self._index[motion.AVERAGE]]
        chance = self._quantile * math.sqrt(
            max(float(self._covariance[np.ix_(pair, pair)].sum()), 0.0)
        )
        return late + float(self._found.theta[motion.AVERAGE]), chance + float(
            self._moved[pair].sum()
        )


def conclude(experiment: Experiment, choice: Choice, grid: Estimate) -> Identified:
    """Return the estimates of a chosen model; a refuted model gives its parameters no value."""
    found, test = choice.model, choice.test
    widths = _Widths(found, () if choice.why else choice.remainder.moved)
    own = _own_delay(experiment, choice, widths)
    total = own
    median, shortest, longest, jitter = _delays(experiment)
    if own.value is not None:
        _, low, high = own.known()
        total = Estimate(own.value + median, low + median, high + median)
        shortest, longest = shortest + low, longest + high
    estimates = _mechanics(experiment, widths, float(found.theta[motion.DAMPING]))
    estimates |= _terms(experiment.period, choice, widths) | {
        "delay": total,
        "device_delay": own,
    }
    unbelieved = {}
    if choice.why:
        unbelieved, unknown = (
            estimates,
            Estimate(None, why=f"the model is refuted: {choice.why}"),
        )
        estimates = dict.fromkeys(estimates, unknown)
    # The median: a window disturbed by a stall does not count against the model.
    residual = math.sqrt(
        float(np.median(test.errors)) / (test.length - own_states(test.theta))
    )
    estimates |= {"encoder": grid, "jitter": jitter}
    return Identified(
        **estimates,
        delay_range=(shortest, longest),
        held=motion.STIFFNESS in widths and float(found.theta[motion.STIFFNESS]) > 0.0,
        residual=found.rms,
        held_out=residual,
        whiteness=choice.whiteness,
        dropped=choice.dropped,
        windows=len(found.starts),
        ticks=found.length,
        axis=experiment.axis,
        period=experiment.period,
        terms=(*choice.terms, *(["sampling jitter"] if choice.unsteady else [])),
        refuted=bool(choice.why),
        why=choice.why,
        unbelieved=unbelieved,
        remainder=choice.remainder.cause,
        remainder_k_max=choice.remainder.k_max_change,
        altered=choice.remainder.devices,
    )


def _mechanics(
    experiment: Experiment, widths: _Widths, damping_per_mass: float
) -> dict[str, Estimate]:
    """Estimate mass, damping, friction, stiffness and load; none if the mass is unknown."""
    g, relative = widths.mobility, widths.mass_off
    # root-mean-square variation of the force [N]
    force = float(np.std(experiment.force))
    if relative > 0.5:
        why = (
            f"its error would be {100 * relative:.0f} %: push with forces that change more, or"
            " record longer"
        )
        unknown = Estimate(None, why=f"the mass is not known ({why})")
        return {
            "mass": Estimate(None, why=why),
            **dict.fromkeys(("damping", "friction", "stiffness", "load"), unknown),
        }
    speed = float(
        np.sqrt(np.mean((np.diff(experiment.position) / experiment.period) ** 2))
    )
    load, load_width = widths.per_mass(motion.LOAD)
    held = motion.STIFFNESS in widths
    return {
        # The interval of 1/m gives that of m, which is not symmetric.
        "mass": Estimate(
            1.0 / g, 1.0 / (g * (1.0 + relative)), 1.0 / (g * (1.0 - relative))
        ),
        "damping": _bounded(
            *widths.per_mass(motion.DAMPING),
            max(damping_per_mass / g, force / speed if speed else 0.0),
        ),
        "friction": _bounded(*widths.per_mass(motion.FRICTION), 0.5 * force),
        "load": Estimate(load, load - load_width, load + load_width),
        "stiffness": (
            _bounded(*widths.per_mass(motion.STIFFNESS), math.inf)
            if held
            else Estimate(0.0, 0.0, 0.0)
        ),
    }


def _own_delay(experiment: Experiment, choice: Choice, widths: _Widths) -> Estimate:
    """Estimate the device's own delay [ticks]."""
    late, width = widths.total_delay()
    # The mean lateness of a jittering sample is unknown; uniform from 0, it is 1.7 of its standard
    # deviations.
    width += 2.0 * choice.unsteady / experiment.period
    if width > 0.5:
        why = (
            f"its error would be {width:.2g} ticks: the force must change often, by much more than"
            " friction"
        )
        return Estimate(None, why=why)
    return Estimate(late, max(late - width, 0.0), late + width)


def _terms(period: float, choice: Choice, widths: _Widths) -> dict[str, Estimate]:
    """Estimate the terms beyond a rigid mass, or bounds below which they would not show."""

    def positive(value: float, width: float) -> Estimate:
        return Estimate(value, max(value - width, 0.0), value + width)

    seen = (
        f"none seen; one above {choice.mode_bound:.0f} Hz, with a quarter of the mass, would not"
        " show"
        if choice.mode_bound > 0.0
        else "none seen, and none with a quarter of the mass would show: push longer, or faster"
    )
    bound, unseen = choice.quadratic_bound / widths.mobility, Estimate(None, why=seen)
    terms = {
        "quadratic": Estimate(0.0, 0.0, bound),
        "lag": Estimate(0.0, 0.0, choice.lag_bound),
    }
    terms |= {
        "frequency": Estimate(None, choice.mode_bound, why=seen),
        "share": unseen,
        "loss": unseen,
    }
    if motion.QUADRATIC in widths:
        terms["quadratic"] = positive(*widths.per_mass(motion.QUADRATIC))
    if motion.LAG in widths:
        terms["lag"] = positive(*widths.direct(motion.LAG, period))
    terms["average"] = Estimate(0.0, 0.0, 0.0)
    if motion.AVERAGE in widths:
        terms["average"] = positive(*widths.direct(motion.AVERAGE))
    for name, which in (
        ("frequency", motion.FREQUENCY),
        ("share", motion.SHARE),
        ("loss", motion.LOSS),
    ):
        if which in widths:
            terms[name] = positive(*widths.direct(which))
    return terms


def _bounded(value: float, width: float, too_wide: float) -> Estimate:
    """Estimate a non-negative quantity; no value if its error exceeds `too_wide`."""
    if width > too_wide:
        return Estimate(
            None,
            why=(
                f"its error would be {width:.2g}, as large as what it is estimated from"
                f" ({too_wide:.2g})"
            ),
        )
    return Estimate(value, max(value - width, 0.0), value + width)


def _delays(experiment: Experiment) -> tuple[float, float, float, Estimate]:
    """Return median, shortest and longest delay of the loop, and its jitter.

    The interval of the jitter is bootstrapped from ten blocks of the run.
    """
    delay = experiment.delay
    if len(delay) < 100:
        return (
            0.0,
            0.0,
            0.0,
            Estimate(
                None, why=f"{len(delay)} ticks were answered, at least 100 are needed"
            ),
        )
    median = float(np.median(delay))
    shortest, longest = (float(q) for q in np.quantile(delay, (0.001, 0.999)))
    blocks = np.array_split(delay, 10)
    rng = np.random.default_rng(1)
    drawn = (
        np.concatenate([blocks[i] for i in rng.integers(0, len(blocks), len(blocks))])
        for _ in range(200)
    )
    spreads = [np.ptp(np.quantile(again, (0.001, 0.999))) for again in drawn]
    low, high = (float(q) for q in np.quantile(spreads, (0.025, 0.975)))
    value = longest - shortest
    return median, shortest, longest, Estimate(value, min(low, value), max(high, value))
