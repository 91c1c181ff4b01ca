"""The exceptions of this project are one tree, so that a caller catches all of it or the branch that concerns it.

| exception | raised for |
| --- | --- |
| `HapticError` | all of these |
| `ParameterError` | a parameter, launch file, law or argument that is refused |
| `LawRefusedError`, `NotInstalledError` | of those: a law not rendered; a name not installed, or not importable |
| `MessageRefusedError` | a message or request that breaks the wire protocol |
| `ControlError` | a control request that is refused or gets no answer |
| `EndpointRefusedError` | an address that may not be used |
| `KeyRefusedError` | a key that is none, or is not allowed |
| `RunError`, `NoSuchNameError` | no such run, or its directory cannot be used; a run that has no such node or topic |
| `CommandError` | a request of a page that is refused |
| `LaunchFailedError`, `LaunchError` | a launch that cannot start, or fails: for the command line; from Python |
| `RecordError` | a recording that cannot be read or written |
| `CutError` | of those: one that ends in the middle |
| `NotCompilableError` | a tick that has no compiled form; the plain one runs |
| `CacheRefusedError` | a folder that compiled code is not taken from |
| `CannotTellError` | a recorded contact that says nothing of K_max |
| `UsageError`, `RefusedError` | what the command line ends with exit code 2, and 1 |
| `StalledError` | of those: a tuning on a machine that does not answer in time |
| `MeasurementError` | a benchmark, study or drill that could not measure |
| `NoCompilerError`, `FaultSkippedError` | of those: no C compiler; a fault not to be had |
"""

__all__ = [
    "HapticError",
]


class HapticError(Exception):
    """Base of every exception that this project raises on purpose; its text says what to do."""
