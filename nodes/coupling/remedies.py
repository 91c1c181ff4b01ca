"""Remedies for a refused law: the nearest accepted value, factor or part of a field."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import msgspec

from messages.errors import AT_LEAST, AT_MOST, OTHER, TOGETHER, Remedy
from nodes.coupling.field_judgement import FeltLaw, largest_share
from nodes.coupling.force_fields import ForceField
from nodes.coupling.law_book import LawBook
from nodes.coupling.law_numbers import numbers_of, scaled_law, with_numbers
from nodes.coupling.parameters import CouplingParameters
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law
from nodes.laws.suggested import rounded_towards

if TYPE_CHECKING:
    from nodes.stability.plant import Plant

_NAMED = 8  # parameters that a text names; a law may have thousands of taps
_SOFTEST = 1e-12  # part of the requested stiffness from which a stable one is searched

Accepts: TypeAlias = Callable[[CouplingParameters, CompiledLaw], bool]
"""Whether a law would be accepted with some parameters, at any delay that is likely."""


@dataclass(frozen=True)
class _Way:
    """From accepted values to the refused ones, by path."""

    where: str  # path of what the values belong to
    start: Mapping[str, float]
    ends: Mapping[str, float]
    accepts: Callable[[Mapping[str, float]], bool]
    taps: int  # length of the law

    def at(self, share: float) -> dict[str, float]:
        """Return the values at a share (0 to 1) of the way."""
        from nodes.stability.judge import between

        return {
            path: between(begin, self.ends[path], share)
            for path, begin in self.start.items()
        }

    def last_accepted(self) -> Remedy | None:
        """Return the last values on the way that are accepted; None if there are none."""
        from nodes.stability.judge import furthest_accepted

        share = furthest_accepted(lambda part: self.accepts(self.at(part)), self.taps)
        if share is None:
            return None
        reached = self.at(share)
        if len(reached) > 1:
            told = _listed([f"{path} {reached[path]:.4g}" for path in reached], ", ")
            return Remedy(
                TOGETHER,
                f"together, {self.where} is accepted up to {told}",
                {f"{self.where}.{path}": value for path, value in reached.items()},
            )
        ((path, begin),) = self.start.items()
        return self.end(path, reached[path], begin, rises=self.ends[path] > begin)

    def end(self, path: str, value: float, begin: float, rises: bool) -> Remedy:
        """Return an end of what is accepted, rounded towards `begin` if that is accepted, too."""
        rounded = rounded_towards(value, begin)
        if self.accepts({path: rounded}):
            value = rounded
        kind = AT_MOST if rises else AT_LEAST
        return Remedy.end(kind, f"{self.where}.{path}", value)


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
        plants: Sequence[Plant],
        field: ForceField,
        axes: Sequence[str],
    ) -> Remedy:
        """Return the largest part of a field in which a law is accepted."""
        stable = largest_share(felt, plants, field, axes)
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

    def of_plant(
        self,
        now: CouplingParameters | None,
        wanted: CouplingParameters,
        law: CompiledLaw,
        accepts: Accepts,
    ) -> Remedy | None:
        """Return the last accepted device on the way from the present one to the wanted one.

        None if the device is not changed, or if none is accepted.
        """
        if now is None or now.plant is None or wanted.plant is None:
            return None
        begins = numbers_of(msgspec.to_builtins(now.plant))
        ends = numbers_of(msgspec.to_builtins(wanted.plant))
        start = {path: begins[path] for path in ends if ends[path] != begins.get(path)}
        if not start or not start.keys() <= begins.keys():
            return None
        plant = wanted.plant

        def accepted(values: Mapping[str, float]) -> bool:
            moved = msgspec.structs.replace(plant, **values)
            return accepts(msgspec.structs.replace(wanted, plant=moved), law)

        where = f"{self._node}.plant"
        return _Way(where, start, ends, accepted, len(law.taps)).last_accepted()

    def of_law(
        self,
        now: CouplingParameters | None,
        wanted: CouplingParameters,
        name: str,
        accepts: Accepts,
    ) -> Remedy:
        """Return the last accepted values on the way from the law of before to the wanted one."""
        asked = self._book.description(wanted, name)
        where = f"{self._node}.laws.{name}" if name in wanted.laws else name
        # Not checked: a law that would pull is asked for, too.
        whole = parse_law(asked).compile(self._period)
        start = self._start(now, name, asked)
        if not start:
            return self._largest_factor(whole, where, wanted, accepts)

        def accepted(values: Mapping[str, float]) -> bool:
            changed = with_numbers(asked, lambda path, end: values.get(path, end))
            try:
                return accepts(wanted, self._compiled(changed))
            except ValueError:
                return False

        way = _Way(where, start, numbers_of(asked), accepted, len(whole.taps))
        found = way.last_accepted()
        if found is not None:
            return found
        return Remedy(
            OTHER,
            f"no value of {where}.{_listed(start, ' or ')} is accepted on the way there, with "
            "the rest as requested",
        )

    def _largest_factor(
        self,
        whole: CompiledLaw,
        where: str,
        wanted: CouplingParameters,
        accepts: Accepts,
    ) -> Remedy:
        """Return the largest factor of all taps with which a law is accepted."""
        from nodes.stability.judge import furthest_accepted

        share = furthest_accepted(
            lambda part: accepts(wanted, scaled_law(whole, part)), len(whole.taps)
        )
        part = (
            f"all taps of {where} times {rounded_towards(share, 0.0):g}"
            if share
            else f"no part of {where}"
        )
        return Remedy(OTHER, f"{part} would be accepted")

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
