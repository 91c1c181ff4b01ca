"""Studies with sweeps by their verbs on the smallest grids; the judge of tuned devices."""

from __future__ import annotations

import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import yaml

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.recording.writer import RecordWriter
from nodes.stability.k_max import k_max
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.lab.monte_carlo.outside import summary_outside
from sim.lab.monte_carlo.tuned import summary, true_edge, true_radius
from sim.lab.monte_carlo.virtual import KINDS, draw
from sim.lab.studies.price import possible_joints
from sim.measure.jobs import program, read_ledger
from sim.play.nonideal import NonidealDevice
from sim.tune.knocking import scaled
from tests.support.launching import exit_code
from tests.support.pictures import assert_drawn

T = 0.002


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the jobs in this process: tests/sim/measure tests the pools."""
    monkeypatch.setattr("sim.studies.sweeps.executor", lambda _: ThreadPoolExecutor(1))


def study(
    capsys: pytest.CaptureFixture[str], folder: Path, *words: str, code: int = 0
) -> dict[str, Any]:
    assert main(["lab", *words, "--out", str(folder), "--json"]) == code
    told: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return told


@pytest.mark.slow
def test_a_joint_that_nobody_knows_of_costs_the_wall(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("price", "--no-land", "--hand", "0", "--known")
    told = study(capsys, tmp_path, *words)
    (rigid,) = told["rows"]
    # Stable on the device that is believed in; on the one that is there nothing settles.
    assert rigid["radius"] > 1.0
    assert rigid["drops_settled"] == "0 of 12"
    # What was done before is only read, whatever is asked besides (tests/sim/design/test_beyond.py
    # designs for a joint).
    (job,) = (
        json.loads(line)["job"]
        for line in Path(told["ledger"]).read_text(encoding="utf-8").splitlines()
    )
    taps = [3000.0, -2042.0]
    row = {
        "h1_n_per_m": 958.0,
        "radius": 0.988,
        "drops_settled": "12 of 12",
        "certified": True,
        "taps_n_per_m": taps,
    }
    put(Path(told["ledger"]), {**job, "spread": 1.2}, row)
    assert main(["lab", *words, "20", "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert re.search(
        r"believed rigid .* UNSTABLE, pole radius 1\.\d+, 0 of 12 drops settle, NOT certified",
        text,
    )
    assert re.search(
        r"joint to 20 % .* 958  stable, 12 of 12 drops settle; taps 3000, -2042$",
        text,
        re.MULTILINE,
    )
    # The laws as a file that a coupling takes; what is for any hand is softer than for any world,
    # and both are proven.
    laws = yaml.safe_load((tmp_path / "price.yaml").read_text(encoding="utf-8"))[
        "coupling"
    ]["laws"]
    assert laws["joint_20_poles_free"]["taps"] == taps
    worlds = {row["world"]: row for row in told["worlds"]}
    assert worlds["any_hand"]["h1_n_per_m"] < worlds["any_world"]["h1_n_per_m"]
    assert all(row["proven"] for row in told["worlds"])
    assert laws["any_hand"]["taps"] == pytest.approx(worlds["any_hand"]["taps_n_per_m"])
    assert (tmp_path / "price.png").stat().st_size > 10_000
    assert len(read_ledger(Path(told["ledger"]))) == 2


@pytest.mark.parametrize("words", [("--share", "1"), ("--taps", "0"), ("--taps", "13")])
def test_a_device_that_cannot_be_has_no_price(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    assert exit_code("lab", "price", *words, "--out", str(tmp_path)) == 2


def recorded(folder: Path, delay: float) -> Path:
    """Write a run whose forces have a given delay [ticks]."""
    path = folder / "run.mcap"
    with RecordWriter(path, {"rate_hz": str(1.0 / T), "pace": "realtime"}) as writer:
        for seq in range(200):
            state = DeviceState(
                seq=seq,
                stamp=seq * T,
                position=(0.0, 0.0, 0.0),
                force_seq=seq - 1,
                delay=delay,
            )
            writer.write(DEVICE_STATE, state, state.stamp)
    return path


@pytest.mark.slow
def test_relatives_are_judged_at_the_delay_that_was_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("relatives", "--families", "pd", "Maxwell", "passive FIR", "--mass", "0.1")
    late = study(capsys, tmp_path, *words, "--from-run", str(recorded(tmp_path, 1.3)))
    assert_drawn(late["plot"], "stiffness felt at rest", "H(1) = 0")
    assert late["delay_ticks"] == pytest.approx(1.3)
    pd, maxwell, passive = late["rows"]
    assert maxwell["h1_n_per_m"] == 0.0
    # Passive whatever hand holds it is what nearly all the stiffness of a tuned law is not.
    assert (pd["passive"], passive["passive"]) == (False, True)
    assert passive["damping_needed_n_s_per_m"] == pytest.approx(1.0, rel=1e-6)
    # No law at all is passive beyond 2b/(T(1 + d)): at a fraction of a tick as at the whole one
    # below it.
    assert 2.0 / (T * (1.0 + 2.3)) < passive["h1_n_per_m"] < 2.0 / (T * (1.0 + 1.0))
    soon = study(capsys, tmp_path, *words, "--delay", "1")
    for before, after in zip(soon["rows"], late["rows"], strict=True):
        assert (
            before["h1_n_per_m"] > after["h1_n_per_m"] or before["family"] == "Maxwell"
        )
    assert len(read_ledger(Path(late["ledger"]))) == 6
    assert main(["lab", "relatives", "--damping", "0", "--out", str(tmp_path)]) == 2
    assert (
        main(
            [
                "lab",
                "relatives",
                "--from-run",
                str(tmp_path / "none.mcap"),
                "--out",
                str(tmp_path),
            ]
        )
        == 2
    )


@pytest.mark.slow
def test_coverage_outside_counts_what_is_said_of_devices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = study(
        capsys, tmp_path, "coverage", "--outside", "--devices", "1", "--seconds", "3"
    )
    assert told["devices"] == 1
    (kind,) = told["kinds"]
    assert kind == next(iter(KINDS))
    one = told["kinds"][kind]
    assert (
        sum(one[word] for word in ("rigid", "richer", "reported", "refused", "false"))
        == 1
    )
    (row,) = read_ledger(Path(told["ledger"])).values()
    assert row["refuted"] or row["off"]
    assert main(["lab", "coverage", "--outside", "--tune", "--out", str(tmp_path)]) == 2


def outside(kind: str, off: float = 0.5, refuted: bool = False) -> dict[str, Any]:
    """Return what a study stores of one device."""
    return {
        "kind": kind,
        "refuted": refuted,
        "why": "",
        "terms": [],
        "remainder": "",
        "k_max_off": 0.001,
        "residual_steps": 0.29,
        "whiteness": 1.0,
        "off": {} if refuted else {"mass": off},
    }


def put(ledger: Path, job: dict[str, Any], row: dict[str, Any]) -> None:
    with open(ledger, "a", encoding="utf-8") as file:
        file.write(json.dumps({"job": job, "row": row, "program": program()}) + "\n")


@pytest.mark.parametrize(("wrong", "code"), [(0, 0), (3, 0), (6, 1)])
def test_false_certainty_beyond_chance_is_a_failure(
    wrong: int, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Of 32 devices: at most 5 % may be false, and 3 are still chance (binomial tail 0.21), 6 are
    # not (0.005).
    for number in range(32):
        kind = list(KINDS)[number % len(KINDS)]
        job = {
            "kind": kind,
            "number": number // len(KINDS),
            "seed": 1,
            "seconds": 8.0,
            "rate": 500.0,
        }
        put(
            tmp_path / "coverage_outside.jsonl",
            job,
            outside(kind, 2.5 if number < wrong else 1.5),
        )
    told = study(
        capsys, tmp_path, "coverage", "--outside", "--devices", "32", code=code
    )
    assert (told["false"], told["missed"]) == (wrong, 32)


@pytest.mark.parametrize(("needless", "code"), [(0, 0), (3, 0), (9, 1)])
def test_needless_refusal_beyond_chance_is_a_failure(
    needless: int, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Of 32 devices whose fit serves: at most 10 % may be refused, and 3 are still chance, 9 are not
    # (binomial tail 0.004).
    for number in range(32):
        kind = list(KINDS)[number % len(KINDS)]
        job = {
            "kind": kind,
            "number": number // len(KINDS),
            "seed": 1,
            "seconds": 8.0,
            "rate": 500.0,
        }
        put(
            tmp_path / "coverage_outside.jsonl",
            job,
            outside(kind, refuted=number < needless),
        )
    told = study(
        capsys, tmp_path, "coverage", "--outside", "--devices", "32", code=code
    )
    assert (told["needless"], told["good"], told["false"]) == (needless, 32, 0)


def test_what_is_refused_is_never_false() -> None:
    kinds = list(KINDS)
    told = summary_outside(
        [
            outside(kinds[0], refuted=True),
            outside(kinds[0], 2.5),
            outside(kinds[1], 0.5),
        ]
    ).total
    assert (told.refused, told.false, told.intervals, told.missed) == (1, 1, 2, 1)


def test_a_ledger_of_another_version_is_not_gone_on_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows of two versions were mixed in one table."""
    words = ("relatives", "--families", "Maxwell", "--mass", "0.1")
    ledger = Path(study(capsys, tmp_path, *words)["ledger"])
    old = ledger.read_text(encoding="utf-8").replace(program(), "0123456789abcdef")
    ledger.write_text(old, encoding="utf-8")
    assert main(["lab", *words, "--out", str(tmp_path)]) == 1
    assert "another version of haptic-nodes" in capsys.readouterr().err
    # Begun anew it is set aside, not lost.
    study(capsys, tmp_path, *words, "--fresh")
    assert program() in ledger.read_text(encoding="utf-8")
    (aside,) = tmp_path.glob("earlier/*/relatives.jsonl")
    assert aside.read_text(encoding="utf-8") == old


