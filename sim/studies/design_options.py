"""Options of `sim.studies.design`: devices, delays and requirements on the law."""

from dataclasses import dataclass
from pathlib import Path

from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import Interval, not_negative, positive, whole
from sim.design.hand_box import HandBox
from sim.studies import device_options as shared
from sim.studies.device_options import grasp_option
from sim.studies.sweeps import SpreadOptions


@dataclass(frozen=True, kw_only=True)
class DesignOptions(SpreadOptions, FileOptions):
    """Options of `design`."""

    mass: tuple[float, float] = quantity("mass", Interval(0.05, 0.2))
    damping: tuple[float, float] = quantity("damping", Interval(1.0, 1.0))
    # A recording may define both.
    delay: tuple[float, float] | None = quantity(
        "delay", Interval(1.0, 1.0), unset=True
    )
    rate: float | None = quantity("rate", 500.0, unset=True)
    taps: int = quantity("taps", 4)
    hand: tuple[float, float] = option(
        default=(0.0, 0.0),
        type=shared.hand,
        help="stiffness of a hand, LOW..HIGH [N/m], or one of `haptic device presets`",
    )
    world: str = option(
        "--for",
        default="wall",
        choices=("wall", "any_world", "any_hand"),
        help=(
            "what is behind the coupling: a wall and the hand given; any passive world and the"
            " device given; any hand and any passive world"
        ),
    )
    sections: bool = option(
        action="store_true",
        help="with --for any_hand or any_world: taps over a pole and two poles too, a minute each",
    )
    grasp: HandBox | None = grasp_option("judge the law in every grasp of a box too")
    radius: float = option(default=0.99, type=positive, help="pole radius allowed")
    nyquist: float = option(
        default=10000.0, type=positive, help="|H(-1)| allowed [N/m]"
    )
    from_run: Path | None = option(
        type=Path,
        metavar="RECORDING",
        help="take rate, delay and jitter from a recording",
    )
    effort: int = option(default=1, type=whole(1, 1000), help="multiplies the search")
    land: bool = option(
        default=True,
        action="on_off",
        help=(
            "demand that every drop settles too, from 5 to 20 mm and 3 %% beyond the masses, under"
            " all contact conventions; without it a law is stiffer, and may not survive a landing"
        ),
    )
    every_delay: bool = option(
        action="store_true",
        help=(
            "demand a certificate for every sequence of delays of the range, at most a tick wide;"
            " not only for constant ones"
        ),
    )
    resolution: float | None = option(
        type=positive, help="of the device's encoder, with --friction [m]"
    )
    friction: float | None = option(
        type=positive,
        help="of the device: |H(-1)| <= 2 friction/resolution, no chatter at rest [N]",
    )
    compare: bool = option(
        action="store_true",
        help="against best PD (bare, filtered, windowed), every PDα and the paper's optimum",
    )
    delays: list[float] = option(
        default=[0.0, 1.0, 2.0],
        type=not_negative,
        nargs="+",
        help="of --compare [ticks]",
    )
    margins: list[float] = option(
        default=[0.0, 0.5],
        type=not_negative,
        nargs="+",
        help="delay margins of --compare [ticks]",
    )
