"""Image of a launch: the states of its nodes before tick 0, as numbers for the worker.

Python builds and checks the nodes as for a launch; the worker only continues from their states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from nodes.compiled.memory import reals_at
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.driver.pointer import SILENCE
from nodes.environment.state import UNKNOWN
from nodes.launcher.launch_spec import Launch
from nodes.launcher.wiring import chains_of
from nodes.laws import CompiledLaw
from nodes.laws.excitation import Push
from nodes.parameters.store import ParameterError, convert
from sim.javascript.values import fields_of
from sim.play.chain import ChainNodes, Instead
from sim.play.chain_rows import parts_of_device
from sim.play.compiled import Pushing, numbers_of
from sim.play.given import Given
from sim.play.hops import Hops, check_chain, hops_of
from sim.play.launched import laws_of

_ADDRESSES: Final = {
    "driver": {"places": ("places_count", 3), "lines": ("line_length", 3)},
    "device": {"path": ("corners", 2), "masses": ("masses_count", 2)},
}
"""Fields that hold an address of floats: the field with their count, and floats per count."""

_ADDRESS: Final = range(2**32, 2**48)
"""Whole numbers of a state that are addresses of this process; counts are smaller."""

_BODIES: Final = (
    "mujoco",
    "world",
)  # kinds of environment that move by code of their own


class NotInBrowserError(ParameterError):
    """A launch that the worker of a page cannot play; the text names the node and the reason."""


def image_of(launch: Launch, ticks: int) -> dict[str, Any]:
    """Return what the worker needs to play a launch, by name.

    Parameters
    ----------
    launch : Launch
        The launch file, read; one chain.
    ticks : int
        Length of the run, for laws whose code depends on it.

    Raises
    ------
    NotInBrowserError
        If the launch has several chains, moving bodies, two devices, or code that is not emitted.
    ParameterError
        As a launch raises it.
    """
    chains = chains_of(launch)
    if len(chains) != 1:
        raise NotInBrowserError(
            f"{launch.scenario}: {len(chains)} chains; a page in the browser plays one"
        )
    for name, spec in launch.nodes.items():
        if spec.kind in _BODIES:
            raise _own_code(launch, name)
    hops = hops_of(launch, chains[0])
    if launch.nodes[hops.environment].kind != "environment":
        raise _own_code(launch, hops.environment)
    check_chain(launch, hops)
    nodes = ChainNodes(launch, hops, ticks, Instead(), Given())
    parts = parts_of_device(nodes.device)
    if list(parts) != [""]:
        raise NotInBrowserError(
            f"{hops.driver}: {launch.nodes[hops.driver].kind} drives two devices; a page in the"
            " browser plays one"
        )
    state = nodes.environment.counters
    if state.kind == UNKNOWN:
        raise _own_code(launch, hops.environment)
    driver = nodes.driver.driving
    return {
        "axes": list(nodes.axes),
        "driver": _fields(driver, "driver"),
        "devices": [_fields(part, "device") for part in parts[""]],
        "environment": _placeless(fields_of(state)),
        "coupling": _placeless(fields_of(nodes.coupling.counters)),
        "table": list(reals_at(state.table, state.table_count)),
        "memory": list(reals_at(state.memory, state.memory_count)),
        **_laws(launch, hops, ticks, len(nodes.axes)),
        **_pointer(launch, hops),
    }


def _own_code(launch: Launch, node: str) -> NotInBrowserError:
    return NotInBrowserError(
        f"{node}: {launch.nodes[node].kind} has code or bodies of its own, which a page in the"
        " browser does not play"
    )


def _fields(state: Any, name: str) -> dict[str, Any]:
    """Return the fields of a state; those that hold an address contain what stands there."""
    fields = fields_of(state)
    placed = {
        address: list(_flat(reals_at(fields[address], fields[count] * each)))
        for address, (count, each) in _ADDRESSES[name].items()
    }
    rest = {key: one for key, one in fields.items() if key not in placed}
    return {"fields": _placeless(rest), **placed}


def _placeless(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with 0 for addresses, so that a launch has the same image each time."""
    return {
        name: [_no_address(part) for part in one]
        if hasattr(one, "__len__")
        else _no_address(one)
        for name, one in fields.items()
    }


def _no_address(value: Any) -> Any:
    return 0 if isinstance(value, int) and value in _ADDRESS else value


def _flat(values: Any) -> list[float]:
    return [float(one) for one in values]


def _pointer(launch: Launch, hops: Hops) -> dict[str, Any]:
    pointer = launch.nodes[hops.driver].parameters.get("pointer")
    if pointer is None:
        return {"pointer": {}}
    return {
        "pointer": {
            "farthest": pointer.get("speed", 0.5) * launch.run.period,
            "silence": pointer.get("silence", SILENCE),
            "beyond": bool(pointer.get("beyond", False)),
        }
    }


def _laws(launch: Launch, hops: Hops, ticks: int, axes: int) -> dict[str, Any]:
    parameters: CouplingParameters = convert(
        launch.nodes[hops.coupling].parameters, CouplingParameters, hops.coupling
    )
    book = LawBook(hops.coupling, launch.run.period)
    rendered = laws_of(launch, hops).names
    names = dict.fromkeys([*parameters.laws, *rendered])
    laws = {}
    for name in names:
        try:
            compiled = book.compile(parameters, name)
            laws[name] = law_of(compiled, ticks, axes, f"{hops.coupling}.laws.{name}")
        except ParameterError:
            if name in rendered:
                raise
    return {
        "laws": laws,
        "law": parameters.law,
        "schedule": [
            {
                "tick": round(swap.at / launch.run.period),
                "law": swap.law,
                "ramp": swap.ramp,
            }
            for swap in sorted(parameters.schedule, key=lambda swap: swap.at)
        ],
        "ramp": parameters.ramp,
    }


def law_of(law: CompiledLaw, ticks: int, axes: int, where: str) -> dict[str, Any]:
    """Return a compiled law as numbers.

    Raises
    ------
    NotInBrowserError
        If the law has code of its own that is not emitted.
    """
    own = law.own_code()
    return {
        "taps": list(law.taps),
        "sections": [number for section in law.sections for number in section],
        "own": {} if own is None else _own(own, ticks, axes, where),
    }


def _own(
    own: Callable[..., float], ticks: int, axes: int, where: str
) -> dict[str, Any]:
    numbers = numbers_of(own, ticks)
    if numbers is None or (isinstance(own, Push) and axes > 1):
        raise NotInBrowserError(
            f"{where}: {type(own).__name__} is code of its own, which a page in the browser does"
            " not play"
        )
    if isinstance(numbers, Pushing):
        return {"kind": "pushed", "numbers": numbers._asdict()}
    return {"kind": "windowed", "numbers": list(numbers)}
