"""Another law under the same hand: the one-process loop plays what a running launch's hand and device would feel with it.

A view calls `play_beside` in a process of its own, off the loop's processors, with the targets that
the driver told so far. It is the loop of `from_launch`, with that hand: the same bits as when the
launch file is played with this law and this path.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec

from nodes.base.setup import Setup
from nodes.launcher.launch_spec import Launch, NodeSpec, RunSpec
from sim.arrays import Array
from sim.play.launched import from_launch
from sim.play.one_axis import Scene, run


def beside_scene(
    setups: Mapping[str, Setup],
    law: Mapping[str, Any],
    targets: Sequence[float],
    begin: tuple[float, float],
    late: float = 0.0,
) -> tuple[Scene, Any, int]:
    """Make the scene of a launch with another law and the hand's targets as they were: scene, law and memory [ticks].

    `targets` are where the hand pulled to, tick by tick [m], `begin` is the position [m] and
    velocity [m/s] of the device at the first of them, `late` the delay of the loop beyond that of
    the device and of ``next_tick`` [ticks].
    """
    first = next(iter(setups.values()))
    nodes = {}
    for name, setup in setups.items():
        parameters = dict(setup.parameters)
        if setup.kind == "coupling":
            # What was felt before is felt on: nothing begins here.
            parameters |= {
                "law": "beside",
                "laws": {"beside": dict(law)},
                "schedule": [],
                "ease": 0.0,
            }
        elif setup.kind == "sim_driver":
            # What brings a force in after a gap has nothing to do here: there is no gap.
            parameters["safety"] = {**parameters.get("safety", {}), "ramp": 0.0}
        nodes[name] = NodeSpec(kind=setup.kind, parameters=parameters)
    spec = RunSpec(rate=1.0 / first.period, apply=first.apply, axes=list(first.axes))
    launched = from_launch(
        Launch(
            scenario=first.run, summary="", path="", text="", arguments={}, run=spec, nodes=nodes
        )
    )
    device = launched.scene.device
    path = [(k * first.period, target) for k, target in enumerate(targets)]
    hand = device.hand and msgspec.structs.replace(device.hand, path=path, repeat=None)
    device = msgspec.structs.replace(
        device, position=begin[0], velocity=begin[1], delay=device.delay + late, hand=hand
    )
    return replace(launched.scene, device=device), launched.law, launched.memory


def play_beside(
    setups: Mapping[str, Setup],
    law: Mapping[str, Any],
    targets: Sequence[float],
    begin: tuple[float, float],
    late: float = 0.0,
) -> tuple[Array, Array]:
    """Play another law under the same hand, see `beside_scene`: what the encoder reads [m], and what is handed over [N]."""
    scene, compiled, memory = beside_scene(setups, law, targets, begin, late)
    trace = run(scene, compiled, len(targets), memory=memory)
    return trace.measured, trace.force
