"""The exceptions of this project are one tree, so that a caller catches all of it or the branch that concerns it.

| exception | raised for |
| --- | --- |
| `HapticError` | all of these |
| `ParameterError` | a parameter, launch file, law or argument that is refused; a command ends with exit code 2 |
| `LawRefusedError`, `NotInstalledError` | of those: a law not rendered; a name not installed, or not importable |
| `MessageRefusedError` | a message or request that breaks the wire protocol |
| `EndpointRefusedError` | an address that may not be used |
| `KeyRefusedError` | a key that is none, or is not allowed |
| `CommandError` | a request of a page that is refused |
| `LaunchFailedError`, `LaunchError` | a launch that cannot start, or fails: for the command line; from Python |
| `RecordError` | a recording that cannot be read or written |
| `CutError` | of those: one that ends in the middle |
| `NotCompilableError` | a tick that has no compiled form; the plain one runs |
| `CacheRefusedError` | a folder that compiled code is not taken from |
| `CannotTellError` | a recorded contact that says nothing of K_max |
| `UsageError` | what cannot be done as it was asked for; a command ends with exit code 2 |
| `RunError`, `NoSuchNameError` | of those: no such run, or its directory cannot be used; a run without such a node or topic |
| `RefusedError` | what was refused, or did not succeed; a command ends with exit code 1 |
| `ControlError` | of those: a control request that is refused or gets no answer |
| `NoAnswerError` | of those: a request that got no answer in time |
| `StalledError` | of those: a tuning on a machine that does not answer in time |
| `UnknownEventError` | an event whose kind or number is in no list; a mistake of a programmer |
| `MeasurementError` | a benchmark, study or drill that could not measure |
| `NoCompilerError`, `FaultSkippedError` | of those: no C compiler; a fault not to be had |
"""

__all__ = ["HapticError", "RefusedError", "UsageError"]


class HapticError(Exception):
    """Base of every exception that this project raises on purpose; its text says what to do."""


class UsageError(HapticError):
    """What the user asked for cannot be done as asked; the text says why and what to do instead."""


class RefusedError(HapticError):
    """What was asked is sensible, but was refused or did not succeed; the text says why."""
