"""Changes from the control thread: applied once, withdrawn or repeated; never half."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import msgspec
import pytest

from nodes.base.node import Node
from nodes.parameters.store import ParameterError
from tests.support.setups import setup_of


class GainParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Two parameters."""

    gain: float = 1.0
    scheduled: int = 0


class Amplifier(Node):
    """A node whose changes only report the tick at which they are applied."""

    Parameters: ClassVar[type[msgspec.Struct]] = GainParameters

    def __init__(self) -> None:
        super().__init__(
            setup_of(run_dir="/nowhere", name="amplifier", kind="amplifier")
        )
        self.state = "running"
        self.applied: list[tuple[int, float]] = []

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Refuse gains above 10 while preparing, and above 5 only when they are applied."""
        if parameters.gain > 10.0:
            raise ParameterError(f"{parameters.gain}, limit 10", path="amplifier.gain")

        def apply(seq: int) -> dict[str, Any]:
            if parameters.gain > 5.0:
                raise ParameterError(
                    f"amplifier.gain: {parameters.gain}, limit 5 just now"
                )
            self.applied.append((seq, parameters.gain))
            return {"seq": seq, "gain": parameters.gain}

        return apply


@contextmanager
def ticking(
    node: Amplifier, each: Callable[[int], None] = lambda _: None
) -> Iterator[None]:
    """Run the loop's side of the node in a thread."""
    ending = threading.Event()

    def loop() -> None:
        seq = 0
        while not ending.wait(0.001):
            seq += 1
            each(seq)
            node.between_ticks(seq)

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


def changing(node: Amplifier, **values: float) -> dict[str, Any]:
    found: dict[str, Any] = node.changes.change(
        lambda: node.store.changed(values), node.prepare
    )
    return found


def test_a_change_is_applied_once_between_two_ticks() -> None:
    node = Amplifier()
    with ticking(node):
        receipt = changing(node, gain=3.0)
    assert node.applied == [(receipt["seq"], 3.0)]
    assert node.store.current.gain == 3.0


def test_what_the_loop_does_not_take_up_is_withdrawn_for_good() -> None:
    node = Amplifier()
    with pytest.raises(
        ParameterError,
        match=r"not applied by the loop within 0\.1 s; nothing was changed",
    ):
        node.changes.hand_over(lambda seq: node.applied.append((seq, 0.0)), timeout=0.1)
    node.between_ticks(1)
    assert node.applied == []


def test_a_node_that_has_finished_refuses_at_once() -> None:
    node = Amplifier()
    node.state = "finished"
    with pytest.raises(ParameterError, match="nothing was changed"):
        node.changes.hand_over(lambda seq: seq, timeout=1e6)


@pytest.mark.parametrize(
    ("gain", "told"),
    [(10.5, "limit 10"), (5.5, "limit 5 just now"), (float("nan"), "finite")],
)
def test_what_is_refused_on_either_side_changes_nothing_and_the_loop_goes_on(
    gain: float, told: str
) -> None:
    node = Amplifier()
    before = node.store.current
    with ticking(node):
        with pytest.raises(ParameterError, match=told):
            changing(node, gain=gain)
        assert node.store.current is before
        assert changing(node, gain=2.0)["gain"] == 2.0
    assert [gain for _, gain in node.applied] == [2.0]


def test_a_change_that_a_scheduled_one_overtakes_is_made_again_from_the_newer_parameters() -> (
    None
):
    node = Amplifier()
    made: list[int] = []
    scheduled = [0]

    def schedule(seq: int) -> None:
        # As a scheduled swap does, the loop itself changes a parameter, at every tick until three
        # attempts are overtaken.
        if 0 < len(made) < 4:
            scheduled.append(seq)
            node.store.accept(
                msgspec.structs.replace(node.store.current, scheduled=seq)
            )

    def make() -> Any:
        made.append(node.store.current.scheduled)
        return node.store.changed({"gain": 4.0})

    with ticking(node, schedule):
        receipt = node.changes.change(make, node.prepare)
    assert receipt["gain"] == 4.0
    assert len(node.applied) == 1
    assert len(made) >= 4
    # Nothing of the schedule was taken back.
    assert node.store.current == GainParameters(gain=4.0, scheduled=scheduled[-1])
