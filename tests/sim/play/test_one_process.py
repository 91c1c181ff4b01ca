"""A recording made in one process equals a launch's, field by field."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT
from messages.types import Message
from nodes.recording.reader import Recording
from tests.support.launching import launch_json
from tests.support.one_process import recorded

OF_THE_MACHINE = {"response", "lateness"}
SUMS = {"energy"}
"""Sums of a product per tick: two orders of adding differ by roundings."""


def compared(message: Message) -> tuple[dict[str, object], list[float]]:
    """Return the fields that must be the same, and those that are sums."""
    fields = msgspec.structs.asdict(message)
    sums = [fields.pop(name) for name in SUMS & fields.keys()]
    return {
        name: value for name, value in fields.items() if name not in OF_THE_MACHINE
    }, sums


@pytest.mark.process
@pytest.mark.parametrize(
    ("words", "coupling"),
    [
        (("law:=pd", "stiffness:=900", "apply:=next_tick"), "{}"),
        (("height:=0.001",), "{schedule: [{at: 0.05, law: multi_term}]}"),
    ],
)
def test_it_is_the_launch_s(
    words: tuple[str, ...], coupling: str, tmp_path: Path
) -> None:
    more = tmp_path / "more.yaml"
    more.write_text(f"coupling: {coupling}\n", encoding="utf-8")
    words = ("floor_drop", *words, "duration:=0.2")
    told = launch_json(tmp_path, *words, "pace:=lockstep", "--params", str(more))
    launched = Recording(tmp_path / told["recording"])
    made = Recording(recorded(tmp_path, *words, params=more))
    for topic in (DEVICE_STATE, PROXY, FORCE, *[RECEIPT] * ("schedule" in coupling)):
        theirs, ours = launched.messages(topic), made.messages(topic)
        assert len(theirs) == len(ours) > 0
        for one, other in zip(theirs, ours, strict=True):
            if topic == RECEIPT:
                # How far the force stepped is the coupling's own to say.
                one = msgspec.structs.replace(one, force_step=0.0)
            (fields, sums), (same, added) = compared(one), compared(other)
            assert same == fields
            assert added == pytest.approx(sums, rel=1e-9, abs=1e-15)
    left_out = {"run", "wall_minus_monotonic_s", "tick"}
    assert {k: v for k, v in made.manifest.items() if k not in left_out} == {
        k: v for k, v in launched.manifest.items() if k not in left_out
    }
