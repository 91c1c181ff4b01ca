"""One contract for every law: taps, limits, normalisation, refusals, round trip, swaps."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import inspect
from numpy.typing import NDArray
from scipy import special

from nodes import arithmetic
from nodes.laws import CompiledLaw, Law, law_kinds
from nodes.laws.fields import MAX_TAPS
from nodes.laws.parse import LawRefusedError, compile_law, law_to_dict, parse_law
from nodes.laws.presets import preset_names
from sim.device.filters import filtered

T = 0.002

EXAMPLES: dict[str, dict[str, Any]] = {
    "pd": {"stiffness": 1200.0, "damping": 3.0},
    "pd_alpha": {
        "stiffness": 1200.0,
        "damping": 0.7,
        "order": 1.3,
        "taps": 12,
        "gains": "paper",
    },
    "multi_term": {
        "stiffness": 1200.0,
        "damping": 2.0,
        "terms": [
            {"gain": 1.1, "order": 0.4},
            {"gain": -0.2, "order": 2.5},
            {"gain": 0.3, "order": 1.0},
        ],
        "taps": 9,
        "gains": "paper",
    },
    "fir": {"taps": [2500.0, -1700.0, 400.0, 0.125]},
    "fractional_sls": {
        "stiffness": 900.0,
        "damping": 8.0,
        "order": 0.6,
        "relaxation": 0.004,
        "taps": 16,
    },
    "pd_filtered": {"stiffness": 1200.0, "damping": 3.0, "cutoff": 30.0},
    "pd_windowed": {
        "stiffness": 1200.0,
        "damping": 3.0,
        "resolution": 2.3e-5,
        "window": 9,
    },
    "excitation": {"amplitude": 0.5, "stiffness": 30.0, "damping": 0.2},
    "knock": {
        "taps": [5000.0, -3000.0, 500.0],
        "step": 1e-4,
        "stiffness": 30.0,
        "damping": 0.2,
    },
}

CASES = [
    pytest.param({"kind": kind, **values}, id=kind) for kind, values in EXAMPLES.items()
]
CASES += [pytest.param({"kind": name}, id=name) for name in preset_names()]


def forces(law: CompiledLaw, deflections: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return forces from the loop's own kernels."""
    length = len(law.taps)
    history, head = [0.0] * (2 * length), 0
    state = [0.0] * (2 * len(law.sections))
    flat = [c for section in law.sections for c in section]
    out, previous = [], 0.0
    for x in deflections.tolist():
        head = arithmetic.push(history, head, length, x)
        force = arithmetic.fir(law.taps, history, head)
        if state:
            force += arithmetic.sections(flat, state, x, previous)
        out.append(force)
        previous = x
    return np.array(out)


