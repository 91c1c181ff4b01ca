"""Laws from whatever a caller has: an object, a name, a mapping as in YAML, or taps."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from nodes.launcher import scenario_files
from nodes.laws import CompiledLaw, Law, law_kinds
from nodes.laws.described_laws import public_kinds
from nodes.laws.parse import LawRefusedError, compile_law, law_to_dict, parse_law
from nodes.laws.presets import preset_names

# A law, or its description: `law`'s result, a mapping ``{"kind": ...}``, the name of a preset, or
# taps [N/m].
LawLike: TypeAlias = (
    "Law | CompiledLaw | Mapping[str, Any] | str | Sequence[float] | NDArray[Any]"
)


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert numpy numbers, arrays and laws to the types of YAML, at any depth."""
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Law):
        return law_to_dict(value)
    if isinstance(value, CompiledLaw):
        return law_to_dict(_as_fir(value))
    if isinstance(value, Mapping):
        return plain(value)
    # A named tuple stays what it is.
    return type(value)(map(_plain, value)) if type(value) in (list, tuple) else value


def _as_fir(law: CompiledLaw) -> Law:
    """Return a compiled law as taps and sections with parameters of their own."""
    if law.evaluate is not None:
        raise TypeError(
            "a compiled law with code of its own; pass the law that it was made from"
        )
    sections = [
        dict(zip(("b0", "b1", "a1", "a2"), one, strict=True)) for one in law.sections
    ]
    recursive = {"recursive": sections} if sections else {}
    return parse_law({"kind": "fir", "taps": list(law.taps), **recursive})


def scenarios() -> dict[str, dict[str, Any]]:
    """Return the scenarios that can be launched.

    Returns
    -------
    dict of str to dict
        Name to ``summary`` and ``arguments`` with their defaults.

    Examples
    --------
    >>> scenarios()["floor_drop"]["arguments"]["stiffness"]
    1000.0
    """
    found = {}
    for name, path in scenario_files.scenarios().items():
        summary, arguments = scenario_files.read_arguments(path)
        found[name] = {
            "summary": summary,
            "arguments": {key: value.default for key, value in arguments.items()},
        }
    return found


def laws() -> list[str]:
    """Return the kinds of law and the presets that `law` accepts.

    ``haptic.PD`` and the like are the classes of the kinds; ``haptic law describe KIND`` explains
    one.

    Returns
    -------
    list of str
        Names, without the kinds that only programs use.

    Examples
    --------
    >>> "pd_alpha" in laws()
    True
    """
    return [*public_kinds(), *preset_names()]


def law_class(name: str) -> type[Law] | None:
    """Return the class of an installed law by the class's name; None if there is none."""
    found = {kind.__name__: kind for kind in law_kinds().values()}
    return found.get(name)


def law(kind: LawLike, **parameters: Any) -> Law:
    """Build a law, with the checks of a launch file.

    Parameters
    ----------
    kind : str, mapping, sequence of float or Law
        A registered kind (``haptic.laws()`` lists them), a preset, a mapping as in YAML, or taps
        h_0 … h_n [N/m].
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
        raise TypeError(
            "a compiled law has no parameters any more; pass the law that it was compiled from"
        )
    if isinstance(kind, Law):
        return parse_law({**law_to_dict(kind), **parameters}) if parameters else kind
    if isinstance(kind, str):
        try:
            return parse_law({"kind": kind, **parameters}, kind)
        except LawRefusedError as error:
            if not parameters and kind in law_kinds():
                error.args = (
                    f"{error.text}; e.g. {_example(law_kinds()[kind])}",
                    error.path,
                )
            raise
    if isinstance(kind, Mapping):
        return parse_law(plain({**kind, **parameters}))
    if not isinstance(kind, Sequence | np.ndarray):
        is_class = isinstance(kind, type) and issubclass(kind, Law)
        example = f"; did you mean {_example(kind)}?" if is_class else ""
        raise TypeError(
            f"{kind!r} is no law: expected a kind, a preset, a mapping as in YAML, taps [N/m] or"
            f" a law{example}"
        )
    return parse_law(
        {"kind": "fir", "taps": [float(tap) for tap in kind], **parameters}
    )


def _example(kind: type[Law]) -> str:
    """Return a call that makes a law of a class, as Python writes it."""
    given = ", ".join(f"{name}={value!r}" for name, value in kind.example.items())
    return f"haptic.{kind.__name__}({given})"


def compiled(kind: LawLike, period: float) -> CompiledLaw:
    """Compile a law for the sampling period T [s]; raises LawRefusedError as `law` does."""
    return kind if isinstance(kind, CompiledLaw) else compile_law(law(kind), period)


def law_name(law: Any) -> str:
    """Return a law's name for a legend: its preset or kind, or ``taps``."""
    if isinstance(law, str):
        return law
    if isinstance(law, Mapping) and "kind" in law:
        return str(law["kind"])
    return str(getattr(law, "kind", "")) or "taps"
