"""Replay a recording with another law: what the recorded hand and device would have felt."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from messages.errors import RefusedError, UsageError
from nodes.cli.main import add_json
from nodes.launcher.scenario_files import parse_assignments
from nodes.parameters.store import ParameterError, convert
from nodes.parameters.yaml_io import read_yaml
from nodes.recording.figure_style import INK, new_figure, styled
from nodes.recording.writer import RecordError
from sim.cli.answers import report

if TYPE_CHECKING:
    from sim.device.model import DeviceModel
    from sim.identify.counterfactual import Felt
    from sim.identify.recorded_scene import RecordedScene

# a smaller residual counts as explained even if the encoder is finer [m]
EXPLAINED = 1e-5


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("file", type=Path, help="recording of a launch")
    parser.add_argument(
        "assignments",
        nargs="*",
        metavar="name:=value",
        help="law:=NAME or a description, and its parameters",
    )
    parser.add_argument(
        "--model",
        help=(
            "the device: declared (as the virtual device was), identified (from this recording), a"
            " recording to identify it from, or a YAML file of a device (default: declared where"
            " there is one, else identified)"
        ),
    )
    parser.add_argument("--out", type=Path, metavar="PNG", help="also draw both runs")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replay the same law, then the other."""
    import numpy as np

    from sim.identify.counterfactual import nudges, replay
    from sim.identify.recorded_scene import another_law, refuse_law

    try:
        given = parse_assignments(arguments.assignments)
        if given:
            refuse_law(arguments.file, given)
        recorded, external, model = _prepared(arguments)
        # A declared device has no missing force.
        nudged = None if model == "declared" else nudges(recorded, external)
        same = replay(recorded, None, external, nudged)
        alone = same if nudged is None else replay(recorded, None, external)
        law, described = another_law(recorded, given)
    except ParameterError:
        raise
    except (RecordError, OSError) as error:
        raise UsageError(str(error)) from error
    except ValueError as error:
        raise RefusedError(str(error)) from error
    other = replay(recorded, law, external, nudged) if given else same
    device, nudge = (
        recorded.scene.scene.device,
        np.zeros(1) if nudged is None else nudged[:, 0],
    )
    figures: dict[str, Any] = {
        "recording": str(recorded.path),
        "model": model,
        "lockstep": recorded.lockstep,
        "ticks": len(recorded.position),
        "ticks_recorded": recorded.recorded_ticks,
        "nudges": {
            "ticks": int(np.count_nonzero(nudge)),
            "largest_m": float(np.max(np.abs(nudge))),
        },
        "hand": None if external is None else "spring" if device.hand else "force",
        "law": described,
        "left_out": list(recorded.left_out),
    }
    for name, felt in (("self", same), ("model", alone)):
        off = float(np.max(np.abs(felt.measured - recorded.position)))
        figures[f"{name}_error_m"] = off
        figures[f"{name}_error_steps"] = (
            None if device.resolution is None else off / device.resolution
        )
    for name, felt in (("recorded", same), ("predicted", other)):
        figures[name] = {
            "settled": felt.settled,
            "peak_force_n": felt.peak_force,
            "rest_m": felt.rest,
        }
    if arguments.out is not None:
        _draw(arguments.out, recorded, same, other)
        figures["plot"] = str(arguments.out)
    return report(arguments, figures, _text(figures))


def _prepared(arguments: argparse.Namespace) -> tuple[RecordedScene, Any, str]:
    """Rebuild the recording with its model; estimate the force missing in the model."""
    from sim.device.model import DeviceModel
    from sim.identify.counterfactual import missing_force
    from sim.identify.experiment import read
    from sim.identify.identify import identify
    from sim.identify.recorded_scene import rebuild
    from sim.play.launched import NotOneAxisError

    name = arguments.model
    if name in (None, "declared"):
        try:
            return rebuild(arguments.file), None, "declared"
        except NotOneAxisError:
            raise  # no model of the device makes it one
        except ValueError:
            if name is not None:
                raise
    if name is not None and Path(name).suffix in (".yaml", ".yml"):
        device = convert(read_yaml(Path(name)), DeviceModel, Path(name).stem)
        noise = 1e-6
    else:
        source = arguments.file if name in (None, "identified") else Path(name)
        found = identify(read(source))
        device, noise = _modelled(found, arguments.file), found.residual
        name = name or "identified"
        if (
            source == arguments.file
            and not found.held
            and noise < max(found.encoder.value or 0.0, EXPLAINED)
        ):
            # The model explains the recording to an encoder step, so no other force moved the
            # device.
            return rebuild(arguments.file, device), None, name
    recorded = rebuild(arguments.file, device)
    rounding = (device.resolution or noise) / math.sqrt(12.0)
    return recorded, missing_force(recorded, rounding), str(name)


