"""One contract for every law's description: complete, and true of the class."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import haptic
import msgspec
import numpy as np
import pytest

from nodes.coupling.law_book import free_name
from nodes.laws import Law, law_kinds
from nodes.laws.described_laws import calls, describe_law, limits_text, public_kinds
from nodes.laws.fields import GAINS
from nodes.laws.parse import LawRefusedError, law_to_dict, parse_law
from nodes.laws.presets import PRESETS, preset_names
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import parse_yaml
from tests.support import ROOT
from tests.support.launching import typed_in

every_kind = pytest.mark.parametrize("kind", law_kinds())
PD = {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}


def described(kind: str) -> tuple[type[Law], dict[str, Any]]:
    return law_kinds()[kind], describe_law(kind)


@every_kind
def test_a_description_names_every_parameter_with_its_meaning(kind: str) -> None:
    law, found = described(kind)
    assert [one["name"] for one in found["parameters"]] == list(law.__struct_fields__)
    assert found["formula"]
    for one in found["parameters"]:
        assert one["meaning"], one
        assert one["required"] == next(
            field.required
            for field in msgspec.structs.fields(law)
            if field.name == one["name"]
        )
    assert found["judged_by"] == (
        "poles"
        if parse_law(found["example"]).compile(0.002).evaluate is None
        else "simulation and launches"
    )


@every_kind
def test_a_limit_is_the_one_that_is_enforced(kind: str) -> None:
    _, found = described(kind)
    for one in found["parameters"]:
        for end, beyond in (("minimum", -1), ("maximum", 1)):
            if (limit := one[end]) is None:
                continue
            step = (
                beyond
                if one["type"] == "integer"
                else beyond * (abs(limit) + 1.0) * 1e-9
            )
            with pytest.raises(
                LawRefusedError, match=rf"law\.{one['name']}: expected a"
            ):
                parse_law({**found["example"], one["name"]: limit + step})
            edge = {**found["example"], one["name"]: limit}
            if one[f"{end}_excluded"]:
                with pytest.raises(
                    LawRefusedError, match=rf"law\.{one['name']}: expected a"
                ):
                    parse_law(edge)
            else:
                parse_law(edge)


@every_kind
def test_presets_and_gains_stand_beside_the_kinds_that_have_them(kind: str) -> None:
    law, found = described(kind)
    assert found["presets"] == [
        name for name in PRESETS if type(parse_law(name)) is law
    ]
    # What a gain is in SI units is told where there is one to choose.
    assert ("gains" in found) == ("gains" in law.__struct_fields__)


@pytest.mark.parametrize(
    ("low", "high", "excluded", "text"),
    [
        (None, None, False, ""),
        (0.0, None, True, "> 0"),
        (0.0, 1.5, False, "≥ 0, ≤ 1.5"),
        (None, 4.0, True, "< 4"),
    ],
)
def test_limits_are_told_with_their_ends(
    low: float | None, high: float | None, excluded: bool, text: str
) -> None:
    ends = {"minimum_excluded": excluded, "maximum_excluded": excluded}
    parameter = {"minimum": low, "maximum": high, **ends}
    assert limits_text(parameter) == text
    four, begin = ["a", "b", "c", "d"], f"{text}, " if text else ""
    assert limits_text({**parameter, "choices": four}) == f"{begin}a, b, c, d"
    # More do not fit into a table.
    assert (
        limits_text({**parameter, "choices": [*four, "e"]})
        == f"{begin}one of those below"
    )


@every_kind
def test_an_example_is_the_same_law_however_it_is_typed_in(kind: str) -> None:
    _, found = described(kind)
    wanted, words = parse_law(found["example"]), calls(found)
    names = {"haptic": haptic}
    assert eval(words["python"], names) == wanted  # noqa: S307  # our own text
    assert parse_law(parse_yaml(words["yaml"], "law")) == wanted
    assert shlex.split(words["shell"])[:4] == ["haptic", "law", "show", kind]


@every_kind
def test_a_class_stands_for_its_kind_in_python(kind: str) -> None:
    law, found = described(kind)
    made = getattr(haptic, law.__name__)
    assert made is law
    required = [one["name"] for one in found["parameters"] if one["required"]]
    if kind in public_kinds() and law.__module__.startswith("nodes."):
        assert law.__name__ in haptic.__all__
    if required:
        with pytest.raises(
            ParameterError, match=rf"^{kind}\.{required[0]}: is missing"
        ) as raised:
            made()
        assert all(name in str(raised.value) for name in required)
        with pytest.raises(
            LawRefusedError, match=rf"law\.{required[0]}: is missing"
        ) as refused:
            parse_law({"kind": kind})
        assert all(name in str(refused.value) for name in required)
    with pytest.raises(ParameterError, match=rf"{kind}\.nonsense: no such parameter"):
        made(**law.example, nonsense=1)
    with pytest.raises(TypeError, match="given by name"):
        made(1.0)


@every_kind
def test_numbers_of_numpy_are_numbers(kind: str) -> None:
    law, found = described(kind)

    def as_numpy(value: Any) -> Any:
        if isinstance(value, float):
            return np.float64(value)
        if isinstance(value, int):
            return np.int64(value)
        if isinstance(value, list) and value and isinstance(value[0], float):
            return np.array(value)
        return value

    values = {key: as_numpy(value) for key, value in law.example.items()}
    for made in (law(**values), haptic.law(kind, **values)):
        assert made == parse_law(found["example"])
        # Not a numpy number among them: it would be in every message and file.
        assert json.dumps(law_to_dict(made))


@pytest.mark.parametrize("kind", ["pd", "pd_filtered", "pd_alpha", "multi_term"])
def test_gain_is_the_damping_of_a_law(kind: str) -> None:
    law = law_kinds()[kind]
    values = {key: value for key, value in law.example.items() if key != "damping"}
    assert law(**values, gain=2.5) == law(**values, damping=2.5)
    assert haptic.law(kind, **values, gain=2.5) == haptic.law(
        kind, **values, damping=2.5
    )
    with pytest.raises(ParameterError, match="gain"):
        law(**values, gain=2.5, damping=2.5)


def test_lists_leave_out_what_only_programs_use() -> None:
    assert {kind for kind, law in law_kinds().items() if law.internal} == {
        "excitation",
        "knock",
    }
    assert haptic.laws() == [*public_kinds(), *preset_names()]
    assert not {"excitation", "knock"} & set(haptic.laws())


def test_the_command_line_describes_laws_without_a_launch(tmp_path: Path) -> None:
    every = json.loads(typed_in(tmp_path, "law", "describe", "--json").stdout)["laws"]
    assert [one["kind"] for one in every] == public_kinds()
    (one,) = json.loads(
        typed_in(tmp_path, "law", "describe", "pd_alpha", "--json").stdout
    )["laws"]
    assert one == describe_law("pd_alpha")
    told = typed_in(tmp_path, "law", "describe", "pd_alpha").stdout
    for text in (
        "F = K x + B_α D^α x",
        "N s^α/m",
        "> 0, < 4",
        "gains unlimited",
        "haptic.PDAlpha",
    ):
        assert text in told
    assert "paper_optimum" in typed_in(tmp_path, "law", "describe", "multi_term").stdout
    told = typed_in(tmp_path, "law", "describe", "pdd", code=2).stderr
    assert "'pdd' is not an installed law or preset" in told
    assert "did you mean pd?" in told


def test_the_page_explains_gains_as_the_description_does() -> None:
    page = (ROOT / "nodes" / "laws" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (N s\S*/m) \| (.*?) \| ", page, re.MULTILINE)
    assert [row for row in rows if row[0] in GAINS] == [
        (name, gain["unit"], gain["gain"]) for name, gain in GAINS.items()
    ]


def test_a_law_given_without_a_name_gets_a_free_one() -> None:
    laws = {"pd": PD, "pd_2": {**PD, "stiffness": 500.0}, "optimum": "paper_optimum"}
    assert free_name(PD, laws) == "pd"  # it is there already
    assert free_name({**PD, "stiffness": 500}, laws) == "pd_2"
    assert free_name({**PD, "stiffness": 501}, laws) == "pd_3"
    assert free_name({**PD, "stiffness": 501}, laws, mine={"pd_2"}) == "pd_2"
    assert free_name({"kind": "paper_optimum"}, laws) == "paper_optimum"


@pytest.mark.parametrize(
    "law",
    [
        haptic.PD(stiffness=1500, damping=3),
        {"kind": "pd", "stiffness": np.int64(1500), "gain": 3},
        [1500 + 3 / 0.002, -3 / 0.002],
        haptic.PD(stiffness=1500, damping=3).compile(0.002),
    ],
)
def test_a_scene_is_played_with_any_law(law: Any) -> None:
    wanted = haptic.play("floor_drop", stiffness=1500, duration=0.1).position_m
    assert np.array_equal(
        haptic.play("floor_drop", law=law, duration=0.1).position_m, wanted
    )


def test_a_refused_law_names_its_place(tmp_path: Path) -> None:
    with pytest.raises(
        LawRefusedError, match=r"law\.stiffness: expected a number above 0, got -1"
    ):
        haptic.play("floor_drop", law={"kind": "pd", "stiffness": -1})
    words = ("launch", "floor_drop", "--law", "{kind: pd, stiffness: 9, dampig: 3}")
    told = typed_in(tmp_path, *words, code=2).stderr
    assert re.search(
        r"floor_drop\.yaml:\d+: coupling\.law\.dampig: .*given as law:=", told
    )
    told = typed_in(
        tmp_path, "launch", "floor_drop", "law:={stiffness: 9}", code=2
    ).stderr
    assert re.search(
        r"floor_drop\.yaml:\d+: arguments\.law: expected text, got a mapping", told
    )


def test_every_preset_describes_its_kind() -> None:
    for name, values in PRESETS.items():
        found = describe_law(name)
        assert found["kind"] == values["kind"]
        assert found["example"] == {"kind": name}
        assert name in found["presets"]
