"""What a kind of node declares, and what a launch asks it before any node exists.

The launcher reads the class: topics, parameters and compiled modules; it asks class methods what
the node would do to the scene and the plant, and has it check its setup.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import msgspec

from nodes.base.setup import Axis, Effect, Setup

__all__ = ["NodeDeclaration"]


class NodeDeclaration:
    """What a kind of node declares; by default it does nothing to a launch.

    Attributes
    ----------
    Parameters : type
        The struct of the node's parameters.
    publishes, listens_to : tuple of str
        The loop topics that the kind publishes and receives; ``"*"`` listens to everything.
    relays : tuple of str
        Loop topics that the kind publishes again, in place of their publisher, for everybody else.
    queue : int
        Messages that may wait to be received.
    answers : bool
        Whether each tick is one message received and one sent; ``sent`` and ``received`` count only
        additional ones.
    kernel_module : str
        Module of the compiled ticks of the kind (nodes/compiled); empty if it has none. Not
        inherited.
    """

    Parameters: ClassVar[type[msgspec.Struct]] = msgspec.Struct
    publishes: ClassVar[tuple[str, ...]] = ()
    listens_to: ClassVar[tuple[str, ...]] = ()
    relays: ClassVar[tuple[str, ...]] = ()
    queue: ClassVar[int] = 1000
    answers: ClassVar[bool] = False
    kernel_module: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # A subclass may change the tick's meaning: it names compiled ticks of its own, or has none.
        if "kernel_module" not in vars(cls):
            cls.kernel_module = ""

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check a node's `setup` before the launch, beyond the types of its parameters.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        del setup

    @classmethod
    def kernel_of(cls, parameters: Mapping[str, Any]) -> str:
        """Return the module of the compiled ticks of a node with these `parameters`.

        Returns
        -------
        str
            Its name; empty without one.
        """
        del parameters
        return cls.kernel_module

    @classmethod
    def modules(cls, parameters: Mapping[str, Any]) -> set[str]:
        """Return the modules to compile for a node with these `parameters`.

        Returns
        -------
        set of str
            Modules of nodes/compiled.
        """
        return {cls.kernel_of(parameters)} - {""}

    @classmethod
    def axes(cls, parameters: Mapping[str, Any], name: str) -> tuple[Axis, ...]:
        """Return the axes that the scene must compute for node `name` with these `parameters`.

        Returns
        -------
        tuple of str
            Axes; none if the node does not care.
        """
        del parameters, name
        return ()

    @classmethod
    def substitute_device(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return node `name` with a real `device` (``device:=NAME``) in place of a virtual one.

        `parameters` are those of the node.

        Returns
        -------
        tuple of dict and dict, or None
            The node's parameters with that device, and its plant for a coupling; None for a node
            without a virtual device.

        Raises
        ------
        ParameterError
            If no such device is known.
        """
        del parameters, name, device
        return None

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return what node `name` with these `parameters` knows of the plant along some `axes`.

        The launcher fills it into the ``plant`` of the chain's coupling, which judges its laws on
        it.

        Returns
        -------
        dict of str to float
            Fields of `nodes.coupling.parameters.PlantParameters` in their units; none for a node
            that knows nothing.

        Raises
        ------
        ParameterError
            If the parameters describe no device.
        """
        del parameters, name, axes
        return {}

    @classmethod
    def effects(cls, parameters: Mapping[str, Any], name: str) -> list[Effect]:
        """Return what node `name` with these `parameters` does to a law.

        The launcher passes it to the chain's coupling, which judges its laws as they are felt.

        Returns
        -------
        list of Effect
            One for each shape or region that changes a law; none for others.

        Raises
        ------
        ParameterError
            If the parameters are invalid.
        """
        del parameters, name
        return []

    @classmethod
    def is_virtual(cls, parameters: Mapping[str, Any], name: str) -> bool:
        """Return whether a device with these parameters lives in simulated time.

        Parameters
        ----------
        parameters : mapping
            Parameters of the node.
        name : str
            Name of the node.

        Returns
        -------
        bool
            False for hardware, and for a node without a device.
        """
        del parameters, name
        return False

    @classmethod
    def largest_force(
        cls, parameters: Mapping[str, Any], name: str, period: float
    ) -> float | None:
        """Return the largest force of node `name` with these `parameters`, at a `period` [s].

        Returns
        -------
        float or None
            Largest magnitude along an axis [N]; None if the parameters set no limit.
        """
        del parameters, name, period
        return None

    @classmethod
    def unjudged(cls, setup: Setup) -> str:
        """Return why the stability of what the node of this `setup` renders is not judged.

        Returns
        -------
        str
            One sentence; empty if it is judged, or renders nothing.
        """
        del setup
        return ""

    @classmethod
    def subscribes(cls, parameters: Any) -> tuple[str, ...]:
        """Return the subscriptions of a node with these `parameters`, which publishers wait for.

        Returns
        -------
        tuple of str
            Topics.
        """
        del parameters
        return ("",) if cls.listens_to == ("*",) else cls.listens_to

    @classmethod
    def hears(cls, parameters: Any, nodes: Iterable[str]) -> frozenset[str]:
        """Return which other `nodes` one with these `parameters` connects to, if it hears all.

        Returns
        -------
        frozenset of str
            Some of them, or all.
        """
        del parameters
        return frozenset(nodes)