def expected(law: CompiledLaw, deflections: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the same by numpy's convolution and BLAS's recursive filter."""
    total = np.convolve(deflections, law.taps)[: len(deflections)]
    for b0, b1, a1, a2 in law.sections:
        total = total + filtered([b0, b1], [1.0, a1, a2], deflections)
    return np.asarray(total)


def size(law: CompiledLaw) -> float:
    """Return the scale of rounding: taps, and sections over their memory."""
    return sum(map(abs, law.taps)) + 50.0 * sum(
        abs(b0) + abs(b1) for b0, b1, _, _ in law.sections
    )


def settling(law: CompiledLaw) -> int:
    """Return the ticks after which a law has forgotten its start."""
    return 2 * len(law.taps) + (400 if law.sections else 4)


def test_every_registered_law_has_an_example_here() -> None:
    assert {
        kind for kind, law in law_kinds().items() if law.__module__.startswith("nodes.")
    } == set(EXAMPLES)


every_law = pytest.mark.parametrize("case", CASES)


@every_law
def test_force_is_the_convolution_of_its_taps(case: dict[str, Any]) -> None:
    law = compile_law(parse_law(case), T)
    x = np.random.default_rng(1).normal(size=60) * 1e-3
    scale = 1e-3 * size(law)
    # Sums of a few dozen products in another order: some roundings of the largest sum.
    assert np.abs(forces(law, x) - expected(law, x)).max() <= 64 * 2.0**-52 * scale


@every_law
def test_is_linear_in_the_deflection(case: dict[str, Any]) -> None:
    law = compile_law(parse_law(case), T)
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 40)) * 1e-3
    together = forces(law, 3.0 * a - 0.5 * b)
    apart = 3.0 * forces(law, a) - 0.5 * forces(law, b)
    assert np.abs(together - apart).max() <= 256 * 2.0**-52 * 4e-3 * size(law)


@every_law
def test_no_deflection_for_as_long_as_its_memory_gives_exactly_no_force(
    case: dict[str, Any],
) -> None:
    law = compile_law(parse_law(case), T)
    if law.sections:
        pytest.skip("recursive laws forget exponentially, not in n ticks")
    n = len(law.taps) - 1
    pulse = np.concatenate([np.random.default_rng(3).normal(size=5), np.zeros(n + 3)])
    rendered = forces(law, pulse)
    assert not rendered[5 + n :].any()
    assert rendered[5 + n - 1] != 0.0 or law.taps[n] == 0.0


@every_law
def test_held_deflection_gives_h1(case: dict[str, Any]) -> None:
    law = compile_law(parse_law(case), T)
    held = forces(law, np.full(settling(law), 1e-3))[-1]
    assert held == pytest.approx(1e-3 * law.h1, abs=64 * 2.0**-52 * 1e-3 * size(law))
    assert law.h1 > 0.0


@every_law
def test_alternating_deflection_gives_the_nyquist_gain(case: dict[str, Any]) -> None:
    law = compile_law(parse_law(case), T)
    ticks = settling(law)
    x = np.array([1e-3 * (-1.0) ** k for k in range(ticks)])
    assert forces(law, x)[-1] == pytest.approx(x[-1] * law.h_nyquist, rel=1e-12)


@every_law
def test_dump_and_load_give_the_same_law_and_the_same_bits(
    case: dict[str, Any],
) -> None:
    law = parse_law(case)
    dumped = yaml.safe_dump(law_to_dict(law))
    again = parse_law(yaml.safe_load(dumped))
    assert again == law
    before, after = compile_law(law, T), compile_law(again, T)
    assert (after.taps, after.sections) == (before.taps, before.sections)
    # Code of its own keeps a state, so that two compilations are never the same object.
    assert (after.evaluate is None) == (before.evaluate is None)


@every_law
def test_swap_at_rest_between_equal_h1_steps_by_rounding_only(
    case: dict[str, Any],
) -> None:
    law = compile_law(parse_law(case), T)
    spring = compile_law(parse_law({"kind": "fir", "taps": [law.h1]}), T)
    length = max(len(law.taps), 1)
    history, head = [1e-3] * (2 * length), 0
    step = arithmetic.fir(law.taps, history, head) - arithmetic.fir(
        spring.taps, history, head
    )
    assert abs(step) <= 64 * 2.0**-52 * 1e-3 * size(law)


@every_law
def test_parameters_are_frozen(case: dict[str, Any]) -> None:
    law = parse_law(case)
    with pytest.raises(AttributeError):
        setattr(law, law.__struct_fields__[0], 1.0)


def test_preset_values_can_be_replaced() -> None:
    law = law_to_dict(parse_law({"kind": "paper_optimum", "stiffness": 321.0}))
    assert law == {**law_to_dict(parse_law("paper_optimum")), "stiffness": 321.0}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (None, r"^laws\.a: expected a mapping"),
        ("pd", r"^laws\.a: expected a mapping"),
        ({}, r"^laws\.a\.kind: None is not"),
        ({"kind": ["pd"]}, r"^laws\.a\.kind: \['pd'\] is not"),
        (
            {"kind": "pdq", "stiffness": 1.0},
            r"^laws\.a\.kind: 'pdq' is not .* available: .*fir, .*paper_optimum",
        ),
        ({"kind": "pd"}, r"^laws\.a\.stiffness: is missing"),
        (
            {"kind": "pd", "stiffness": 0.0},
            r"^laws\.a\.stiffness: expected a number above 0, got 0\.0",
        ),
        (
            {"kind": "pd", "stiffness": 1.0, "damping": -1e-9},
            r"^laws\.a\.damping: .*of at least 0, got -1e-09",
        ),
        (
            {"kind": "pd", "stiffness": math.nan},
            r"^laws\.a\.stiffness: nan is not a finite",
        ),
        (
            {"kind": "pd", "stiffness": math.inf},
            r"^laws\.a\.stiffness: inf is not a finite",
        ),
        (
            {"kind": "pd", "stiffness": "1000"},
            r"^laws\.a\.stiffness: expected a number, got '1000'",
        ),
        (
            {"kind": "pd", "stiffness": True},
            r"^laws\.a\.stiffness: expected a number, got True",
        ),
        (
            {"kind": "pd", "stifness": 1.0},
            r"^laws\.a\.stifness: law kind pd has no such .* stiffness, damping",
        ),
        ({"kind": "fir", "taps": []}, r"^laws\.a\.taps: .*a list of length at least 1"),
        (
            {"kind": "fir", "taps": [1.0] * (MAX_TAPS + 1)},
            rf"^laws\.a\.taps: .*of length at most {MAX_TAPS}",
        ),
        ({"kind": "fir", "taps": [1.0, math.inf]}, r"^laws\.a\.taps\[1\]: inf"),
        (
            {"kind": "paper_optimum", "terms": []},
            r"^laws\.a\.terms: .*a list of length at least 1",
        ),
        (
            {"kind": "paper_optimum", "terms": [{"gain": 1.0, "order": 4.0}]},
            r"^laws\.a\.terms\[0\]\.order: .*below 4, got 4",
        ),
        (
            {"kind": "paper_optimum", "terms": [{"gain": 1.0, "order": 0.0}]},
            r"^laws\.a\.terms\[0\]\.order: .*above 0, got 0",
        ),
        (
            {"kind": "paper_optimum", "taps": 1},
            r"^laws\.a\.taps: .*of at least 2, got 1",
        ),
        ({"kind": "paper_optimum", "gains": "SI"}, r"^laws\.a\.gains: "),
    ],
)
def test_refusals_name_path_value_and_limit(data: object, message: str) -> None:
    with pytest.raises(LawRefusedError, match=message):
        parse_law(data, "laws.a")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"kind": "fir", "taps": [1.0, -1.0]}, r"^laws\.a: renders H\(1\) = 0 N/m"),
        ({"kind": "fir", "taps": [1.0, -1.5]}, r"^laws\.a: renders H\(1\) = -0\.5 N/m"),
        (
            {"kind": "pd", "stiffness": 1e308, "damping": 1e308},
            r"^laws\.a: taps or their sum are not finite",
        ),
        (
            {"kind": "fir", "taps": [1e308, 1e308]},
            r"^laws\.a: taps or their sum are not finite",
        ),
        (
            {"kind": "fir", "taps": [1.0], "period": 0.001},
            r"^laws\.a\.period: .*T = 0\.001 s .*T = 0\.002 s",
        ),
        (
            {"kind": "paper_optimum", "derivative": "none"},
            r"^laws\.a.*derivative = 'none'",
        ),
    ],
)
def test_compiling_refuses_what_must_not_be_rendered(
    data: object, message: str
) -> None:
    with pytest.raises(LawRefusedError, match=message):
        compile_law(parse_law(data, "laws.a"), T, "laws.a")


def test_just_inside_and_just_outside_a_positive_h1() -> None:
    """GL of order 1.5 with 4 taps leaks −B·T^−α·|C(0.5, 3)|: above that K is felt."""
    leak = T**-1.5 * abs(float(special.binom(0.5, 3)))
    data = {
        "kind": "pd_alpha",
        "damping": 1.0,
        "order": 1.5,
        "taps": 4,
        "gains": "physical",
    }
    inside = compile_law(parse_law({**data, "stiffness": leak * (1.0 + 1e-9)}), T)
    assert 0.0 < inside.h1 < 1e-5
    with pytest.raises(LawRefusedError, match=r"H\(1\) = -"):
        compile_law(parse_law({**data, "stiffness": leak * (1.0 - 1e-9)}), T)


def test_a_sum_of_taps_within_its_rounding_is_no_stiffness() -> None:
    """0.1 + 0.2 - 0.3 is 2.8e-17 in doubles, less than the rounding of its own summands."""
    taps = [0.1, 0.2, -0.3]
    rounding = 2.0**-52 * sum(map(abs, taps))
    assert 0.0 < sum(taps) < rounding
    with pytest.raises(
        LawRefusedError, match=r"H\(1\) = 2\.77556e-17 N/m .*limit: > 1\.3e-16"
    ):
        compile_law(parse_law({"kind": "fir", "taps": taps}), T)
    taps[2] += 2.0 * rounding
    assert (
        rounding
        < compile_law(parse_law({"kind": "fir", "taps": taps}), T).h1
        < 4.0 * rounding
    )


def test_sections_that_do_not_decay_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Ringing(Law, frozen=True, kw_only=True):
        a2: float = 1.0

        def compile(self, period: float) -> CompiledLaw:  # noqa: ARG002
            return CompiledLaw((1000.0,), ((1.0, 0.0, 0.0, self.a2),))

    assert compile_law(Ringing(a2=1.0 - 1e-12), T).h1 > 0.0
    with pytest.raises(LawRefusedError, match="limit: radius < 1"):
        compile_law(Ringing(a2=1.0), T)


@pytest.mark.parametrize("taps", [2, 3, 2000, MAX_TAPS])
@pytest.mark.parametrize("order", [1e-3, 0.999, 3.999])
def test_orders_and_lengths_up_to_their_limits(order: float, taps: int) -> None:
    law = compile_law(parse_law({"kind": "pd_alpha", "stiffness": 1e13, "damping": 1.0,
    "order": order, "taps": taps,
                                 "gains": "physical"}), T)  # fmt: skip
    assert len(law.taps) == taps
    # Beyond m = 171 the paper's Gamma-ratio form gives 0; the recursion must not.
    assert law.taps[-1] != 0.0


def edges(of: inspect.Type) -> list[Any]:
    """Return a type's limits, their neighbours inside, and the last numbers around 1 and 2."""
    if isinstance(of, inspect.UnionType):
        return [value for one in of.types for value in edges(one)]
    if isinstance(of, inspect.NoneType):
        return [None]
    if isinstance(of, inspect.IntType):
        return [value for value in (of.ge, (of.ge or 0) + 1) if value is not None]
    if not isinstance(of, inspect.FloatType):
        return []
    least = -1e300 if of.gt is None else math.nextafter(of.gt, math.inf)
    least = least if of.ge is None else of.ge
    most = 1e300 if of.lt is None else math.nextafter(of.lt, -math.inf)
    most = most if of.le is None else of.le
    near = [
        math.nextafter(at, to)
        for at in (least, most, 1.0, 2.0)
        for to in (-math.inf, at + 1)
    ]
    return [
        value
        for value in (least, most, 1.0, 1e-300, 1e300, *near)
        if least <= value <= most
    ]


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_two_parameters_at_their_edges_compile_or_are_refused(kind: str) -> None:
    """Anything but a law, a ValueError or an overflow is an error of ours."""
    law = law_kinds()[kind]
    fields = {
        f.encode_name: edges(f.type) for f in cast(Any, inspect.type_info(law)).fields
    }
    tried = 0
    for one, other in itertools.combinations_with_replacement(fields, 2):
        for pair in itertools.product(fields[one], fields[other]):
            values = {**EXAMPLES[kind], one: pair[0], other: pair[1]}
            try:
                compiled = parse_law({"kind": kind, **values}).compile(T)
            except (LawRefusedError, ValueError, OverflowError):
                continue
            assert isinstance(compiled, CompiledLaw)
            tried += 1
    assert tried or kind == "fir"  # it has lists only


def test_any_number_of_terms() -> None:
    terms = [{"gain": 0.01, "order": 0.05 + 0.019 * i} for i in range(200)]
    data = {
        "kind": "multi_term",
        "stiffness": 1e4,
        "damping": 1.0,
        "terms": terms,
        "taps": 30,
        "gains": "paper",
    }
    whole = parse_law(data).compile(T)
    parts = [parse_law({**data, "terms": [term]}).compile(T) for term in terms]
    total = np.sum([part.taps for part in parts], axis=0)
    total[0] -= 199 * 1e4
    # 200 additions around 2e6.
    assert np.abs(total - np.array(whole.taps)).max() < 200 * 2.0**-52 * 2e6


def test_a_law_of_another_package_works_by_being_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere_law.py").write_text(
        "from nodes.laws import CompiledLaw, Law\n"
        "class Soft(Law, frozen=True, kw_only=True, forbid_unknown_fields=True):\n"
        "    kind = 'soft'\n"
        "    stiffness: float\n"
        "    def compile(self, period):\n"
        "        return CompiledLaw((self.stiffness,))\n"
    )
    info = tmp_path / "elsewhere-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: elsewhere\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text("[haptic.laws]\nsoft = elsewhere_law:Soft\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert compile_law(parse_law({"kind": "soft", "stiffness": 5.0}), T).taps == (5.0,)