# -- who judges the tuned devices
# --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mass", "damping", "delay"), [(0.1, 1.0, 0.0), (0.3, 2.0, 1.0), (0.05, 0.5, 1.4)]
)
@pytest.mark.parametrize("start", [0.3, 3.0])
def test_the_true_edge_of_a_spring_is_its_k_max(
    start: float, mass: float, damping: float, delay: float
) -> None:
    limit = k_max(CompiledLaw((0.0,)), Plant(T, mass, damping, delay)).k_max_n_per_m
    assert limit is not None
    device = NonidealDevice(DeviceModel(mass=mass, damping=damping, delay=delay))
    # From below the edge and from above it; bisected 20 times from steps of 2 %.
    assert true_edge(CompiledLaw((start * limit,)), device, T) == pytest.approx(
        limit, rel=1e-6
    )


def test_a_law_that_is_unstable_far_below_itself_is_judged_from_itself_upwards() -> (
    None
):
    """Searched from below, its limit was 362 N/m, a twelfth of a stable law."""
    law = CompiledLaw(
        (14637.851675576338, -10684.824134320634, -7546.077294457547, 7797.369406764558)
    )
    device = NonidealDevice(draw(2, 1, held=False))
    assert true_radius(scaled(law, 0.2), device, T) > 1.0 > true_radius(law, device, T)
    edge = true_edge(law, device, T)
    assert edge is not None
    assert edge > 1.5 * law.h1
    inside, outside_it = (
        true_radius(scaled(law, share * edge / law.h1), device, T)
        for share in (0.999, 1.001)
    )
    assert inside < 1.0 < outside_it


