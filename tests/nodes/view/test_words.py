"""Why there is no force: each reason has a sentence."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from messages.types import Event
from nodes.driver.force_words import cause_of, explain
from tests.support.touching import FORCE, PROXY, STATE

NONE = (0.0, 0.0, 0.0)


def told(
    state: dict[str, Any] | None = None,
    proxy: dict[str, Any] | None = None,
    force: Any = None,
    silent: float = 0.0,
) -> Any:
    replace = msgspec.structs.replace
    return explain(
        replace(STATE, **(state or {})),
        replace(PROXY, **(proxy or {})),
        replace(FORCE, **(force or {})),
        silent,
        "",
    )


@pytest.mark.parametrize(
    ("given", "level", "words"),
    [
        ({}, "ok", "1.00 N: pd pushes back, 1.00 mm deep."),
        (
            {"state": {"safety": "waiting", "force": NONE}},
            "stop",
            "waits for the first force",
        ),
        (
            {"state": {"safety": "zero", "force": NONE}},
            "stop",
            "the force is zero until a fresh one",
        ),
        (
            {"state": {"safety": "fault", "force": NONE}},
            "stop",
            "outside its workspace",
        ),
        ({"state": {"safety": "damping"}}, "warn", "the driver damps the device"),
        ({"state": {"safety": "ramp"}}, "warn", "the force ramps up"),
        ({"force": {"law": "fallback"}}, "warn", "the law failed"),
        ({"force": {"force": (-12.0, 0.0, 0.0)}}, "warn", "1.00 N of the 12.00 N"),
        (
            {"force": {"force": (-12.0, 0.0, 0.0), "seq": 9}},
            "ok",
            "1.00 N: pd pushes back",
        ),
        (
            {"proxy": {"contact": False, "distance": 0.008}, "state": {"force": NONE}},
            "rest",
            "the surface is 8.0 mm away",
        ),
        (
            {"proxy": {"contact": False, "normal": NONE}, "state": {"force": NONE}},
            "rest",
            "there is nothing to touch",
        ),
        (
            {"state": {"force": NONE}, "force": {"force": NONE}},
            "rest",
            "renders none at this deflection",
        ),
        # No sentence says that 0.00 N push back: half of the last digit is the limit.
        (
            {
                "state": {"force": (0.00499, 0.0, 0.0)},
                "force": {"force": (0.00499, 0.0, 0.0)},
            },
            "rest",
            "No force to feel: pd renders less than 0.01 N.",
        ),
        (
            {
                "state": {"force": (0.00501, 0.0, 0.0)},
                "force": {"force": (0.00501, 0.0, 0.0)},
            },
            "ok",
            "0.01 N: pd pushes back",
        ),
        (
            {"state": {"safety": "stopped", "force": NONE}},
            "stop",
            "Too hard: the loop was unstable, and the driver stopped it.",
        ),
        ({"silent": 0.51}, "stop", "nothing has come from the driver for 0.5 s"),
    ],
)
def test_each_reason_has_its_sentence(
    given: dict[str, Any], level: str, words: str
) -> None:
    found = told(**given)
    assert found[0] == level
    assert words in found[1]


def test_before_the_first_tick() -> None:
    assert (
        explain(None, None, None, 9.0)[1] == "No force: the driver has not ticked yet."
    )
    assert (
        explain(STATE, None, None, 0.0)[1]
        == "1.00 N: the environment has not answered yet."
    )
    unanswered = msgspec.structs.replace(STATE, force=NONE)
    assert (
        explain(unanswered, None, None, 0.0)[1]
        == "No force: the environment has not answered yet."
    )
    assert (
        "(coupling silent)"
        in explain(
            msgspec.structs.replace(STATE, safety="zero", force=NONE),
            PROXY,
            FORCE,
            0.0,
            "coupling silent",
        )[1]
    )


def test_a_stop_is_told_by_its_strokes() -> None:
    data = {
        "cause": 9.0,
        "tick": 7.0,
        "limit_n": 10.0,
        "strokes": 6.0,
        "span_s": 0.25,
        "energy_j": 0.0653,
    }
    event = Event(
        seq=7,
        stamp=0.0,
        node="driver",
        kind="stopped",
        reason="put otherwise",
        data=data,
    )
    assert (
        cause_of(event)
        == "6 strokes to the limit of 10 N within 0.25 s, 0.0653 J generated"
    )
    # Of an older recording, another package, or a number that was not finite: the sentence itself.
    for less in (
        {},
        {"cause": 99.0},
        {key: value for key, value in data.items() if key != "span_s"},
    ):
        assert cause_of(msgspec.structs.replace(event, data=less)) == "put otherwise"
