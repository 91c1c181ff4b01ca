"""Loop rate and delay on the chart: force error and stiffest settling floor of launches.

Each point is a launch of its own: four processes, real time, the force taken from the recording.
The reference is the same drop on a continuous spring and damper (200 kHz, one process, no delay).
The stiffest settling floor is searched downwards from the pole-radius limit at the *measured*
delay.
"""

import math
import statistics
import tempfile
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from nodes.launcher.scenario_files import find
from nodes.laws.pd import PD
from nodes.recording.reader import Recording
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.lab.charts.points import Extra, Group, Point
from sim.measure import measured_launch
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface

RATES = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)
_QUICK_RATES = (500.0, 1000.0)
# Tick modes and force timing; the quick run omits the plain tick.
CHOICES = (
    ("compiled", "on_arrival"),
    ("plain", "on_arrival"),
    ("compiled", "next_tick"),
)
MASS, DAMPING, HEIGHT, GRAVITY = 0.1, 1.0, 0.01, 9.81
STIFFNESS, GAIN = 400.0, 3.0
_SECONDS = 1.0
_ROUNDS = 3
# On a busy machine the number of rounds is limited so that the chart ends in time.
_PATIENCE = 100.0
_TRIES = (0.95, 0.8, 0.65, 0.5)
_FINE = 200_000.0


@dataclass(frozen=True)
class Launched:
    """Rendered force of a launch."""

    figures: dict[str, Any]  # output of ``haptic launch --json``
    # when each force took effect, from tick 0 [s], shape (n,)
    onset: NDArray[np.float64]
    force: NDArray[np.float64]  # the forces [N], shape (n,)
    height: NDArray[np.float64]  # measured height at the ticks [m], shape (n,)
    # Median delay from a sample to the effect of its force [ticks]; infinite if no force was
    # on time.
    delay: float


def launch(
    rate: float,
    apply: str,
    stiffness: float,
    pace: str = "realtime",
    tick: str = "auto",
) -> Launched:
    """Drop the device in a launch."""
    values = {
        "rate": rate,
        "apply": apply,
        "pace": pace,
        "duration": _SECONDS,
        "tick": tick,
    }
    values |= {"stiffness": stiffness, "damping": GAIN, "mass": MASS, "height": HEIGHT}
    with tempfile.TemporaryDirectory(prefix="haptic-chart-") as folder:
        scenario = Path(folder) / "floor_drop.yaml"
        scenario.write_text(yaml.safe_dump(_with_one_law(), sort_keys=False))
        figures = measured_launch.launch(
            str(scenario),
            *(f"{name}:={value}" for name, value in values.items()),
            folder=Path(folder),
        )
        states = Recording(Path(folder) / figures["recording"]).arrays("/device/state")
    period = 1.0 / rate
    seq, answered = states["seq"], states["force_seq"]
    fresh = np.flatnonzero((answered >= 0) & np.append(True, np.diff(answered) > 0))
    late = states["delay"][fresh]
    rows = (
        (answered[fresh] + late) * period,
        states["force"][fresh, 2],
        states["position"][np.argsort(seq), 2],
    )
    onset, force, height = (np.asarray(row, dtype=np.float64) for row in rows)
    return Launched(
        figures, onset, force, height, float(np.median(late)) if len(late) else math.inf
    )


def _with_one_law() -> dict[str, Any]:
    """Return the shipped drop with PD as its only law.

    Other laws would be refused at some of these rates and stiffnesses.
    """
    scenario: dict[str, Any] = yaml.safe_load(find("floor_drop").read_text())
    coupling = scenario["nodes"]["coupling"]["parameters"]
    coupling["laws"] = {"pd": coupling["laws"]["pd"]}
    del scenario["nodes"]["driver"]["parameters"]["safety"]
    return scenario


