"""Options of `sim.tune.tune`."""

from dataclasses import dataclass, field
from pathlib import Path

from nodes.parameters.options import argument, option, quantity
from nodes.parameters.quantities import between, positive
from sim.identify.pushing import PushOptions

STEPS = ("identify", "design", "predict", "verify", "apply")


@dataclass(frozen=True, kw_only=True)
class TuneOptions(PushOptions):
    """Options of a tuning."""

    scenario: str | None = argument(
        default=None, help="start this launch file for it; left out: the running launch"
    )
    steps: list[str] = option(
        nargs="+",
        choices=STEPS,
        default=list(STEPS),
        help="only these; what comes before is read from --out",
    )
    taps: int = quantity("taps", 4)
    spread: float = option(
        type=between(1.0, 100.0), default=1.25, help="factor the mass may be off by"
    )
    radius: float = option(
        type=between(1e-3, 1.0), default=0.99, help="pole radius allowed"
    )
    nyquist: float | None = option(
        type=positive,
        help="|H(-1)| allowed [N/m] (default: what friction quiets, 2 f_c/Δ, 1000 to 10000)",
    )
    land: bool = option(
        action="on_off",
        default=True,
        help=(
            "demand that every drop on a floor settles too; without it a law is stiffer, and may"
            " not survive a landing"
        ),
    )
    refuted: bool = option(
        action="store_true",
        help="design even if the recording refutes the model of the device",
    )
    rearm: bool = option(
        action="store_true",
        help=(
            "re-enable forces after a trial that stopped the driver; use only while standing at the"
            " device (virtual: always)"
        ),
    )
    out: Path = option(type=Path, default=Path("tuning"), help="directory of files")
    # the command line, for the report
    command: str = field(default="", repr=False, compare=False)
