"""Tune a law for the device at hand: identify it, design, predict, apply, verify up to the edge, and report."""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.cli.ask import add_run, ask, chosen_run
from nodes.cli.main import RefusedError, UsageError, answer
from sim.identify.device_verb import add_push, excitation, identify_running, say
from sim.measure.launches import HAPTIC

if TYPE_CHECKING:
    from sim.identify.identified import Identified
    from sim.identify.push import Loop

STEPS = ("identify", "design", "predict", "apply", "verify")
RAMP = 250
"""Cross-fade to the tuned law [ticks]."""
SOFT, SOFT_LAW = "soft", {"kind": "pd", "stiffness": 20.0, "damping": 0.5}
"""What holds the device while surfaces change under it."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scenario", nargs="?", help="start this launch file for it; left out: the running launch")
    parser.add_argument("assignments", nargs="*", metavar="name:=value", help="arguments of the launch file")
    parser.add_argument(
        "--steps",
        nargs="+",
        choices=STEPS,
        default=list(STEPS),
        help="only these; what comes before is read from --out",
    )
    parser.add_argument("--taps", type=int, default=4, help="length of the law (default: %(default)s)")
    parser.add_argument(
        "--spread", type=float, default=1.25, help="factor the mass may be off by (default: %(default)s)"
    )
    parser.add_argument("--radius", type=float, default=0.99, help="pole radius allowed (default: %(default)s)")
    parser.add_argument(
        "--nyquist", type=float, help="|H(-1)| allowed [N/m] (default: what friction quiets, 2 f_c/Δ, 1000 to 10000)"
    )
    parser.add_argument("--land", action="store_true", help="tune until every drop settles too")
    add_push(parser)
    add_run(parser)
    parser.set_defaults(run=run, out=Path("tuning"))


def run(arguments: argparse.Namespace) -> int:
    """Go through the steps; whatever happens, leave the device safe and write what is known."""
    if not (1 <= arguments.taps <= 12 and arguments.spread >= 1.0 and 0.0 < arguments.radius <= 1.0):
        raise UsageError("--taps 1 to 12, --spread at least 1, --radius above 0 and at most 1")
    excitation(arguments)
    arguments.out.mkdir(parents=True, exist_ok=True)
    tuning = _Tuning(arguments)
    from sim.identify.push import interrupted_once, undisturbed

    live = {"identify", "apply", "verify"} & set(arguments.steps)
    code = 0
    with interrupted_once(), _launched(arguments) if live and arguments.scenario else contextlib.nullcontext():
        try:
            for step in (name for name in STEPS if name in arguments.steps):
                tuning.now = step
                say(f"{step} ...")
                getattr(tuning, step)()
                tuning.write()
            tuning.now = ""
        except KeyboardInterrupt:
            code = 130
        except (RefusedError, ValueError) as error:
            tuning.told["refused"] = str(error)
            code = 1
        finally:
            if tuning.now:
                tuning.told["interrupted"] = tuning.now
            with undisturbed():
                tuning.leave()
                tuning.write()
    answer(arguments.json, tuning.told | {"files": tuning.files}, tuning.text())
    return code


@contextlib.contextmanager
def _launched(arguments: argparse.Namespace) -> Iterator[None]:
    """Run a launch file for as long as the tuning takes."""
    from nodes.launcher.runs import RunError, find_run, runs

    def started() -> Any:
        with contextlib.suppress(RunError):
            for name in runs():
                run = find_run(name)
                if run.launcher == process.pid and _ticks(run):
                    return run
        return None

    words = [arguments.scenario, *arguments.assignments, "duration:=0"]
    command = [*HAPTIC, "launch", *words, "--json", "--no-plot"]
    # A group of its own: Ctrl-C is for the tuning, which then ends the launch itself.
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, process_group=0)
    try:
        until = time.monotonic() + 60.0
        while True:
            new = started()
            if new is not None:
                arguments.run_name = new.run
                break
            if process.poll() is not None or time.monotonic() > until:
                told = "" if process.stderr is None else process.stderr.read()
                raise RefusedError(f"haptic launch {' '.join(words)} did not start: {told[-1000:].strip()}")
            time.sleep(0.1)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60.0)


def _ticks(run: Any) -> bool:
    from sim.identify.push import Loop

    try:
        return bool(Loop(run).progress()["tick"] > 10)
    except RefusedError:
        return False


class _Tuning:
    """The steps, what they told, and what must be put back."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.now = ""
        self._arguments = arguments
        self._file: Path = arguments.out / "tune.json"
        self.files = {"json": str(self._file), "html": str(arguments.out / "tune.html")}
        self.told: dict[str, Any] = {}
        if "identify" not in arguments.steps and self._file.exists():
            self.told = json.loads(self._file.read_text(encoding="utf-8"))
            self.told.pop("interrupted", None)
            self.told.pop("refused", None)
        self._loop: Loop | None = None
        self._surface: Any = None
        self._law = ""
        self._applied = False
        self.place: list[float] = []

    def _running(self) -> Loop:
        from sim.identify.push import Loop

        if self._loop is None:
            self._loop = Loop(chosen_run(self._arguments))
            self._loop.read_limits()
        return self._loop

    def _need(self, key: str) -> Any:
        if key not in self.told:
            raise RefusedError(f"{self._file}: holds no {key!r}; run that step first")
        return self.told[key]

    def _nyquist(self, found: Identified) -> float:
        """Bound encoder noise by what friction swallows: an edge of the encoder crossed to and fro gains Δ²·H(−1)."""
        if self._arguments.nyquist is not None:
            return float(self._arguments.nyquist)
        if not found.encoder.value or found.friction.low is None:
            return 1e4
        return min(max(2.0 * found.friction.low / found.encoder.value, 1e3), 1e4)

    def identify(self) -> None:
        """Push and identify."""
        from sim.identify.report import figures

        if self._arguments.places is None:
            self._arguments.places = [0.0]
        ((pushed, found), *_) = identify_running(self._arguments, say)
        self.told["identified"] = {"recording": str(pushed.recording), "stopped": pushed.reason, **figures(found)}
        self.told["limits"] = {"peak_n": self._running().peak, "slew_n": self._running().slew}
        if pushed.reason == "Ctrl-C":
            raise KeyboardInterrupt

    def design(self) -> None:
        """Design for the identified ranges."""
        from sim.design.families import to_yaml
        from sim.identify.report import from_figures
        from sim.tune.design import Wanted, design
        from sim.tune.knock import LAW

        chosen = self._arguments
        found = from_figures(self._need("identified"))
        wanted = Wanted(chosen.taps, chosen.spread, chosen.radius, self._nyquist(found), chosen.land)
        law, pd, asked = design(found, wanted)
        if law.found is None or law.law is None:
            raise RefusedError("no law keeps the demand: allow a larger --radius, less --spread or more --taps")
        known = None if pd.found is None else pd.found.h1_n_per_m
        self.told["designed"] = {
            "family": law.family,
            "law": law.law,
            "taps_n_per_m": law.found.taps.tolist(),
            "h1_n_per_m": law.found.h1_n_per_m,
            "best_pd_h1_n_per_m": known,
            "gain_over_pd": None if known is None else law.found.h1_n_per_m / known,
            "mass_kg": list(asked.mass),
            "delay_ticks": list(asked.delay),
            "radius_limit": asked.radius,
        }
        path = self._arguments.out / "tuned.yaml"
        comment = f"haptic launch SCENARIO --params {path}\nm {asked.mass[0]:.4g}..{asked.mass[1]:.4g} kg"
        path.write_text(to_yaml(law.law, LAW, comment=comment), encoding="utf-8")
        self.files["params"] = str(path)

    def predict(self) -> None:
        """Predict edge, margins, landing and rest."""
        import numpy as np

        from sim.design.demand import Robust
        from sim.design.families import Tuned
        from sim.identify.report import from_figures
        from sim.tune.design import Wanted, demand, predict

        designed = self._need("designed")
        found = from_figures(self._need("identified"))
        chosen = self._arguments
        asked = demand(found, Wanted(chosen.taps, chosen.spread, chosen.radius, self._nyquist(found)))
        taps = np.array(designed["taps_n_per_m"])
        nyquist = float(taps @ np.where(np.arange(len(taps)) % 2, -1.0, 1.0))
        robust = Robust(taps, taps, designed["h1_n_per_m"], nyquist, designed["radius_limit"], (0.0, 0.0, 0.0))
        law = Tuned(designed["family"], designed["law"], robust)
        limits = self.told["limits"]
        figures, edge, knock, tried = predict(law, asked, found, limits["peak_n"], limits["slew_n"])
        self.told["predicted"] = figures
        self.told["predicted_steps"] = {
            "steps": [asdict(step) for step in edge.steps],
            "ended": edge.ended,
            "tried": tried,
            "knock_m": knock,
        }

    def apply(self) -> None:
        """Hold the device softly where it is, then fade to the tuned law in the running coupling."""
        from sim.tune.knock import LAW

        loop = self._running()
        designed = self._need("designed")
        if self._surface is None:
            self._law = ask(loop.run, loop.coupling, "law.list")["active"]
            self._surface = ask(loop.run, loop.environment, "param.get", name="surface")
        # A stiff law must never meet a point that the device is not at.
        self._soft()
        self.place = _hold(loop)
        law = {"kind": "fir", "taps": designed["taps_n_per_m"], "period": loop.period}
        ask(loop.run, loop.coupling, "param.set", values={f"laws.{LAW}": law})
        receipt = ask(loop.run, loop.coupling, "law.switch", law=LAW, ramp=RAMP)
        self.told["applied"] = {"seq": receipt["seq"], "ramp_ticks": RAMP, "force_step_n": receipt["force_step_n"]}
        self._applied = True
        loop.wait(2 * RAMP)

    def _soft(self) -> None:
        loop = self._running()
        ask(loop.run, loop.coupling, "param.set", values={f"laws.{SOFT}": SOFT_LAW})
        ask(loop.run, loop.coupling, "law.switch", law=SOFT, ramp=RAMP)
        loop.wait(RAMP)

    def verify(self) -> None:
        """Knock on the held device at rising stiffness."""
        from sim.tune.design import edge_error
        from sim.tune.knock import Verdict, measured_edge

        if not self._applied:
            self.apply()
        loop = self._running()
        predicted, planned = self._need("predicted"), self._need("predicted_steps")
        steps: list[Verdict] = []
        ended = "interrupted"
        taps = self._need("designed")["taps_n_per_m"]
        try:
            ended = measured_edge(loop, taps, self.place, planned["knock_m"], planned["tried"], say, steps)
        finally:
            factor = next((step.factor for step in steps if not step.rests), None)
            self.told["verified"] = {
                "edge_factor": factor,
                "edge_h1_n_per_m": None if factor is None else factor * predicted["h1_n_per_m"],
                "edge_error": edge_error(predicted["edge_factor"], factor),
                "stiffest_at_rest_n_per_m": max(
                    (step.factor * predicted["h1_n_per_m"] for step in steps if step.rests), default=None
                ),
                "ended": ended,
                "steps": [asdict(step) for step in steps],
            }

    def leave(self) -> None:
        """Put the surface back, and the law too unless the tuned one was asked for and came through."""
        loop = self._loop
        if loop is None or self._surface is None:
            return
        from sim.tune.knock import LAW

        try:
            self._soft()
            ask(loop.run, loop.environment, "param.set", values={"surface": self._surface})
            loop.wait(RAMP)
            ask(loop.run, loop.coupling, "law.switch", law=self._law if self.now else LAW, ramp=RAMP, force=True)
        except RefusedError as error:
            self.told["not_put_back"] = str(error)

    def write(self) -> None:
        """Write what is known."""
        from sim.tune.page import page

        self._file.write_text(json.dumps(self.told, indent=1), encoding="utf-8")
        (self._arguments.out / "tune.html").write_text(page(self.told), encoding="utf-8")

    def text(self) -> str:
        """Tell the outcome to people."""
        lines = []
        if "identified" in self.told:
            from sim.identify.report import from_figures, text

            lines.append(text(from_figures(self.told["identified"])))
        if "designed" in self.told:
            one = self.told["designed"]
            gain = one["gain_over_pd"]
            lines.append(
                f"law: {one['family']}, H(1) {one['h1_n_per_m']:.5g} N/m"
                + ("" if gain is None else f", {gain:.2f} times the best PD of the same demand")
            )
        if "predicted" in self.told:
            one = self.told["predicted"]
            lines.append(
                f"predicted: edge at {_number(one['edge_h1_n_per_m'])} N/m by knocking on the model, "
                f"{one['edge_linear_h1_n_per_m']:.5g} N/m by the poles; {one['drops_settled']} of {one['drops']} drops settle; "
                f"every sequence of delays: {one['every_delay_stable']}; free of limit cycles: {one['limit_cycle_free']}"
            )
        if "verified" in self.told:
            one = self.told["verified"]
            off = one["edge_error"]
            lines.append(
                f"measured: edge at {_number(one['edge_h1_n_per_m'])} N/m"
                + ("" if off is None else f", {100 * off:+.1f} % from the predicted one")
                + f" ({one['ended']})"
            )
        if self.told.get("refused"):
            lines.append(f"stopped: {self.told['refused']}")
        elif self.told.get("interrupted"):
            lines.append(f"interrupted during {self.told['interrupted']}; the law that was there is back")
        return "\n".join([*lines, *self.files.values()])


def _number(value: float | None) -> str:
    return "no" if value is None else f"{value:.5g}"


def _hold(loop: Loop) -> list[float]:
    """Put the coupling's far end where the device is, once it rests there; where that is [m]."""
    place: list[float] = []
    for _ in range(3):
        place = [float(x) for x in loop.progress()["position_m"]]
        surface = {"kind": "anchor", "position": place}
        ask(loop.run, loop.environment, "param.set", values={"surface": surface})
        loop.wait(RAMP)
    return place
