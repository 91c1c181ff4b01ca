"""Exceptions of this project, in one tree, so that a caller can catch all or one branch.

| exception | raised for |
| --- | --- |
| `HapticError` | all of these |
| `ParameterError` | an invalid parameter, launch file, law or argument; exit code 2 |
| `LawRefusedError` | of those: a law that is not rendered |
| `NotInstalledError` | of those: a name that is not installed or not importable |
| `MessageRefusedError` | a message or request that violates the wire protocol |
| `EndpointRefusedError` | an address that must not be used |
| `KeyRefusedError` | an invalid or unknown key |
| `CommandError` | a refused request of a page |
| `LaunchFailedError` | a launch that cannot start, or fails, on the command line |
| `LaunchError` | the same from Python |
| `LaunchWarning` | a warning of a launch, in Python; no exception |
| `RecordError` | a recording that cannot be read or written |
| `CutError` | of those: a truncated recording |
| `ResultsError` | a section of the results that cannot be measured or written |
| `NotCompilableError` | a tick without a compiled form; the plain one runs |
| `CacheRefusedError` | a folder that is not trusted for compiled code |
| `CannotTellError` | a recorded contact that does not determine K_max |
| `NotInBrowserError` | a scenario that the static page does not play |
| `NotEmittedError` | Python that is not emitted as JavaScript; a programming error |
| `StudyCancelledError` | a study that its caller cancelled |
| `NotOneAxisError` | a launch that cannot be simulated as one axis |
| `UsageError` | a request that cannot be done as asked; exit code 2 |
| `RunError` | of those: no such run, or its directory is unusable |
| `NoSuchNameError` | of those: no such node or topic |
| `RefusedError` | a request that was refused, or failed; exit code 1 |
| `ControlError` | of those: a control request that is refused or gets no answer |
| `NoAnswerError` | of those: a request without an answer in time |
| `StalledError` | of those: a tuning on a machine that does not respond in time |
| `SurplusError` | a device's service that sends more answers than requested; its driver fails |
| `UnknownEventError` | an event of an unregistered kind or number; a programming error |
| `MeasurementError` | a benchmark, study or drill that could not measure |
| `NoCompilerError` | of those: no C compiler |
| `FaultSkippedError` | of those: a fault that cannot be injected |
"""

from typing import Annotated, Final, Self

import msgspec

from messages.types import Name, Real, Text

__all__ = [
    "AT_LEAST",
    "AT_MOST",
    "FORCE",
    "OTHER",
    "SIDES",
    "TOGETHER",
    "HapticError",
    "RefusedError",
    "Remedy",
    "UsageError",
]

# Kinds of remedies.
AT_MOST: Final = "at_most"  # the largest value of a parameter that would be accepted
AT_LEAST: Final = "at_least"  # the smallest one
TOGETHER: Final = "together"  # values of several parameters that would be accepted
FORCE: Final = "force"  # repeat the request with ``force: true``
OTHER: Final = "other"  # what only its text says

SIDES: Final = {AT_MOST: "largest", AT_LEAST: "smallest"}  # in words

_MOST_VALUES: Final = 16384  # values of a remedy; the longest law has 8192 taps


class Remedy(msgspec.Struct, frozen=True):
    """One way out of a refusal, which each interface words for itself.

    Attributes
    ----------
    kind : str
        `AT_MOST`, `AT_LEAST`, `TOGETHER`, `FORCE` or `OTHER`; readers skip others.
    text : str
        In the words of the command line.
    values : dict of str to float
        What would be accepted, by the path of the parameter [SI units]; empty if no value would.
    """

    kind: Name
    text: Text
    values: Annotated[dict[Name, Real], msgspec.Meta(max_length=_MOST_VALUES)] = {}

    @classmethod
    def end(cls, kind: str, path: str, value: float) -> Self:
        """Return the last value of a parameter that would be accepted.

        Parameters
        ----------
        kind : str
            `AT_MOST` or `AT_LEAST`.
        path : str
            Path of the parameter.
        value : float
            The value [SI units].

        Returns
        -------
        Remedy
            With a text in words of both.
        """
        text = f"the {SIDES[kind]} {path} that is accepted is {value:.9g}"
        return cls(kind, text, {path: value})


class HapticError(Exception):
    """Base of every exception that this project raises on purpose; its text has the remedies.

    Attributes
    ----------
    remedies : tuple of Remedy
        Ways out as data, if there are any; the error's text ends with them.
    """

    remedies: tuple[Remedy, ...] = ()

    @property
    def fault(self) -> str:
        """The error's text without `remedies`."""
        return super().__str__()

    def __str__(self) -> str:
        return "; ".join((self.fault, *(one.text for one in self.remedies)))

    def with_remedies(self, *remedies: Remedy) -> Self:
        """Add ways out to the error and return it.

        Parameters
        ----------
        *remedies : Remedy
            They follow those that the error has.

        Returns
        -------
        HapticError
            The same error.
        """
        self.remedies += remedies
        return self


class UsageError(HapticError):
    """A request that cannot be done as asked; the text has the reason and the remedy."""


class RefusedError(HapticError):
    """A sensible request that was refused or failed; the text has the reason."""
