"""The emitter: what JavaScript does differently is bridged or refused, with file and line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sim.javascript.emitter import Emitter
from sim.javascript.names import NotEmittedError, literal
from sim.javascript.values import Plain, value
from tests.support.in_node import node

EDGES = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    2.5,
    -2.5,
    0.1,
    7.0,
    -7.0,
    1e300,
    5e-324,
    math.inf,
    -math.inf,
)


here: Any = sys.modules[__name__]


def least(a: float, b: float) -> float:
    return min(a, b)


def greatest(a: float, b: float) -> float:
    return max(a, b, 0.5)


def remainder(a: float, b: float) -> float:
    return a % b if b != 0.0 and math.isfinite(a) else 0.0


def quotient(a: float, b: float) -> float:
    return (
        a // b
        if b != 0.0 and abs(a) < 1e6 and math.isfinite(b) and abs(b) > 0.01
        else 0.0
    )


def truncated(a: float, b: float) -> float:
    return float(int(a)) + float(int(b)) if math.isfinite(a + b) else 0.0


def rounded_up(a: float, b: float) -> float:
    return float(math.ceil(a) + math.floor(b)) if math.isfinite(a + b) else 0.0


def swapped(a: float, b: float) -> float:
    a, b = b, a
    (low, high) = (a, b) if a < b else (b, a)
    return low if low == low and high == high else b


def chained(a: float, b: float) -> float:
    total = 0.0
    for i in range(3, 0, -1):
        for part in (a, b):
            total += part * i if -2.0 <= part < b or part in (0.1, 7.0) else 0.0
    return total


def _share(a: float, b: float) -> float:
    return a + b


def hidden(a: float, b: float) -> float:
    # in JavaScript, a function without its underscore would be hidden
    share = _share(a, b)
    return share + _share(b, b)


def masked(a: float, b: float) -> float:
    whole = 2**40 + 5 if a > b else 3
    return float(whole & (whole - 1))


def signed(a: float, b: float) -> float:
    return math.copysign(a, b) + float(not a) + float(bool(b))


FUNCTIONS: tuple[Callable[[float, float], float], ...] = (
    least,
    greatest,
    remainder,
    quotient,
    truncated,
    rounded_up,
    swapped,
    chained,
    hidden,
    masked,
    signed,
)


@pytest.mark.process
@pytest.mark.smoke
def test_arithmetic_has_the_bits_of_python_at_every_edge(tmp_path: Path) -> None:
    emitter, pairs = Emitter(), [(a, b) for a in EDGES for b in EDGES]
    names = [emitter.function(function) for function in FUNCTIONS]
    script = tmp_path / "edges.js"
    script.write_text(
        f"{emitter.text}const pairs = {value(pairs)};\n"
        f"const all = [{', '.join(names)}].map((f) => pairs.map(([a, b]) => f(a, b)));\n"
        "const text = (x) => Object.is(x, -0) ? '-0.0' : String(x);\n"
        "console.log(JSON.stringify(all.map((row) => row.map(text))));\n"
    )
    done = subprocess.run(
        [node(), str(script)], capture_output=True, text=True, check=True
    )
    for function, row in zip(FUNCTIONS, json.loads(done.stdout), strict=True):
        for (a, b), got in zip(pairs, row, strict=True):
            want, found = function(a, b), float(got.replace("Infinity", "inf"))
            same = found == want and math.copysign(1.0, found) == math.copysign(
                1.0, want
            )
            assert same or (math.isnan(found) and math.isnan(want)), (
                function.__name__,
                a,
                b,
                got,
            )


def with_star(*values: float) -> float:
    return values[0]


def with_text(a: float) -> str:
    return f"{a}"


def from_the_end(values: Any) -> Any:
    return values[-1]


def with_comprehension(values: Any) -> Any:
    return [one for one in values]  # noqa: C416  # the construct under test


def with_unknown_call(a: float) -> Any:
    return json.dumps(a).encode()


def with_exception(a: float) -> float:
    if a < 0.0:
        raise ValueError
    return a


def with_a_hidden_function(masked: float) -> Any:
    return here.masked(masked, 1.0)


def calls_another(a: float) -> str:
    return with_text(a)


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (with_star, "star arguments"),
        (with_text, "expression JoinedStr"),
        (from_the_end, "an index from the end"),
        (with_comprehension, "expression ListComp"),
        (with_exception, "statement Raise"),
        (
            with_a_hidden_function,
            "a variable that has the name of a function called, masked,",
        ),
        (calls_another, "expression JoinedStr"),
        (with_unknown_call, ""),
    ],
)
def test_what_has_no_form_in_javascript_is_refused_with_file_and_line(
    function: Callable[..., Any], why: str
) -> None:
    with pytest.raises(NotEmittedError, match=rf"\w+\.py:\d+: {why}"):
        Emitter().function(function)


def test_what_scripts_call_keeps_its_name_whatever_is_emitted_before() -> None:
    def other(a: float) -> float:
        return least(a, 1.0)

    other.__name__ = "greatest"
    emitter = Emitter()
    emitter.reserve([greatest])
    assert emitter.function(other) == "greatest_test_emitter"
    assert emitter.function(greatest) == "greatest"
    with pytest.raises(ValueError, match="two functions are named greatest"):
        emitter.reserve([other])


def test_functions_that_engines_round_differently_are_counted() -> None:
    def root(a: float) -> float:
        return math.exp(a) * a**3

    emitter = Emitter()
    emitter.function(root)
    assert sorted(emitter.inexact.values()) in (["**"], ["exp"], ["**", "exp"])
    assert "Math.exp(a)" in emitter.text


def test_a_whole_number_that_is_no_double_is_refused() -> None:
    assert literal(2**62) == "4611686018427387904"
    with pytest.raises(NotEmittedError, match="is no double"):
        literal(2**53 + 1)


def test_plain_data_stays_json_and_ends_no_script() -> None:
    assert value(Plain([1, 2.5, True, None])) == "[1,2.5,true,null]"
    assert value("</script>") == '"<\\/script>"'
    assert value([True, 0.5]) == "new Float64Array([1, 0.5])"
