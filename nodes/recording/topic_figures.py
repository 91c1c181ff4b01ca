"""Figures of one topic in a recording: message count, gaps, ``seq`` and stamps."""

from __future__ import annotations

import msgspec

__all__ = ["TopicFigures"]


class TopicFigures(msgspec.Struct):
    """Figures of one topic in a recording.

    Attributes
    ----------
    messages : int
        Number of messages.
    gaps : int
        Number of ``seq`` missing between the first and the last; 0 for topics without one message
        per tick.
    back : int
        Number of times that ``seq`` did not rise on a topic with one message per tick: repeated
        messages, or a restarted driver.
    first_seq, last_seq : int
        First and last ``seq``.
    first_stamp, last_stamp : float
        Earliest and latest stamp [s].
    """

    messages: int = 0
    gaps: int = 0
    back: int = 0
    first_seq: int = 0
    last_seq: int = 0
    first_stamp: float = 0.0
    last_stamp: float = 0.0

    @property
    def rate(self) -> float:
        """Return the mean rate over the stamps [1/s]; 0 for fewer than two messages."""
        span = self.last_stamp - self.first_stamp
        return (self.messages - 1) / span if span > 0.0 else 0.0

    def add(self, sequence: int, stamp: float, ticking: bool) -> None:
        """Count one more message.

        Parameters
        ----------
        sequence : int
            ``seq`` of the message modulo 2³², as stored by MCAP.
        stamp : float
            Stamp of the message [s].
        ticking : bool
            Whether the topic carries one message per tick.
        """
        self.messages += 1
        if self.messages == 1:
            self.first_seq = self.last_seq = sequence
            self.first_stamp = self.last_stamp = stamp
            return
        self.first_stamp = min(self.first_stamp, stamp)
        self.last_stamp = max(self.last_stamp, stamp)
        if ticking:
            # The difference modulo 2³², between ±2³¹.
            step = (sequence - self.last_seq + 0x80000000) % 0x100000000 - 0x80000000
            if step > 0:
                self.gaps += step - 1
            else:
                self.back += 1
            self.last_seq += step
        else:
            self.last_seq = sequence
