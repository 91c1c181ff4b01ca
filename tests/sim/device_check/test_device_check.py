"""The device check on emulators: a user who answers, moves the handle, and reports."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.devices import Bench, bench, real_devices
from tests.support.launching import HAPTIC, haptic, typed_in, wait_for

MOVES = {
    "away from you": (0.05, 0.0, 0.0),
    "to the left": (0.0, 0.05, 0.0),
    "upwards, hold": (0.0, 0.0, 0.05),
}


@pytest.fixture(params=sorted(real_devices()))
def stand(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    with bench(request.param, tmp_path) as made:
        yield made


def words(stand: Bench, **given: Any) -> list[str]:
    """Return its parameters as command-line words."""
    parameters = {**stand.parameters, **given}
    return [
        f"{stand.section}.{name}:={json.dumps(value)}"
        for name, value in parameters.items()
    ]


def felt(stand: Bench, question: str) -> str:
    """Answer a question like a cooperative user."""
    w = stand.world.state
    for way, move in MOVES.items():
        if way in question:
            w.position[:] = [a + b for a, b in zip(w.position, move, strict=True)]
    if "Hold the handle loosely" in question:
        # A hand: heavy, and slow.
        w.mass, w.damping, w.largest, w.free_from = 1.0, 100.0, 0.0, 0.0
        return "y"
    if "Did it push" in question:
        asked = float(question.split(" N?")[0].split()[-1])
        return "y" if w.largest > 0.9 * asked else "n"
    return ""


def checked(
    stand: Bench,
    folder: Path,
    answer: Callable[[Bench, str], str],
    *more: str,
    **given: Any,
) -> tuple[int, str, str]:
    """Run `haptic device check` with answers; return exit code, output and questions."""
    command = [*HAPTIC, "device", "check", stand.kind, *words(stand, **given), *more]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, "NO_COLOR": "1"},
    )
    assert process.stdin
    assert process.stdout
    assert process.stderr
    said = ""
    line = ""
    with process:
        while letter := process.stderr.read(1):
            line += letter
            if line.endswith((": ", "] ")):
                said += line
                # A question ends so, a line of facts does not.
                if "Enter" in line or "[y/n]" in line:
                    process.stdin.write(f"{answer(stand, line)}\n")
                    process.stdin.flush()
                    line = ""
            elif line.endswith("\n"):
                said += line
                line = ""
        return process.wait(timeout=30), process.stdout.read(), said + line


@pytest.mark.slow
def test_check_ends_with_a_line_to_paste(stand: Bench, tmp_path: Path) -> None:
    stand.world.state.resolution = 2e-5
    stand.world.state.peak = 8.0
    code, out, said = checked(stand, tmp_path, felt)
    assert code == 0, said
    line = out.strip().splitlines()[-1]
    assert line.startswith(f"haptic device check {stand.kind}: ")
    assert "right" in line
    assert (
        "0.1 N felt, 1 N felt, 8 N felt" in line
        or "0.1 N felt, 1 N felt, 7.9 N felt" in line
    )
    assert re.search(r"\d+ samples/s of 1000, \d+ missed, longest gap", line)
    assert re.search(
        r"force to effect \d+\.\d ± \d+\.\d ms \(95 %, \d+ pulses\)$", line
    )
    assert stand.world.state.broken == 0
    assert not any(stand.world.force())


@pytest.mark.slow
def test_check_finds_wrong_axes_before_any_force(tmp_path: Path) -> None:
    with bench("inverse3_driver", tmp_path) as stand:
        code, _, said = checked(
            stand, tmp_path, felt, 'mapping.axes:=["+x", "+y", "+z"]'
        )
        assert code == 1
        assert 'mapping: {axes: ["+y", "-x", "+z"]}' in said
        assert stand.world.state.largest == 0.0
        # As it says, it is right.
        code, out, said = checked(
            stand, tmp_path, felt, 'mapping.axes:=["+y", "-x", "+z"]', "--json"
        )
        assert code == 0, said
        assert json.loads(out.splitlines()[-1])["axes_right"] is True


@pytest.mark.process
@pytest.mark.parametrize(
    ("move", "told"),
    [
        ((0.0, -0.05, 0.0), "a mirror of the scene"),
        ((0.05, 0.0, 0.0), "each of x, y and z must stand in it once"),
    ],
)
def test_a_handle_that_is_moved_otherwise_gives_no_axes(
    move: tuple[float, float, float], told: str, tmp_path: Path
) -> None:
    """Right instead of left, or forward again: no valid mapping exists, so none is offered."""

    def otherwise(stand: Bench, question: str) -> str:
        if "to the left" not in question:
            return felt(stand, question)
        w = stand.world.state
        w.position[:] = [a + b for a, b in zip(w.position, move, strict=True)]
        return ""

    with bench("inverse3_driver", tmp_path) as stand:
        code, _, said = checked(
            stand, tmp_path, otherwise, 'mapping.axes:=["+x", "+y", "+z"]'
        )
        assert code == 1
        assert told in said
        assert "left is your left" in said
        assert "Set mapping" not in said
        assert stand.world.state.largest == 0.0


@pytest.mark.process
def test_no_force_is_explained(tmp_path: Path) -> None:
    with bench("force_dimension_driver", tmp_path) as stand:
        stand.world.state.cause = 1
        code, out, said = checked(stand, tmp_path, felt)
        assert code == 1
        assert "the device's FORCE button is off: press it" in said
        assert "0.1 N NOT felt" in out


@pytest.mark.process
def test_a_handle_that_flies_off_is_let_go(tmp_path: Path) -> None:
    def light(stand: Bench, question: str) -> str:
        answer = felt(stand, question)
        stand.world.state.mass, stand.world.state.damping = 0.02, 0.0
        return answer

    with bench("touch_driver", tmp_path) as stand:
        code, _, said = checked(stand, tmp_path, light)
        assert code == 1
        assert "let go: the handle moved at" in said
        assert not any(stand.world.force())


@pytest.mark.process
def test_yes_to_everything_pushes_nobody(tmp_path: Path) -> None:
    """`yes | haptic device check`: nobody moved the handle, so nobody is there."""
    with bench("touch_driver", tmp_path) as stand:
        code, _, said = checked(stand, tmp_path, lambda *_: "y")
        assert code == 1
        assert "the position changed by +0, +0, +0 mm" in said
        assert stand.world.state.largest == 0.0
        refused = typed_in(
            tmp_path, "device", "check", stand.kind, *words(stand), "--yes", code=2
        )
        assert "--yes" in refused.stderr


def test_nobody_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with bench("touch_driver", tmp_path) as stand, open(os.devnull) as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        done = typed_in(tmp_path, "device", "check", stand.kind, *words(stand), code=2)
        assert "no answer" in done.stderr
        assert (stand.world.state.open, stand.world.state.forces) == (0, 0)


@pytest.mark.process
def test_info_and_free(stand: Bench, tmp_path: Path) -> None:
    told = json.loads(
        haptic(
            tmp_path, "device", "info", stand.kind, *words(stand), "--json"
        ).stdout.splitlines()[-1]
    )
    assert told["facts"]["serial"] in ("1234", "04BA")
    assert told["limits"]["hold"] > 0.0
    if stand.kind == "force_dimension_driver":
        # The stand-in is half as heavy again to the operator, which is x here, too.
        assert [one["mass_kg"] for one in told["edge"]["axes"]] == pytest.approx(
            [0.15, 0.1, 0.1]
        )
        stiffest = [one["k_max_n_per_m"] for one in told["edge"]["axes"]]
        assert stiffest[1] == stiffest[2] != stiffest[0]
        assert (
            "no process holds it"
            in haptic(tmp_path, "device", "free", stand.kind, *words(stand)).stdout
        )
        done = haptic(
            tmp_path,
            "device",
            "info",
            stand.kind,
            f"{stand.section}.nonsense:=1",
            code=2,
        )
        assert "nonsense" in done.stderr
    wait_for(lambda: stand.world.state.open == 0, "it is given back")


@pytest.mark.process
def test_free_names_who_holds_the_device(tmp_path: Path) -> None:
    with bench("touch_driver", tmp_path) as stand:
        path = stand.parameters["library"]
        code = f"import ctypes, sys; ctypes.CDLL({path!r}); print(1, flush=True); sys.stdin.read()"
        holder = subprocess.Popen(
            ["python3", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        with holder:
            assert holder.stdout
            assert holder.stdin
            holder.stdout.readline()
            done = haptic(tmp_path, "device", "free", stand.kind, *words(stand), code=1)
            holder.stdin.close()
        assert f"held by process {holder.pid}: " in done.stderr