def test_a_delay_that_jitters_counts_at_its_worst() -> None:
    rigid = DeviceModel(mass=0.1, damping=1.0, delay=1.0)
    law = CompiledLaw((300.0,))
    late, later = (
        true_edge(law, NonidealDevice(rigid, late=late), T) for late in (0.0, 0.7)
    )
    at_worst = true_edge(
        law, NonidealDevice(DeviceModel(mass=0.1, damping=1.0, delay=1.7)), T
    )
    assert None not in (late, later, at_worst)
    assert later == at_worst
    assert (late or 0.0) > (later or 0.0)


def test_a_sensor_that_averages_lowers_the_true_edge() -> None:
    """Without the sensor the judge gave 2347 N/m instead of 1801."""
    rigid, law = (
        DeviceModel(mass=0.1, damping=1.0, delay=1.0),
        CompiledLaw((1500.0, -1000.0)),
    )
    edges = [
        true_edge(law, NonidealDevice(rigid, average=part), T)
        for part in (0.0, 0.25, 0.5)
    ]
    assert None not in edges
    assert edges == sorted(edges, key=lambda edge: -(edge or 0.0))
    # By convolution: two samples averaged are the law's taps, half of them a tick later.
    averaged = CompiledLaw((750.0, 250.0, -500.0))
    assert edges[2] == pytest.approx(
        true_edge(averaged, NonidealDevice(rigid), T), rel=1e-12
    )
    with pytest.raises(ValueError, match="only taps are judged"):
        true_radius(
            CompiledLaw((1.0,), ((1.0, 0.0, -0.5, 0.0),)),
            NonidealDevice(rigid, average=0.5),
            T,
        )


