"""Rebuild the scene of a recording from the files recorded with it."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from messages.topics import DEVICE_STATE, RECEIPT
from nodes.base.setup import least_delay
from nodes.launcher import launch_file
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.laws.base import Law
from nodes.laws.parse import compile_law, law_to_dict, parse_law
from nodes.parameters.store import ParameterError, merge
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.facts import refuse_foreign_files
from nodes.recording.reader import Recording
from sim.arrays import Array
from sim.device.model import DeviceModel
from sim.experiments.settling import SHORTEST
from sim.identify.forces import handed_over
from sim.play.hops import UNJUDGED
from sim.play.launched import LaunchedScene, from_launch
from sim.play.one_axis import PlannedSwap


@dataclass(frozen=True)
class RecordedScene:
    """A recording and its scene."""

    path: Path  # the recording
    scene: LaunchedScene  # device, surface, conventions, law and recorded law changes
    launch: Launch  # as it was started
    lockstep: bool  # whether every tick was answered with a constant delay
    # limits that are not replayed: for a real-time run, the driver's ramp and motor heating under
    # another law
    left_out: tuple[str, ...]
    position: Array  # measured position of each recorded tick [m], shape (N,)
    force: Array  # force on the device until that tick [N], shape (N,)
    # when each force took effect, ascending, and when the driver received it [ticks], shape (M,)
    took: Array
    came: Array
    # tick that each force answers; −1 for the driver's own, whose value is in `given`, shape (M,)
    answers: NDArray[np.int64]
    given: Array  # its recorded value [N], shape (M,)
    # position of the device's hand if a user moved it [m], shape (N,); None for a hand on its own
    # path
    target: Array | None
    declared: bool  # whether the device is virtual, with recorded parameters
    # ticks in the recording; more than N if the driver overran: ticks after that are not replayed
    recorded_ticks: int


def rebuild(path: Path, device: DeviceModel | None = None) -> RecordedScene:
    """Rebuild the scene of a recording; `device` replaces a real device.

    Raise ValueError if too few ticks can be replayed or a real device has no model.
    """
    recording = Recording(path)
    launch = _launch(recording)
    states = recording.messages(DEVICE_STATE)
    seq = np.array([state.seq for state in states], dtype=np.int64)
    whole = np.flatnonzero(np.diff(seq) != 1)
    if len(whole):
        # An overrun cannot be replayed; the ticks before it can.
        states = states[: int(whole[0]) + 1]
    if len(states) < SHORTEST or seq[0] != 0:
        slept = " before one that the driver slept through" if len(whole) else ""
        first = seq[0] if len(seq) else 0
        raise ValueError(
            f"{path}: {len(states)} ticks from tick {first} on{slept}; a replay needs {SHORTEST}"
            " from 0 on"
        )
    launch, left_out, dragged = _playable(launch, device)
    played = from_launch(launch)
    receipts = [
        one for one in recording.messages(RECEIPT) if one.action in ("switch", "set")
    ]
    if receipts:
        swaps = tuple(
            PlannedSwap(one.seq, _law_of(one.after, played.scene.period), one.ramp)
            for one in receipts
        )
        played = replace(played, swaps=swaps)
    axis = played.axis
    handed = handed_over(states, axis)
    lockstep = launch.run.pace == "lockstep"
    return RecordedScene(
        path=path,
        scene=played,
        launch=launch,
        lockstep=lockstep,
        left_out=() if lockstep else left_out,
        position=np.array([state.position[axis] for state in states]),
        force=np.array([state.force[axis] for state in states]),
        took=handed.at,
        came=handed.at - least_delay(launch.run.apply),
        answers=handed.answers,
        given=handed.force,
        target=(
            np.array([state.target[axis] for state in states])
            if dragged and not lockstep
            else None
        ),
        declared=device is None,
        recorded_ticks=len(seq),
    )


def _launch(recording: Recording) -> Launch:
    """Read the recorded launch file with its arguments and the nodes' initial parameters."""
    text = recording.metadata.get("launch_file", {}).get("yaml")
    arguments = recording.manifest.get("arguments")
    if text is None or arguments is None:
        raise ParameterError(
            "was recorded without its launch file, so its scene is not known",
            path=str(recording.path),
        )
    # The launch file comes from elsewhere: it must not name a file to be read or written here.
    with tempfile.TemporaryDirectory(prefix="haptic-replay-") as folder:
        file = Path(folder) / "recorded.yaml"
        file.write_bytes(
            msgspec.json.encode(
                _without_files(parse_yaml(text, "the recorded launch file"))
            )
        )
        launch = launch_file.read(str(file), msgspec.json.decode(arguments))
    scenario = recording.manifest.get("scenario", "")
    launch = msgspec.structs.replace(
        launch, scenario=scenario or launch.scenario, text=text
    )
    nodes = {}
    for name, spec in launch.nodes.items():
        recorded = recording.metadata.get("parameters", {}).get(name)
        over = {} if recorded is None else parse_yaml(recorded, name)
        parameters = merge(spec.parameters, over)
        if "surface" in parameters or "scene" in parameters:
            refuse_foreign_files(recording, parameters, name)
        nodes[name] = msgspec.structs.replace(spec, parameters=parameters)
    return msgspec.structs.replace(launch, nodes=nodes)


