"""Handing a change to the loop: prepared on the control thread, applied between two ticks."""

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
    """Working time of the control thread, during which it may have held the GIL."""

    def __init__(self) -> None:
        # one tuple, because the loop reads both at any moment
        self._state: tuple[float, float | None] = (0.0, None)

    def start(self) -> None:
        """Start counting."""
        self._state = self.seconds(), time.monotonic()

    def stop(self) -> None:
        """Stop counting."""
        self._state = self.seconds(), None

    def seconds(self) -> float:
        """Return the total time [s]."""
        before, since = self._state
        return before if since is None else before + time.monotonic() - since


class Change:
    """A prepared change; `apply` runs on the main thread between two ticks."""

    def __init__(self, apply: Callable[[int], Any]) -> None:
        self._apply = apply
        self.applied = threading.Event()
        self._result: Any = None
        self._error: Exception | None = None

    def run(self, seq: int) -> None:
        """Apply the change (main thread)."""
        try:
            self._result = self._apply(seq)
        # a failing change must not end the loop; the reply has the reason
        except Exception as error:  # noqa: BLE001
            self._error = error
        self.applied.set()

    def result(self) -> Any:
        """Return the reply, or raise the error (control thread, once `applied` is set)."""
        if self._error is not None:
            raise self._error
        return self._result


class Changes:
    """Changes of a node's parameters, all or nothing, while its loop `lives`."""

    def __init__(
        self,
        setup: Setup,
        store: ParameterStore,
        notify: Callable[[], None],
        lives: Callable[[], bool],
    ) -> None:
        self._setup = setup
        self._store = store
        self._notify = notify
        self._lives = lives
        self._waiting: deque[Change] = deque()
        self.serving = Stopwatch()  # working time of the control thread

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def apply_next(self, seq: int) -> None:
        """Apply one change (main thread); the loop applies one per tick."""
        # it may be withdrawn at this very moment
        with contextlib.suppress(IndexError):
            self._waiting.popleft().run(seq)

    def hand_over(self, apply: Callable[[int], Any], timeout: float = 2.0) -> Any:
        """Hand a change to the loop and return its reply; withdraw it if it is not taken.

        Runs on the control thread.
        """
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
                    # just taken: it is being applied
                    change.applied.wait()
                else:
                    raise ParameterError(
                        f"not applied by the loop within {timeout:g} s;"
                        " nothing was changed; is the node stopping?",
                        path=self._setup.name,
                    )
            return change.result()
        finally:
            self.serving.start()

    def change(
        self, make: Callable[[], Any], prepare: Callable[[Any], Callable[[int], Any]]
    ) -> dict[str, Any]:
        """Check, prepare and apply new parameters, all or nothing (control thread).

        Return a receipt with the differences.
        """
        # If they change meanwhile (a scheduled change), everything is repeated with the newer ones.
        while True:
            base = self._store.current
            parameters = make()
            if self._setup.allow_paths is not None:
                check_paths(
                    parameters,
                    [Path(folder) for folder in self._setup.allow_paths],
                    self._setup.name,
                )
            receipt = self.hand_over(
                self._unless_changed(base, parameters, prepare(parameters))
            )
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
