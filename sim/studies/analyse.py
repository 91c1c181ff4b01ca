"""Analyse a law: f(ω), leak, passivity limit, pole radius, K_max, tolerance of the device."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from messages.errors import UsageError
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law
from nodes.parameters.options import FileOptions, argument, option, quantity
from nodes.parameters.quantities import interval, not_negative, positive
from nodes.recording.figure_style import OMEGA, new_figure, save_figure, styled, threshold
from nodes.stability.closed_loop import law_figures
from nodes.stability.effective_damping import effective_damping
from nodes.stability.every_delay import every_delay
from nodes.stability.k_max import edge_of, k_max, tolerance, without_spring
from nodes.stability.plant import Plant
from nodes.stability.rest import rest, stiffest_at_rest
from nodes.stability.world_limits import finite, world_limits
from sim.experiments.rest_map import rest_map
from sim.results import fresh
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions, LawOptions
from sim.studies.result import Answer, answered


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


def analyse(options: AnalyseOptions) -> Answer:
    """Analyse one law on one device."""
    device, period = shared.device(options), 1.0 / options.rate
    law = shared.law(options, options.law, options.gain, nominal=True)
    compiled, derivative = compile_law(law, period), without_spring(law, period)
    if compiled.evaluate is not None:
        raise UsageError(
            f"{law.kind}: has code of its own, so no transfer function and no poles to analyse;"
            " drop it: haptic study kmax --method simulation"
        )
    limits, edge, boundary = (
        tolerance(compiled, device),
        edge_of(derivative, device),
        asdict(k_max(derivative, device)),
    )
    worlds = world_limits(derivative, device)
    figures = law_figures(compiled, device) | {
        "tolerance": limits and asdict(limits),
        **{key: boundary[key] for key in ("k_max_n_per_m", "h1_max_n_per_m", "method")},
        "edge": edge and asdict(edge),
        **{f"k_max_{name}_n_per_m": finite(k) for name, k in worlds.k_max_n_per_m.items()},
        "every_delay": _every_delay(options, compiled, device),
        "rest": _rest(options, compiled, derivative, device, boundary["k_max_n_per_m"] or 0.0),
    }
    if options.resolution is not None:
        friction = options.friction or figures["rest"]["friction_bound_n"]
        nominal = compiled.taps[0] - derivative.taps[0]
        figures["rest"]["map"] = rest_map(
            compiled, nominal, device, options.resolution, friction, options.out / "rest.png"
        )
    figures["loop"] = shared.head(law, device)
    return answered(figures, _text(figures), plot=_draw(options, compiled, device))


def _every_delay(options: AnalyseOptions, law: CompiledLaw, device: Plant) -> dict[str, Any] | None:
    if options.every_delay is None:
        return None
    try:
        found = every_delay(law, device, options.every_delay)
    except ValueError as error:
        raise UsageError(f"--every-delay: {error}") from error
    return {"delay_ticks": list(options.every_delay), **asdict(found)}


def _rest(
    options: AnalyseOptions, law: CompiledLaw, derivative: CompiledLaw, device: Plant, limit: float
) -> dict[str, Any] | None:
    if options.resolution is None:
        if options.friction is not None:
            raise UsageError("--friction: rest takes the encoder too; give --resolution")
        return None
    needed = rest(law, device, options.resolution)
    found: dict[str, Any] = {**asdict(needed), "text": needed.text()}
    if options.friction is not None:
        # Above K_max friction stops only small motions.
        stiffest = min(stiffest_at_rest(derivative, options.resolution, options.friction), limit)
        found["limit_cycle_free"] = needed.free(options.friction)
        found["k_rest_n_per_m"] = stiffest if stiffest > 0.0 else None
    return found


def _text(figures: dict[str, Any]) -> list[str]:
    def shown(value: float | None, unit: str, missing: str = "none") -> str:
        return missing if value is None else f"{value:.6g} {unit}".rstrip()

    verdict = "stable" if figures["pole_radius"] < 1.0 else "UNSTABLE"
    lines = [
        figures["loop"],
        f"H(1)            {shown(figures['h1_n_per_m'], 'N/m')}",
        f"H(-1)           {shown(figures['h_nyquist_n_per_m'], 'N/m')}",
        (
            f"f min, H(1)     {shown(figures['f_min_n_s_per_m'], 'N s/m')} at"
            f" {figures['f_min_rad_per_s']:.5g} rad/s"
        ),
        f"f(w_N), H(1)    {shown(figures['f_nyquist_n_s_per_m'], 'N s/m')}",
        f"passive from b  {shown(figures['damping_needed_n_s_per_m'], 'N s/m')}",
        f"passive scale   {shown(figures['passive_scale'], '')}",
        f"pole radius     {figures['pole_radius']:.9f} ({verdict})",
        (
            f"K_max           {shown(figures['k_max_n_per_m'], 'N/m')} nominal, "
            f"{shown(figures['h1_max_n_per_m'], 'N/m')} felt ({figures['method']})"
        ),
    ]
    for key, label in (("any_world", "K_max any world"), ("any_hand_any_world", "any hand, world")):
        lines.append(
            f"{label} {shown(figures[f'k_max_{key}_n_per_m'], 'N/m', 'none certified')} (THEORY.md"
            " §18)"
        )
    lines += _beyond(figures)
    limits = figures["tolerance"]
    if limits is not None:
        lines += [
            (
                "mass            "
                f"{shown(limits['mass_min_kg'], 'kg', 'stable down to 1e-4 of it, no limit found')}"
                " .. "
                f"{shown(limits['mass_max_kg'], 'kg', 'stable up to 1e4 of it, no limit found')}"
            ),
            f"damping from    {shown(limits['damping_min_n_s_per_m'], 'N s/m', '0 N s/m')}",
            (
                "hand up to     "
                f" {shown(limits['hand_stiffness_max_n_per_m'], 'N/m', '1e6 N/m, no limit found')}"
            ),
            (
                "delay up to    "
                f" {shown(limits['delay_max_ticks'], 'ticks', '100 ticks more, no limit found')}"
            ),
        ]
    return lines


def _beyond(figures: dict[str, Any]) -> list[str]:
    """Return the requested lines on ringing frequency, sequences of delays and rest."""
    lines = []
    edge, jitter, still = figures["edge"], figures["every_delay"], figures["rest"]
    if edge is not None:
        lines.append(
            f"at the edge     rings at {edge['omega_rad_per_s'] / (2.0 * math.pi):.5g} Hz, where f"
            f" = {edge['f_n_s_per_m']:.5g} N s/m: 2(b R - f)/T = {edge['k_exact_n_per_m']:.6g} N/m,"
            f" R = {edge['damping_factor']:.5g} (THEORY.md §9)"
        )
    if jitter is not None:
        low, high = jitter["delay_ticks"]
        row = {
            True: f"stable: a common norm shrinks over each of {jitter['words']} words of delays",
            False: (
                f"UNSTABLE: {', '.join(f'{d:.4g}' for d in jitter['growing'])} ticks, repeated,"
                f" grow by {jitter['growth']:.6f} per tick"
            ),
            None: "not decided: no norm found, and no sequence that grows",
        }[jitter["stable"]]
        lines.append(f"every delay     of {low:g}..{high:g} ticks: {row} (THEORY.md §10)")
    if still is not None:
        lines.append(f"rest            {still['text']}")
        if "k_rest_n_per_m" in still:
            stiffest = still["k_rest_n_per_m"]
            lines.append(
                f"stiffest rest   {'none' if stiffest is None else f'{stiffest:.6g} N/m'} with the"
                " declared friction"
            )
        lines.append(f"rest map        {still['map']['plot']}")
    return lines


@styled
def _draw(options: AnalyseOptions, law: CompiledLaw, device: Plant) -> Path:
    period, theta = device.period, np.linspace(0.0, np.pi, 801)
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(
        xlabel=OMEGA, ylabel=r"$f(\omega)$  [N s/m]", title=f"effective damping of {options.law}"
    )
    spring = 0.5 * period * law.h1
    axes.plot(theta / np.pi, effective_damping(law, period, theta / period), label="without delay")
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
