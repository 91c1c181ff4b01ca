"""The named laws of a coupling: compiled, described, and judged for the declared device before they may render."""

from __future__ import annotations

from typing import Any

from nodes.base.node import describe
from nodes.coupling.parameters import CouplingParameters
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, law_to_dict, parse_law
from nodes.laws.presets import PRESETS, preset_names
from nodes.parameters.store import ParameterError

FIXED = ("memory", "schedule")
"""Parameters that cannot change while the node runs."""

MAX_TEXT = 4000
"""Longest description of a law in a receipt [characters]."""


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

    def text(self, parameters: CouplingParameters, name: str) -> str:
        """Describe a law in one line, for receipts.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node.
        name : str
            The law's name.

        Returns
        -------
        str
            JSON, which is YAML flow style too, at most 4000 characters: of longer lists only the length is told.
        """
        described = {"law": name, **self.description(parameters, name)}
        text = describe(described)
        if len(text) > MAX_TEXT:
            short = {
                key: f"{len(value)} values" if isinstance(value, list) else value for key, value in described.items()
            }
            text = describe(short)
        return text[:MAX_TEXT]

    def _find(self, parameters: CouplingParameters, name: str) -> Any:
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
        if not judge or plant is None or parameters.stability == "off" or compiled.evaluate is not None:
            # What a law's own code adds is not linear: no pole tells whether it is stable.
            return compiled, ""
        from nodes.stability.closed_loop import pole_radius

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
        return self.figures_of(parameters, compiled, measured_delay)

    def figures_of(
        self, parameters: CouplingParameters, compiled: CompiledLaw, measured_delay: float
    ) -> dict[str, Any]:
        """Tell what a compiled law really renders.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node; its plant is used where it is known.
        compiled : CompiledLaw
            The law.
        measured_delay : float
            The loop's delay as measured now [ticks].

        Returns
        -------
        dict
            Figures with units in the keys; those of its taps and sections when the law has code of its own beside them.
        """
        from nodes.stability.closed_loop import law_figures

        plant = parameters.plant
        if plant is None:
            return law_figures(compiled, self._period)
        delay = measured_delay if plant.delay is None else plant.delay
        return law_figures(compiled, self._period, plant.mass, plant.damping, delay, plant.stiffness)

    def unfit(self, parameters: CouplingParameters) -> list[str]:
        """List the laws that cannot be rendered as they are: nothing to refuse until one is switched to.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node, checked.

        Returns
        -------
        list of str
            Why, one sentence per law; e.g. the paper's optimum above 2.3 kHz, where its H(1) is negative.
        """
        reasons = []
        for name in parameters.laws:
            try:
                self.compile(parameters, name, 0.0, judge=False)
            except ParameterError as error:
                reasons.append(str(error))
        return reasons

    def check(self, parameters: CouplingParameters, delay: float) -> None:
        """Check what belongs together, and compile the laws that will render.

        Parameters
        ----------
        parameters : CouplingParameters
            Of the node.
        delay : float
            Least delay of the loop [ticks], for the stability policy.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        if parameters.stability == "refuse" and parameters.plant is None:
            raise ParameterError(
                f"{self._node}.stability: refuse needs {self._node}.plant, the device that a law is judged with; "
                "declare its mass and damping, or set stability to warn"
            )
        for name, law in parameters.laws.items():
            parse_law(law, f"{self._node}.laws.{name}")
        self.compile(parameters, parameters.law, delay, judge=parameters.stability == "refuse")
        taken_until = 0
        for i, swap in sorted(enumerate(parameters.schedule), key=lambda numbered: numbered[1].at):
            where = f"{self._node}.schedule[{i}]"
            if swap.law not in parameters.laws and swap.law not in PRESETS:
                there = ", ".join(self.names(parameters))
                raise ParameterError(f"{where}.law: no law is named {swap.law!r}; there is: {there}")
            self.compile(parameters, swap.law, 0.0, judge=False)
            tick = round(swap.at / self._period)
            if tick < taken_until:
                raise ParameterError(
                    f"{where}.at: {swap.at:g} s is tick {tick}, but the swap before it is over at tick {taken_until} only; "
                    "schedule it later or shorten that one's ramp"
                )
            taken_until = tick + max(swap.ramp, 1)

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
