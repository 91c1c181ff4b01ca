"""What a refusal suggests is accepted when it is typed, whatever the loop's delay is then."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.errors import AT_LEAST, AT_MOST
from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import LawBook
from nodes.coupling.likely_delays import BIN, SPAN, LikelyDelays
from nodes.coupling.parameters import CouplingParameters
from nodes.laws.parse import LawRefusedError
from nodes.parameters.store import ParameterError, convert

T = 0.002
BOOK = LawBook("coupling", T)
JUDGEMENT = Judgement("coupling", T, BOOK)
PD = {"kind": "pd", "stiffness": 500.0, "damping": 3.0}
DEVICE = {"mass": 0.1, "damping": 1.0}
PAPER = {"damping": 3.0, "gains": "paper"}
ALPHA = {"kind": "pd_alpha", "order": 1.2, "taps": 10, **PAPER}


def of(law: dict[str, Any], **plant: float) -> CouplingParameters:
    made: CouplingParameters = convert(
        {"law": "own", "laws": {"own": law}, "plant": {**DEVICE, **plant}},
        CouplingParameters,
        "coupling",
    )
    return made


def change(
    now: CouplingParameters,
    wanted: CouplingParameters,
    delay: float,
    likely: tuple[float, ...] = (),
) -> None:
    law = BOOK.compile(wanted, "own")
    JUDGEMENT.of_change(now, wanted, "own", law, delay, False, likely)


def suggested(
    now: CouplingParameters,
    wanted: CouplingParameters,
    delay: float,
    likely: tuple[float, ...] = (),
) -> dict[str, tuple[str, float]]:
    """Return the ends that a refusal names: kind and value by path."""
    with pytest.raises(ParameterError) as raised:
        change(now, wanted, delay, likely)
    return {
        path: (one.kind, value)
        for one in raised.value.remedies
        if one.kind in (AT_MOST, AT_LEAST)
        for path, value in one.values.items()
    }


def accepted(now: CouplingParameters, wanted: CouplingParameters, delay: float) -> bool:
    try:
        change(now, wanted, delay)
    except ParameterError:
        return False
    return True


@settings(max_examples=15)
@given(
    st.lists(st.floats(0.0, 1.5), min_size=2, max_size=8),
    st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2),
)
def test_a_told_limit_is_accepted_at_any_delay_that_was_seen(
    delays: list[float], later: list[float]
) -> None:
    """Told at the present delay only, it was refused where the delay grew."""
    seen = LikelyDelays()
    for n, delay in enumerate(delays):
        seen.add(SPAN * n / len(delays), delay)
    low, high = min(delays), max(delays)
    now, around = of(PD), seen.around(delays[-1])
    told = suggested(now, of({**PD, "stiffness": 1e6}), delays[-1], around)
    ((kind, most),) = told.values()
    assert kind == AT_MOST
    for share in (0.0, 1.0, *later):
        delay = min(high, low + share * (high - low))
        assert accepted(now, of({**PD, "stiffness": most}), delay)
    late = suggested(now, of(PD, device_delay=30.0), delays[-1], around)
    kind, ticks = late["coupling.plant.device_delay"]
    assert kind == AT_MOST
    assert accepted(now, of(PD, device_delay=ticks), high)


@settings(max_examples=50)
@given(st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 5.0)), min_size=1))
def test_the_likely_delays_contain_what_was_measured_lately(
    samples: list[tuple[float, float]],
) -> None:
    seen = LikelyDelays()
    for now, delay in sorted(samples):
        seen.add(now, delay)
    end, last = max(samples)
    low, high = seen.around(last)
    for now, delay in samples:
        if end - now <= SPAN - BIN:
            # 1e-12: rounding of a sum of a few ticks
            assert low - 1e-12 <= delay <= high + 1e-12


def test_a_steady_loop_is_told_its_edge_itself() -> None:
    assert LikelyDelays().around(0.25) == (0.25, 0.25)


def test_a_refused_delay_is_told_the_longest_one_and_the_largest_stiffness() -> None:
    now, late = of(PD, device_delay=0.2), of(PD, device_delay=20.0)
    told = suggested(now, late, 0.5)
    assert set(told) == {"coupling.plant.device_delay", "coupling.laws.own.stiffness"}
    kind, ticks = told["coupling.plant.device_delay"]
    assert kind == AT_MOST
    # Three digits, so a hundredth more is past the edge.
    assert accepted(now, of(PD, device_delay=ticks), 0.5)
    assert not accepted(now, of(PD, device_delay=1.011 * ticks), 0.5)
    kind, stiffness = told["coupling.laws.own.stiffness"]
    assert kind == AT_MOST
    assert accepted(now, of({**PD, "stiffness": stiffness}, device_delay=20.0), 0.5)


@pytest.mark.parametrize("law", [ALPHA, {"kind": "paper_optimum", "damping": 3.0}])
@pytest.mark.parametrize("asked", [1e-3, 12.0])
def test_a_law_that_would_pull_is_told_the_smallest_stiffness(
    law: dict[str, Any], asked: float
) -> None:
    now, soft = of({**law, "stiffness": 1000.0}), of({**law, "stiffness": asked})
    told = suggested(now, soft, 0.5)
    ((path, (kind, least)),) = told.items()
    assert (path, kind) == ("coupling.laws.own.stiffness", AT_LEAST)
    assert accepted(now, of({**law, "stiffness": least}), 0.5)
    with pytest.raises(ParameterError, match="pull into the wall"):
        BOOK.compile(of({**law, "stiffness": 0.989 * least}), "own")


@pytest.mark.parametrize("law", [ALPHA, {"kind": "paper_optimum"}])
@pytest.mark.parametrize("likely", [(0.5,), (0.3, 0.7)])
def test_a_damping_at_which_a_law_would_pull_is_told_the_largest_one(
    law: dict[str, Any], likely: tuple[float, ...]
) -> None:
    """Told was a stiffness for it, at which the loop is unstable with either damping."""
    made = {**law, "stiffness": 1000.0, "damping": 3.0}
    now, wanted = of(made), of({**made, "damping": 1000.0})

    def told(force: bool) -> tuple[str, float]:
        with pytest.raises(LawRefusedError, match="pull into the wall") as raised:
            BOOK.compile(wanted, "own")
        error = raised.value
        JUDGEMENT.replace_remedies(error, now, wanted, "own", force, likely)
        (way,) = error.remedies
        ((path, value),) = way.values.items()
        assert path == "coupling.laws.own.damping"
        return way.kind, value

    kind, most = told(force=False)
    assert kind == AT_MOST
    assert all(accepted(now, of({**made, "damping": most}), one) for one in likely)
    # Three digits, so a hundredth more is past the edge.
    assert not accepted(now, of({**made, "damping": 1.011 * most}), max(likely))
    assert told(force=True)[1] >= most