def _without_files(content: Any) -> Any:
    """Remove the watched parameter files of nodes.

    The recorded parameters contain their initial values.
    """
    if isinstance(content, dict) and content.get("include"):
        raise ParameterError(
            "a recording of a launch file that includes others: replay the recording of one of its"
            " chains"
        )
    if isinstance(content, dict) and isinstance(content.get("nodes"), dict):
        nodes = {
            name: (
                {key: value for key, value in spec.items() if key != "watch"}
                if isinstance(spec, dict)
                else spec
            )
            for name, spec in content["nodes"].items()
        }
        return {**content, "nodes": nodes}
    return content


def _playable(
    launch: Launch, device: DeviceModel | None
) -> tuple[Launch, tuple[str, ...], bool]:
    """Replace hardware by a virtual device.

    Return the launch, the limits that only lockstep can replay, and whether a user could move the
    hand.
    """
    nodes, left_out, dragged = dict(launch.nodes), [], False
    for name, spec in launch.nodes.items():
        if spec.kind == "coupling":
            judged = {**spec.parameters, **UNJUDGED}
            nodes[name] = msgspec.structs.replace(spec, parameters=judged)
        if not spec.kind.endswith("driver"):
            continue
        safety = spec.parameters.get("safety", {})
        left_out += [
            f"{name}.safety.{limit}"
            for limit in ("ramp", "continuous_force")
            if safety.get(limit)
        ]
        parameters: dict[str, Any] = {"safety": safety}
        for kept in ("passivity", *(() if device else ("preset",))):
            if kept in spec.parameters:
                parameters[kept] = spec.parameters[kept]
        if device is not None:
            parameters["device"] = {
                k: v for k, v in msgspec.to_builtins(device).items() if v is not None
            }
        elif "device" in spec.parameters:
            parameters["device"] = spec.parameters["device"]
            dragged = spec.parameters.get("pointer") is not None
        else:
            raise ValueError(
                f"{name} is a {spec.kind}: its device is not declared; name a model by --model"
            )
        nodes[name] = msgspec.structs.replace(
            spec, kind="sim_driver", parameters=parameters
        )
    return msgspec.structs.replace(launch, nodes=nodes), tuple(left_out), dragged


def _law_of(text: str, period: float) -> CompiledLaw:
    """Compile the law described by a receipt."""
    described = parse_yaml(text, "receipt")
    name = described.pop("law", "law")
    return compile_law(parse_law(described, name), period, name)


def another_law(
    recorded: RecordedScene, given: Mapping[str, Any]
) -> tuple[CompiledLaw, dict[str, Any]]:
    """Return the law requested in place of the recorded one, compiled and as a mapping."""
    law = _wanted(recorded.launch, given)
    return compile_law(law, recorded.scene.scene.period, "law"), law_to_dict(law)


def refuse_law(path: Path, given: Mapping[str, Any]) -> None:
    """Reject an invalid law before the recording is rebuilt, which takes seconds."""
    _wanted(_launch(Recording(path)), given)


def _wanted(launch: Launch, given: Mapping[str, Any]) -> Law:
    coupling = next(
        (spec.parameters for spec in launch.nodes.values() if spec.kind == "coupling"),
        {},
    )
    changes = dict(given)
    wanted = changes.pop("law", coupling.get("law"))
    described = (
        wanted
        if isinstance(wanted, dict)
        else coupling.get("laws", {}).get(wanted, {"kind": wanted})
    )
    described = {"kind": described} if isinstance(described, str) else dict(described)
    return parse_law({**described, **changes}, "law")