def continuous(stiffness: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Drop the device on a nearly continuous floor (200 kHz)."""
    device = DeviceModel(mass=MASS, damping=DAMPING, gravity=GRAVITY, position=HEIGHT)
    scene = Scene(
        device=device,
        surface=SceneSurface("plane"),
        period=1.0 / _FINE,
        raw=False,
        clamp=True,
    )
    trace = run(
        scene,
        PD(stiffness=stiffness, damping=GAIN).compile(scene.period),
        round(_SECONDS * _FINE),
    )
    return trace.time, trace.force


def force_error(
    onset: NDArray[np.float64],
    force: NDArray[np.float64],
    time: NDArray[np.float64],
    wanted: NDArray[np.float64],
) -> float:
    """Return the difference of a force held between its onsets from a continuous one."""
    if len(onset) == 0:
        return 1.0
    order = np.argsort(onset, kind="stable")
    index = np.searchsorted(onset[order], time, side="right") - 1
    held = np.where(index >= 0, force[order][np.maximum(index, 0)], 0.0)
    return float(np.sqrt(np.mean((held - wanted) ** 2) / np.mean(wanted**2)))


def calms_down(height: NDArray[np.float64]) -> bool:
    """Return whether the swing in a drop's last fifth is below a tenth of its height.

    This is weaker than the verdict of the drop test.
    """
    end = height[-max(2, len(height) // 5) :]
    return bool(np.isfinite(end).all() and np.ptp(end) < 0.1 * HEIGHT)


def rate_groups(step: Callable[[str], None], quick: bool = False) -> list[Group]:
    """Measure all rates and delays."""
    time, wanted = continuous(STIFFNESS)
    choices = _choices(quick)
    rounds = 1 if quick else _ROUNDS
    launched: dict[tuple[str, str, float], list[Launched]] = {
        choice: [] for choice in choices
    }
    start = clock.monotonic()
    done = 0
    for k in range(rounds):
        enough = k > 0 and (clock.monotonic() - start) * (k + 1) / k > _PATIENCE
        for tick, apply, rate in choices:
            if not enough:
                launched[tick, apply, rate].append(
                    launch(rate, apply, STIFFNESS, tick=tick)
                )
                done = k + 1
            step(f"launch at {rate:g} Hz {tick} {apply}, round {k + 1} of {rounds}")
    points: list[tuple[str, float, float, str, dict[str, Extra]]] = []
    for (tick, apply, rate), runs in launched.items():
        family = f"{tick} {apply}"
        name = f"{rate:g} Hz {family}"
        stable, detail = _at_rate(
            tick,
            apply,
            rate,
            runs,
            [force_error(r.onset, r.force, time, wanted) for r in runs],
        )
        points.append((name, rate, stable, family, detail))
        step(f"stiffness at {name}")
    best = max(stable for _, _, stable, _, _ in points) or 1.0
    note = (
        f"{1e3 * MASS:g} g dropped {1e3 * HEIGHT:g} mm on K = {STIFFNESS:g} N/m, B = {GAIN:g} N"
        f" s/m, four processes in real time; median of {done} interleaved launches per point."
    )
    return [
        Group(
            "rate_force",
            "Loop rate: force",
            "rate of the loop [Hz]",
            "error of the rendered force against a continuous floor (rms) [1]",
            tuple(
                Point(name, rate, float(d["force_error"] or 0.0), family, d)
                for name, rate, _, family, d in points
            ),
            note,
        ),
        Group(
            "rate_stiffness",
            "Loop rate: stiffest floor that calms down",
            "rate of the loop [Hz]",
            f"stiffness lost against the best, {best:.0f} N/m [1]",
            tuple(
                Point(name, rate, 1.0 - stable / best, family, d)
                for name, rate, stable, family, d in points
            ),
            f"{note} One launch each at 95, 80, 65 and 50 % of what the pole radius at the measured"
            " delay allows, until one calms down.",
            linear=True,
        ),
    ]


def _at_rate(
    tick: str, apply: str, rate: float, runs: list[Launched], errors: list[float]
) -> tuple[float, dict[str, Extra]]:
    """Return the stiffest floor that settles in launches at one rate, and its details."""
    errors = sorted(errors)
    delay = statistics.median(one.delay for one in runs)
    period = 1.0 / rate
    limit = 0.0
    if math.isfinite(delay):
        law = without_spring(PD(stiffness=1.0, damping=GAIN), period)
        limit = k_max(law, Plant(period, MASS, DAMPING, delay)).k_max_n_per_m or 0.0
    tries = (factor * limit for factor in _TRIES if limit > 0.0)
    stable = next(
        (k for k in tries if calms_down(launch(rate, apply, k, tick=tick).height)), 0.0
    )
    return stable, {
        "rate_hz": rate,
        "delay_ticks": delay if math.isfinite(delay) else None,
        "delay_us": 1e6 * delay * period if math.isfinite(delay) else None,
        "missed": statistics.median(
            one.figures["missed"] + one.figures["overruns"] for one in runs
        ),
        "ticks": statistics.median(
            one.figures["ticks"] + one.figures["overruns"] for one in runs
        ),
        "response_us_p99": statistics.median(
            float(one.figures["response_us"]["p99"]) for one in runs
        ),
        "cpu_s": statistics.median(
            sum(
                float(one.figures["nodes"][node]["cpu"])
                for node in ("driver", "environment", "coupling")
            )
            for one in runs
        ),
        "force_error": statistics.median(errors),
        "force_error_low": errors[0],
        "force_error_high": errors[-1],
        "k_max_n_per_m": limit,
        "k_settled_n_per_m": stable,
    }


def _choices(quick: bool) -> list[tuple[str, str, float]]:
    ways = [way for way in CHOICES if not quick or way[0] == "compiled"]
    return [
        (tick, apply, rate)
        for tick, apply in ways
        for rate in (_QUICK_RATES if quick else RATES)
    ]


def rate_steps(quick: bool = False) -> int:
    """Return the number of steps of `rate_groups`."""
    return len(_choices(quick)) * ((1 if quick else _ROUNDS) + 1)
