"""A law as a linear system of scipy or python-control."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant
from sim.api.laws import LawLike, compiled
from sim.api.responses import USUAL
from sim.arrays import Array


def to_scipy(law: LawLike, plant: Plant | None = None) -> Any:
    """Return a law as a discrete-time system of scipy, from deflection [m] to force [N].

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        Source of the period [s]; by default 2 ms.

    Returns
    -------
    scipy.signal.dlti
        A transfer function in z; a law with recursive sections is a state space, in which they stay
        parallel, because the product of their polynomials is ill-conditioned (scipy's own
        ``dfreqresp`` makes it; ``to_control`` does not).

    Raises
    ------
    ValueError
        For a law with code of its own, which has no transfer function.

    Examples
    --------
    >>> to_scipy({"kind": "pd", "stiffness": 1000, "damping": 3}).num
    array([ 2500., -1500.])
    """
    from scipy import signal

    period = (plant or USUAL).period
    found = linear_law(law, period)
    if not found.sections:
        taps = np.array(found.taps)
        return signal.TransferFunction(taps, np.eye(1, len(taps))[0], dt=period)
    return signal.StateSpace(*_state_space(found), dt=period)


def to_control(law: LawLike, plant: Plant | None = None) -> Any:
    """Return a law as a system of python-control, from deflection [m] to force [N].

    Parameters
    ----------
    law : str, mapping, sequence of float, Law or CompiledLaw
        The law.
    plant : Plant, optional
        Source of the period [s]; by default 2 ms.

    Returns
    -------
    control.TransferFunction or control.StateSpace
        As `to_scipy`.

    Raises
    ------
    ModuleNotFoundError
        If python-control is not installed.
    ValueError
        For a law with code of its own.

    Examples
    --------
    >>> to_control({"kind": "pd", "stiffness": 1000, "damping": 3}).dcgain()  # doctest: +SKIP
    1000.0
    """
    return as_control(to_scipy(law, plant))


def linear_law(law: LawLike, period: float) -> CompiledLaw:
    """Return a compiled law; ValueError for one with code of its own."""
    found = compiled(law, period)
    if found.evaluate is not None:
        raise ValueError(
            "law: has code of its own and no transfer function; play it instead"
        )
    return found


def _state_space(law: CompiledLaw) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C and D: the history of the taps, and each section in direct form II."""
    history, count = len(law.taps) - 1, len(law.sections)
    size = history + 2 * count
    a, b, c = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((1, size))
    d = law.taps[0]
    if history:
        b[0, 0], c[0, :history] = 1.0, law.taps[1:]
        a[range(1, history), range(history - 1)] = 1.0
    for i, (b0, b1, a1, a2) in enumerate(law.sections):
        at = history + 2 * i
        a[at, at : at + 2], a[at + 1, at], b[at, 0] = (-a1, -a2), 1.0, 1.0
        c[0, at : at + 2] = b1 - b0 * a1, -b0 * a2
        d += b0
    return a, b, c, np.array([[d]])


def as_control(system: Any) -> Any:
    """Return a system of scipy as one of python-control."""
    try:
        control = importlib.import_module("control")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "needs python-control: pip install control"
        ) from error
    if hasattr(system, "num"):
        return control.TransferFunction(system.num, system.den, system.dt)
    return control.StateSpace(system.A, system.B, system.C, system.D, system.dt)