@pytest.mark.process
@pytest.mark.smoke
def test_laws_are_parsed_without_numpy() -> None:
    code = (
        "import sys; from nodes.laws.parse import parse_law, compile_law; "
        "compile_law(parse_law('paper_optimum'), 0.002); "
        "sys.exit(','.join({'numpy', 'scipy', 'numba', 'matplotlib'} & set(sys.modules)))"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True
        ).stderr.strip()
        == ""
    )


finite = st.floats(1e-3, 1e5)
terms = st.lists(
    st.fixed_dictionaries(
        {"gain": st.floats(-10, 10), "order": st.floats(1e-6, 3.999)}
    ),
    min_size=1,
    max_size=5,
)
laws = st.one_of(
    st.fixed_dictionaries(
        {"kind": st.just("pd"), "stiffness": finite, "damping": finite}
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("multi_term"),
            "stiffness": finite,
            "damping": finite,
            "terms": terms,
            "taps": st.integers(2, 40),
            "gains": st.sampled_from(["physical", "paper", "unlimited"]),
        }
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("fir"),
            "taps": st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40),
        }
    ),
)


@given(laws)
@settings(max_examples=60)
def test_any_law_survives_dump_and_load(data: dict[str, Any]) -> None:
    law = parse_law(data)
    assert parse_law(yaml.safe_load(yaml.safe_dump(law_to_dict(law)))) == law
    assert parse_law(msgspec.json.decode(msgspec.json.encode(law_to_dict(law)))) == law


