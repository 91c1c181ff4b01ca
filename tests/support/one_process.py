"""The recording of a lockstep launch of one axis, made in this process.

What one process plays has the bits of the launch (tests/sim/play/test_lockstep.py), and what it
leaves, but for statuses and response times, is what the launch leaves (test_one_process.py there).
For whoever reads a recording; scenes in which a driver's limit acts are launched.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT
from messages.types import DeviceState, Force, Message, Proxy, Receipt, Vector
from nodes.coupling.parameters import CouplingParameters
from nodes.environment.node import EnvironmentParameters
from nodes.environment.surfaces import parse_surface
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Launch
from nodes.launcher.wiring import manifest_of
from nodes.laws.parse import law_to_dict, parse_law
from nodes.recording.logger import open_writer
from sim.play.launched import from_launch, parameters_of
from sim.play.player import play

RESPONSE = 160e-6
"""Time of each tick's answer here [s]; a launch's shows how busy the machine was."""


def recorded(
    folder: Path,
    scenario: str,
    *assignments: str,
    params: Path | None = None,
    name: str = "run",
) -> Path:
    """Write the recording of ``haptic launch SCENARIO pace:=lockstep …`` without launching.

    Parameters
    ----------
    folder : Path
        Where.
    scenario : str
        Name or path of a launch file of one axis.
    *assignments : str
        Arguments, ``name:=value``.
    params : Path, optional
        A file that ``--params`` would take.
    name : str
        Of the file, without its ending.

    Returns
    -------
    Path
        The recording.
    """
    given = scenario_files.parse_assignments([*assignments, "pace:=lockstep"])
    launch = launch_file.read(scenario, given, () if params is None else (params,))
    path = folder / f"{name}.mcap"
    run = f"{Path(launch.scenario).stem}-20000101-000000-000001"
    # In lockstep the time of the run begins at 0, and the run now.
    manifest = manifest_of(launch, run, time.time())
    with open_writer(str(path), manifest, overwrite=True) as writer:
        for number, (topic, message) in enumerate(messages(launch)):
            # Log times rise, as those of a logger do.
            writer.write(topic, message, message.stamp + 1e-7 * number)
    return path


def messages(launch: Launch) -> Iterator[tuple[str, Message]]:
    """Play a launch of one axis, and go through what its nodes publish, tick by tick."""
    played = from_launch(launch)
    ticks, period, lag = (
        played.ticks,
        launch.run.period,
        int(launch.run.apply == "next_tick"),
    )
    trace = play(launch, ticks=ticks + 1).along()
    assert max(abs(trace.force)) < (played.scene.peak or 1e300), (
        "a limit acts: launch it"
    )
    _, environment = parameters_of(launch, "environment", EnvironmentParameters)
    meet = parse_surface(environment.surface, "surface").meeting()
    _, coupling = parameters_of(launch, "coupling", CouplingParameters)
    changes = {round(one.at / period): one for one in coupling.schedule}
    law, revision, energy = coupling.law, 0, 0.0

    def along(value: float) -> Vector:
        x, y, z = (value if i == played.axis else 0.0 for i in range(3))
        return x, y, z

    for k in range(ticks + 1):
        position = along(float(trace.measured[k]))
        held = float(trace.force[k - 1]) if k else 0.0
        # With next_tick the newest force is handed over at the end of its tick.
        mean = float(trace.force[k - 1 - lag]) if k > lag else 0.0
        if k:
            energy += mean * float(trace.measured[k] - trace.measured[k - 1])
        yield (
            DEVICE_STATE,
            DeviceState(
                seq=k,
                stamp=k * period,
                position=position,
                force=along(held),
                mean_force=along(mean),
                changed_at=float(lag) if k else 0.0,
                force_seq=k - 1,
                response=RESPONSE if k else 0.0,
                safety="active" if k else "waiting",
                energy=energy,
                delay=float(lag) if k else 0.0,
            ),
        )
        proxy, normal, distance, contact = meet(position)
        yield (
            PROXY,
            Proxy(
                seq=k,
                stamp=k * period,
                position=position,
                proxy=proxy,
                normal=normal,
                distance=distance,
                contact=contact,
                delay=float(lag) if k else 0.0,
            ),
        )
        if k in changes:
            before, law, revision = law, changes[k].law, revision + 1
            texts = [
                json.dumps(
                    {"law": one, **law_to_dict(parse_law(coupling.laws[one]))},
                    separators=(",", ":"),
                )
                for one in (before, law)
            ]
            yield (
                RECEIPT,
                Receipt(
                    seq=k,
                    stamp=k * period,
                    action="switch",
                    before=texts[0],
                    after=texts[1],
                    reason="schedule",
                    revision=revision,
                    ramp=changes[k].ramp,
                ),
            )
        yield (
            FORCE,
            Force(
                seq=k,
                stamp=k * period,
                force=along(float(trace.force[k])),
                law=law,
                revision=revision,
                normal=normal if contact else (0.0, 0.0, 0.0),
            ),
        )
