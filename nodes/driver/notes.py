"""Codes of the notes of a driver's rules; nodes/driver/force_words.py has their texts.

A code is also the number `cause` of the driver's event (messages/PROTOCOL.md), so it never changes.
"""

FIRST_FORCE, FRESH_FORCE, DONE_RAMP, SILENT, STILL_SILENT, LET_GO = range(6)
NO_POSITION, OUTSIDE, BACK_INSIDE, SWINGS, CONTINUOUS, HELD_UP, REARMED, JUMPED = range(
    6, 14
)
REFUSED_FIRST = 14  # 14 to 17: future, replayed, stale, not finite
