"""Remedies for a refused law: the nearest accepted value, factor or part of a field."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from messages.errors import AT_LEAST, AT_MOST, OTHER, TOGETHER, Remedy
from nodes.coupling.field_judgement import FeltLaw, largest_share
from nodes.coupling.force_fields import ForceField
from nodes.coupling.law_book import LawBook
from nodes.coupling.law_numbers import (
    numbers_of,
    rounded_towards,
    scaled_law,
    with_numbers,
)
from nodes.coupling.parameters import CouplingParameters
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law

if TYPE_CHECKING:
    from nodes.stability.plant import Plant

_NAMED = 8  # parameters that a text names; a law may have thousands of taps
_SOFTEST = 1e-12  # part of the requested stiffness from which a stable one is searched


class Remedies:
    """Searches what a coupling would accept instead of an unstable law.

    Parameters
    ----------
    node : str
        Name of the coupling.
    period : float
        Sampling period T [s].
    book : LawBook
        Its laws.
    """

    def __init__(self, node: str, period: float, book: LawBook) -> None:
        self._node, self._period, self._book = node, period, book

    def in_field(
        self,
        felt: Sequence[FeltLaw],
        plant: Plant,
        field: ForceField,
        axes: Sequence[str],
    ) -> Remedy:
        """Return the largest part of a field in which a law is accepted."""
        stable = largest_share(felt, [plant], field, axes)
        part = f"{rounded_towards(stable, 0.0):g} times" if stable else "no part of"
        text = f"the law itself is stable: {part} this field would be accepted"
        return Remedy(OTHER, text)

    def felt_at(self, effect: str) -> Remedy:
        """Return what to change where a shape or region makes a stable law unstable."""
        return Remedy(
            OTHER,
            f"the law itself is stable: raise the factors of {effect} (its damping), or"
            " change its time, or take a softer law",
        )

    def of_law(
        self,
        now: CouplingParameters | None,
        wanted: CouplingParameters,
        name: str,
        plant: Plant,
    ) -> Remedy:
        """Return the last accepted values on the way from the law of before to the wanted one."""
        asked = self._book.description(wanted, name)
        where = f"{self._node}.laws.{name}" if name in wanted.laws else name
        start = self._start(now, name, asked)
        return (
            self._last_values(asked, start, where, plant)
            if start
            else self._largest_factor(asked, where, plant)
        )

    def _largest_factor(
        self, asked: dict[str, Any], where: str, plant: Plant
    ) -> Remedy:
        """Return the largest factor of all taps with which a law is accepted."""
        from nodes.stability.judge import furthest_stable

        whole = self._compiled(asked)
        share = furthest_stable(lambda part: scaled_law(whole, part), plant)
        part = (
            f"all taps of {where} times {rounded_towards(share, 0.0):g}"
            if share
            else f"no part of {where}"
        )
        return Remedy(OTHER, f"{part} would be accepted")

    def _last_values(
        self, asked: dict[str, Any], start: dict[str, float], where: str, plant: Plant
    ) -> Remedy:
        """Return the last accepted values on the way from `start` to the values asked for."""
        from nodes.stability.judge import between, furthest_stable, judge

        def at(share: float) -> Any:
            return with_numbers(
                asked,
                lambda path, end: (
                    between(start[path], end, share) if path in start else end
                ),
            )

        share = furthest_stable(lambda part: self._compiled(at(part)), plant)
        if share is None:
            return Remedy(
                OTHER,
                f"no value of {where}.{_listed(start, ' or ')} is accepted on the way there, with "
                "the rest as requested",
            )
        reached = numbers_of(at(share))
        ends = numbers_of(asked)
        if len(start) > 1:
            told = _listed([f"{path} {reached[path]:.4g}" for path in start], ", ")
            return Remedy(
                TOGETHER,
                f"together, {where} is accepted up to {told}",
                {f"{where}.{path}": reached[path] for path in start},
            )
        ((path, begin),) = start.items()
        value = rounded_towards(reached[path], begin)
        rounded = self._compiled(
            with_numbers(asked, lambda at, end: value if at == path else end)
        )
        found = judge(rounded, plant)
        if found is None or not found.stable:
            value = reached[path]
        kind, side = (
            (AT_MOST, "largest") if ends[path] > begin else (AT_LEAST, "smallest")
        )
        return Remedy(
            kind,
            f"the {side} {where}.{path} that is accepted is {value:.9g}",
            {f"{where}.{path}": value},
        )

    def _start(
        self, now: CouplingParameters | None, name: str, asked: dict[str, Any]
    ) -> dict[str, float]:
        """Return the start of the path to a refused law: the values before, or no stiffness.

        Empty if the law has no such value.
        """
        ends = numbers_of(asked)
        if now is not None and name in self._book.names(now):
            before = self._book.description(now, name)
            begins = numbers_of(before)
            changed = {
                path: begins[path]
                for path in ends
                if path in begins and begins[path] != ends[path]
            }
            if (
                changed
                and with_numbers(before, lambda path, value: ends.get(path, value))
                == asked
            ):
                return changed
        return (
            {"stiffness": _SOFTEST * ends["stiffness"]} if "stiffness" in ends else {}
        )

    def _compiled(self, description: dict[str, Any]) -> CompiledLaw:
        return compile_law(parse_law(description), self._period)


def _listed(names: Iterable[str], joint: str) -> str:
    """Return names for a person, of many the first."""
    every = list(names)
    more = len(every) - _NAMED
    first = joint.join(every[:_NAMED])
    return f"{first} and {more} more" if more > 0 else first
