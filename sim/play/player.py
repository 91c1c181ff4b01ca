"""Play a chain of a launch file in one process: the one entry point for every method.

The chain's own nodes can play every chain (`sim.play.chain`). For one rigid device on one axis at a
surface, with a driver that only lowers forces, the compiled loop of one axis gives the same bits a
thousand times faster and is used instead.
"""

from collections.abc import Callable
from functools import partial
from typing import Literal, TypeAlias

import numpy as np

from nodes.driver.limits import SafetyParameters, start_ramp
from nodes.driver.safety import REACH
from nodes.driver.safety_setup import pressed_ticks
from nodes.launcher.launch_spec import Launch
from nodes.launcher.wiring import chains_of
from nodes.parameters.store import ParameterError
from sim.arrays import Array
from sim.play.chain import Instead, play_chain
from sim.play.given import Given
from sim.play.hops import check_chain, hops_of
from sim.play.launched import LaunchedScene, NotOneAxisError, from_launch
from sim.play.one_axis import MAX_TICKS, Trace, run_with_asked
from sim.play.trace import ChainTrace

# ``fastest``: the compiled loop of one axis, where it gives the same bits; ``interpreted``: the
# same loop interpreted, for a run shorter than its compilation; ``nodes``: the nodes.
How: TypeAlias = Literal["fastest", "interpreted", "nodes"]


def play_launch(
    launch: Launch, ticks: int | None = None, how: How = "fastest"
) -> dict[str, ChainTrace]:
    """Play all chains of a launch separately; return traces by namespace. See `play`."""
    return {chain: play(launch, chain, ticks, how=how) for chain in chains_of(launch)}


def play(
    launch: Launch,
    namespace: str | None = None,
    ticks: int | None = None,
    instead: Instead | None = None,
    given: Given | None = None,
    how: How = "fastest",
) -> ChainTrace:
    """Play a chain of a launch, bit-identical to its lockstep run, whatever ``run.pace`` is.

    Parameters
    ----------
    launch : Launch
        The launch file, read.
    namespace : str, optional
        Namespace of the chain; may be omitted if there is only one.
    ticks : int, optional
        Length of the run; by default the launch file's, or 10 s without one.
    instead : Instead, optional
        Replacements for parts of the launch file.
    given : Given, optional
        Additional inputs of the chain.
    how : str
        ``fastest``, ``interpreted`` or ``nodes``; the bits are the same.

    Returns
    -------
    ChainTrace
        Every tick.

    Raises
    ------
    ParameterError
        As a launch raises it, or with the node that one process cannot play.
    """
    return prepare(launch, namespace, ticks, instead, given, how)()


def prepare(
    launch: Launch,
    namespace: str | None = None,
    ticks: int | None = None,
    instead: Instead | None = None,
    given: Given | None = None,
    how: How = "fastest",
) -> Callable[[], ChainTrace]:
    """Check a chain once; return the function that plays it. Arguments as of `play`."""
    instead = instead or Instead()
    given = given or Given()
    chain = _only_chain(launch) if namespace is None else namespace
    wanted = ticks or launch.run.ticks or round(10.0 / launch.run.period)
    if wanted > MAX_TICKS:
        raise ParameterError(
            f"{wanted} ticks, limit {MAX_TICKS} in one process, which keeps all of a"
            " run; launch a longer one",
            path="run.duration",
        )
    check_chain(launch, hops_of(launch, chain))
    by_nodes = partial(play_chain, launch, chain, wanted, instead, given)
    if how == "nodes" or instead.is_scenery or given.path is not None:
        return by_nodes
    one = _one_axis(launch, chain, instead, given)
    if one is None:
        return by_nodes

    def fastest() -> ChainTrace:
        return _on_one_axis(one, wanted, given, how == "interpreted") or by_nodes()

    return fastest


def _only_chain(launch: Launch) -> str:
    chains = chains_of(launch)
    if len(chains) != 1:
        remedy = (
            f" ({', '.join(chains)}); name one of them"
            if chains
            else "; nothing to play"
        )
        raise ParameterError(f"{len(chains)} chains{remedy}", path=launch.scenario)
    return chains[0]


def _one_axis(
    launch: Launch, namespace: str, instead: Instead, given: Given
) -> LaunchedScene | None:
    """Convert a chain for the loop of one axis; None if only its nodes can play it."""
    real_time = given.arrivals is not None or given.read is not None
    try:
        one = from_launch(launch, namespace)
    except NotOneAxisError:
        if real_time:
            raise
        return None
    if instead.law is not None:
        one = one.rendering(instead.law, tuple(instead.swaps))
    if one.swaps and any(law.evaluate is not None for law in one.laws):
        return None  # compiled code cannot swap it
    if not real_time and (one.safety.ramp or one.safety.continuous_force):
        return None
    return one


def _on_one_axis(
    one: LaunchedScene, ticks: int, given: Given, interpreted: bool
) -> ChainTrace | None:
    """Play by the loop of one axis; None if the driver might have intervened."""
    swaps = [swap for swap in one.swaps if swap.tick < ticks]
    trace, asked = run_with_asked(
        one.scene, one.law, ticks, swaps, one.memory, interpreted, given
    )
    if given.arrivals is None and driver_intervenes(one, trace, asked):
        return None
    return one.in_space(trace)


def driver_intervenes(one: LaunchedScene, trace: Trace, asked: Array) -> bool:
    """Return whether a driver might have done more than lower the forces of a run."""
    begins = asked[0] != 0.0 and start_ramp(one.safety) > 0.0
    return bool(begins) or _stops(one.safety, one.scene.peak, trace, asked)


def _stops(
    safety: SafetyParameters, peak: float | None, trace: Trace, asked: Array
) -> bool:
    """Return whether the force saturated too often, or the device left its reach."""
    if not np.all(np.abs(trace.measured) <= REACH):
        return True
    if safety.stop_after is None or peak is None:
        return False
    sides = np.where(np.abs(asked) > peak, np.sign(asked), 0.0)
    comes = np.count_nonzero((sides != 0.0) & (np.diff(sides, prepend=0.0) != 0.0))
    stays = np.count_nonzero(sides) // pressed_ticks(safety.stop_after, trace.period)
    return int(comes + stays) >= safety.stop_after
