"""The named laws of a coupling, compiled and described before they render."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Collection, Mapping
from typing import Any

from nodes.coupling.parameters import CouplingParameters, PlantParameters
from nodes.laws import CompiledLaw, law_names, load_law
from nodes.laws.parse import compile_law, law_to_dict, parse_law
from nodes.laws.presets import PRESETS, expand, preset_names
from nodes.parameters.nearest import did_you_mean
from nodes.parameters.store import ParameterError, describe

FIXED = ("memory", "schedule")  # parameters that cannot change while the node runs
MAX_TEXT = 4000  # longest description of a law in a receipt [characters]


class LawBook:
    """Finds laws by name."""

    def __init__(self, node: str, period: float) -> None:
        self._node, self._period = node, period

    def names(self, parameters: CouplingParameters) -> list[str]:
        """Return the names of all laws that can become active."""
        kinds = [
            kind
            for kind in law_names()
            if kind not in PRESETS and self._usual(parameters, kind)
        ]
        return [
            *parameters.laws,
            *(
                name
                for name in [*preset_names(), *kinds]
                if name not in parameters.laws
            ),
        ]

    def description(self, parameters: CouplingParameters, name: str) -> dict[str, Any]:
        """Return the complete description of a law."""
        return law_to_dict(
            parse_law(self._find(parameters, name), f"{self._node}.laws.{name}")
        )

    def text(self, parameters: CouplingParameters, name: str) -> str:
        """Return a law's description in one line, for receipts."""
        whole = {"law": name, **self.description(parameters, name)}
        if len(text := describe(whole)) > MAX_TEXT:
            text = describe(
                {
                    key: f"{len(value)} values" if isinstance(value, list) else value
                    for key, value in whole.items()
                }
            )
        return text[:MAX_TEXT]

    def _find(self, parameters: CouplingParameters, name: str) -> Any:
        if name in parameters.laws:
            return parameters.laws[name]
        if name in PRESETS or name in law_names():
            fields = _fields(name)
            return {
                "kind": name,
                **{
                    key: value
                    for key, value in parameters.usual.items()
                    if key in fields
                },
            }
        raise ParameterError(self._unknown(parameters, name), path=f"{self._node}.law")

    def _unknown(self, parameters: CouplingParameters, name: str) -> str:
        """Return the text about an unknown name; a kind that lacks parameters may be meant too."""
        names = self.names(parameters)
        meant = did_you_mean(name, [*names, *law_names()])
        return f"no law is named {name!r}; available: {', '.join(names)}{meant}"

    def _usual(self, parameters: CouplingParameters, kind: str) -> bool:
        """Return whether law `kind` can be built from the default fields."""
        try:
            used = set(parameters.usual) & set(_fields(kind))
            law_to_dict(parse_law(self._find(parameters, kind)))
        except ParameterError:
            return False
        return bool(used)

    def compile(self, parameters: CouplingParameters, name: str) -> CompiledLaw:
        """Return a law by name, compiled."""
        where = f"{self._node}.laws.{name}"
        compiled = compile_law(
            parse_law(self._find(parameters, name), where), self._period, where
        )
        if len(compiled.taps) > parameters.memory:
            raise ParameterError(
                f"{len(compiled.taps)} taps, but {self._node}.memory is"
                f" {parameters.memory}; shorten the law, or start with a longer memory",
                path=where,
            )
        return compiled

    def figures(
        self,
        parameters: CouplingParameters,
        law: CompiledLaw | str,
        measured_delay: float,
    ) -> dict[str, Any]:
        """Return what a law, compiled or by name, renders."""
        compiled = self.compile(parameters, law) if isinstance(law, str) else law
        if parameters.plant is None:
            from nodes.stability.closed_loop import law_figures

            return law_figures(compiled, self._period)
        return worst_figures(compiled, parameters.plant, self._period, measured_delay)

    def unfit(self, parameters: CouplingParameters) -> list[str]:
        """Return why laws cannot render as they are; only activating them is refused."""
        reasons = []
        for name in parameters.laws:
            try:
                self.compile(parameters, name)
            except ParameterError as error:
                reasons.append(str(error))
        return reasons

    def check(self, parameters: CouplingParameters) -> None:
        """Check the laws and the schedule, and compile the laws that will render."""
        for name, law in parameters.laws.items():
            parse_law(law, f"{self._node}.laws.{name}")
        self.compile(parameters, parameters.law)
        taken_until = 0
        for i, swap in sorted(
            enumerate(parameters.schedule), key=lambda numbered: numbered[1].at
        ):
            where = f"{self._node}.schedule[{i}]"
            if swap.law not in [*parameters.laws, *PRESETS, *law_names()]:
                raise ParameterError(
                    self._unknown(parameters, swap.law), path=f"{where}.law"
                )
            self.compile(parameters, swap.law)
            tick = round(swap.at / self._period)
            if tick < taken_until:
                raise ParameterError(
                    f"{swap.at:g} s is tick {tick}, but the swap before it ends at "
                    f"tick {taken_until}; schedule it later or shorten that one's ramp",
                    path=f"{where}.at",
                )
            taken_until = tick + max(swap.ramp, 1)

    def refuse_fixed(self, now: CouplingParameters, wanted: CouplingParameters) -> None:
        """Reject a change of parameters that are fixed while the node runs."""
        for name in FIXED:
            if getattr(now, name) != getattr(wanted, name):
                raise ParameterError(
                    "is fixed while the node runs; set it in the launch file",
                    path=f"{self._node}.{name}",
                )


def free_name(
    law: Mapping[str, Any], laws: Mapping[str, Any], mine: Collection[str] = ()
) -> str:
    """Return a name for a law given without one: its kind, numbered if taken.

    `laws` are the coupling's; a name among `mine` may be used again. A law that is already there
    keeps its name.
    """
    kind = str(law["kind"])[:56]
    wanted = law_to_dict(parse_law(law))
    names = itertools.chain(
        [kind], (f"{kind}_{number}" for number in itertools.count(2))
    )
    for name in names:
        if name not in laws or name in mine:
            return name
        with contextlib.suppress(ParameterError):
            if law_to_dict(parse_law(laws[name])) == wanted:
                return name
    raise AssertionError("the numbers never end")


def worst_figures(
    compiled: CompiledLaw, plant: PlantParameters, period: float, delay: float
) -> dict[str, Any]:
    """Return what a law renders on a device; for a variable mass, at the worst mass."""
    from nodes.stability.closed_loop import law_figures

    found = [
        law_figures(compiled, device) for device in plant.over_workspace(period, delay)
    ]
    if plant.heaviest is None:
        return found[0]
    worst = max(range(len(found)), key=lambda i: found[i]["pole_radius"] or 0.0)
    return {
        **found[worst],
        "worst_mass_kg": plant.masses[worst],
        "masses_kg": [plant.mass, plant.heaviest],
    }


def _fields(name: str) -> tuple[str, ...]:
    """Return the parameter names of a preset or kind."""
    return load_law(str(expand({"kind": name})["kind"])).__struct_fields__
