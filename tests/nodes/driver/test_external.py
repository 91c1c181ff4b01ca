"""External forces: added to the law's, limited, and gone when not renewed."""

from __future__ import annotations

import math
from typing import Any

import pytest

from messages.types import Force
from nodes.driver.external import ExternalParameters, give
from nodes.parameters.store import ParameterError
from tests.support.safety import Port, T, force

ALLOWED = ExternalParameters(peak=2.0, age=5 * T)


def pushed(port: Port, z: float) -> dict[str, Any]:
    return give(port.s, ALLOWED, "driver", [0.0, 0.0, z])


def answered(port: Port, seq: int) -> float:
    port.s.seq = seq
    port.answer(force(seq), seq)
    return port.force[2]


@pytest.fixture
def port() -> Port:
    port = Port()
    for seq in range(200):
        answered(port, seq)
    assert port.state == "active"
    return port


def test_it_comes_on_top_of_the_law_until_it_is_too_old(port: Port) -> None:
    port.s.seq = 200
    told = pushed(port, 0.5)
    assert told == {"force_n": (0.0, 0.0, 0.5), "lowered": False, "age_s": 5 * T}
    assert [answered(port, seq) for seq in range(200, 207)] == [1.5] * 5 + [1.0] * 2


def test_a_new_one_takes_its_place_and_zero_ends_it(port: Port) -> None:
    port.s.seq = 200
    pushed(port, 0.5)
    assert answered(port, 200) == 1.5
    pushed(port, -0.25)
    assert answered(port, 201) == 0.75
    pushed(port, 0.0)
    assert answered(port, 202) == 1.0


def test_it_is_lowered_to_its_peak_in_its_direction(port: Port) -> None:
    told = give(port.s, ALLOWED, "driver", [3.0, 0.0, 4.0])
    assert told["lowered"]
    assert told["force_n"] == pytest.approx((1.2, 0.0, 1.6), rel=4e-16)


def test_the_drivers_own_limits_come_after_it() -> None:
    port = Port(peak_force=1.2)
    for seq in range(200):
        answered(port, seq)
    pushed(port, 1.5)
    assert answered(port, 200) == 1.2


@pytest.mark.parametrize(
    "bad", [[0.0, 0.0], [math.nan, 0.0, 0.0], ["x", 0.0, 0.0], [0.0, 0.0, math.inf]]
)
def test_nonsense_is_refused(port: Port, bad: list[Any]) -> None:
    with pytest.raises(ParameterError, match=r"driver\.external\.force"):
        give(port.s, ALLOWED, "driver", bad)
    assert answered(port, 200) == 1.0


def test_along_an_axis_that_nobody_computes_there_is_none() -> None:
    """Forces along axes not computed are ignored, without effect on the others."""
    alone, beside = (
        Port(axes=(0, 1), peak_force=5.0, continuous_force=3.0) for _ in range(2)
    )
    with pytest.raises(
        ParameterError,
        match=r"driver\.external\.force: 0\.5 N along z, .*\[x, y\]: nothing would be felt",
    ):
        give(alone.s, ALLOWED, "driver", [0.5, 0.0, 0.5])
    assert give(alone.s, ALLOWED, "driver", [0.5, 0.0, 0.0])["force_n"] == (
        0.5,
        0.0,
        0.0,
    )
    give(beside.s, ALLOWED, "driver", [0.5, 0.0, 0.0])
    for seq in range(400):
        for port, z in ((alone, 0.0), (beside, 40.0)):
            # Fast outwards while it comes back after a gap, which slows its ramp.
            port.moves((0.3, 0.0, 0.0) if seq > 200 else (0.0, 0.0, 0.0))
            if 100 <= seq < 200:
                port.missed(seq, (0.0, 0.0, 0.1))
            else:
                port.answer(Force(seq=seq, stamp=0.0, force=(1.0, 0.5, z)), seq)
        assert alone.force == beside.force
        assert beside.force[2] == 0.0
    assert alone.limited == beside.limited


def test_nobody_pushes_unasked(port: Port) -> None:
    with pytest.raises(
        ParameterError, match=r"driver\.external: no force from outside.*peak"
    ):
        give(port.s, None, "driver", [0.0, 0.0, 1.0])