@given(laws, st.floats(0.25, 4.0))
@settings(max_examples=60)
def test_laws_scale_with_their_gains(data: dict[str, Any], factor: float) -> None:
    scaled = dict(data)
    for name in ("stiffness", "damping"):
        if name in scaled:
            scaled[name] *= factor
    if "taps" in scaled and isinstance(scaled["taps"], list):
        scaled["taps"] = [factor * tap for tap in scaled["taps"]]
    once, more = (
        np.array(parse_law(data).compile(T).taps),
        np.array(parse_law(scaled).compile(T).taps),
    )
    # A tap may be a small difference of large terms (K + gains of both signs).
    size = np.abs(once).max() + sum(
        abs(t["gain"]) * data["damping"] * T**-4 for t in data.get("terms", ())
    )
    assert np.abs(more - factor * once).max() <= 32 * 2.0**-52 * factor * size + 1e-300


@given(laws, laws, st.integers(0, 30))
@settings(max_examples=60)
def test_a_swap_over_the_shared_history_has_no_start_up(
    first: dict[str, Any], second: dict[str, Any], at: int
) -> None:
    """After the swap the force is bit-equal to a loop with the second law throughout."""
    a, b = parse_law(first).compile(T), parse_law(second).compile(T)
    x = np.random.default_rng(at).normal(size=40) * 1e-3
    length = max(len(a.taps), len(b.taps))
    history, head = [0.0] * (2 * length), 0
    for k, value in enumerate(x.tolist()):
        head = arithmetic.push(history, head, length, value)
        if k >= at:
            fresh, start = [0.0] * (2 * length), 0
            for older in x[: k + 1].tolist():
                start = arithmetic.push(fresh, start, length, older)
            assert arithmetic.fir(b.taps, history, head) == arithmetic.fir(
                b.taps, fresh, start
            )