def _modelled(found: Any, recording: Path) -> DeviceModel:
    """Place the identified device, with its weight, where the recording begins."""
    from sim.device.model import DeviceModel
    from sim.identify.experiment import read
    from sim.identify.identified_text import device_parameters
    from sim.identify.identify import initial_state

    position, velocity = initial_state(read(recording, found.axis), found)
    load = 0.0 if found.load.value is None or found.held else found.load.value
    start: dict[str, Any] = {
        "position": position,
        "velocity": velocity,
        "gravity": -load / found.mass.known()[0],
    }
    if found.held and found.stiffness.value:
        # The hand pulls to a fixed point; its motion is part of the missing force.
        start["hand"] = {"stiffness": found.stiffness.value, "path": [(0.0, 0.0)]}
    return msgspec.convert({**device_parameters(found), **start}, DeviceModel)


def at_most(metres: float) -> str:
    """Write a largest difference; below a picometre only rounding is left."""
    return "0 µm" if metres == 0.0 else f"{max(1e-6, metres * 1e6):.3g} µm"


def _text(figures: dict[str, Any]) -> list[str]:
    def error(name: str) -> str:
        steps = figures[f"{name}_error_steps"]
        return at_most(figures[f"{name}_error_m"]) + (
            "" if steps is None else f" = {steps:.3g} encoder steps"
        )

    lines = [
        (
            f"{figures['recording']}: device {figures['model']},"
            f" {'lockstep' if figures['lockstep'] else 'real time'}"
        ),
        f"  the recorded law replayed differs from what was recorded by at most {error('self')}",
    ]
    if figures["ticks"] < figures["ticks_recorded"]:
        whole = figures["ticks_recorded"]
        lines.append(
            f"  only the first {figures['ticks']} of {whole} ticks: the driver slept through the"
            " next one"
        )
    nudges = figures["nudges"]
    if nudges["ticks"]:
        lines.append(
            f"  the model was nudged at {nudges['ticks']} ticks, by at most"
            f" {nudges['largest_m'] * 1e6:.2g} µm; without that it differs by {error('model')}"
        )
    for name in ("recorded", "predicted"):
        row = figures[name]
        state = "settles" if row["settled"] else "does not settle"
        lines.append(
            f"  {name:9} {state}, peak {row['peak_force_n']:.4g} N, rests at {row['rest_m']:.6g} m"
            f" (± {error('model')})"
        )
    lines.append(
        "  predicted for "
        + ", ".join(f"{key} {value}" for key, value in figures["law"].items())
    )
    if figures["hand"] == "force":
        yielding = "one that yields needs hand: {stiffness: K} in --model's YAML"
        lines.append(f"  the hand is replayed as its recorded force; {yielding}")
    if figures["left_out"]:
        lines.append(f"  not replayed: {', '.join(figures['left_out'])}")
    return lines


@styled
def _draw(path: Path, recorded: RecordedScene, same: Felt, other: Felt) -> None:
    import numpy as np

    figure = new_figure(9.0, 5.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    time = np.arange(len(recorded.position)) * recorded.scene.scene.period
    top.plot(
        time,
        1e3 * recorded.position,
        color=INK,
        ls="-",
        lw=2.5,
        alpha=0.3,
        label="recorded",
    )
    for felt, label in ((same, "same law replayed"), (other, "predicted")):
        top.plot(time, 1e3 * felt.measured, lw=0.9, label=label)
        bottom.plot(time, felt.force, lw=0.9)
    top.set(ylabel="position  [mm]")
    bottom.set(xlabel="time  [s]", ylabel="force  [N]")
    top.legend()
    figure.savefig(path, dpi=150)
