"""Analyse a law: f(ω), leak, passivity limit, pole radius, K_max, tolerance of the device."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from messages.errors import UsageError
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law
from nodes.parameters.options import FileOptions, argument, option, quantity
from nodes.parameters.quantities import interval, not_negative, positive
from nodes.recording.figure_style import (
    OMEGA,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from nodes.stability.closed_loop import Rendered, rendered
from nodes.stability.effective_damping import effective_damping
from nodes.stability.k_max import (
    KMax,
    Tolerance,
    edge_of,
    k_max,
    tolerance,
    without_spring,
)
from nodes.stability.occurring import Edge
from nodes.stability.plant import Plant
from nodes.stability.world_limits import WorldLimits, finite, world_limits
from sim.experiments.rest_map import RestFound, rest_map
from sim.results import fresh
from sim.stability.every_delay import Certificate, EveryDelay, every_delay
from sim.stability.rest import rest, stiffest_at_rest
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions, LawOptions
from sim.studies.result import Findings, at_top


@dataclass(frozen=True, kw_only=True)
class AnalyseOptions(LawOptions, DeviceOptions, FileOptions):
    """Options of `analyse`."""

    law: str = argument(
        help="kind, preset or YAML mapping, e.g. '{kind: pd, stiffness: 1000, damping: 3}'"
    )
    gain: float | None = quantity("gain")
    every_delay: tuple[float, float] | None = option(
        type=interval,
        metavar="LOW..HIGH",
        help=(
            "certify the loop for every sequence of delays of this range, at most a tick wide"
            " [ticks]"
        ),
    )
    resolution: float | None = option(
        type=positive, help="of the device's encoder: tells the friction for rest [m]"
    )
    friction: float | None = option(
        type=not_negative, help="of the device: tells the stiffness for rest [N]"
    )


@dataclass(frozen=True)
class DelaysJudged:
    """Verdict on every sequence of delays of a range."""

    delay_ticks: tuple[float, float]
    found: EveryDelay

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        return {"delay_ticks": self.delay_ticks, **vars(self.found)}

    @property
    def line(self) -> str:
        """The verdict in one line."""
        (low, high), found = self.delay_ticks, self.found
        row = {
            Certificate.CERTIFIED: (
                f"stable: a common norm shrinks over each of {found.words} words of delays"
            ),
            Certificate.UNSTABLE: (
                f"UNSTABLE: {', '.join(f'{d:.4g}' for d in found.growing)} ticks, repeated,"
                f" grow by {found.growth:.6f} per tick"
            ),
        }.get(found.stable, "not decided: no norm found, and no sequence that grows")
        return f"every delay     of {low:g}..{high:g} ticks: {row} (THEORY.md §10)"


@dataclass(frozen=True, repr=False, kw_only=True)
class Analysis(Findings):
    """What a law renders on a device, and how far the device may differ."""

    lines: list[str] | tuple[str, ...] = ()
    loop: str  # law, device and loop
    law: Rendered = at_top()
    delay_ticks: float
    taps_n_per_m: Sequence[float]
    sections: int
    k_max: KMax
    worlds: WorldLimits
    tolerance: Tolerance | None
    edge: Edge | None
    every_delay: DelaysJudged | None  # None: not asked for
    rest: RestFound | None  # None: no encoder given

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, those of the law and of the worlds at the top level."""
        figures = super().answer
        limit, _ = figures.pop("k_max"), figures.pop("worlds")
        del limit["stable"]
        worlds = self.worlds.k_max_n_per_m.items()
        return {
            **figures,
            **limit,
            **{f"k_max_{name}_n_per_m": finite(k) for name, k in worlds},
        }

    @property
    def text(self) -> str:
        """Text for the terminal."""
        law, limit = self.law, self.k_max
        radius = law.pole_radius or 0.0  # a device with a mass has one
        verdict = "stable" if radius < 1.0 else "UNSTABLE"
        lines = [
            self.loop,
            f"H(1)            {_shown(law.h1_n_per_m, 'N/m')}",
            f"H(-1)           {_shown(law.h_nyquist_n_per_m, 'N/m')}",
            (
                f"f min, H(1)     {_shown(law.f_min_n_s_per_m, 'N s/m')} at"
                f" {law.f_min_rad_per_s:.5g} rad/s"
            ),
            f"f(w_N), H(1)    {_shown(law.f_nyquist_n_s_per_m, 'N s/m')}",
            f"passive from b  {_shown(law.damping_needed_n_s_per_m, 'N s/m')}",
            f"passive scale   {_shown(law.passive_scale, '')}",
            f"pole radius     {radius:.9f} ({verdict})",
            (
                f"K_max           {_shown(limit.k_max_n_per_m, 'N/m')} nominal, "
                f"{_shown(limit.h1_max_n_per_m, 'N/m')} felt ({limit.method})"
            ),
        ]
        named = {
            "any_world": "K_max any world",
            "any_hand_any_world": "any hand, world",
        }
        lines += [
            f"{label} {_shown(finite(self.worlds.k_max_n_per_m[key]), 'N/m', 'none certified')}"
            " (THEORY.md §18)"
            for key, label in named.items()
        ]
        lines += self._beyond()
        lines += _tolerance_lines(self.tolerance) if self.tolerance is not None else []
        return "\n".join([*lines, str(self.picture)])

    def _beyond(self) -> list[str]:
        """Return the requested lines on ringing frequency, sequences of delays and rest."""
        lines = []
        if (edge := self.edge) is not None:
            lines.append(
                f"at the edge     rings at {edge.omega_rad_per_s / (2.0 * math.pi):.5g} Hz, where f"
                f" = {edge.f_n_s_per_m:.5g} N s/m: 2(b R - f)/T = {edge.k_exact_n_per_m:.6g} N/m,"
                f" R = {edge.damping_factor:.5g} (THEORY.md §9)"
            )
        if self.every_delay is not None:
            lines.append(self.every_delay.line)
        if (still := self.rest) is not None:
            lines.append(f"rest            {still.rest.text()}")
            if still.limit_cycle_free is not None:
                stiffest = _shown(still.k_rest_n_per_m, "N/m")
                lines.append(f"stiffest rest   {stiffest} with the declared friction")
            lines.append(f"rest map        {still.map.plot}")
        return lines


