"""A recording of version 0.1.0, made before the modules moved into rooms, is read by every verb of ``haptic bag``.

It is 0.3 s of floor_swap in lockstep, as that version wrote it: stamps on the monotonic clock, no list of who publishes what.
"""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest

from nodes.cli import main
from nodes.recording.reader import Recording
from tests.support import FIXTURES


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return Path(shutil.copy(FIXTURES / "recordings" / "floor_swap_0.1.0.mcap", tmp_path))


def test_info_accounts_for_every_message(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["bag", "info", str(old), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    # Ticks 0 to 149, and the state after the last one.
    assert found["topics"]["/device/state"]["messages"] == 151
    assert found["lost"] == 0
    assert found["recovered"] is False


def test_arrays_hold_the_drop(old: Path) -> None:
    states = Recording(old).arrays("/device/state")
    assert list(states["seq"]) == list(range(151))
    height = states["position"][:, 2]
    # Free fall under 9.81 m/s² and 1 N s/m on 0.1 kg: z = h − g τ (t − τ (1 − e^{−t/τ})), τ = m/b, to rounding of 10 mm.
    assert height[0] == 0.01
    t, tau = 10 * 0.002, 0.1
    assert height[10] == pytest.approx(0.01 - 9.81 * tau * (t - tau * (1.0 - math.exp(-t / tau))), abs=1e-15)


@pytest.mark.parametrize(
    ("words", "made"),
    [
        (("export", "--out", "tables"), "tables/ticks.csv"),
        (("plot", "--out", "drop.png"), "drop.png"),
        (("recover", "--out", "copy.mcap"), "copy.mcap"),
    ],
)
def test_it_is_exported_drawn_and_copied(
    words: tuple[str, ...], made: str, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(old.parent)
    assert main.main(["bag", words[0], str(old), *words[1:]]) == 0
    assert (old.parent / made).stat().st_size > 1000


def test_a_word_that_has_another_meaning_now_is_refused_with_what_to_write(
    old: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["bag", "replay", str(old), "law:=pd", "--model", "declared"]) == 2
    assert "write 'unlimited' for that" in capsys.readouterr().err
