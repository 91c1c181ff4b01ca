"""The named laws of a coupling: compiled, described, and judged for the declared device before they may render."""

from __future__ import annotations

from typing import Any

from nodes.coupling_parameters import CouplingParameters
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, law_to_dict, parse_law
from nodes.laws.presets import PRESETS, preset_names
from nodes.parameters import ParameterError

FIXED = ("memory", "schedule")
"""Parameters that cannot change while the node runs."""


class LawBook:
    """Looks laws up by name.

    Parameters
    ----------
    node : str
        Name of the node, for errors.
    period : float
        Sampling period T [s].
    """

    def __init__(self, node: str, period: float) -> None:
        self._node = node
        self._period = period

    def names(self, parameters: CouplingParameters) -> list[str]:
        """List what can be switched to.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node.

        Returns
        -------
        list of str
            Named laws, then presets.
        """
        return [*parameters.laws, *(name for name in preset_names() if name not in parameters.laws)]

    def description(self, parameters: CouplingParameters, name: str) -> dict[str, Any]:
        """Describe a law completely.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node.
        name : str
            The law's name.

        Returns
        -------
        dict
            ``kind`` and every parameter.
        """
        return law_to_dict(parse_law(self._find(parameters, name), f"{self._node}.laws.{name}"))

    def _find(self, parameters: CouplingParameters, name: str) -> dict[str, Any]:
        if name in parameters.laws:
            return parameters.laws[name]
        if name in PRESETS:
            return {"kind": name}
        there = ", ".join(self.names(parameters))
        raise ParameterError(f"{self._node}.law: no law is named {name!r}; there is: {there}")

    def compile(
        self, parameters: CouplingParameters, name: str, measured_delay: float, judge: bool = True
    ) -> tuple[CompiledLaw, str]:
        """Compile a law and judge it by the stability policy.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node.
        name : str
            The law's name.
        measured_delay : float
            The loop's delay as measured now [ticks].
        judge : bool
            Whether to apply the stability policy.

        Returns
        -------
        tuple of CompiledLaw and str
            The law, and a warning (empty when there is none).

        Raises
        ------
        ParameterError
            When it cannot be compiled, is longer than the history, or is refused by the policy.
        """
        where = f"{self._node}.laws.{name}"
        compiled = compile_law(parse_law(self._find(parameters, name), where), self._period, where)
        if len(compiled.taps) > parameters.memory:
            raise ParameterError(
                f"{where}: {len(compiled.taps)} taps, but {self._node}.memory is {parameters.memory}; "
                "shorten the law, or start with a longer memory"
            )
        plant = parameters.plant
        if not judge or plant is None or parameters.stability == "off":
            return compiled, ""
        from nodes.stability import pole_radius

        delay = measured_delay if plant.delay is None else plant.delay
        radius = pole_radius(compiled, self._period, plant.mass, plant.damping, delay, plant.stiffness)
        if radius < 1.0:
            return compiled, ""
        text = (
            f"{where}: pole radius {radius:.6g} (limit: < 1) with mass {plant.mass:g} kg, damping {plant.damping:g} N s/m "
            f"at a delay of {delay:.3g} ticks: the loop is unstable"
        )
        if parameters.stability == "refuse":
            raise ParameterError(f"{text}; lower the stiffness or set {self._node}.stability to warn")
        return compiled, text

    def figures(self, parameters: CouplingParameters, name: str, measured_delay: float) -> dict[str, Any]:
        """Tell what a law really renders.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node; its plant is used where it is known.
        name : str
            The law's name.
        measured_delay : float
            The loop's delay as measured now [ticks].

        Returns
        -------
        dict
            Figures with units in the keys.
        """
        compiled, _ = self.compile(parameters, name, measured_delay, judge=False)
        from nodes.stability import law_figures

        plant = parameters.plant
        if plant is None:
            return law_figures(compiled, self._period)
        delay = measured_delay if plant.delay is None else plant.delay
        return law_figures(compiled, self._period, plant.mass, plant.damping, delay, plant.stiffness)

    def refuse_fixed(self, now: CouplingParameters, wanted: CouplingParameters) -> None:
        """Refuse a change of what cannot change while the node runs.

        Parameters
        ----------
        now, wanted : CouplingParameters
            Before and after the change.

        Raises
        ------
        ParameterError
            Naming the parameter.
        """
        for name in FIXED:
            if getattr(now, name) != getattr(wanted, name):
                raise ParameterError(f"{self._node}.{name}: is fixed while the node runs; set it in the launch file")
