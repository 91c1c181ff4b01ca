"""Times of other programs that begin again, lack digits, or are of two recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from nodes.recording.foreign_table import ForeignTable
from nodes.recording.imported_samples import samples_of
from nodes.recording.writer import RecordError

ROWS = 1000
STEPS = np.arange(ROWS)
POSITION = 1e-6 * STEPS


def table(times: NDArray[np.generic], unit: str = "us") -> ForeignTable:
    return ForeignTable(Path("rig.npz"), {"t": times, "x": POSITION}, {"t": unit})


@pytest.mark.parametrize(
    ("times", "unit", "at"),
    [
        ((STEPS * 2 + 65_000) % 65_536, "ms", 65_536),
        (((STEPS * 500 + 60_000) % 65_536).astype(np.uint16), "us", 65_536),
        (((STEPS * 2 + 64_000) % 65_536 - 32_768).astype(np.int16), "ms", 65_536),
        ((STEPS * 2000 + 16_000_000) % (1 << 24), "us", 1 << 24),
        ((STEPS * 2000 + (1 << 32) - 9) % (1 << 32), "us", 1 << 32),
        (((STEPS * 2000 + 5) % (1 << 32) - (1 << 31)).astype(np.int32), "us", 0),
        ((STEPS * 0.002 + 86_399.0) % 86_400.0, "s", 86_400),
        ((STEPS * 2.0 + 86_399_500.0) % 86_400_000.0, "ms", 86_400_000),
    ],
)
def test_a_counter_that_begins_again_goes_on(
    times: NDArray[np.generic], unit: str, at: int
) -> None:
    missing = np.flatnonzero(STEPS % 97 == 5)  # also beside a place where it begins
    rows = np.delete(STEPS, missing)
    period = 0.5e-3 if times.dtype == np.uint16 else 2e-3
    for kept in (STEPS, rows):
        of_rows = ForeignTable(
            Path("rig.npz"), {"t": times[kept], "x": POSITION[kept]}, {"t": unit}
        )
        found = samples_of(of_rows)
        assert found.seq.tolist() == kept.tolist()
        # Seconds of the day have 1e-11 s in a float, over a second or more.
        assert found.period == pytest.approx(period, rel=1e-9)
        said = f"a counter that began again at {at}"
        assert (said in found.sources["time"]) is bool(at)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        # no counter of that size, or no step as the others
        (np.roll(STEPS * 2000, 300), "sort the rows"),
        (np.where(STEPS == 500, 0, STEPS * 2000), "sort the rows"),
        ((STEPS * 2000 + 65_536 * 40) % 1_000_000, "sort the rows"),
        ((STEPS * 2000)[::-1], "sort the rows"),
        ((STEPS * 2000).astype(np.uint32)[::-1], "sort the rows"),
        # a second recording, which begins 1.11 steps after the end of 16 bits
        (np.arange(23) % 13 * 5000, "import each of the recordings"),
        # a whole number of rows that is a power of two, but three times the step
        (np.where(STEPS < 400, STEPS * 100, STEPS * 100 - 80_000), "sort the rows"),
        ((STEPS % 500) * 2000, "import each of the recordings in this file on its own"),
        (STEPS // 4, r"too few digits; .*--ignore-times, about 4012 Hz on the average"),
        (np.zeros(ROWS), "too few digits"),
        (np.where(STEPS == 500, 499, STEPS), "remove the repeated rows"),
    ],
)
def test_times_that_do_not_grow_name_their_remedy(
    times: NDArray[np.generic], words: str
) -> None:
    with pytest.raises(RecordError, match=f"the time does not grow .*{words}"):
        samples_of(table(times, "us" if times.max() > ROWS else "ms"))


def test_days_are_a_unit_of_time() -> None:
    """As in MATLAB's datenum; a double of it has steps of 10 µs."""
    days = 739_948.25 + STEPS * 0.01 / 86_400.0
    found = samples_of(table(days, "days"))
    assert found.seq.tolist() == STEPS.tolist()
    assert found.period == pytest.approx(0.01, rel=1e-5)
    with pytest.raises(RecordError, match=r"Is it in day \(100.02 Hz\)\? .*time=day"):
        samples_of(ForeignTable(Path("rig.npz"), {"t": days, "x": POSITION}))
