"""Times of the rows of a foreign table: their period, ticks, gaps, and unlikely units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from nodes.recording.facts import FASTEST, SLOWEST
from nodes.recording.foreign_table import ForeignTable
from nodes.recording.foreign_units import UNITS
from nodes.recording.import_words import words
from nodes.recording.imported_columns import factor_in, is_own
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Array = np.ndarray[Any, np.dtype[np.float64]]

UNEVEN = 0.25  # tolerated distance of a stamp from its tick [ticks]
# the same of rounded stamps; a missing row makes 0.5 − 0.75/rows [ticks]
ROUNDED = 0.45
# tolerated difference between a given rate and that of the stamps
RATE_TOLERANCE = 0.01
LONGEST_GAP = 86400.0  # gap between two rows beyond which a time is damaged [s]
_ROWS_OF_GAP = 1000.0  # rows that are missing in such a gap
_BITS = (16, 24, 32)  # of counters that begin again
_DAY = 86400.0  # [s]
_CLOCK = 1e-9  # unit of times of the clock [s]
_EVEN = 1e-3  # tolerated rounding of times that are no whole numbers [steps]
_FEW = 10.5  # rows between which a counter may begin again [steps]
_FEW_SAME = 0.1  # share of rows with the stamp before from which stamps lack digits
_TOLD_BY_ALL = 32  # rows from which times are judged as a whole
SLOWEST_USUAL = 20.0  # rate below which another unit of time was probably meant [Hz]
ROUNDING = 1e-9  # a period this near to one of six digits is that one [share]


def refuse_rate(table: ForeignTable, rate: float) -> None:
    """Raise RecordError for a rate that no loop has [Hz]."""
    if not SLOWEST <= rate <= FASTEST:
        raise RecordError(
            f"{table.path}: a rate of {rate:g} Hz; expected {SLOWEST:g} to {FASTEST:g} Hz"
        )


def ticks_of(
    table: ForeignTable,
    name: str,
    rate: float | None,
    given: Mapping[str, tuple[str, float]],
    sources: dict[str, str],
) -> tuple[float, Any, Array]:
    """Return the period, and tick and time of each row, from a column of times."""
    import numpy as np

    if is_own(table):
        return _own_ticks(table, _times(table, name), sources)
    since, factor, source = growing(table, name, given)
    step = float(np.median(np.diff(since)))
    if "time" not in given and factor == 1.0:
        refuse_unlikely_time(table, name, step, rate)
    own_period, ticks = _regular(table, name, since, step)
    period = own_period * factor
    refuse_rate(table, 1.0 / period)
    if rate is not None and abs(rate * period - 1.0) > RATE_TOLERANCE:
        raise RecordError(
            f"{table.path}: {words.get().rate(f'{rate:g}')}, while column {name!r} advances"
            f" {1.0 / period:.6g} times a second; which one is it?"
            f"{unit_hint(step, rate)}"
        )
    if rate is not None:
        period = 1.0 / rate
    seq = np.concatenate(([0.0], ticks)).astype(np.int64)
    begin = float(table.numbers(name)[0]) * factor
    sources["time"] = source + (f", from {begin:.9g} s on" if begin else "")
    return period, seq, since * factor


def _times(table: ForeignTable, name: str) -> Any:
    """Return a column of times as it is."""
    import numpy as np

    raw = table.numbers(name)
    if (bad := np.flatnonzero(~np.isfinite(raw))).size:
        raise RecordError(
            f"{table.path}: {table.place(int(bad[0]))}, column {name!r}: no time ({bad.size} such"
            f" rows of {len(raw)}); remove these rows, or read each row as a tick with"
            f" {words.get().ticks}"
        )
    # Differences of short or unsigned integers would begin again at their largest.
    short = raw.dtype.kind in "iu" and raw.max() < 1 << 63
    return raw.astype(np.int64) if short else raw.astype(np.float64)


def growing(
    table: ForeignTable, name: str, given: Mapping[str, tuple[str, float]]
) -> tuple[Array, float, str]:
    """Return increasing times since the first row, the SI value of their unit, and its source."""
    import numpy as np

    raw = _times(table, name)
    factor, source = factor_in(table, "time", name, given)
    # Integers are subtracted as such: nanoseconds since 1970 have more digits than a float.
    since = (raw - raw[0]).astype(np.float64)
    steps = np.diff(since)
    if whole := _wraps_at(raw, steps, factor):
        times = int(np.count_nonzero(steps < 0.0))
        often = "once" if times == 1 else f"{times} times"
        source += f", a counter that began again at {whole:.10g} {often}"
        steps = np.where(steps < 0.0, steps + whole, steps)
        since = np.concatenate(([0.0], np.cumsum(steps)))
    if (back := np.flatnonzero(steps <= 0.0)).size:
        raise RecordError(
            f"{table.path}: {table.place(int(back[0]) + 1)}, column {name!r}: the time does not"
            f" grow ({raw[back[0]]} to {raw[back[0] + 1]}; {back.size} such rows);"
            f" {_way_on(raw, steps, factor)}"
        )
    longest = max(LONGEST_GAP / factor, _ROWS_OF_GAP * float(np.median(steps)))
    if (far := np.flatnonzero(steps > longest)).size:
        raise RecordError(
            f"{table.path}: {table.place(int(far[0]) + 1)}, column {name!r}: {raw[far[0]]} to"
            f" {raw[far[0] + 1]} is a gap of more than a day; import the parts beside it on their"
            f" own, or name the unit with {words.get().unit('time', 'UNIT')}"
        )
    return since, factor, source


def _wraps_at(raw: Any, steps: Array, factor: float) -> float:
    """Return where a counter begins again at its least value; 0 for other times.

    Such are counters of 16, 24 or 32 bits, and seconds since midnight. All its steps back must then
    be steps as the others are, and as even: another recording in the file may begin anywhere.
    """
    import numpy as np

    back = steps[steps < 0.0]
    if not back.size or back.size == len(steps):
        return 0.0
    whole = not np.any(raw != np.rint(raw))
    span = float(raw.max() - raw.min())
    on = steps[steps >= 0.0]
    usual = float(np.median(on))
    if usual == 0.0:
        return 0.0
    stray = float(np.abs(on / usual - np.rint(on / usual)).max())
    even = min(UNEVEN, 2.0 * stray + (1.5 / usual if whole else _EVEN))
    sizes = [2.0**bits for bits in _BITS] if whole else []
    # Nanoseconds are of the clock, whose midnights are read.
    sizes += [_DAY / factor] if raw.min() >= 0 and factor > _CLOCK else []
    for size in sizes:
        steps_on = (back + size) / usual
        near = np.abs(steps_on - np.rint(steps_on)) <= even
        if span < size and np.all(near & (steps_on > 1.0 - UNEVEN) & (steps_on < _FEW)):
            return size
    return 0.0


def _way_on(raw: Any, steps: Array, factor: float) -> str:
    """Return the remedy for times that do not grow."""
    import numpy as np

    ticks = f"read each row as a tick with {words.get().ticks}"
    same = int(np.count_nonzero(steps == 0.0))
    if (back := np.flatnonzero(steps < 0.0)).size:
        far = np.abs(raw[back + 1] - raw[0])
        after = np.abs(steps[np.minimum(back + 1, len(steps) - 1)])
        if np.all(np.maximum(far, after) <= _FEW * abs(np.median(steps))):
            return f"import each of the recordings in this file on its own, or {ticks}"
        return f"sort the rows, or {ticks}"
    if same < _FEW_SAME * len(steps):
        return f"remove the repeated rows, or {ticks}"
    rate = len(steps) / (float(raw[-1] - raw[0]) * factor) if raw[-1] > raw[0] else 0.0
    mean = f", about {rate:.4g} Hz on the average" if rate else ""
    return f"the stamps have too few digits; {ticks}{mean}"


def _own_ticks(
    table: ForeignTable, stamp: Array, sources: dict[str, str]
) -> tuple[float, Any, Array]:
    """Return period, tick and time of each row of our own export."""
    import numpy as np

    seq = table.numbers("seq")
    fractional = np.any(seq != np.rint(seq))
    if fractional or np.any(np.diff(seq) <= 0) or seq[0] < 0:
        raise RecordError(
            f"{table.path}: column 'seq' does not grow; of a run whose driver restarted, import"
            " one part"
        )
    lasted = stamp[-1] - stamp[0]
    period = float(lasted / (seq[-1] - seq[0]))
    period = 1.0 / table.rate if table.rate is not None else period
    if not period > 0.0:
        raise RecordError(f"{table.path}: column 'stamp' does not grow")
    refuse_rate(table, 1.0 / period)
    sources["time"] = "stamp in s, seq"
    return (_plain(period), seq.astype(np.int64), np.asarray(stamp, dtype=np.float64))


def unit_hint(step: float, rate: float | None = None) -> str:
    """Return the units of time in which a step is a usual rate, as a question; or nothing."""
    likely = []
    for unit, factor in UNITS["time"].items():
        found = 1.0 / (step * factor)
        if unit != "s" and (
            20.0 <= found <= 20e3 if rate is None else abs(found / rate - 1) < 0.1
        ):
            likely.append(f"{unit} ({found:.5g} Hz)")
    unit = likely[0].partition(" ")[0] if len(likely) == 1 else "UNIT"
    return (
        f" Is it in {' or '.join(likely)}? Say so with {words.get().unit('time', unit)}"
        if likely
        else ""
    )


def refuse_unlikely_time(
    table: ForeignTable, name: str, step: float, rate: float | None
) -> None:
    """Raise RecordError for a step that is none in seconds, with the unit that was meant."""
    if SLOWEST_USUAL <= 1.0 / step <= FASTEST:
        return
    named = f" Say its unit with {words.get().unit('time', 'UNIT')}"
    raise RecordError(
        f"{table.path}: column {name!r} grows by {step:g} a row, {1.0 / step:.4g} Hz if it is"
        f" seconds.{unit_hint(step, rate) or named}, or {words.get().unit('time', 's')} if it is;"
        f" if it counts rows, use {words.get().ticks}"
    )


def _regular(
    table: ForeignTable, name: str, since: Array, step: float
) -> tuple[float, Array]:
    """Return the period that fits all times, and the tick of each row after the first.

    Times may have gaps but must be even.
    """
    import numpy as np

    steps = np.diff(since)
    counts = np.rint(steps / step)
    stray = np.abs(steps / step - counts)
    bad = np.flatnonzero((stray > UNEVEN) | (counts < 1))
    missing = counts.sum() != len(steps)
    if (bad.size or missing) and (even := _even_period(since)):
        return even, np.arange(1.0, len(since))
    if bad.size:
        raise RecordError(
            f"{table.path}: {table.place(int(bad[0]) + 1)}, column {name!r}: the times are uneven"
            f" ({bad.size} of {len(steps)} steps lie beside a multiple of {step:g}); resample the"
            f" data evenly, or, if each row is a tick, use {words.get().ticks}"
        )
    # Stamps are rounded, and so is their mean step.
    return _plain(float(since[-1] / counts.sum())), np.cumsum(counts)


def _plain(period: float) -> float:
    """Return the period of six digits that a period is near to, or the period itself."""
    rounded = float(f"{period:.6g}")
    return rounded if abs(rounded / period - 1.0) < ROUNDING else period


def _even_period(since: Array) -> float:
    """Return the mean step of times of which none is far from its tick, or 0.

    Such are times in whole milliseconds at 300 Hz, whose steps are 3 and 4. A missing row would
    move all rows behind it by a whole tick, half of it to either side.
    """
    import numpy as np

    if len(since) < _TOLD_BY_ALL:
        return 0.0
    steps = np.diff(since)
    # Rounded times have two steps, beside which nothing is missing.
    two = np.isclose(steps, steps.min()) | np.isclose(steps, steps.max())
    ticks = np.arange(len(since))
    period = float(np.polyfit(ticks, since, 1)[0])
    beside = since / period - ticks
    stray = np.abs(beside - np.median(beside)).max()
    return period if stray < (ROUNDED if two.all() else UNEVEN) else 0.0
