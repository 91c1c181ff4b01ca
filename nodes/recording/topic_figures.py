"""What a recording holds of one topic: how many messages, of which ticks and times, and what is missing between them."""

from __future__ import annotations

import msgspec

__all__ = ["TopicFigures"]


class TopicFigures(msgspec.Struct):
    """What a recording holds of one topic.

    Attributes
    ----------
    messages : int
        How many.
    gaps : int
        How many ``seq`` are missing between the first and the last; 0 for topics that do not carry
        one message a tick.
    back : int
        How often ``seq`` did not rise on a topic with one message a tick: repeated messages, or a
        restarted driver.
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
        """Mean rate over the stamps [1/s]; 0 for fewer than two messages."""
        span = self.last_stamp - self.first_stamp
        return (self.messages - 1) / span if span > 0.0 else 0.0

    def add(self, sequence: int, stamp: float, ticking: bool) -> None:
        """Count one more message.

        Parameters
        ----------
        sequence : int
            Its ``seq`` modulo 2³², as MCAP keeps it.
        stamp : float
            Its stamp [s].
        ticking : bool
            Whether its topic carries one message a tick.
        """
        self.messages += 1
        if self.messages == 1:
            self.first_seq = self.last_seq = sequence
            self.first_stamp = self.last_stamp = stamp
            return
        self.first_stamp = min(self.first_stamp, stamp)
        self.last_stamp = max(self.last_stamp, stamp)
        if ticking:
            # Differences are taken modulo 2³², too.
            step = (sequence - self.last_seq + 0x80000000) % 0x100000000 - 0x80000000
            if step > 0:
                self.gaps += step - 1
            else:
                self.back += 1
            self.last_seq += step
        else:
            self.last_seq = sequence
