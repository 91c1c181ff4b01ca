"""What a study of K_max found: at one gain, over a range, or by launches."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from nodes.stability.k_max import KMax
from sim.studies.result import Findings, StudyResult

if TYPE_CHECKING:
    from sim.design.hand_box import HandBox
    from sim.experiments.k_max_launched import SameKMax


@dataclass(frozen=True)
class SearchedKMax(KMax):
    """Result of a simulation."""

    # softest and stiffest tried K [N/m]
    searched: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True, repr=False)
class KMaxFound(StudyResult):
    """K_max of one law at one gain, optionally by launches too."""

    loop: str  # law, device and loop
    found: KMax
    grasp: HandBox | None = None
    # in the worst grasp of the box; None: no stable stiffness
    k_max_grasp_n_per_m: float | None = None

    @property
    def k_max_n_per_m(self) -> float | None:
        """Largest stable nominal stiffness [N/m]; None if none is stable or no limit was found."""
        return bounded(self.found.k_max_n_per_m)

    @property
    def held(self) -> bool:
        """Whether any stiffness is stable."""
        return self.found.k_max_n_per_m is not None

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        stable = [
            [low, high if math.isfinite(high) else None]
            for low, high in self.found.stable
        ]
        figures = (
            {"loop": self.loop} | _figures(self.found) | {"stable_n_per_m": stable}
        )
        if self.grasp is not None:
            figures["k_max_grasp_n_per_m"] = self.k_max_grasp_n_per_m
            figures["grasp"] = asdict(self.grasp)
        return figures

    @property
    def text(self) -> str:
        """Text for the terminal."""
        lines, limit = [self.loop, _said(self.found)], self.k_max_grasp_n_per_m
        if self.grasp is not None:
            text = (
                "no stiffness is stable"
                if limit is None
                else f"{limit:.6g} N/m (nominal)"
            )
            lines.append(f"K_max    {text} in the worst {self.grasp.text()}")
        return "\n".join(lines)


@dataclass(frozen=True, repr=False, kw_only=True)
class KMaxLaunched(StudyResult):
    """K_max on a grid of stiffnesses, by launches in lockstep and in one process."""

    loop: str
    found: SameKMax
    grid: tuple[float, float, float]  # softest, next and stiffest K [N/m]

    @property
    def same(self) -> bool:
        """Whether both found the same stiffness."""
        return self.found.launched_n_per_m == self.found.one_process_n_per_m

    @property
    def held(self) -> bool:
        """Whether they did, and it lies on the grid."""
        return self.same and bounded(self.found.launched_n_per_m) is not None

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return {
            "loop": self.loop,
            "k_max_n_per_m": bounded(self.found.launched_n_per_m),
            "h1_max_n_per_m": self.found.h1_n_per_m,
            "method": "lockstep",
            "one_process_n_per_m": bounded(self.found.one_process_n_per_m),
            "searched_n_per_m": [self.grid[0], self.grid[2]],
            "same": self.same,
            "launches": self.found.launches,
            "grid_ratio": self.grid[1] / self.grid[0],
        }

    @property
    def text(self) -> str:
        """Text for the terminal."""
        # Beyond the ends of the grid nothing was tried.
        ends = {
            0.0: f"below {self.grid[0]:.6g} N/m",
            math.inf: f"above {self.grid[2]:.6g} N/m",
        }
        both = self.found.launched_n_per_m, self.found.one_process_n_per_m
        launched, alone = (ends.get(k or 0.0, f"{k or 0.0:.6g} N/m") for k in both)
        verdict, step = (
            "the same" if self.same else "NOT the same",
            self.grid[1] / self.grid[0],
        )
        return (
            f"{self.loop}\nK_max    {launched} (nominal), by {self.found.launches} launches in"
            f" lockstep\n         {alone} in one process: {verdict}, on steps of {step - 1.0:.2%}"
        )


@dataclass(frozen=True)
class KMaxPoint:
    """K_max at one gain."""

    gain: float
    found: KMax

    @property
    def k(self) -> float | None:
        """Largest stable nominal stiffness [N/m]; None if none is stable or no limit was found."""
        return bounded(self.found.k_max_n_per_m)

    @property
    def h1(self) -> float | None:
        """The felt one [N/m]; None for a law that is not linear too."""
        return None if self.k is None else self.found.h1_max_n_per_m

    @property
    def endless(self) -> bool:
        """Whether no limit was found."""
        return self.found.k_max_n_per_m == math.inf

    @property
    def line(self) -> str:
        """The point as a line of a table."""
        least = _figures(self.found).get("at_least_n_per_m")
        end = "no limit" if least is None else f"> {least:.6g}"
        missing = end if self.endless else "-"
        return (
            f"{self.gain:10.4g}  {missing if self.k is None else f'{self.k:.6g}':>12} "
            f" {'-' if self.h1 is None else f'{self.h1:.6g}':>12}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        return {"gain": self.gain, **_figures(self.found)}


@dataclass(frozen=True, repr=False, kw_only=True)
class KMaxBoundary(Findings):
    """K_max over a range of gains."""

    loop: str
    points: list[KMaxPoint]

    @property
    def best(self) -> KMaxPoint | None:
        """The stiffest gain; None if none is stable, or a limit is missing."""
        if any(one.endless for one in self.points):
            return None
        stable = [one for one in self.points if one.k is not None]
        felt = all(one.h1 is not None for one in stable)
        return max(
            stable, key=lambda one: (one.h1 if felt else one.k) or 0.0, default=None
        )

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, those of the stiffest gain at the top level."""
        return {**({} if self.best is None else self.best.as_json()), **super().answer}


def _said(found: KMax) -> str:
    if found.k_max_n_per_m is None:
        return f"{nothing_found(found)}: lower the gain, the delay or the order"
    if not math.isfinite(found.k_max_n_per_m):
        if isinstance(found, SearchedKMax):
            return f"K_max    above {found.searched[1]:.6g} N/m (nominal), where the search ends"
        return "stable however stiff: no K_max"
    felt = (
        f"{found.h1_max_n_per_m:.6g} N/m (felt)"
        if found.h1_max_n_per_m is not None
        else "none: the law is not linear"
    )
    return (
        f"K_max    {found.k_max_n_per_m:.6g} N/m (nominal)\nH(1)_max {felt}\nmethod  "
        f" {found.method}"
    )


def bounded(k: float | None) -> float | None:
    """Return a finite limit, else None."""
    return k if k is not None and math.isfinite(k) else None


def nothing_found(found: KMax) -> str:
    """Return why nothing was found, in words."""
    if not isinstance(found, SearchedKMax):
        return "no stiffness is stable"
    return (
        f"nothing from {found.searched[0]:.4g} to {found.searched[1]:.4g} N/m settles"
    )


def _figures(found: KMax) -> dict[str, Any]:
    # JSON has no infinity: without a limit the figure is null, and the stable interval is open.
    limit = bounded(found.k_max_n_per_m)
    figures = {
        "k_max_n_per_m": limit,
        "h1_max_n_per_m": None if limit is None else found.h1_max_n_per_m,
        "method": found.method,
    }
    if found.k_max_n_per_m == math.inf:
        figures["at_least_n_per_m"] = (
            found.searched[1] if isinstance(found, SearchedKMax) else None
        )
    return figures
