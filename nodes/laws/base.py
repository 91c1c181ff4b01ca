"""Base of the coupling laws: parameters in, taps out.

Each law has a file of its own; other packages add laws through the entry points ``haptic.laws``. A
law is a frozen msgspec struct whose fields are its parameters, with one method, ``compile``. The
result has the same form for all laws: taps over the shared deflection history (every law of the
paper is just that, eq. 1, 6, 10) and, for recursive realisations of D^α, parallel second-order
sections. Changing the law therefore only changes numbers.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, cast, overload

import msgspec

from nodes.parameters.checked import check_fields, check_given
from nodes.parameters.registry import Registry

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "LAWS",
    "CompiledLaw",
    "Law",
    "law_kinds",
    "law_names",
    "load_law",
    "with_gain",
]


def _wrong_law(name: str, found: Any) -> str:
    if not (isinstance(found, type) and issubclass(found, Law)):
        return f"{found!r} is not a subclass of nodes.laws.Law"
    return (
        ""
        if found.kind == name
        else f"{found!r} calls itself {found.kind!r}; its class variable kind must be its name"
    )


LAWS = Registry("haptic.laws", "law", _wrong_law)
# Functions that packages above this one compute from a law: its response, its K–B plane.
RESULTS = Registry("haptic.results", "result of a law")


@dataclass(frozen=True)
class CompiledLaw:
    """A law's coefficients at one sampling period.

    Attributes
    ----------
    taps : tuple of float, shape (n + 1,)
        h_0 ... h_n [N/m]: F[k] = Σ h_m x[k−m] + Σ sections.
    sections : tuple of tuple of float, shape (s, 4)
        b0, b1 [N/m], a1, a2 of parallel sections y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂.
    evaluate : callable or None
        Nonlinear code of a law, in addition to taps and sections: from (ring, head), with
        ``ring[head + m]`` the deflection m ticks ago, to a force [N] that is added. It is tested
        before it may render and monitored afterwards: if it raises, returns a force that is not
        finite or exceeds its time budget, the fallback takes over within the same tick. Code with a
        memory has a method ``on_axis`` (see `own_code`).
    """

    taps: tuple[float, ...]
    sections: tuple[tuple[float, float, float, float], ...] = ()
    evaluate: Callable[[Sequence[float], int], float] | None = None

    def own_code(self, axis: int = 0) -> Callable[[Sequence[float], int], float] | None:
        """Return the law's own code for one axis; called before the first tick.

        Parameters
        ----------
        axis : int
            Index among the axes that the scene computes. Code with a method ``on_axis`` is created
            for each axis by that method.

        Returns
        -------
        callable or None
            `evaluate`, or the result of its ``on_axis``; None for a law without own code.
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
        """Return the transfer function from deflection to force.

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
        """Stiffness rendered to a constant deflection, H(1) [N/m]."""
        return self.response(1.0).real

    @property
    def h_nyquist(self) -> float:
        """Gain at the Nyquist frequency, H(−1) [N/m], which amplifies encoder noise."""
        return self.response(-1.0).real

    @property
    def finite(self) -> bool:
        """Whether every coefficient is finite."""
        return all(map(math.isfinite, self.taps)) and all(
            math.isfinite(c) for s in self.sections for c in s
        )

    def stable_sections(self) -> bool:
        """Return whether the recursive sections are stable.

        Returns
        -------
        bool
            True if all their poles lie inside the unit circle (also without sections).
        """
        for _, _, a1, a2 in self.sections:
            root = cmath.sqrt(a1 * a1 - 4.0 * a2)
            if max(abs(-a1 + root), abs(-a1 - root)) >= 2.0:
                return False
        return True


class LawType(msgspec.StructMeta):
    """Class of laws: a call names everything that is missing or unknown in one error."""

    if not TYPE_CHECKING:  # type checkers read the fields

        def __call__(cls, *args, **parameters):  # noqa: N805  # of a class of classes
            """Return a law with these parameters."""
            if args:
                raise TypeError(
                    f"{cls.__name__}: parameters are given by name:"
                    f" {', '.join(cls.__struct_fields__)}"
                )
            parameters = with_gain(cls, parameters)
            check_given(cls, parameters, cls.kind)
            return super().__call__(**parameters)


class Law(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    metaclass=LawType,
):
    """Base of all laws: the fields of a subclass are its parameters.

    Attributes
    ----------
    kind : str
        Class variable: the registered name.
    example : dict
        Class variable: parameters of an example, as in YAML; at least those without a default.
    internal : bool
        Class variable: whether only programs use it, so that no list shows it.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown, of the wrong type, out of its limits or not finite.
    """

    kind: ClassVar[str] = ""
    example: ClassVar[dict[str, Any]] = {}
    internal: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check values given in Python as those of a YAML file are checked."""
        check_fields(self, self.kind)

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps and sections of these parameters.

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
            If the parameters cannot be realised; the text names the parameter, its value and the
            limit.
        """
        raise TypeError(
            f"law kind {type(self).kind!r} does not define compile(), asked for T = {period:g} s"
        )

    def response(self, plant: Any = None, **options: Any) -> Any:
        """Return rendered stiffness and damping over frequency.

        Parameters
        ----------
        plant : Plant, optional
            Source of period [s] and delay [ticks]; by default 2 ms without delay.
        **options : object
            See ``haptic.response``.

        Returns
        -------
        haptic.Response
            Arrays over the frequency; ``.plot()`` draws them.
        """
        return RESULTS.load("response")(self, plant, **options)

    def bode(self, plant: Any = None, ax: Any = None, **options: Any) -> Any:
        """Plot magnitude and phase of the rendered impedance.

        Parameters
        ----------
        plant : Plant, optional
            Source of period [s] and delay [ticks]; by default 2 ms without delay.
        ax : pair of matplotlib.axes.Axes, optional
            Axes of magnitude and phase; by default a new figure.
        **options : object
            See ``haptic.bode``.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        return RESULTS.load("bode")(self, plant, ax=ax, **options)

    def loop(self, plant: Any = None) -> Any:
        """Return the loop of this law and a device, broken at the force.

        Parameters
        ----------
        plant : Plant, optional
            The device; by default 0.1 kg and 1 N s/m at 500 Hz.

        Returns
        -------
        haptic.OpenLoop
            Margins, Bode and Nyquist plot, root locus; L for scipy and python-control.
        """
        return RESULTS.load("loop")(self, plant)

    def to_scipy(self, plant: Any = None) -> Any:
        """Return this law as a discrete-time system of scipy, from deflection to force.

        Parameters
        ----------
        plant : Plant, optional
            Source of the period [s]; by default 2 ms.

        Returns
        -------
        scipy.signal.dlti
            A transfer function; a state space if the law has recursive sections.
        """
        return RESULTS.load("to_scipy")(self, plant)

    def to_control(self, plant: Any = None) -> Any:
        """Return this law as a system of python-control, from deflection to force.

        Parameters
        ----------
        plant : Plant, optional
            Source of the period [s]; by default 2 ms.

        Returns
        -------
        control.TransferFunction or control.StateSpace
            As `to_scipy`.
        """
        return RESULTS.load("to_control")(self, plant)

    def z_width(self, plant: Any = None, **options: Any) -> Any:
        """Return the K–B plane: the largest stable stiffness for each damping gain.

        Parameters
        ----------
        plant : Plant, optional
            The device; by default 0.1 kg and 1 N s/m at 500 Hz.
        **options : object
            See ``haptic.z_width``.

        Returns
        -------
        haptic.ZWidthResult
            Arrays over the gain; ``.plot()`` draws them.
        """
        return RESULTS.load("z_width")(self, plant, **options)


def with_gain(kind: type[Law], parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters with B, given as ``gain``, as the law's ``damping``.

    Parameters
    ----------
    kind : type of Law
        The law.
    parameters : mapping
        Parameters as given.

    Returns
    -------
    dict
        Parameters as the law names them; beside a device B is called ``gain``. A law with a
        parameter ``gain`` of its own keeps it, and so does one that is given both, which its own
        check refuses.
    """
    found = dict(parameters)
    fields = kind.__struct_fields__
    if (
        "gain" in found
        and "gain" not in fields
        and "damping" in fields
        and "damping" not in found
    ):
        found["damping"] = found.pop("gain")
    return found


def law_kinds() -> dict[str, type[Law]]:
    """Return all installed laws that can be imported.

    Returns
    -------
    dict of str to type of Law
        Registered name to class, sorted by name.
    """
    return LAWS.all()[0]


def law_names() -> list[str]:
    """Return the names of the installed laws without importing any.

    Returns
    -------
    list of str
        Registered names, sorted.
    """
    return LAWS.names()


def load_law(kind: str) -> type[Law]:
    """Import a law and return its class.

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
        If no law of that name is installed, or the registered object cannot be imported or is no
        law.
    """
    found: type[Law] = LAWS.load(kind)
    return found
