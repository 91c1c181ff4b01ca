"""Messages to and from Haply's service, without the service."""

from __future__ import annotations

import json

import pytest

from nodes.driver.haply.service import MAX_BUTTONS, PROFILE, buttons, command, read


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("force", [None, (1.0, -2.0, 3.5)])
def test_a_command_asks_for_the_position_or_sets_the_force(
    force: tuple[float, float, float] | None, first: bool
) -> None:
    """Only the first one names the session, whose profile the service then keeps."""
    said = json.loads(command("042", force, first=first))
    (device,) = said["inverse3"]
    assert device["device_id"] == "042"
    assert device["commands"] == (
        {"probe_position": {}}
        if force is None
        else {"set_cursor_force": {"vector": {"x": 1.0, "y": -2.0, "z": 3.5}}}
    )
    session = {"configure": {"profile": {"name": PROFILE}}}
    assert said.get("session") == (session if first else None)


def test_buttons_are_bits_in_the_order_of_their_names() -> None:
    def state(pressed: dict[str, object]) -> str:
        return json.dumps({"wireless_verse_grip": [{"state": {"buttons": pressed}}]})

    assert buttons(read("{}")) == (0, False)
    assert buttons(read(state({"b": True, "a": False, "c": True, "d": 1}))) == (
        0b0110,
        False,
    )
    names = [f"b{n:02}" for n in range(MAX_BUTTONS + 1)]
    most = dict.fromkeys(names[:-1], True)
    assert buttons(read(state(dict(most)))) == (2**MAX_BUTTONS - 1, False)
    assert buttons(read(state({**most, names[-1]: True}))) == (2**MAX_BUTTONS - 1, True)
    with pytest.raises(ValueError, match="what it should not"):
        read("[1")
