"""Options of a function that is also a command: declared once, as dataclass fields.

The command line declares its arguments from them, and `Options.of` reads the keywords of a Python
call by the same rules; who has the values calls the dataclass itself, which is typed.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any, Self, TypeAlias

from messages.errors import UsageError
from nodes.parameters.nearest import did_you_mean
from nodes.parameters.quantities import QUANTITIES, Interval, interval

# Called with what is done and how many parts that is, one by default.
ProgressStep: TypeAlias = Callable[..., None]
# Called with the number of parts of a job; returns what is called with each.
ProgressOf: TypeAlias = Callable[[int], ProgressStep]

_KEY = "option"


def silent(total: int) -> ProgressStep:
    """Show no progress."""
    del total
    return lambda *_: None


@dataclass(frozen=True)
class Declared:
    """How one option is written on a command line."""

    flags: tuple[str, ...]  # empty: by the field's name
    words: Mapping[str, Any]  # of `argparse.ArgumentParser.add_argument`
    positional: bool = False
    off: str = ""  # flag that sets a flag to False
    off_help: str = ""

    def flag(self, name: str) -> str:
        """Return the first flag; of an argument by position its name."""
        return (
            name
            if self.positional
            else (self.flags or (f"--{name.replace('_', '-')}",))[0]
        )

    @property
    def is_flag(self) -> bool:
        """Whether it is on or off, without a value."""
        return "action" in self.words

    def read(self, name: str, value: Any) -> Any:
        """Read a value given in Python; raises UsageError as the command line does."""
        if value is None:
            return None
        if self.is_flag:
            if not isinstance(value, bool):
                raise UsageError(f"{name} = {value!r}: expected True or False")
            return value
        if self.words.get("nargs") in ("+", "*"):
            several = [value] if isinstance(value, str | int | float) else list(value)
            return [self._read_one(name, one) for one in several]
        return self._read_one(name, value)

    def _read_one(self, name: str, value: Any) -> Any:
        read = self.words.get("type", str)
        try:
            found = read(_written(value))
        except (ArgumentTypeError, ValueError) as error:
            raise UsageError(f"{name}: {error}") from error
        choices = self.words.get("choices")
        if choices is not None and found not in choices:
            raise UsageError(
                f"{name} = {value!r}: expected one of {', '.join(map(str, choices))}"
            )
        return found


def _written(value: Any) -> str:
    """Write a value as it is typed."""
    if isinstance(value, tuple) and len(value) == 2:
        return f"{value[0]!r}..{value[1]!r}"
    if isinstance(value, Mapping | list):
        return json.dumps(value)
    return str(value)


def option(
    *flags: str,
    default: Any = None,
    positional: bool = False,
    off: str = "",
    **words: Any,
) -> Any:
    """Declare an option with argparse's keywords; `action` is ``store_true`` or ``on_off``."""
    off_help = words.pop("off_help", "")
    metadata = {_KEY: Declared(flags, words, positional, off, off_help)}
    if isinstance(default, list):
        return field(default_factory=default.copy, metadata=metadata)
    if default is None and words.get("action") == "store_true" and not off:
        default = False
    return field(default=default, metadata=metadata)


def argument(default: Any = MISSING, **words: Any) -> Any:
    """Declare an argument by position; without a default it must be given."""
    if default is not MISSING and "nargs" not in words:
        words["nargs"] = "?"
    return option(default=default, positional=True, **words)


