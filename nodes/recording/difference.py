"""Difference of two recorded motions over time, in bounded memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from messages.topics import DEVICE_STATE
from messages.types import DeviceState, Vector
from nodes.recording.reader import Recording
from nodes.recording.series import Line, Lines

_NEAR = 1e-6  # of a tick: stamps this near are of the same time


def _motion(recording: Recording) -> Iterator[tuple[float, Vector]]:
    """Yield time since the first tick [s] and position [m], as long as the stamps rise."""
    begin = recording.topics[DEVICE_STATE].first_stamp
    last = -1.0
    for entry in recording.entries([DEVICE_STATE]):
        state = entry.message
        if isinstance(state, DeviceState):
            time = state.stamp - begin
            if time <= last:
                return
            last = time
            yield time, state.position


def difference(recording: Recording, lines: Lines, reference: Recording) -> Line:
    """Return position minus that of a reference at the same time since the first tick.

    Parameters
    ----------
    recording, reference : Recording
        Recordings with ``/device/state``.
    lines : Lines
        What is drawn of the first: its times.

    Returns
    -------
    Line
        Differences along x, y and z [m] at the recording's stamps; linear between the ticks of the
        reference, and nothing beyond its end.
    """
    start = lines.start - lines.begin
    stop = lines.stop - lines.begin
    found = Line(lines.start, lines.stop, 3)
    pairs = itertools.pairwise(_motion(reference))
    pair = next(pairs, None)
    for time, position in _motion(recording):
        if time > stop:
            break
        while pair is not None and pair[1][0] < time:
            following = next(pairs, None)
            if following is None and time - pair[1][0] > _NEAR * (
                pair[1][0] - pair[0][0]
            ):
                pair = None
            elif following is None:
                break
            else:
                pair = following
        if pair is None:
            break
        if time < start:
            continue
        (before, low), (after, high) = pair
        share = min((time - before) / (after - before), 1.0)
        # At a tick of both, the difference is that of the numbers: no rounding of a share.
        share = round(share) if abs(share - round(share)) < _NEAR else share
        at = high if share == 1 else low if share == 0 else None
        values = (
            at[i] if at is not None else low[i] + share * (high[i] - low[i])
            for i in range(3)
        )
        found.add(
            lines.begin + time, *(p - v for p, v in zip(position, values, strict=True))
        )
    return found
