"""Rendered stiffness and damping of laws over frequency, with hold and delay, and Z-width."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import Interval, whole
from nodes.recording.figure_style import PAGE_WIDTH, new_figure, save_figure, styled
from nodes.stability.plant import Plant
from sim.results import fresh
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions, LawOptions
from sim.studies.law_looks import law_looks
from sim.studies.result import Findings

if TYPE_CHECKING:
    from sim.experiments.rendered import FeltResponse, ZWidth

SHOWN = (1.0, 10.0, 50.0, 100.0)  # frequencies of the printed table [Hz]


@dataclass(frozen=True, kw_only=True)
class ResponseOptions(LawOptions, DeviceOptions, FileOptions):
    """Options of `response`."""

    law: list[str] = option(
        default=["pd"],
        nargs="+",
        help="kinds, presets or YAML mappings, compared (default: pd)",
    )
    gain: tuple[float, float] | None = quantity("gain", Interval())
    points: int = option(default=41, type=whole(2, 10000), help="gains of the plane")


@dataclass(frozen=True)
class LawFelt:
    """What is felt of one law."""

    law: str
    felt: FeltResponse
    plane: ZWidth | None  # over gains; None for one gain

    def as_json(self) -> dict[str, Any]:
        """Return the figures, those of what is felt at the top level."""
        return {"law": self.law, **vars(self.felt), "plane": self.plane}


@dataclass(frozen=True, repr=False, kw_only=True)
class ResponseFound(Findings):
    """What is felt of each law over frequency, and its K–B plane over gains."""

    rate_hz: float
    delay_ticks: float
    laws: list[LawFelt]


def response(options: ResponseOptions) -> ResponseFound:
    """Compute the response of each law at its own gains, and the K–B plane over gains."""
    import numpy as np

    from sim.experiments.rendered import frequencies, rendered, z_width

    device = shared.device(options)
    low, high = options.gain or (
        0.0,
        2.0 * device.mass / device.period / (1.0 + 2.0 * device.delay),
    )
    several = low < high
    one = low if options.gain is not None and not several else 0.3 * high
    chosen = [shared.law(options, name, one) for name in options.law]
    at = np.unique(
        np.concatenate(
            [frequencies(device.period), [f for f in SHOWN if f <= 0.5 * options.rate]]
        )
    )
    try:
        found = [
            rendered(law.compile(device.period), device.period, device.delay, at)
            for law in chosen
        ]
        gains = np.linspace(low, high, options.points).tolist() if several else []
        planes = [z_width(law, device, gains) for law in chosen] if gains else []
    except ValueError as error:
        raise UsageError(str(error)) from error
    lines = [
        f"at {options.rate:g} Hz, {device.delay:g} ticks late; felt with the hold, and (of the"
        " law alone)"
    ]
    for law, felt in zip(chosen, found, strict=True):
        lines.append(shared.head(law, device))
        for frequency in [f for f in SHOWN if f <= 0.5 * options.rate]:
            i = int(np.searchsorted(felt.frequency_hz, frequency))
            lines.append(
                f"  {frequency:6g} Hz  {felt.stiffness_n_per_m[i]:10.5g} N/m"
                f" ({felt.law_stiffness_n_per_m[i]:.5g})  {felt.damping_n_s_per_m[i]:10.4g} N s/m"
                f" ({felt.law_damping_n_s_per_m[i]:.4g})"
            )
    return ResponseFound(
        lines=lines + _plane_lines(options.law, planes),
        rate_hz=options.rate,
        delay_ticks=device.delay,
        laws=[
            LawFelt(*one) for one in itertools.zip_longest(options.law, found, planes)
        ],
        picture=draw(options.out / "response.png", options.law, found, planes, device),
    )


def _plane_lines(names: list[str], planes: list[Any]) -> list[str]:
    import numpy as np

    lines = []
    for name, plane in zip(names, planes, strict=False):
        stable, passive = plane.h1_max_n_per_m, plane.passive_n_per_m
        for words, values in (
            ("stable in known hands", stable),
            ("passive in any", passive),
        ):
            if np.all(np.isnan(values)):
                lines.append(
                    f"{name}: {words}: at no gain from {plane.gain[0]:g} to {plane.gain[-1]:g}"
                )
                continue
            i = int(np.nanargmax(values))
            lines.append(
                f"{name}: {words} up to {values[i]:.5g} N/m, at a gain of {plane.gain[i]:.4g}"
            )
    return lines


@styled
def draw(
    path: Path, names: list[str], found: list[Any], planes: list[Any], device: Plant
) -> Path:
    """Plot stiffness and damping over frequency, with the K–B plane beside them."""
    figure = new_figure(PAGE_WIDTH, 4.4)
    looks = law_looks(names)
    grid = figure.add_gridspec(2, 2 if planes else 1)
    top = figure.add_subplot(grid[0, 0], xscale="log", ylabel="stiffness felt  [N/m]")
    below = figure.add_subplot(
        grid[1, 0],
        xscale="log",
        ylabel="damping felt  [N s/m]",
        xlabel="frequency  [Hz]",
    )
    for name, look, felt in zip(names, looks, found, strict=True):
        for axes, key in ((top, "stiffness_n_per_m"), (below, "damping_n_s_per_m")):
            axes.plot(felt.frequency_hz, getattr(felt, key), **look.curve(), label=name)
            alone = getattr(felt, f"law_{key}")
            axes.plot(
                felt.frequency_hz, alone, ls=":", lw=0.8, color=look.color, label="_"
            )
    top.set_title(
        f"what is felt (dotted: of the law alone), {1.0 / device.period:g} Hz, {device.delay:g}"
        " ticks late",
        fontsize=8,
    )
    top.legend()
    if planes:
        plane = figure.add_subplot(
            grid[:, 1], xlabel="gain B of the damper", ylabel="stiffness  [N/m]"
        )
        for name, look, one in zip(names, looks, planes, strict=True):
            plane.plot(
                one.gain,
                one.h1_max_n_per_m,
                **look.curve(),
                label=f"{name}, stable: H(1)",
            )
            passive: dict[str, Any] = look.curve() | {"lw": 0.7}
            plane.plot(
                one.gain, one.passive_n_per_m, **passive, label=f"{name}, passive"
            )
        plane.set_title(
            f"Z-width, m = {device.mass:g} kg, b = {device.damping:g} N s/m", fontsize=8
        )
        plane.legend()
    return save_figure(figure, path, fresh)
