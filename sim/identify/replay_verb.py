"""Replay a recording with another law: what the recorded hand and device would have felt."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.cli.main import RefusedError, UsageError, answer

if TYPE_CHECKING:
    from sim.device.model import DeviceModel
    from sim.identify.counterfactual import Felt
    from sim.identify.recorded_scene import RecordedScene

EXPLAINED = 1e-5
"""A residual below this is explained even where the encoder is finer [m]."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("file", type=Path, help="recording of a launch")
    parser.add_argument(
        "assignments", nargs="*", metavar="name:=value", help="law:=NAME or a description, and its parameters"
    )
    parser.add_argument(
        "--model",
        help="the device: declared (as the virtual device was), identified (from this recording), a recording to identify it "
        "from, or a YAML file of a device (default: declared where there is one, else identified)",
    )
    parser.add_argument("--out", type=Path, metavar="PNG", help="also draw both runs")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replay the same law, then the other."""
    import numpy as np

    from nodes.launcher.launch_file import parse_assignments
    from nodes.laws.parse import LawRefusedError
    from nodes.parameters.store import ParameterError
    from nodes.recording.writer import RecordError
    from sim.identify.counterfactual import replay
    from sim.identify.recorded_scene import another_law

    try:
        given = parse_assignments(arguments.assignments)
        recorded, external, model = _prepared(arguments)
        same = replay(recorded, None, external)
        law, described = another_law(recorded, given)
    except (RecordError, OSError, ParameterError, LawRefusedError) as error:
        raise UsageError(str(error)) from error
    except ValueError as error:
        raise RefusedError(str(error)) from error
    other = replay(recorded, law, external) if given else same
    error_m = float(np.max(np.abs(same.measured - recorded.position)))
    step = recorded.scene.scene.device.resolution
    figures: dict[str, Any] = {
        "recording": str(recorded.path),
        "model": model,
        "lockstep": recorded.lockstep,
        "self_error_m": error_m,
        "self_error_steps": None if step is None else error_m / step,
        "law": described,
        "recorded": _told(same),
        "predicted": _told(other),
        "left_out": list(recorded.left_out),
    }
    if arguments.out is not None:
        _draw(arguments.out, recorded, same, other)
        figures["plot"] = str(arguments.out)
    answer(arguments.json, figures, _text(figures))
    return 0


def _told(felt: Felt) -> dict[str, Any]:
    return {"settled": felt.settled, "peak_force_n": felt.peak_force, "rest_m": felt.rest}


def _prepared(arguments: argparse.Namespace) -> tuple[RecordedScene, Any, str]:
    """Rebuild the recording with its model, and estimate the force that the model lacks."""
    import math

    from sim.identify.counterfactual import missing_force
    from sim.identify.experiment import read
    from sim.identify.identify import identify
    from sim.identify.recorded_scene import rebuild

    name = arguments.model
    if name in (None, "declared"):
        try:
            return rebuild(arguments.file), None, "declared"
        except ValueError:
            if name is not None:
                raise
    if name is not None and Path(name).suffix in (".yaml", ".yml"):
        device, noise = _device(Path(name))
    else:
        source = arguments.file if name in (None, "identified") else Path(name)
        found = identify(read(source))
        device, noise = _modelled(found, arguments.file), found.residual
        name = name or "identified"
        if source == arguments.file and not found.held and noise < max(found.encoder.value or 0.0, EXPLAINED):
            # The model explains the recording to an encoder step: nothing else moved the device.
            return rebuild(arguments.file, device), None, name
    recorded = rebuild(arguments.file, device)
    rounding = (device.resolution or noise) / math.sqrt(12.0)
    return recorded, missing_force(recorded, rounding), str(name)


def _device(path: Path) -> tuple[DeviceModel, float]:
    from nodes.parameters.store import convert
    from nodes.parameters.yaml_io import read_yaml
    from sim.device.model import DeviceModel

    model: DeviceModel = convert(read_yaml(path), DeviceModel, path.stem)
    return model, model.resolution or 1e-6


def _modelled(found: Any, recording: Path) -> DeviceModel:
    """Put the identified device where the recording begins, its weight with it."""
    import msgspec

    from sim.device.model import DeviceModel
    from sim.identify.experiment import read
    from sim.identify.identify import initial_state
    from sim.identify.report import device_parameters

    position, velocity = initial_state(read(recording, found.axis), found)
    load = 0.0 if found.load.value is None or found.held else found.load.value
    start = {"position": position, "velocity": velocity, "gravity": -load / found.mass.known()[0]}
    return msgspec.convert({**device_parameters(found), **start}, DeviceModel)


def _text(figures: dict[str, Any]) -> str:
    steps = figures["self_error_steps"]
    error = f"{figures['self_error_m'] * 1e6:.3g} µm" + ("" if steps is None else f" = {steps:.3g} encoder steps")
    lines = [
        f"{figures['recording']}: device {figures['model']}, {'lockstep' if figures['lockstep'] else 'real time'}",
        f"  the recorded law replayed differs from what was recorded by at most {error}",
    ]
    for name in ("recorded", "predicted"):
        told = figures[name]
        state = "settles" if told["settled"] else "does not settle"
        lines.append(
            f"  {name:9} {state}, peak {told['peak_force_n']:.4g} N, rests at {told['rest_m']:.6g} m (± {error})"
        )
    lines.append("  predicted for " + ", ".join(f"{key} {value}" for key, value in figures["law"].items()))
    if figures["left_out"]:
        lines.append(f"  not replayed: {', '.join(figures['left_out'])}")
    return "\n".join(lines)


def _draw(path: Path, recorded: RecordedScene, same: Felt, other: Felt) -> None:
    import numpy as np
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    time = np.arange(len(recorded.position)) * recorded.scene.scene.period
    top.plot(time, 1e3 * recorded.position, "k", lw=2.5, alpha=0.3, label="recorded")
    for felt, label in ((same, "same law replayed"), (other, "predicted")):
        top.plot(time, 1e3 * felt.measured, lw=0.9, label=label)
        bottom.plot(time, felt.force, lw=0.9)
    top.set(ylabel="position [mm]")
    bottom.set(xlabel="time [s]", ylabel="force [N]")
    top.legend(fontsize=8)
    figure.savefig(path, dpi=120)