def analyse(options: AnalyseOptions) -> Analysis:
    """Analyse one law on one device."""
    device, period = shared.device(options), 1.0 / options.rate
    law = shared.law(options, options.law, options.gain, nominal=True)
    compiled, derivative = compile_law(law, period), without_spring(law, period)
    if compiled.evaluate is not None:
        raise UsageError(
            f"{law.kind}: has code of its own, so no transfer function and no poles to analyse;"
            " drop it: haptic study kmax --method simulation"
        )
    boundary = k_max(derivative, device)
    return Analysis(
        loop=shared.head(law, device),
        law=rendered(compiled, device),
        delay_ticks=device.delay,
        taps_n_per_m=compiled.taps,
        sections=len(compiled.sections),
        k_max=boundary,
        worlds=world_limits(derivative, device),
        tolerance=tolerance(compiled, device),
        edge=edge_of(derivative, device),
        every_delay=_every_delay(options, compiled, device),
        rest=_rest(
            options, compiled, derivative, device, boundary.k_max_n_per_m or 0.0
        ),
        picture=_draw(options, compiled, device),
    )


def _every_delay(
    options: AnalyseOptions, law: CompiledLaw, device: Plant
) -> DelaysJudged | None:
    if options.every_delay is None:
        return None
    try:
        return DelaysJudged(
            options.every_delay, every_delay(law, device, options.every_delay)
        )
    except ValueError as error:
        raise UsageError(f"--every-delay: {error}") from error


def _rest(
    options: AnalyseOptions,
    law: CompiledLaw,
    derivative: CompiledLaw,
    device: Plant,
    limit: float,
) -> RestFound | None:
    step, friction = options.resolution, options.friction
    if step is None:
        if friction is not None:
            raise UsageError(
                "--friction: rest takes the encoder too; give --resolution"
            )
        return None
    needed, nominal = rest(law, device, step), law.taps[0] - derivative.taps[0]
    free = stiffest = None
    if friction is not None:
        # Above K_max friction stops only small motions.
        stiffest = min(stiffest_at_rest(derivative, step, friction), limit)
        free, stiffest = needed.free(friction), stiffest if stiffest > 0.0 else None
    shown = friction or needed.friction_bound_n
    drawn = rest_map(law, nominal, device, step, shown, options.out / "rest.png")
    return RestFound(needed, drawn, free, stiffest)


def _shown(value: float | None, unit: str, missing: str = "none") -> str:
    return missing if value is None else f"{value:.6g} {unit}".rstrip()


def _tolerance_lines(limits: Tolerance) -> list[str]:
    low = _shown(limits.mass_min_kg, "kg", "stable down to 1e-4 of it, no limit found")
    high = _shown(limits.mass_max_kg, "kg", "stable up to 1e4 of it, no limit found")
    hand = _shown(limits.hand_stiffness_max_n_per_m, "N/m", "1e6 N/m, no limit found")
    late = _shown(limits.delay_max_ticks, "ticks", "100 ticks more, no limit found")
    return [
        f"mass            {low} .. {high}",
        f"damping from    {_shown(limits.damping_min_n_s_per_m, 'N s/m', '0 N s/m')}",
        f"hand up to      {hand}",
        f"delay up to     {late}",
    ]


@styled
def _draw(options: AnalyseOptions, law: CompiledLaw, device: Plant) -> Path:
    period, theta = device.period, np.linspace(0.0, np.pi, 801)
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(
        xlabel=OMEGA,
        ylabel=r"$f(\omega)$  [N s/m]",
        title=f"effective damping of {options.law}",
    )
    spring = 0.5 * period * law.h1
    axes.plot(
        theta / np.pi,
        effective_damping(law, period, theta / period),
        label="without delay",
    )
    whole = int(device.delay)
    if whole:
        axes.plot(
            theta / np.pi,
            effective_damping(law, period, theta / period, whole),
            label=f"late by {whole} T",
        )
    limit = device.damping - spring
    threshold(axes, limit, f"b − H(1)T/2 = {limit:.3g} N s/m: passive below")
    axes.legend()
    return save_figure(figure, options.out / "analyse.png", fresh)
