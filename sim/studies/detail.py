"""Find the coarsest scene that the device cannot tell from the finest: meshes, bodies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, argument, option
from nodes.parameters.quantities import not_negative, positive
from nodes.recording import figure_style as style
from sim.results import fresh
from sim.studies.result import Findings, at_top

if TYPE_CHECKING:
    from nodes.launcher.launch_spec import Launch
    from nodes.laws import CompiledLaw
    from sim.experiments.detail import Detail


@dataclass(frozen=True, kw_only=True)
class DetailOptions(FileOptions):
    """Options of `detail`."""

    scenario: str = argument(
        help="name of a launch file with a shape in three axes, or the path of one"
    )
    assignments: list[str] = argument(
        default=[],
        nargs="*",
        metavar="name:=value",
        help="arguments of the launch file",
    )
    fraction: float = option(
        default=0.01,
        type=not_negative,
        help="part of the largest force that is no difference",
    )
    resolution: float | None = option(
        type=positive,
        help="encoder step [m] (default: the scene's device, or a Touch X's)",
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class DetailFound(Findings):
    """Levels of detail of a scene, and the coarsest that is enough."""

    scenario: str
    found: Detail = at_top()

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return super().answer | {"needs": self.found.coarsest.name}


def detail(options: DetailOptions) -> DetailFound:
    """Guide the device along a lockstep run's path through every level of detail."""
    from nodes.coupling.law_book import LawBook
    from nodes.coupling.parameters import CouplingParameters
    from nodes.launcher import launch_file, scenario_files
    from nodes.parameters.store import ParameterError, convert
    from sim.experiments.body_detail import body_detail
    from sim.experiments.terms import RESOLUTION

    try:
        launch = launch_file.read(
            options.scenario, scenario_files.parse_assignments(options.assignments)
        )
        parts = {
            spec.kind: (name, spec.parameters) for name, spec in launch.nodes.items()
        }
        if not {"environment", "mujoco"} & set(parts) or "coupling" not in parts:
            raise UsageError(
                f"{launch.scenario}: has no node of kind environment with a shape or of kind"
                " mujoco, and a coupling"
            )
        name, given = parts["coupling"]
        coupling = convert(given, CouplingParameters, name)
        law = LawBook(name, launch.run.period).compile(coupling, coupling.law)
        stiffness = law.h1
        device = parts.get("sim_driver", ("", {}))[1].get("device", {})
        resolution = options.resolution or device.get("resolution") or RESOLUTION
        if "mujoco" in parts:
            # In one process, bit-identical to a launch.
            step = options.progress(5)
            found = body_detail(launch, stiffness, resolution, options.fraction, step)
        else:
            found = _shapes(options, launch, *parts["environment"], law, resolution)
    except ParameterError:
        raise
    except ValueError as error:
        raise UsageError(f"{launch.scenario}: {error}") from error
    lines = _text(launch.scenario, stiffness, resolution, found)
    picture = draw(
        options.out / f"detail_{launch.scenario}.png", launch.scenario, found
    )
    return DetailFound(
        lines=lines, scenario=launch.scenario, found=found, picture=picture
    )


def _shapes(
    options: DetailOptions,
    launch: Launch,
    name: str,
    given: dict[str, Any],
    law: CompiledLaw,
    resolution: float,
) -> Detail:
    """Compare the levels of a shape along the proxy's path of a launch in lockstep."""
    from nodes.environment.shapes.touchable import Touchable
    from nodes.environment.surfaces import parse_surface
    from sim.experiments.detail import detail
    from sim.play.player import play

    surface = parse_surface(given.get("surface", {"kind": "free"}), f"{name}.surface")
    if not isinstance(surface, Touchable):
        raise UsageError(
            f"{name}.surface.kind: {surface.kind!r} has one level of detail; take a shape"
            " in three axes, e.g. mesh_pebble"
        )
    at = f"{name}.surface"
    solids, regions = surface.solids(at), surface.regions(at)
    if any(solid.motion is not None for solid in solids):
        raise UsageError(
            f"{at}: shapes that move are not judged, because their speed depends on the"
            " force; leave motion out to judge them where they begin"
        )
    # In one process, bit-identical to a lockstep launch, whatever `run.pace` is.
    path = play(launch).measured
    loop = launch.run.period, law.h1, resolution, options.fraction
    return detail(
        solids, path, surface.tool_radius, *loop, options.progress(12), regions, law
    )


