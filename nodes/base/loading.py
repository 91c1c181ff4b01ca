"""Loading of files while a node runs: what it takes is not taken for unbounded requests."""

from __future__ import annotations


class Loading:
    """Whether a node loads files of its launch; a with block does so.

    Memory that it takes meanwhile is its own (see ``ControlServer``), up to a limit.
    """

    def __init__(self) -> None:
        self.is_on = False  # whether it loads now
        self.has_been = False  # whether it has, since the control thread last looked

    def __enter__(self) -> None:
        """Begin a load."""
        self.is_on = True

    def __exit__(self, *error: object) -> None:
        """End the load."""
        self.has_been, self.is_on = True, False
