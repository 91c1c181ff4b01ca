"""From a device to its law: the functions behind the command line, with their objects.

They run in this process: interrupting the cell stops them, and the files already written remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.parameters.installed import points
from nodes.parameters.options import options_of
from nodes.parameters.refusals import choices
from sim.api.laws import plain
from sim.api.progress import bars_of
from sim.api.python_runs import LaunchError
from sim.measure.cancelling import cancelled_by, stopping

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from sim.studies.result import StudyResult
    from sim.tune.tune import TuneResult


_HOW = ("progress", "cancel")  # keywords that are no options


def _called(name: str, words: Sequence[Any], given: dict[str, Any]) -> StudyResult:
    """Call a registered sub-verb with options as Python objects."""
    found = points("haptic.verbs")
    if name not in found:
        kind, _, asked = name.partition(".")
        known = [one.partition(".")[2] for one in found if one.startswith(f"{kind}.")]
        moved = f"; haptic.lab({asked!r}) is it now" if f"lab.{asked}" in found else ""
        raise LaunchError(f"{kind} {asked!r}: {choices(asked, known)}{moved}")
    function: Any = found[name].load()
    options = plain({key: value for key, value in given.items() if key not in _HOW})
    with bars_of(name.replace(".", " ")) as shown, cancelled_by(given.get("cancel")):
        progress = stopping(given.get("progress") or shown)
        result: StudyResult = function(
            options_of(function).of(*words, **options, progress=progress)
        )
    return result


def study(name: str, *words: str, client: Any = None, **options: Any) -> StudyResult:
    """Run a study: ``haptic study NAME``.

    Parameters
    ----------
    name : str
        E.g. ``kmax`` or ``edge``; ``haptic study --help`` lists them.
    *words : str
        Positional arguments, e.g. a recording.
    client : distributed.Client, optional
        Dask client whose workers run the jobs of a sweep; the figures are bit-identical.
    **options : object
        The study's options: ``gain=(1, 40)`` or ``gain="1..40"``, ``points=41``; ``haptic study
        kmax --help`` lists them. ``progress``: a function of the number of parts that returns the
        function called for each part. ``cancel``: a `threading.Event` that ends the study.

    Returns
    -------
    StudyResult
        The result: ``result["NAME"]`` is a figure, ``.held`` whether its verdict is yes.

    Raises
    ------
    HapticError
        If the study refuses; the text states why. A `StudyCancelledError` if it was cancelled.

    Examples
    --------
    >>> study("kmax", law="pd", gain=3)["k_max_n_per_m"]
    3781.8664...
    """
    return _called(f"study.{name}", words, options | _cluster(client))


def lab(name: str, *words: str, client: Any = None, **options: Any) -> StudyResult:
    """Run an experiment that checks a claim of this project: ``haptic lab NAME``.

    Parameters
    ----------
    name : str
        E.g. ``fig4`` or ``coverage``; ``haptic lab --help`` lists them.
    *words : str
        Positional arguments.
    client : distributed.Client, optional
        Dask client whose workers run the jobs; the figures are bit-identical.
    **options : object
        The experiment's options, as those of `study`.

    Returns
    -------
    StudyResult
        The result: ``result["NAME"]`` is a figure, ``.held`` whether its verdict is yes.

    Raises
    ------
    HapticError
        If the experiment refuses; the text states why.

    Examples
    --------
    >>> lab("fig2", taps=4)["taps"]
    4
    """
    return _called(f"lab.{name}", words, options | _cluster(client))


def _cluster(client: Any) -> dict[str, Any]:
    """Return the address of a client's scheduler, and the paths of its certificates."""
    if client is None:
        return {}
    address, security = client.scheduler.address, client.security
    if not address.startswith(("tcp://", "tls://")):
        raise LaunchError(
            f"client: {address} is inside this process; make it of processes:"
            " LocalCluster(processes=True)"
        )
    if address.startswith("tcp://"):
        return {"cluster": address}
    files = {
        "tls_ca_file": security.tls_ca_file,
        "tls_cert": security.tls_client_cert,
        "tls_key": security.tls_client_key,
    }
    if any(not isinstance(file, str) or "\n" in file for file in files.values()):
        raise LaunchError(
            "client: its certificates are in memory; give distributed.Security their files"
        )
    return {"cluster": address, **files}