def _text(
    scenario: str, stiffness: float, resolution: float, found: Detail
) -> list[str]:
    lines = [
        (
            f"{scenario}: H(1) {stiffness:.4g} N/m, encoder step {1e6 * resolution:.3g} µm: force"
            f" step {1e3 * found.force_step_n:.3g} mN; largest force {found.largest_n:.3g} N; no"
            f" difference up to {1e3 * found.limit_n:.3g} mN"
        ),
        "",
        (
            f"{'level':30}{'shapes':>8}{'triangles':>11}{'force differs [mN]':>20}"
            f"{'proxy [µm]':>12}{'places':>8}{'µs a call':>18}"
        ),
        f"{'':49}{'max':>10}{'rms':>10}{'':20}{'median':>9}{'p99':>9}",
    ]
    lines += [
        f"{level.name:30}{level.solids:8}{level.triangles:11}"
        f"{1e3 * level.force_n:10.3g}{1e3 * level.rms_n:10.3g}"
        f"{level.proxy_um:12.3g}{level.places:8}{level.call_us:9.3g}{level.call_p99_us:9.3g}"
        f"{'  enough' if level.enough else ''}"
        for level in found.levels
    ]
    lines += [f"left out: {text}" for text in found.left_out]
    enough, finest = found.coarsest, found.levels[0]
    lines.append(f"this scene needs: {enough.name}")
    if enough is not finest:
        lines[-1] += (
            f"; as it is, it adds at most {1e3 * enough.force_n:.3g} mN and costs "
            f"{finest.call_us - enough.call_us:+.3g} µs a tick"
        )
    return lines


@style.styled
def draw(path: Path, scenario: str, found: Detail) -> Path:
    """Plot each level's difference of force, and the time of a call."""
    import numpy as np

    levels = found.levels
    figure = style.new_figure(8.6, 1.4 + 0.32 * len(levels))
    differs, costs = figure.subplots(1, 2, sharey=True, width_ratios=(1.6, 1.0))
    style.name_rows(differs, [level.name for level in levels])
    # Zero and rounding have no place on a logarithmic axis; they are drawn at its end.
    least = 1e-3 * (1e3 * found.limit_n)
    for axes, low, high, names, scale in (
        (differs, "rms_n", "force_n", ("rms", "largest"), 1e3),
        (costs, "call_us", "call_p99_us", ("median", "p99"), 1.0),
    ):
        for key, name, colour, mark in zip(
            (low, high), names, style.COLOURS, style.MARKERS, strict=False
        ):
            values = np.maximum(
                [scale * getattr(level, key) for level in levels],
                least if axes is differs else 0.0,
            )
            axes.plot(
                values,
                range(len(levels)),
                mark,
                color=colour,
                label=name,
                clip_on=False,
            )
        style.legend_above(axes)
    differs.set(
        xscale="log",
        xlabel="the force differs by, at the left end less than that  [mN]",
        # The limit is drawn even if no level differs at all.
        xlim=(
            least,
            1e3 * max(3.0 * found.limit_n, *(2.0 * level.force_n for level in levels)),
        ),
    )
    # A single interrupted call would push all others to the left.
    apart = max(level.call_p99_us for level in levels) > 20.0 * min(
        level.call_us for level in levels
    )
    costs.set(xscale="log" if apart else "linear", xlabel="time of a call  [µs]")
    figure.suptitle(
        f"{scenario} needs: {found.coarsest.name}", fontsize=9.5, x=0.01, ha="left"
    )
    style.threshold(
        differs,
        1e3 * found.limit_n,
        f"no difference: up to {1e3 * found.limit_n:.3g} mN",
        vertical=True,
    )
    return style.save_figure(figure, path, fresh)
