"""The coupling laws: parameters in, taps out. One law per file; other packages add laws through entry points ``haptic.laws``.

A law is a frozen msgspec struct whose fields are its parameters, with one method, ``compile``. What
it compiles to is the same for all: a vector of taps over the shared deflection history (every law
of the paper is just that, eq. 1, 6, 10) and, for recursive realisations of D^α, parallel
second-order sections beside them. So a swap of laws is a swap of numbers.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, cast, overload

import msgspec

from nodes.parameters.checked import check_fields
from nodes.parameters.registry import Registry

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["LAWS", "CompiledLaw", "Law", "law_kinds", "law_names", "load_law"]


def _wrong_law(name: str, found: Any) -> str:
    if not (isinstance(found, type) and issubclass(found, Law)):
        return f"{found!r} is not a subclass of nodes.laws.Law"
    return (
        ""
        if found.kind == name
        else f"{found!r} calls itself {found.kind!r}; its class variable kind must be its name"
    )


LAWS = Registry("haptic.laws", "law", _wrong_law)
# What is worked out of a law beside its coefficients, by packages above this one: its response, its
# plane of K and B.
RESULTS = Registry("haptic.results", "result of a law")


@dataclass(frozen=True)
class CompiledLaw:
    """What a law renders at one sampling period.

    Attributes
    ----------
    taps : tuple of float, shape (n + 1,)
        h_0 ... h_n [N/m]: F[k] = Σ h_m x[k−m] + Σ sections.
    sections : tuple of tuple of float, shape (s, 4)
        b0, b1 [N/m], a1, a2 of parallel sections y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂.
    evaluate : callable or None
        A law's own code beside taps and sections, for what is not linear: from (ring, head), with
        ``ring[head + m]`` the deflection m ticks ago, to a force [N] that is added. It is tried
        once before it may render, and watched then: when it raises, returns a force that is not
        finite or overruns its budget, the fallback takes over within the same tick. Code that
        remembers something from tick to tick has a method ``on_axis`` (see `own_code`).
    """

    taps: tuple[float, ...]
    sections: tuple[tuple[float, float, float, float], ...] = ()
    evaluate: Callable[[Sequence[float], int], float] | None = None

    def own_code(self, axis: int = 0) -> Callable[[Sequence[float], int], float] | None:
        """Give the law's own code for one axis, before its first tick.

        Parameters
        ----------
        axis : int
            Which of the axes that the scene computes, from 0. Code with a method ``on_axis`` is
            made anew by it, for this axis.

        Returns
        -------
        callable or None
            `evaluate`, or what its ``on_axis`` makes; None for a law without code of its own.
        """
        made = getattr(self.evaluate, "on_axis", None)
        return (
            self.evaluate
            if made is None
            else cast(Callable[[Sequence[float], int], float], made(axis))
        )

    @overload
    def response(self, z: complex) -> complex: ...

    @overload
    def response(self, z: NDArray[np.complex128]) -> NDArray[np.complex128]: ...

    def response(self, z: Any) -> Any:
        """Transfer function from deflection to force.

        Parameters
        ----------
        z : complex or ndarray of complex
            Points of the z plane, e.g. exp(jωT).

        Returns
        -------
        complex or ndarray of complex
            H(z) [N/m].
        """
        w = 1.0 / z
        total = 0.0 * w
        for tap in reversed(self.taps):
            total = total * w + tap
        for b0, b1, a1, a2 in self.sections:
            total += (b0 + b1 * w) / (1.0 + w * (a1 + w * a2))
        return total

    @property
    def h1(self) -> float:
        """Stiffness rendered to a held deflection, H(1) [N/m]."""
        return self.response(1.0).real

    @property
    def h_nyquist(self) -> float:
        """Gain at the Nyquist frequency, H(−1) [N/m]: what encoder noise is multiplied with."""
        return self.response(-1.0).real

    @property
    def finite(self) -> bool:
        """Whether every coefficient is finite."""
        return all(map(math.isfinite, self.taps)) and all(
            math.isfinite(c) for s in self.sections for c in s
        )

    def stable_sections(self) -> bool:
        """Whether the recursive sections themselves decay.

        Returns
        -------
        bool
            True when all their poles lie inside the unit circle (True without sections).
        """
        for _, _, a1, a2 in self.sections:
            root = cmath.sqrt(a1 * a1 - 4.0 * a2)
            if max(abs(-a1 + root), abs(-a1 - root)) >= 2.0:
                return False
        return True


class Law(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all laws: the fields of a subclass are its parameters.

    Attributes
    ----------
    kind : str
        Class variable: the registered name.

    Raises
    ------
    ParameterError
        When a parameter is of the wrong type, out of its limits or not finite.
    """

    kind: ClassVar[str] = ""

    def __post_init__(self) -> None:
        """Check what Python code gives as YAML is checked."""
        check_fields(self, self.kind)

    def compile(self, period: float) -> CompiledLaw:
        """Turn the parameters into taps.

        Parameters
        ----------
        period : float
            Sampling period T [s].

        Returns
        -------
        CompiledLaw
            Taps and sections.

        Raises
        ------
        ValueError
            When the parameters cannot be realised; the text names the parameter, its value and the
            limit.
        """
        raise TypeError(
            f"law kind {type(self).kind!r} does not define compile(), asked for T = {period:g} s"
        )

    def response(self, plant: Any = None, **options: Any) -> Any:
        """Return stiffness and damping that are rendered against frequency.

        Parameters
        ----------
        plant : Plant, optional
            Gives period [s] and delay [ticks]; 2 ms without a delay where there is none.
        **options : object
            See ``haptic.response``.

        Returns
        -------
        haptic.Response
            Arrays over the frequency; ``.plot()`` draws them.
        """
        return RESULTS.load("response")(self, plant, **options)

    def bode(self, plant: Any = None, ax: Any = None, **options: Any) -> Any:
        """Draw magnitude and phase of what is rendered.

        Parameters
        ----------
        plant : Plant, optional
            Gives period [s] and delay [ticks]; 2 ms without a delay where there is none.
        ax : pair of matplotlib.axes.Axes, optional
            Where to draw magnitude and phase; a figure of its own where none is given.
        **options : object
            See ``haptic.bode``.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        return RESULTS.load("bode")(self, plant, ax=ax, **options)

    def z_width(self, plant: Any = None, **options: Any) -> Any:
        """Return the K–B plane: how stiff the law may be at each gain of its damper.

        Parameters
        ----------
        plant : Plant, optional
            The device; 0.1 kg and 1 N s/m at 500 Hz where there is none.
        **options : object
            See ``haptic.z_width``.

        Returns
        -------
        haptic.ZWidthResult
            Arrays over the gain; ``.plot()`` draws them.
        """
        return RESULTS.load("z_width")(self, plant, **options)


def law_kinds() -> dict[str, type[Law]]:
    """Find all installed laws that can be imported.

    Returns
    -------
    dict of str to type of Law
        Registered name to class, sorted by name.
    """
    return LAWS.all()[0]


def law_names() -> list[str]:
    """List the installed laws without importing any.

    Returns
    -------
    list of str
        Registered names, sorted.
    """
    return LAWS.names()


def load_law(kind: str) -> type[Law]:
    """Import one law.

    Parameters
    ----------
    kind : str
        Registered name.

    Returns
    -------
    type of Law
        The class.

    Raises
    ------
    NotInstalledError
        When none of that name is installed, it cannot be imported, or what is registered is no law.
    """
    found: type[Law] = LAWS.load(kind)
    return found
