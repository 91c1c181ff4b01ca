"""Laws by name, and wherever a law is meant: an object, a name, a mapping as in YAML, or taps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw, Law
from nodes.laws.parse import compile_law, parse_law
from sim.api.values import plain

LawLike: TypeAlias = "Law | CompiledLaw | Mapping[str, Any] | str | Sequence[float] | NDArray[Any]"
"""What is taken for a law: `law`'s result, a mapping ``{"kind": ...}``, the name of a preset, or taps [N/m]."""


def law(kind: LawLike, **parameters: Any) -> Law:
    """Make a law, checked as a launch file's is.

    Parameters
    ----------
    kind : str, mapping, sequence of float or Law
        A registered kind (``haptic.laws()`` lists them), a preset, a mapping as in YAML, or taps h_0 … h_n [N/m].
    **parameters : object
        The law's parameters.

    Returns
    -------
    Law
        The law; ``.compile(period)`` gives its taps.

    Raises
    ------
    nodes.laws.parse.LawRefusedError
        With path, value and limit.

    Examples
    --------
    >>> law("pd", stiffness=1500, damping=3)
    PD(stiffness=1500.0, damping=3.0)
    """
    parameters = plain(parameters)
    if isinstance(kind, CompiledLaw):
        raise TypeError("a compiled law has no parameters any more; pass the law that it was compiled from")
    if isinstance(kind, Law):
        return parse_law({"kind": kind.kind, **_values(kind), **parameters}) if parameters else kind
    if isinstance(kind, str):
        return parse_law({"kind": kind, **parameters}, kind)
    if isinstance(kind, Mapping):
        return parse_law({**kind, **parameters})
    if not isinstance(kind, Sequence | np.ndarray):
        raise TypeError(f"{kind!r} is no law: expected a kind, a preset, a mapping as in YAML, taps [N/m] or a law")
    return parse_law({"kind": "fir", "taps": [float(tap) for tap in kind], **parameters})


def _values(made: Law) -> dict[str, Any]:
    return {name: getattr(made, name) for name in made.__struct_fields__}


def compiled(kind: LawLike, period: float) -> CompiledLaw:
    """Compile whatever is taken for a law.

    Parameters
    ----------
    kind : str, mapping, sequence of float, Law or CompiledLaw
        As for `law`.
    period : float
        Sampling period T [s].

    Returns
    -------
    CompiledLaw
        Taps and sections.

    Raises
    ------
    nodes.laws.parse.LawRefusedError
        When it must not be rendered.
    """
    return kind if isinstance(kind, CompiledLaw) else compile_law(law(kind), period)
