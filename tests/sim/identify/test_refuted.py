"""A recording that refutes the device model: file, exit code, and no designed law."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.cli.main import main
from nodes.recording.writer import RecordWriter
from sim.device.model import DeviceModel
from sim.lab.monte_carlo.virtual import excite_outside
from sim.play.nonideal import NonidealDevice

T = 0.002
RIGID = DeviceModel(mass=0.1, damping=1.0, friction=0.03, delay=1.2, resolution=23e-6)


def recorded(folder: Path, device: NonidealDevice) -> Path:
    """Push a device and return a driver's states, each with the force of the tick before."""
    run = excite_outside(device, T, 4.0, seed=1)
    path = folder / "push.mcap"
    with RecordWriter(path, {"rate_hz": str(1.0 / T), "pace": "lockstep"}) as writer:
        for seq, (position, force) in enumerate(
            zip(run.position, [0.0, *run.force[:-1]], strict=True)
        ):
            held = (float(force), 0.0, 0.0)
            place = (float(position), 0.0, 0.0)
            state = DeviceState(
                seq=seq,
                stamp=seq * T,
                position=place,
                force=held,
                mean_force=held,
                force_seq=seq - 1,
            )
            writer.write(DEVICE_STATE, state, state.stamp)
    return path


@pytest.fixture(scope="module")
def cogging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the recording of a motor whose force repeats with its poles."""
    return recorded(
        tmp_path_factory.mktemp("cogging"), NonidealDevice(RIGID, cogging=0.05)
    )


def identified(
    path: Path, capsys: pytest.CaptureFixture[str], code: int
) -> dict[str, Any]:
    assert main(["study", "identify", str(path), "--json"]) == code
    told: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return told


def test_a_device_that_the_model_fits_is_identified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = identified(recorded(tmp_path, NonidealDevice(RIGID)), capsys, code=0)
    assert not told["refuted"]
    assert told["mass_kg"]["low"] < 0.1 < told["mass_kg"]["high"]


def test_a_refuted_recording_tells_no_figure_and_no_law_is_designed_on_it(
    cogging: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Mass and damping had 95 % intervals, and a law was designed on them."""
    told = identified(cogging, capsys, code=1)
    assert told["refuted"]
    assert "a force that repeats" in told["why"]
    assert told["mass_kg"]["value"] is told["damping_n_s_per_m"]["value"] is None
    tuning = tmp_path / "tuning"
    tuning.mkdir()
    known = {
        "identified": {**told, "stopped": "done"},
        "limits": {"peak_n": 3.3, "slew_n": None},
    }
    (tuning / "tune.json").write_text(json.dumps(known))
    words = [
        "tune",
        "--steps",
        "design",
        "--taps",
        "2",
        "--no-land",
        "--out",
        str(tuning),
        "--json",
    ]
    assert main(words) == 1
    refused = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "designed" not in refused
    assert refused["headline"].startswith("No law: ")
    assert "a force that repeats" in refused["headline"]
    assert list(tuning.glob("*.yaml")) == []
    # Told to, it designs, and says on what.
    assert main([*words, "--refuted"]) == 0
    designed = json.loads(capsys.readouterr().out.splitlines()[-1])["designed"]
    assert "a force that repeats" in designed["model_refuted"]
