"""The law book: compatible laws, and refusals with paths."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import MAX_TEXT, LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.laws.presets import preset_names
from nodes.parameters.store import ParameterError, convert
from tests.support import FIXTURES

T = 0.002


# -- law book
# --------------------------------------------------------------------------------------------------


def parameters(**more: Any) -> CouplingParameters:
    laws = {
        "pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0},
        "optimum": "paper_optimum",
    }
    made: CouplingParameters = convert(
        {"law": "pd", "laws": laws, **more}, CouplingParameters, "coupling"
    )
    return made


def check(**more: Any) -> None:
    book = LawBook("coupling", T)
    book.check(parameters(**more))
    Judgement("coupling", T, book).at_start(parameters(**more), 0.0)


def test_a_bare_preset_is_a_law() -> None:
    check(law="optimum")
    book = LawBook("coupling", T)
    assert book.description(parameters(), "optimum") == book.description(
        parameters(), "paper_optimum"
    )
    assert book.names(parameters()) == ["pd", "optimum", *preset_names()]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (
            {"law": "nix"},
            "coupling.law: no law is named 'nix'; available: pd, optimum, ",
        ),
        (
            {"laws": {"pd": 3}},
            "coupling.laws.pd: expected a mapping with kind and parameters, got 3",
        ),
        (
            {"laws": {"pd": {"kind": "pd", "damping": 1.0}}},
            "coupling.laws.pd.stiffness: is missing",
        ),
        (
            {"laws": {"pd": {"kind": "pdd"}}},
            "coupling.laws.pd.kind: 'pdd' is not an installed law",
        ),
        (
            {"schedule": [{"at": 1.0, "law": "nix"}]},
            "coupling.schedule[0].law: no law is named 'nix'",
        ),
        (
            {
                "schedule": [
                    {"at": 2.0, "law": "pd"},
                    {"at": 1.0, "law": "pd", "ramp": 501},
                ]
            },
            (
                "coupling.schedule[0].at: 2 s is tick 1000,"
                " but the swap before it ends at tick 1001"
            ),
        ),
        (
            {"schedule": [{"at": 1.0, "law": "pd"}, {"at": 1.0, "law": "optimum"}]},
            "the swap before it ends at tick 501; schedule it later",
        ),
        ({"stability": "refuse"}, "coupling.stability: refuse needs coupling.plant"),
        (
            {"memory": 3, "law": "optimum"},
            "coupling.laws.optimum: 4 taps, but coupling.memory is 3",
        ),
        (
            {"laws": {"a.b": "paper_optimum"}},
            "coupling.laws: expected a name that matches",
        ),
        (
            {"laws": {"x" * 65: "paper_optimum"}},
            "coupling.laws: expected a name that matches",
        ),
    ],
)
def test_what_does_not_belong_together_is_refused(
    more: dict[str, Any], told: str
) -> None:
    with pytest.raises(ParameterError) as raised:
        check(**more)
    assert told in str(raised.value)


@pytest.mark.parametrize(
    "more",
    [
        {"schedule": [{"at": 2.0, "law": "pd"}, {"at": 1.0, "law": "pd", "ramp": 500}]},
        {"memory": 4, "law": "optimum"},
        {"laws": {"x" * 64: "paper_optimum"}, "law": "x" * 64},
        {"stability": "refuse", "plant": {"mass": 0.1}},
    ],
)
def test_the_limits_themselves_are_accepted(more: dict[str, Any]) -> None:
    check(**more)


def test_laws_that_cannot_be_rendered_are_listed_and_do_not_stop_the_others() -> None:
    # At 4 kHz the paper's optimum has H(1) = 1000 − 0.14428·3·4000 < 0 (its leak grows with 1/T).
    book = LawBook("coupling", 1.0 / 4000.0)
    fast = parameters()
    book.check(fast)
    (reason,) = book.unfit(fast)
    assert reason.startswith("coupling.laws.optimum: renders H(1) = -")
    with pytest.raises(ParameterError, match=r"H\(1\) = -"):
        book.check(msgspec.structs.replace(fast, law="optimum"))


def test_receipts_of_long_laws_stay_short_and_readable() -> None:
    book = LawBook("coupling", T)
    long = parameters(laws={"long": {"kind": "fir", "taps": [1.25] * 2000}}, law="long")
    assert msgspec.json.decode(book.text(long, "long")) == {
        "law": "long",
        "kind": "fir",
        "taps": "2000 values",
    }
    assert len(book.text(long, "long")) < MAX_TEXT
    described = msgspec.json.decode(book.text(parameters(), "pd"))
    assert described == {"law": "pd", "kind": "pd", "stiffness": 1000.0, "damping": 3.0}


INSTALLED = FIXTURES / "installed"


@pytest.mark.parametrize(
    ("law", "told"),
    [
        (
            {"kind": "absent"},
            "coupling.laws.pd.kind: 'absent': the law cannot be imported: ModuleNotFoundError",
        ),
        (
            {"kind": "uncompilable"},
            "coupling.laws.pd: cannot be compiled: KeyError: 0.002",
        ),
        (
            {"kind": "stiffening", "stiffness": 1.0, "qubic": 1.0},
            "coupling.laws.pd.qubic: law kind stiffening has no such",
        ),
    ],
)
def test_laws_of_another_package_break_with_a_path(
    law: dict[str, Any], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(INSTALLED))
    with pytest.raises(ParameterError) as raised:
        check(laws={"pd": law})
    assert told in str(raised.value)
