"""The steps of `haptic tune` and their record; redoing a step invalidates later ones."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from messages.errors import RefusedError, UsageError
from nodes.client.launches import ask

if TYPE_CHECKING:
    from sim.identify.borrowed import PushedLaunch
    from sim.identify.identified import Identified
    from sim.tune.tune_options import TuneOptions

# Record entries that each step invalidates.
OVERTAKES = {
    "identify": (
        "identified",
        "limits",
        "designed",
        "predicted",
        "predicted_steps",
        "verified",
        "applied",
    ),
    "design": ("designed", "predicted", "predicted_steps", "verified", "applied"),
    "predict": ("predicted", "predicted_steps"),
    "verify": ("verified", "applied"),
    "apply": ("applied",),
}
RAMP = 250  # cross-fade to the tuned law [ticks]
LAW = "tuned"  # name of the law that is delivered
NYQUIST = (1e3, 1e4)  # limits of the bound on |H(−1)| derived from friction [N/m]


def _kept(file: Path) -> dict[str, Any]:
    """Read the record of an earlier tuning."""
    from sim.identify.identified_text import from_figures

    try:
        record = msgspec.json.decode(file.read_bytes(), type=dict[str, Any])
        if "identified" in record:
            from_figures(record["identified"])
    except (msgspec.DecodeError, LookupError, TypeError, ValueError) as error:
        raise UsageError(
            f"{file}: is not what haptic tune wrote ({error}); remove it, and begin with identify"
        ) from error
    return record


class Tuning:
    """The steps, each a method; a `fresh` tuning ignores earlier results.

    The launch is looked up when a step needs it.
    """

    def __init__(
        self,
        options: TuneOptions,
        running: Callable[[], PushedLaunch],
        identified: Callable[[], tuple[Path, str, Identified]],
        fresh: bool,
    ) -> None:
        self._options, self._find, self._identified = options, running, identified
        self._file, self._tuned, self._designed = (
            options.out / name for name in ("tune.json", "tuned.yaml", "designed.yaml")
        )
        # written files
        self.files = {"html": str(options.out / "tune.html"), "json": str(self._file)}
        self.record: dict[str, Any] = {}  # results of the steps
        if not fresh and self._file.exists():
            self.record = _kept(self._file)
            for key in ("interrupted", "refused", "headline", "not_put_back"):
                self.record.pop(key, None)
        # The files of an earlier tuning are kept until this one has a result.
        self._untouched = self._file.exists() if fresh else "designed" in self.record
        self._loop: PushedLaunch | None = None

    def _running(self) -> PushedLaunch:
        if self._loop is None:
            self._loop = self._find()
            self._loop.read_limits()
        return self._loop

    def _need(self, key: str) -> Any:
        if key not in self.record:
            raise RefusedError(f"{self._file}: contains no {key!r}; run that step first")
        return self.record[key]

    def do(self, step: str) -> None:
        """Perform one step after dropping the entries it invalidates."""
        before = dict(self.record)
        for key in OVERTAKES[step]:
            self.record.pop(key, None)
        # In lockstep the launch pauses during calculations.
        loop = self._loop if step in ("design", "predict") else None
        try:
            with contextlib.nullcontext() if loop is None else loop.standing():
                getattr(self, f"_{step}")()
        finally:
            if not set(OVERTAKES[step]) & set(self.record):
                # Refused before it began: earlier results remain.
                self.record.update(before)
            else:
                self._untouched = False
                if step in ("identify", "design", "verify") and not self.record.get(
                    "verified", {}
                ).get("holds"):
                    # The law delivered before is not this one.
                    self._tuned.unlink(missing_ok=True)
                    if step == "verify":
                        self._write_law(
                            self._designed,
                            "tried on the device, and it did NOT hold, or was not verified",
                        )

    def _identify(self) -> None:
        from sim.identify.identified_text import figures

        recording, ended, found = self._identified()
        self.record["identified"] = {
            "recording": str(recording),
            "stopped": ended,
            **figures(found),
        }
        loop = self._running()
        self.record["limits"] = {"peak_n": loop.peak, "slew_n": loop.slew}
        if (poses := loop.poses()) is not None:
            self.record["identified"]["poses_kg"] = list(poses)
        if ended == "Ctrl-C":
            raise KeyboardInterrupt

    def _design(self) -> None:
        from sim.design.landing import drops, prove_over
        from sim.identify.identified import refusal
        from sim.identify.identified_text import from_figures
        from sim.tune.design import Wanted, design, remainder_refusal

        chosen, identified = self._options, self._need("identified")
        found = from_figures(identified)
        poses = identified.get("poses_kg") or (0.0, 0.0)
        refused = refusal(found)
        if refused and not chosen.refuted:
            raise RefusedError(
                f"{refused}. A law would be for another device; --refuted designs it anyway"
            )
        found = found.anyway()
        self._options.say(
            f"designing {chosen.taps} taps{' that land' if chosen.land else ''}, and PD to compare"
        )
        wanted = Wanted(
            chosen.taps,
            chosen.spread,
            chosen.radius,
            self._nyquist(found),
            chosen.land,
            poses=(poses[0], poses[1]),
        )
        law, pd, asked = design(found, wanted)
        if law.found is None or law.law is None:
            raise RefusedError(
                "no law keeps the demand: allow a larger --radius, less --spread or more --taps"
            )
        if (risk := remainder_refusal(law.found.law, found)) and not chosen.refuted:
            raise RefusedError(
                f"{risk}. Ask for a smaller --radius, or push longer (--duration);"
                " --refuted designs it anyway"
            )
        lands = all(drops(law.found.law, asked).values())
        # A ratio between a law that settles and one that does not would be meaningless.
        comparable = pd.found is not None and lands and all(drops(pd.found.law, asked).values())
        known = pd.found.h1_n_per_m if pd.found is not None and comparable else None
        self.record["designed"] = {
            "family": law.family,
            "law": law.law,
            "taps_n_per_m": law.found.taps.tolist(),
            "h1_n_per_m": law.found.h1_n_per_m,
            "lands": lands,
            "landing_proof": asdict(prove_over(law.found.law, asked)),
            "best_pd_h1_n_per_m": known,
            "gain_over_pd": None if known is None else law.found.h1_n_per_m / known,
            "model_refuted": refused,
            "poses_kg": list(poses),
            "worst": list(law.found.worst[:2]),
            "demand": asdict(asked),
        }
        self._write_law(
            self._designed, "NOT tried on the device: haptic tune --steps predict verify"
        )

    def _nyquist(self, found: Identified) -> float:
        """Return the bound on |H(−1)| for which friction absorbs encoder noise [N/m].

        Crossing an encoder edge to and fro generates Δ²·H(−1).
        """
        if self._options.nyquist is not None:
            return self._options.nyquist
        low, high = NYQUIST
        if not found.encoder.value or found.friction.low is None:
            return high
        return min(max(2.0 * found.friction.low / found.encoder.value, low), high)

    def _write_law(self, path: Path, tried: str) -> None:
        from sim.design.families import to_yaml

        designed = self.record["designed"]
        low, high = designed["demand"]["mass"]
        lands = "every drop settles" if designed["lands"] else "it FAILS the drop test"
        lines = (
            f"haptic launch SCENARIO --params {path}",
            tried,
            lands,
            f"m {low:.4g}..{high:.4g} kg",
        )
        path.write_text(to_yaml(designed["law"], LAW, comment="\n".join(lines)), encoding="utf-8")

    def _predict(self) -> None:
        from nodes.laws import CompiledLaw
        from sim.design.demand import Demand
        from sim.identify.identified_text import from_figures
        from sim.tune.design import predict
        from sim.tune.outcome import compared

        designed = self._need("designed")
        found, asked = (
            from_figures(self._need("identified")).anyway(),
            msgspec.convert(designed["demand"], Demand),
        )
        limits = self._need("limits")
        law = CompiledLaw(tuple(designed["taps_n_per_m"]))
        figures, edge, plan = predict(law, asked, found, limits["peak_n"], limits["slew_n"])
        self.record["predicted"], steps = figures, [asdict(step) for step in edge.steps]
        self.record["predicted_steps"] = {"steps": steps, "ended": edge.ended, "plan": asdict(plan)}
        if "verified" in self.record:
            self.record["verified"] |= compared(
                figures["edge_factor"], self.record["verified"]["edge_factor"]
            )

    def _verify(self) -> None:
        from sim.identify.borrowed import borrowed, carried
        from sim.tune.knocking import KnockedEdge, Plan
        from sim.tune.live_trial import Trials
        from sim.tune.outcome import verified

        designed, predicted = self._need("designed"), self._need("predicted")
        loop = self._running()
        self._refuse_other_rate(loop)
        plan = Plan(**self._need("predicted_steps")["plan"])
        loop.ready()
        load = carried(loop, self._options.amplitude, self._options.load)
        edge = KnockedEdge()
        with borrowed(loop) as held:
            try:
                taps, knock = designed["taps_n_per_m"], predicted["knock_m"]
                Trials(loop, held, taps, knock, load, self._options.say, self._options.rearm).climb(
                    plan, edge
                )
            except KeyboardInterrupt:
                edge.ended, edge.complete = edge.ended or "interrupted", False
                raise
            except RefusedError as error:
                edge.ended, edge.complete = str(error), False
                raise
            finally:
                self.record["verified"] = verified(predicted, edge)
                if held.not_put_back:
                    self.record["not_put_back"] = held.not_put_back
        if held.not_put_back:
            self.record["not_put_back"] = held.not_put_back
        if self.record["verified"]["holds"]:
            most = self.record["verified"]["stiffest_at_rest_n_per_m"]
            self._write_law(
                self._tuned, f"tried on the device: knocks came to rest up to {most:.4g} N/m"
            )
            self._designed.unlink(missing_ok=True)

    def _refuse_other_rate(self, loop: PushedLaunch) -> None:
        """Refuse a launch at another rate than the law's; its taps are for one period."""
        period = self._need("designed")["demand"]["period"]
        if not math.isclose(period, loop.period, rel_tol=1e-6):
            raise RefusedError(
                f"{loop.run.run}: runs at {1.0 / loop.period:g} Hz, and the law was designed for"
                f" {1.0 / period:g} Hz; start it with that rate, or begin with identify"
            )

    def _apply(self) -> None:
        """Switch the running coupling to the tuned law, only if it was verified."""
        designed = self._need("designed")
        if not self.record.get("verified", {}).get("holds"):
            raise RefusedError(
                "apply: the law was not tried on the device, or does not hold; only a law that held"
                " is applied"
            )
        loop = self._running()
        self._refuse_other_rate(loop)
        loop.ready()
        law = {"kind": "fir", "taps": designed["taps_n_per_m"], "period": loop.period}
        # The active law, perhaps of an earlier tuning, remains defined, to fade from and to switch
        # back to.
        before = str(ask(loop.run, loop.coupling, "law.list")["active"])
        name = LAW if before != LAW else f"{LAW}_again"
        ask(loop.run, loop.coupling, "param.set", values={f"laws.{name}": law})
        receipt = ask(loop.run, loop.coupling, "law.switch", law=name, ramp=RAMP, force=True)
        told = {"seq": receipt["seq"], "ramp_ticks": RAMP, "force_step_n": receipt["force_step_n"]}
        self.record["applied"] = {**told, "law": name, "before": before}

    def keep(self) -> None:
        """Write the record, for later steps."""
        from sim.tune.outcome import headline

        self.files = {name: file for name, file in self.files.items() if name in ("html", "json")}
        if law := next((path for path in (self._tuned, self._designed) if path.exists()), None):
            self.files["params"] = str(law)
        if self._untouched:
            why: dict[str, Any] = {
                key: self.record[key] for key in ("refused", "interrupted") if key in self.record
            }
            said = why.get("refused") or f"interrupted during {why.get('interrupted')}"
            self.record, self.files = (
                {**why, "headline": f"Nothing new: {said}. {self._file} is as it was."},
                {},
            )
            return
        self.record["headline"] = headline(self.record)
        self.record["command"], self.record["date"] = (
            self._options.command,
            time.strftime("%Y-%m-%d %H:%M:%S %z"),
        )
        with contextlib.suppress(RefusedError):
            self.record["device"] = self.record.get("device") or (
                self._loop.run.scenario if self._loop else ""
            )
        self._file.write_text(json.dumps(self.record, indent=1), encoding="utf-8")

    def write(self) -> None:
        """Write the record and the report, which takes as long as some steps."""
        from sim.tune.tuning_page import page

        self.keep()
        if self._untouched:
            return
        with contextlib.nullcontext() if self._loop is None else self._loop.standing():
            (self._options.out / "tune.html").write_text(page(self.record), encoding="utf-8")

    @property
    def came_through(self) -> bool:
        """Return whether no law was tried, or the law holds."""
        after = self.record.get("verified")
        return after is None or bool(after["holds"])
