"""Sound of the loop on a laptop: a ring, a knock, a clean contact, a constant force."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nodes.view
from tests.support.in_node import node

pytestmark = [pytest.mark.process, pytest.mark.smoke]

RATE, T = 48_000, 0.002
# what a loudspeaker of a laptop plays [Hz]
AUDIBLE = 150.0

_RUN = """
import { readFileSync } from "node:fs";
import { Voice } from "./voice.mjs";
const found = {};
for (const [name, forces] of Object.entries(JSON.parse(readFileSync(process.argv[2], "utf8")))) {
  const voice = new Voice(48000), sound = [], block = new Float32Array(480);
  // As on the page: ten milliseconds of force, then ten of sound.
  for (let k = 0; k + 5 <= forces.length; k += 5) {
    const now = forces.slice(k, k + 5);
    voice.feed(now.map((_, n) => (k + n) * 0.002), now);
    voice.fill(block);
    sound.push(...block);
  }
  found[name] = sound;
}
console.log(JSON.stringify(found));
"""


@pytest.fixture(scope="module")
def sounds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("voice")
    source = Path(nodes.view.__file__).with_name("web") / "voice.js"
    (folder / "voice.mjs").write_text(
        source.read_text(encoding="utf-8"), encoding="utf-8"
    )
    (folder / "run.mjs").write_text(_RUN, encoding="utf-8")
    time = np.arange(0.0, 2.0, T)
    rise = np.clip((time - 0.5) / 0.5, 0.0, 1.0)
    forces = {
        "ring": 1.5 + 1.5 * np.sin(2.0 * np.pi * 21.0 * time),
        "contact": 1.5 * rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2),
        "knock": np.where((time > 1.0) & (time < 1.008), 3.0, 0.0),
        "constant": np.full(len(time), 2.0),
    }
    (folder / "forces.json").write_text(
        json.dumps({name: one.tolist() for name, one in forces.items()}),
        encoding="utf-8",
    )
    done = subprocess.run(
        [node(), str(folder / "run.mjs"), str(folder / "forces.json")],
        capture_output=True,
        text=True,
        check=True,
    )
    return {name: np.array(sound) for name, sound in json.loads(done.stdout).items()}


def level(sound: Any) -> float:
    """Return the root mean square of the last second, from which the start has gone."""
    return float(np.sqrt(np.mean(sound[-RATE:] ** 2)))


def test_a_ring_is_heard_on_a_laptop_and_moves_like_a_siren(
    sounds: dict[str, Any],
) -> None:
    ring = sounds["ring"][-RATE:]
    power = np.abs(np.fft.rfft(ring * np.hanning(len(ring)))) ** 2
    frequency = np.fft.rfftfreq(len(ring), 1.0 / RATE)
    assert power[frequency > AUDIBLE].sum() > 0.99 * power.sum()
    assert level(ring) > 0.1
    # Crossings of zero are dense and sparse by turns: the pitch goes up and down.
    crossings = np.nonzero(np.diff(np.signbit(ring)))[0]
    pitch = 0.5 * RATE / np.diff(crossings)
    assert pitch.max() > 1.5 * pitch.min()


def test_a_knock_is_a_click(sounds: dict[str, Any]) -> None:
    loud = np.nonzero(np.abs(sounds["knock"]) > 0.05)[0]
    assert len(loud) > 0
    # 8 ms of force; the tone then dies away within some 100 ms.
    assert (loud[-1] - loud[0]) / RATE < 0.15


def test_a_clean_contact_is_soft_and_a_constant_force_silent(
    sounds: dict[str, Any],
) -> None:
    begin, end = round(0.5 * RATE), round(1.1 * RATE)
    contact = float(np.sqrt(np.mean(sounds["contact"][begin:end] ** 2)))
    assert 0.0 < contact < 0.2 * level(sounds["ring"])
    assert level(sounds["constant"]) < 1e-6


def test_it_never_exceeds_full_scale(sounds: dict[str, Any]) -> None:
    assert max(float(np.abs(sound).max()) for sound in sounds.values()) <= 1.0