def test_nothing_is_told_of_an_edge_far_above_the_law() -> None:
    assert (
        true_edge(
            CompiledLaw((1.0,)), NonidealDevice(DeviceModel(mass=0.1, damping=1.0)), T
        )
        is None
    )


def device_row(**told: Any) -> dict[str, Any]:
    """Return what a study stores of one tuned device: delivered, with a limit within 2 %."""
    return {
        "kind": "inside the model",
        "refuted": None,
        "holds": True,
        "delivered": True,
        "h1_n_per_m": 1000.0,
        "true_radius": 0.98,
        "edge_n_per_m": 1500.0,
        "edge_between_n_per_m": [1470.0, 1530.0],
        "true_edge_n_per_m": 1510.0,
        "ended": "",
    } | told


@pytest.mark.parametrize(
    ("told", "holds"),
    [
        ({}, True),
        # The interval alone, which holds it.
        ({"edge_n_per_m": None, "edge_between_n_per_m": [1350.0, 1550.0]}, True),
        ({"true_edge_n_per_m": 1560.0}, False),
        ({"edge_n_per_m": None, "true_edge_n_per_m": 1600.0}, False),
        ({"true_radius": 1.01}, False),
        (
            {
                "true_radius": 1.01,
                "holds": False,
                "delivered": False,
                "edge_between_n_per_m": None,
            },
            True,
        ),
    ],
)
def test_an_unstable_delivery_and_a_false_edge_are_failures(
    told: dict[str, Any], holds: bool
) -> None:
    assert summary([device_row(**told)]).held == holds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("told", "code"),
    [
        ({}, 0),
        ({"true_radius": 1.01, "edge_n_per_m": None}, 1),
        (
            {
                "true_radius": 1.01,
                "holds": False,
                "delivered": False,
                "edge_between_n_per_m": None,
            },
            0,
        ),
    ],
)
def test_the_verb_draws_and_fails_as_the_devices_say(
    told: dict[str, Any], code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = {
        "number": 0,
        "kind": "inside the model",
        "seed": 1,
        "seconds": 8.0,
        "rate": 500.0,
        "taps": 4,
        "nyquist": 1e4,
        "land": True,
        "refuted": False,
    }
    put(tmp_path / "tuned.jsonl", job, device_row(**told))
    found = study(capsys, tmp_path, "tuned", "--devices", "1", code=code)
    assert found["devices"] == 1
    assert_drawn(
        found["plot"],
        "unstable from 1",
        "delivered, and unstable" if told == {"true_radius": 1.01} else "+5 %",
    )
    assert main(["lab", "tuned", "--devices", "1", "--out", str(tmp_path)]) == code
    assert "intervals hold the edge" in capsys.readouterr().out


def test_an_edge_is_within_5_percent_or_counted_as_off() -> None:
    rows = [
        device_row(),
        device_row(true_edge_n_per_m=1590.0),
        device_row(edge_n_per_m=None),
    ]
    found = summary(rows)
    assert (found.edges, found.edges_within_5_percent) == (2, 1)
    assert (found.intervals, found.intervals_that_hold_the_edge) == (3, 2)


def test_all_three_numbers_of_a_joint_are_varied() -> None:
    """Nine joints: the declared one and all combinations of factors; or one number alone."""
    job: dict[str, Any] = {
        "share": 0.3,
        "frequency": 40.0,
        "loss": 0.03,
        "spread": 1.5,
        "vary": ["share", "frequency", "loss"],
    }
    joints = possible_joints(job)
    assert len(joints) == 9
    for index, name in enumerate(("share", "frequency", "loss"), 1):
        assert {round(joint[index] / job[name], 9) for joint in joints} == {
            round(1 / 1.5, 9),
            1.0,
            1.5,
        }
    assert len(possible_joints({**job, "vary": ["frequency"]})) == 3
    assert possible_joints({**job, "spread": 1.0}) == ((0.0, 0.3, 40.0, 0.03),)
    assert max(joint[1] for joint in possible_joints({**job, "share": 0.9})) < 1.0
