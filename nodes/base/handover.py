"""Handing something prepared to the loop: made on the control thread, applied on the main thread between two ticks."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nodes.base.setup import Setup
from nodes.parameters.paths import check_paths
from nodes.parameters.store import ParameterError, ParameterStore, differences


class Stopwatch:
    """How long the control thread has been at work: for so long it may have kept the interpreter from the loop."""

    def __init__(self) -> None:
        # together: the loop reads them at any moment
        self._state: tuple[float, float | None] = (0.0, None)

    def start(self) -> None:
        """Begin to count."""
        self._state = self.seconds(), time.monotonic()

    def stop(self) -> None:
        """Count no longer."""
        self._state = self.seconds(), None

    def seconds(self) -> float:
        """Tell how long in all [s]."""
        before, since = self._state
        return before if since is None else before + time.monotonic() - since


class Change:
    """Something prepared off the hot path; `apply` runs on the main thread between two ticks, and gives the reply."""

    def __init__(self, apply: Callable[[int], Any]) -> None:
        self._apply = apply
        self.applied = threading.Event()
        self._result: Any = None
        self._error: Exception | None = None

    def run(self, seq: int) -> None:
        """Apply it (main thread)."""
        try:
            self._result = self._apply(seq)
        except Exception as error:  # noqa: BLE001  # a change that fails must not end the loop; the reply says why
            self._error = error
        self.applied.set()

    def result(self) -> Any:
        """Give what came of it (control thread, once it was `applied`)."""
        if self._error is not None:
            raise self._error
        return self._result


class Changes:
    """How a node's parameters change, all or nothing: prepared on the control thread, applied by a loop that still `lives`."""

    def __init__(
        self,
        setup: Setup,
        store: ParameterStore,
        notify: Callable[[], None],
        lives: Callable[[], bool],
    ) -> None:
        self._setup, self._store, self._notify, self._lives = setup, store, notify, lives
        self._waiting: deque[Change] = deque()
        self.serving = Stopwatch()  # how long the control thread was at work

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def apply_next(self, seq: int) -> None:
        """Apply one change (main thread): the loop takes one a tick."""
        # It may be withdrawn at this very moment.
        with contextlib.suppress(IndexError):
            self._waiting.popleft().run(seq)

    def hand_over(self, apply: Callable[[int], Any], timeout: float = 2.0) -> Any:
        """Hand a prepared change to the loop and wait until it was applied (control thread); one not taken up is withdrawn."""
        self.serving.stop()
        try:
            change = Change(apply)
            self._waiting.append(change)
            self._notify()
            deadline = time.monotonic() + timeout
            while not change.applied.wait(0.05):
                if time.monotonic() < deadline and self._lives():
                    continue
                try:
                    self._waiting.remove(change)
                except ValueError:
                    # Taken up just now: it is being applied.
                    change.applied.wait()
                else:
                    raise ParameterError(
                        f"{self._setup.name}: not taken up by the loop within {timeout:g} s;"
                        " nothing was changed; is the node stopping?"
                    )
            return change.result()
        finally:
            self.serving.start()

    def change(
        self, make: Callable[[], Any], prepare: Callable[[Any], Callable[[int], Any]]
    ) -> dict[str, Any]:
        """Make new parameters, check, prepare and apply them, all or nothing; a receipt with what changed (control thread)."""
        # Should they change in between (a scheduled swap), all is made again from the newer ones.
        while True:
            base = self._store.current
            parameters = make()
            if self._setup.allow_paths is not None:
                check_paths(
                    parameters,
                    [Path(folder) for folder in self._setup.allow_paths],
                    self._setup.name,
                )
            receipt = self.hand_over(self._unless_changed(base, parameters, prepare(parameters)))
            if receipt is not None:
                return {**receipt, "changed": differences(base, parameters)}

    def _unless_changed(
        self, base: Any, parameters: Any, apply: Callable[[int], Any]
    ) -> Callable[[int], Any]:
        def at_tick(seq: int) -> Any:
            if self._store.current is not base:
                return None
            receipt = apply(seq)
            self._store.accept(parameters)
            return receipt

        return at_tick
