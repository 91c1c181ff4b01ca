"""A drop onto a floor as the messages of its nodes, for tests of recordings."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT, status
from messages.types import DeviceState, Force, Message, NodeStatus, Proxy, Receipt
from nodes.arithmetic import deflection, one_sided, plane_distance
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from sim.device.model import advance, coefficients

PERIOD = 0.002
PUBLISHES = json.dumps(
    {"driver": [DEVICE_STATE], "environment": [PROXY], "coupling": [FORCE, RECEIPT]}
)
"""Publishers by topic, as in a manifest."""
MASS, STIFFNESS, DAMPING = 0.1, 1500.0, 3.0


def drop(
    ticks: int, *, missed: tuple[int, ...] = (), switch: int | None = None
) -> Iterator[tuple[str, Message]]:
    """Yield the messages of a drop of 0.1 kg from 10 mm.

    Parameters
    ----------
    ticks : int
        How many.
    missed : tuple of int
        Ticks to report as missed.
    switch : int or None
        Tick at which the damping is doubled, with a receipt.

    Yields
    ------
    tuple of str and Message
        Topic and message, in the order of publication; a final status of each node last.
    """
    step = coefficients(MASS, 0.0, 0.0, PERIOD)
    x, v, force, before, damping, energy = 0.010, 0.0, 0.0, 0.0, DAMPING, 0.0
    late = 0
    for k in range(ticks):
        up = (0.0, 0.0, 1.0)
        late += k - 1 in missed
        yield (
            DEVICE_STATE,
            DeviceState(
                seq=k,
                stamp=k * PERIOD,
                position=(0.0, 0.0, x),
                force=(0.0, 0.0, force),
                mean_force=(0.0, 0.0, force),
                force_seq=k - 1,
                response=(
                    0.0
                    if k == 0 or k - 1 in missed
                    else 160e-6 + 40e-6 * ((k * 7919) % 13) / 13
                ),
                missed=late,
                energy=energy,
            ),
        )
        distance = plane_distance(x, 0.0, 1.0)
        contact = distance < 0.0
        proxy = 0.0 if contact else x
        yield (
            PROXY,
            Proxy(
                seq=k,
                stamp=k * PERIOD,
                position=(0.0, 0.0, x),
                proxy=(0.0, 0.0, proxy),
                normal=up,
                distance=distance,
                contact=contact,
            ),
        )
        if k == switch:
            damping *= 2.0
            yield (
                RECEIPT,
                Receipt(
                    seq=k,
                    stamp=k * PERIOD,
                    action="switch",
                    before="{law: pd}",
                    after="{law: stiffer}",
                    revision=1,
                ),
            )
        stretch = deflection(x, proxy, distance, 1.0, contact, False)
        law = STIFFNESS * stretch + damping * (stretch - before) / PERIOD
        force, before = one_sided(law, 1.0, law, contact, False, True), stretch
        name = "pd" if switch is None or k < switch else "stiffer"
        yield FORCE, Force(seq=k, stamp=k * PERIOD, force=(0.0, 0.0, force), law=name)
        energy -= force * x
        x, v = advance(x, v, force - MASS * 9.81, step)
        energy += force * x
    for node, kind, sent in (
        ("driver", "sim_driver", ticks),
        ("environment", "environment", ticks),
    ):
        yield (
            status(node),
            NodeStatus(
                seq=ticks,
                stamp=ticks * PERIOD,
                node=node,
                kind=kind,
                state="finished",
                pid=1,
                sent=sent,
            ),
        )


def rewritten(path: Path, keep: Callable[[str, int], bool]) -> Path:
    """Copy a part of a recording by topic and seq, with all its metadata."""
    recording, out = Recording(path), path.with_suffix(".less.mcap")
    written = recording.metadata
    with RecordWriter(
        out,
        recording.manifest,
        launch_file=written["launch_file"]["yaml"],
        parameters=written["parameters"],
        overwrite=True,
    ) as writer:
        for entry in recording.entries():
            if keep(entry.topic, entry.message.seq):
                writer.write(entry.topic, entry.message, entry.log_time)
    return out
