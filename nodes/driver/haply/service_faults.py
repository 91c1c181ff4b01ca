"""Why an Inverse3 gives no force: numbers for the mailbox, and their texts."""

from typing import Final

CLOSED, SLOW, FORCELESS, UNPLUGGED, NO_STATE, UNREADABLE, SURPLUS, BROKEN = range(1, 9)
"""Errors, as numbers for the mailbox."""

ERRORS: Final = {
    CLOSED: "the Inverse Service closed the connection",
    SLOW: "the Inverse Service does not answer in time",
    FORCELESS: (
        "the Inverse Service takes no forces (0 N act while a force is asked for): it must be of"
        " version 3.5"
    ),
    UNPLUGGED: "the Inverse3 was unplugged",
    NO_STATE: "the Inverse Service gives no state of the Inverse3",
    UNREADABLE: "the Inverse Service sends messages that cannot be read",
    SURPLUS: (
        "the Inverse Service goes on sending more states than it is asked for: it must be of"
        " version 3.5"
    ),
    BROKEN: "the exchange with the Inverse Service failed",
}
