"""What a law really renders: f(ω), leak, passivity limit, pole radius, K_max, and how far the device may be off."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from nodes.cli.main import UsageError, answer
from nodes.laws import CompiledLaw
from nodes.laws.parse import LawRefusedError, compile_law
from nodes.stability.closed_loop import law_figures
from nodes.stability.k_max import Device, k_max, tolerance, without_spring
from sim.studies import arguments as shared


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the study.
    """
    parser.add_argument("law", help="kind, preset or YAML mapping, e.g. '{kind: pd, stiffness: 1000, damping: 3}'")
    parser.add_argument("--gain", type=shared.not_negative, help="damping gain of the law")
    shared.add_law(parser)
    shared.add_device(parser)
    shared.add_answer(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Analyse one law on one device.

    Parameters
    ----------
    arguments : argparse.Namespace
        As declared by `add`.

    Returns
    -------
    int
        0.

    Raises
    ------
    UsageError
        When the law is refused.
    """
    device, period = shared.device(arguments), 1.0 / arguments.rate
    law = shared.law(arguments, arguments.law, arguments.gain)
    try:
        compiled = compile_law(law, period)
        derivative = without_spring(law, period)
    except LawRefusedError as error:
        raise UsageError(str(error)) from error
    figures = law_figures(compiled, period, device.mass, device.damping, device.delay, device.stiffness)
    limits = tolerance(compiled, period, device)
    boundary = k_max(derivative, period, device)
    figures |= {"tolerance": None if limits is None else asdict(limits), **_boundary(asdict(boundary))}
    figures["plot"] = str(_draw(arguments, compiled, device, period))
    answer(arguments.json, figures, _text(figures))
    return 0


def _boundary(found: dict[str, Any]) -> dict[str, Any]:
    return {key: found[key] for key in ("k_max_n_per_m", "h1_max_n_per_m", "method")}


def _text(figures: dict[str, Any]) -> str:
    def shown(value: float | None, unit: str, missing: str = "none") -> str:
        return missing if value is None else f"{value:.6g} {unit}".rstrip()

    verdict = "stable" if figures["pole_radius"] < 1.0 else "UNSTABLE"
    lines = [
        f"H(1)            {shown(figures['h1_n_per_m'], 'N/m')}",
        f"H(-1)           {shown(figures['h_nyquist_n_per_m'], 'N/m')}",
        f"f min           {shown(figures['f_min_n_s_per_m'], 'N s/m')} at {figures['f_min_rad_per_s']:.5g} rad/s",
        f"f at Nyquist    {shown(figures['f_nyquist_n_s_per_m'], 'N s/m')}",
        f"passive from b  {shown(figures['damping_needed_n_s_per_m'], 'N s/m')}",
        f"passive scale   {shown(figures['passive_scale'], '')}",
        f"pole radius     {figures['pole_radius']:.9f} ({verdict})",
        f"K_max           {shown(figures['k_max_n_per_m'], 'N/m')} nominal, "
        f"{shown(figures['h1_max_n_per_m'], 'N/m')} felt ({figures['method']})",
    ]
    limits = figures["tolerance"]
    if limits is not None:
        lines += [
            f"mass            {shown(limits['mass_min_kg'], 'kg', 'any lighter')} .. "
            f"{shown(limits['mass_max_kg'], 'kg', 'any heavier')}",
            f"damping from    {shown(limits['damping_min_n_s_per_m'], 'N s/m', '0 N s/m')}",
            f"hand up to      {shown(limits['hand_stiffness_max_n_per_m'], 'N/m', 'any stiffness')}",
            f"delay up to     {shown(limits['delay_max_ticks'], 'ticks', 'any')}",
        ]
    return "\n".join([*lines, figures["plot"]])


def _draw(arguments: argparse.Namespace, law: CompiledLaw, device: Device, period: float) -> Path:
    import numpy as np
    from matplotlib.figure import Figure

    from nodes.stability.effective_damping import effective_damping

    theta = np.linspace(0.0, np.pi, 801)
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot(xlabel="ω/ω_N", ylabel="[N s/m]", title=f"f(ω) of {arguments.law}")
    spring = 0.5 * period * law.h1
    axes.plot(theta / np.pi, effective_damping(law, period, theta / period), label="f(ω)")
    whole = int(device.delay)
    if whole:
        axes.plot(
            theta / np.pi, effective_damping(law, period, theta / period, whole), label=f"f(ω), {whole} ticks late"
        )
    axes.axhline(device.damping - spring, color="k", linestyle="--", label="passive below b − H(1)T/2")
    axes.legend()
    axes.grid(alpha=0.3)
    arguments.out.mkdir(parents=True, exist_ok=True)
    path: Path = arguments.out / "analyse.png"
    figure.savefig(path, dpi=150)
    return path