def quantity(
    name: str, default: float | Interval | None = None, unset: bool = False
) -> Any:
    """Declare a quantity that many verbs ask for, with its unit and range.

    Parameters
    ----------
    name : str
        Of the quantity, and of the field.
    default : float or Interval, optional
        Its default; an interval takes LOW..HIGH.
    unset : bool
        Left out it is None, and the default is what the function then takes.
    """
    read, text = QUANTITIES[name]
    value: Any = default
    if isinstance(default, Interval):
        low, high = default
        read = interval
        text = f"{text}, LOW..HIGH"
        shown = (
            None if low is None else f"{low:g}" if low == high else f"{low:g}..{high:g}"
        )
        value = None if low is None else (low, high)
    else:
        shown = None if default is None else f"{default:g}"
    help_text = text if shown is None else f"{text} (default: {shown})"
    return option(default=None if unset else value, type=read, help=help_text)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Base of options; every function that takes some reports its progress to a callback."""

    progress: ProgressOf = field(default=silent, repr=False, compare=False)

    @classmethod
    def declared(cls) -> dict[str, Declared]:
        """List the options: field to how it is written."""
        return {
            one.name: one.metadata[_KEY]
            for one in dataclasses.fields(cls)
            if _KEY in one.metadata
        }

    @classmethod
    def default_of(cls, name: str) -> Any:
        """Return the default of an option; `dataclasses.MISSING` where it must be given."""
        found = next(one for one in dataclasses.fields(cls) if one.name == name)
        return (
            found.default
            if found.default_factory is MISSING
            else found.default_factory()
        )

    @classmethod
    def of(cls, *values: Any, **given: Any) -> Self:
        """Read values given in Python, positional first; raises UsageError like the command."""
        declared = cls.declared()
        places = [name for name, one in declared.items() if one.positional]
        rest = (
            places[-1:]
            if places and declared[places[-1]].words.get("nargs") in ("*", "+")
            else []
        )
        if len(values) > len(places) and not rest:
            raise UsageError(
                f"{len(values)} words given, expected at most {len(places)}"
            )
        found: dict[str, Any] = dict(zip(places, values, strict=False))
        if rest and len(values) >= len(places):
            given_last = values[len(places) - 1 :]
            alone = len(given_last) == 1 and isinstance(given_last[0], list | tuple)
            found[rest[0]] = list(given_last[0] if alone else given_last)
        # Callbacks are taken as they are.
        others = {one.name for one in dataclasses.fields(cls)} - declared.keys()
        for name, value in (found | given).items():
            if name in others:
                found[name] = value
                continue
            if name not in declared:
                known = f"; there are {', '.join(declared)}"
                hint = did_you_mean(name, declared) or known
                raise UsageError(f"{name}: no such option{hint}")
            found[name] = declared[name].read(name, value)
        missing = [
            name
            for name in places
            if cls.default_of(name) is MISSING and name not in found
        ]
        if missing:
            raise UsageError(f"{', '.join(missing)}: must be given")
        return cls(**found)

    def chosen(self, *names: str) -> dict[str, Any]:
        """Return some of the values by name: what a job is given."""
        return {name: getattr(self, name) for name in names}

    def refuse_unused(self, why: str, *names: str) -> None:
        """Refuse options that would change nothing here: who gives one expects another answer.

        Parameters
        ----------
        why : str
            Why they have no effect.
        *names : str
            Fields.

        Raises
        ------
        UsageError
            When one of them is not at its default.
        """
        declared = self.declared()
        found = [
            declared[name].flag(name)
            for name in names
            if getattr(self, name) != self.default_of(name)
        ]
        if found:
            raise UsageError(f"{', '.join(found)}: no effect here: {why}")


@dataclass(frozen=True, kw_only=True)
class FileOptions(Options):
    """Options of a function that writes files."""

    out: Path = option(
        "--out-dir",
        "--out",
        default=Path("studies"),
        type=Path,
        help="directory of files",
    )


def takes_options(found: Any) -> bool:
    """Whether something is a function of options: its argument is called that."""
    return callable(found) and "options" in getattr(found, "__annotations__", {})


def options_of(function: Callable[..., Any]) -> type[Options]:
    """Return the class of a function's options: the annotation of its argument ``options``."""
    found = function.__annotations__["options"]
    kind = (
        inspect.unwrap(function).__globals__[found] if isinstance(found, str) else found
    )
    if not (isinstance(kind, type) and issubclass(kind, Options)):
        raise TypeError(
            f"{function.__qualname__}: options is {found!r}, expected a class of Options"
        )
    return kind
