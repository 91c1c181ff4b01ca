"""Another law under the same hand: what it would feel like in a running launch.

A view calls `play_beside` in a separate process, on other processors than the loop, with the hand
targets that the driver published so far. The player then gives the same bits as the launch file
with this law and this path.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from messages.types import Vector
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.launcher.launch_spec import Launch, NodeSpec, RunSpec
from nodes.parameters.store import convert
from sim.arrays import Array
from sim.device.driver import SimDriverParameters, along
from sim.play.given import Given
from sim.play.hops import UNJUDGED
from sim.play.player import play


def shadow_launch(
    setups: Mapping[str, Setup],
    law: Mapping[str, Any],
    begin: tuple[Any, Any],
    late: float = 0.0,
) -> Launch:
    """Return a running launch with another law and the device's current state.

    `begin` is the position [m] and velocity [m/s] of the device at the first tick, three numbers
    each if the scene has several axes; `late` is the delay of the loop beyond that of the device
    and of ``next_tick`` [ticks].
    """
    first = next(iter(setups.values()))
    nodes = {}
    for name, setup in setups.items():
        parameters = dict(setup.parameters)
        if setup.kind == "coupling":
            # The contact continues, so there is no initial easing.
            parameters |= {
                "law": "beside",
                "laws": {"beside": dict(law)},
                "schedule": [],
                "ease": 0.0,
                **UNJUDGED,
            }
        elif setup.kind == "sim_driver":
            parameters = _begun(setup, begin, late)
        nodes[name] = NodeSpec(kind=setup.kind, parameters=parameters)
    spec = RunSpec(rate=1.0 / first.period, apply=first.apply, axes=list(first.axes))
    return Launch(
        scenario=first.run,
        summary="",
        path="",
        text="",
        arguments={},
        run=spec,
        nodes=nodes,
    )


def _begun(setup: Setup, begin: tuple[Any, Any], late: float) -> dict[str, Any]:
    """Return a driver's parameters with another initial state, and without an initial ramp."""
    wanted: SimDriverParameters = convert(
        setup.parameters, SimDriverParameters, setup.name
    )
    several = len(setup.axes) > 1
    device: dict[str, Any] = msgspec.to_builtins(
        wanted.device if several else along(wanted.device, setup.axes)[0]
    )
    own = {"": device}
    if several:
        device["axes"] = own = {
            axis: {**device["axes"].get(axis, {})} for axis in setup.axes
        }
        device["delay"] += late
    for axis, described in own.items():
        at = AXIS_INDEX.get(axis)
        described["position"], described["velocity"] = (
            each if at is None else each[at] for each in begin
        )
        if "delay" in described:
            described["delay"] += late
    safety = msgspec.structs.replace(wanted.safety, ramp=0.0)
    return {
        **setup.parameters,
        "device": device,
        "preset": "",
        "safety": msgspec.to_builtins(safety),
    }


def play_beside(
    setups: Mapping[str, Setup],
    law: Mapping[str, Any],
    targets: Sequence[float] | Sequence[Vector],
    begin: tuple[Any, Any],
    late: float = 0.0,
) -> tuple[Array, Array]:
    """Play another law under the same hand; return encoder readings [m] and forces [N].

    `targets` are the targets of the hand, tick by tick [m]; `begin` and `late` as of
    `shadow_launch`. All have three columns if the scene has several axes.
    """
    launch = shadow_launch(setups, law, begin, late)
    target = np.array(targets, dtype=np.float64)
    trace = play(launch, ticks=len(targets), given=Given(target=target))
    if target.ndim > 1:
        return trace.measured, trace.force
    axis = AXIS_INDEX[launch.run.axes[0]]
    return trace.measured[:, axis], trace.force[:, axis]
