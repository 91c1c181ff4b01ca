"""The way a hand went in a recording, as the path of a hand: to play a run again that somebody drove with the mouse."""

from __future__ import annotations

from messages.topics import DEVICE_STATE
from nodes.base.setup import AXIS_INDEX
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError


def target_path(recording: Recording, axis: str) -> list[tuple[float, float]]:
    """Read where a hand pulled to, tick by tick.

    As ``device.hand.path`` of a sim driver it gives the same target at every tick, to the bit.
    """
    try:
        period = 1.0 / float(recording.manifest["rate_hz"])
    except (KeyError, ValueError, ZeroDivisionError) as error:
        raise RecordError(f"{recording.path}: its manifest tells no rate_hz") from error
    states = recording.messages(DEVICE_STATE)
    if not states:
        raise RecordError(f"{recording.path}: holds nothing on {DEVICE_STATE}")
    return [(state.seq * period, state.target[AXIS_INDEX[axis]]) for state in states]
