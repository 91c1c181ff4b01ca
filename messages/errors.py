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
| `UnknownEventError` | an event of an unregistered kind or number; a programming error |
| `MeasurementError` | a benchmark, study or drill that could not measure |
| `NoCompilerError` | of those: no C compiler |
| `FaultSkippedError` | of those: a fault that cannot be injected |
"""

__all__ = ["HapticError", "RefusedError", "UsageError"]


class HapticError(Exception):
    """Base of every exception that this project raises on purpose; its text has the remedy."""


class UsageError(HapticError):
    """A request that cannot be done as asked; the text has the reason and the remedy."""


class RefusedError(HapticError):
    """A sensible request that was refused or failed; the text has the reason."""
