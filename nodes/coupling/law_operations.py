"""Control requests about laws: list them, show one, switch to another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from nodes.base.node import Node
from nodes.coupling.law_book import LawBook, free_name
from nodes.coupling.live_judgement import LiveJudgement
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.renderer import Renderer
from nodes.coupling.swap_schedule import SwapSchedule
from nodes.laws.parse import parse_law


class LawOperations:
    """The law operations of one coupling (control thread).

    Parameters
    ----------
    node : Node
        The coupling, for its parameters and their changes.
    book : LawBook
        Its laws.
    renderer : Renderer
        What renders the active law.
    schedule : SwapSchedule
        Laws that become active later.
    judgement : LiveJudgement
        The measured delay of the loop.
    """

    def __init__(
        self,
        node: Node,
        book: LawBook,
        renderer: Renderer,
        schedule: SwapSchedule,
        judgement: LiveJudgement,
    ) -> None:
        self._node, self._book, self._renderer = node, book, renderer
        self._schedule, self._judgement = schedule, judgement
        # names of laws that a switch was given by kind and parameters
        self._given_laws: set[str] = set()

    @property
    def _parameters(self) -> CouplingParameters:
        parameters: CouplingParameters = self._node.store.current
        return parameters

    def _figures(self, parameters: CouplingParameters, law: Any) -> dict[str, Any]:
        return self._book.figures(parameters, law, self._judgement.delay)

    def list(self) -> dict[str, Any]:
        """Return the name of the active law, and the description of every law."""
        parameters = self._parameters
        laws = {
            name: self._book.description(parameters, name)
            for name in self._book.names(parameters)
        }
        return {"active": self._renderer.law.name, "laws": laws}

    def show(self, law: str = "") -> dict[str, Any]:
        """Return the description and figures of a law, by default of the active one."""
        parameters = self._parameters
        active = self._renderer.law
        plant = parameters.plant
        described = (
            {"law": law, **self._book.description(parameters, law)}
            if law
            else msgspec.json.decode(active.text)
        )
        return {
            **described,
            **({} if plant is None else {"plant": msgspec.to_builtins(plant)}),
            **self._figures(parameters, law or active.compiled),
        }

    def switch(
        self,
        law: Any,
        ramp: int | None,
        prepare: Callable[[Any, int], Callable[[int], Any]],
    ) -> dict[str, Any]:
        """Switch to a law by name, or to one that is given by kind and parameters.

        `prepare` prepares the changed parameters, with the ramp of the switch [ticks].
        """
        usual = self._parameters.ramp
        wanted: dict[str, Any] = {} if ramp is None else {"ramp": ramp}
        if isinstance(law, Mapping):
            law, description = self._named(law), law
            wanted[f"laws.{law}"] = dict(description)
        wanted["law"] = law
        before = self._renderer.law
        ramps = []

        def make() -> Any:
            changed: CouplingParameters = self._node.store.changed(wanted)
            ramps.append(changed.ramp)
            return msgspec.structs.replace(changed, ramp=usual)

        change = self._node.changes.change
        receipt = change(make, lambda wanted: prepare(wanted, ramps[-1]))
        parameters = self._parameters
        if parameters.figures:
            receipt["was"] = self._figures(parameters, before.compiled)
            receipt["is"] = self._figures(parameters, law)
        return receipt

    def _named(self, law: Mapping[str, Any]) -> str:
        """Return a name for a law given by kind and parameters; raises LawRefusedError.

        Names of such laws that no longer render are used again, so that a program may switch
        without end.
        """
        parse_law(law, f"{self._node.setup.name}.law")
        parameters = self._parameters
        needed = {parameters.law, *self._schedule.names}
        name = free_name(law, parameters.laws, self._given_laws - needed)
        if name not in parameters.laws:
            self._given_laws.add(name)
        return name