def design(**options: Any) -> StudyResult:
    """Search the taps of the stiffest wall for a range of devices: ``haptic study design``.

    Parameters
    ----------
    **options : object
        The verb's options: ``mass="0.05..0.2"``, ``delay=1``, ``taps=4``, ``rate=500``; ``haptic
        study design --help``.

    Returns
    -------
    StudyResult
        Its figures.

    Raises
    ------
    HapticError
        If the study refuses; the text states why.

    Examples
    --------
    >>> design(mass="0.05..0.2", taps=2, land=False)["designed"]["h1_n_per_m"]
    1866...
    """
    return _called("study.design", (), options)


def identify(
    recording: str | Path | None = None,
    *,
    position: ArrayLike | None = None,
    force: ArrayLike | None = None,
    **options: Any,
) -> StudyResult:
    """Identify the device of a recording, of a table or of arrays: ``haptic study identify``.

    Parameters
    ----------
    recording : str or Path, optional
        Recording of a launch, preferably of the scenario ``identify``; or a table, see
        `haptic.read`.
    position : array_like, shape (N,) or (N, 3), optional
        In place of a recording: position sampled at each tick [m].
    force : array_like, shape (N,) or (N, 3), optional
        Force handed over for each tick, held until the next [N].
    **options : object
        The verb's options: ``axis``, ``held``, ``window``; of arrays also ``rate`` [Hz], which
        they need, and ``delay`` [ticks]; of a table those of `haptic.read`.

    Returns
    -------
    StudyResult
        Mass, damping, friction, delay and encoder, each with its 95 % interval.

    Raises
    ------
    HapticError
        If the study refuses; the text states why.

    Examples
    --------
    >>> identify("identify.mcap")["mass_kg"]  # doctest: +SKIP
    >>> identify(position=x, force=f, rate=1000)["mass_kg"]  # doctest: +SKIP
    """
    from sim.api.own_data import IMPORT_OPTIONS, as_recording, identify_arrays

    if recording is None:
        if position is None or force is None or "rate" not in options:
            raise UsageError("identify: needs a recording, or position, force and rate")
        return identify_arrays(position, force, **options)
    if position is not None or force is not None:
        raise UsageError("identify: a recording, or position and force; not both")
    of_table = {name: options.pop(name) for name in IMPORT_OPTIONS if name in options}
    with as_recording(recording, axis=options.get("axis"), **of_table) as path:
        found: Any = _called("study.identify", (path,), options)
    named: StudyResult = replace(found, recording=Path(recording))
    return named


def tune(
    scenario: str,
    out: str | Path = "tuning",
    *,
    arguments: dict[str, Any] | None = None,
    **options: Any,
) -> TuneResult:
    """From a device to its law: identify, design, predict, verify, apply: ``haptic tune``.

    Parameters
    ----------
    scenario : str
        Launch file to start.
    out : str or Path
        Output directory.
    arguments : dict, optional
        Arguments of the launch file.
    **options : object
        The verb's options.

    Returns
    -------
    TuneResult
        Identified device, designed laws and measurements.

    Raises
    ------
    LaunchError
        If a step refuses; the text states why. ``tune.json`` contains the results up to there.

    Examples
    --------
    >>> tune("identify", arguments={"pace": "lockstep"})  # doctest: +SKIP
    """
    from sim.tune.tune import tune as function
    from sim.tune.tune_options import TuneOptions

    given = [f"{name}:={value}" for name, value in plain(arguments or {}).items()]
    with cancelled_by(options.pop("cancel", None)):
        found = function(TuneOptions.of(scenario, *given, out=out, **plain(options)))
    if found.refused:
        raise LaunchError(f"tune {scenario}: {found.refused}")
    return found
