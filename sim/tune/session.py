"""The steps of `haptic tune` and their record; redoing a step invalidates later ones."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from messages.errors import RefusedError
from nodes.client.launches import ask
from sim.tune.record import (
    AppliedStep,
    DesignedStep,
    ForceLimits,
    IdentifiedStep,
    TuneRecord,
)

if TYPE_CHECKING:
    from sim.identify.borrowed import PushedLaunch
    from sim.identify.identified import Identified
    from sim.tune.tune_options import TuneOptions

S = TypeVar("S")

_TRIED = ("predicted", "predicted_steps", "verified", "applied")
# Entries of the record that each step invalidates, its own first.
OVERTAKES = {
    "identify": ("identified", "limits", "designed", *_TRIED),
    "design": ("designed", *_TRIED),
    "predict": ("predicted", "predicted_steps"),
    "verify": ("verified", "applied"),
    "apply": ("applied",),
}
RAMP = 250  # cross-fade to the tuned law [ticks]
LAW = "tuned"  # name of the law that is delivered
NYQUIST = (1e3, 1e4)  # limits of the bound on |H(−1)| derived from friction [N/m]


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
        self.record = TuneRecord()
        if not fresh and self._file.exists():
            self.record = replace(
                TuneRecord.read(self._file),
                interrupted="",
                refused="",
                headline="",
                not_put_back="",
            )
        # The files of an earlier tuning are kept until this one has a result.
        self._untouched = (
            self._file.exists() if fresh else self.record.designed is not None
        )
        self._loop: PushedLaunch | None = None

    def _running(self) -> PushedLaunch:
        if self._loop is None:
            self._loop = self._find()
            self._loop.read_limits()
        return self._loop

    def _need(self, found: S | None, key: str) -> S:
        if found is None:
            raise RefusedError(
                f"{self._file}: contains no {key!r}; run that step first"
            )
        return found

    @property
    def _device(self) -> Identified:
        return self._need(self.record.identified, "identified").found

    @property
    def _law(self) -> DesignedStep:
        return self._need(self.record.designed, "designed")

    def do(self, step: str) -> None:
        """Perform one step after dropping the entries it invalidates."""
        before = replace(self.record)
        for key in OVERTAKES[step]:
            setattr(self.record, key, None)
        # In lockstep the launch pauses during calculations.
        loop = self._loop if step in ("design", "predict") else None
        try:
            with contextlib.nullcontext() if loop is None else loop.standing():
                getattr(self, f"_{step}")()
        finally:
            if all(getattr(self.record, key) is None for key in OVERTAKES[step]):
                # Refused before it began: earlier results remain.
                self.record = before
            else:
                self._untouched = False
                held = self.record.verified is not None and self.record.verified.holds
                if step in ("identify", "design", "verify") and not held:
                    # The law delivered before is not this one.
                    self._tuned.unlink(missing_ok=True)
                    if step == "verify":
                        self._write_law(
                            self._designed,
                            "tried on the device, and it did NOT hold, or was not verified",
                        )

    def _identify(self) -> None:
        recording, ended, found = self._identified()
        self.record.identified = IdentifiedStep(str(recording), ended, found)
        loop = self._running()
        self.record.limits = ForceLimits(loop.peak, loop.slew)
        if (poses := loop.poses()) is not None:
            self.record.identified = replace(self.record.identified, poses_kg=poses)
        if ended == "Ctrl-C":
            raise KeyboardInterrupt

    def _design(self) -> None:
        from sim.design.landing import drops, prove_over
        from sim.identify.identified import refusal
        from sim.tune.design import Wanted, design, remainder_refusal

        chosen, found = self._options, self._device
        poses = self._need(self.record.identified, "identified").poses_kg or (0.0, 0.0)
        refused = refusal(found)
        if refused and not chosen.refuted:
            raise RefusedError(
                f"{refused}. A law would be for another device; --refuted designs it anyway"
            )
        found = found.anyway()
        self._options.say(
            f"designing {chosen.taps} taps{' that land' if chosen.land else ''}, and PD to compare"
        )
        nyquist = self._nyquist(found)
        wanted = Wanted(
            chosen.taps, chosen.spread, chosen.radius, nyquist, chosen.land, poses
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
        comparable = (
            pd.found is not None and lands and all(drops(pd.found.law, asked).values())
        )
        self.record.designed = DesignedStep(
            law=law.law,
            taps_n_per_m=tuple(law.found.taps.tolist()),
            h1_n_per_m=law.found.h1_n_per_m,
            lands=lands,
            demand=asked,
            family=law.family,
            worst=(law.found.worst[0], law.found.worst[1]),
            landing_proof=prove_over(law.found.law, asked),
            best_pd_h1_n_per_m=pd.found.h1_n_per_m if pd.found and comparable else None,
            model_refuted=refused,
            poses_kg=poses,
        )
        self._write_law(
            self._designed,
            "NOT tried on the device: haptic tune --steps predict verify",
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

        low, high = self._law.demand.mass
        lines = (
            f"haptic launch SCENARIO --params {path}",
            tried,
            "every drop settles" if self._law.lands else "it FAILS the drop test",
            f"m {low:.4g}..{high:.4g} kg",
        )
        path.write_text(
            to_yaml(self._law.law, LAW, comment="\n".join(lines)), encoding="utf-8"
        )

    def _predict(self) -> None:
        from nodes.laws import CompiledLaw
        from sim.tune.design import predict
        from sim.tune.outcome import compared

        designed = self._law
        found = self._device.anyway()
        limits = self._need(self.record.limits, "limits")
        law = CompiledLaw(designed.taps_n_per_m)
        figures, steps = predict(
            law, designed.demand, found, limits.peak_n, limits.slew_n
        )
        self.record.predicted, self.record.predicted_steps = figures, steps
        if (after := self.record.verified) is not None:
            error, words = compared(figures.edge_factor, after.edge_factor)
            self.record.verified = replace(after, edge_error=error, edge_compared=words)

    def _verify(self) -> None:
        from sim.identify.borrowed import borrowed, carried
        from sim.tune.knocking import KnockedEdge
        from sim.tune.live_trial import Trials
        from sim.tune.outcome import verified

        taps = list(self._law.taps_n_per_m)
        predicted = self._need(self.record.predicted, "predicted")
        plan = self._need(self.record.predicted_steps, "predicted_steps").plan
        loop = self._running()
        self._refuse_other_rate(loop)
        loop.ready()
        load = carried(loop, self._options.amplitude, self._options.load)
        edge = KnockedEdge()
        with borrowed(loop) as held:
            try:
                how = (load, self._options.say, self._options.rearm)
                Trials(loop, held, taps, predicted.knock_m, *how).climb(plan, edge)
            except KeyboardInterrupt:
                edge.ended = edge.ended or "interrupted"
                edge.complete = False
                raise
            except RefusedError as error:
                edge.ended = str(error)
                edge.complete = False
                raise
            finally:
                self.record.verified = verified(predicted, edge)
                self.record.not_put_back = held.not_put_back
        self.record.not_put_back = held.not_put_back
        if self.record.verified.holds:
            most = self.record.verified.stiffest_at_rest_n_per_m
            self._write_law(
                self._tuned,
                f"tried on the device: knocks came to rest up to {most:.4g} N/m",
            )
            self._designed.unlink(missing_ok=True)

    def _refuse_other_rate(self, loop: PushedLaunch) -> None:
        """Refuse a launch at another rate than the law's; its taps are for one period."""
        period = self._law.demand.period
        if not math.isclose(period, loop.period, rel_tol=1e-6):
            raise RefusedError(
                f"{loop.run.run}: runs at {1.0 / loop.period:g} Hz, and the law was designed for"
                f" {1.0 / period:g} Hz; start it with that rate, or begin with identify"
            )

    def _apply(self) -> None:
        """Switch the running coupling to the tuned law, only if it was verified."""
        taps, after = self._law.taps_n_per_m, self.record.verified
        if after is None or not after.holds:
            raise RefusedError(
                "apply: the law was not tried on the device, or does not hold; only a law that held"
                " is applied"
            )
        loop = self._running()
        self._refuse_other_rate(loop)
        loop.ready()
        law = {"kind": "fir", "taps": list(taps), "period": loop.period}
        # The active law, perhaps of an earlier tuning, remains defined, to fade from and to switch
        # back to.
        before = str(ask(loop.run, loop.coupling, "law.list")["active"])
        name = LAW if before != LAW else f"{LAW}_again"
        ask(loop.run, loop.coupling, "param.set", values={f"laws.{name}": law})
        receipt = ask(
            loop.run, loop.coupling, "law.switch", law=name, ramp=RAMP, force=True
        )
        self.record.applied = AppliedStep(
            receipt["seq"], RAMP, receipt["force_step_n"], name, before
        )

    def keep(self) -> None:
        """Write the record, for later steps."""
        from sim.tune.outcome import headline

        self.files = {
            name: file for name, file in self.files.items() if name in ("html", "json")
        }
        if law := next(
            (path for path in (self._tuned, self._designed) if path.exists()), None
        ):
            self.files["params"] = str(law)
        now = self.record
        if self._untouched:
            said = now.refused or f"interrupted during {now.interrupted or None}"
            words = f"Nothing new: {said}. {self._file} is as it was."
            self.record = TuneRecord(
                refused=now.refused, interrupted=now.interrupted, headline=words
            )
            self.files = {}
            return
        now.headline = headline(now)
        now.command = self._options.command
        now.date = time.strftime("%Y-%m-%d %H:%M:%S %z")
        now.device = now.device or (self._loop.run.scenario if self._loop else "")
        now.write(self._file)

    def write(self) -> None:
        """Write the record and the report, which takes as long as some steps."""
        from sim.tune.tuning_page import page

        self.keep()
        if self._untouched:
            return
        with contextlib.nullcontext() if self._loop is None else self._loop.standing():
            (self._options.out / "tune.html").write_text(
                page(self.record), encoding="utf-8"
            )
