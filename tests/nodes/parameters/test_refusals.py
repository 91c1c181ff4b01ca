"""Misfits of values: found by the types alone, where msgspec finds them."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nodes.cli.main import Parser
from nodes.coupling.parameters import CouplingParameters
from nodes.launcher.launch_spec import NodeSpec, RunSpec
from nodes.parameters.refusals import find_misfit
from nodes.parameters.store import ParameterError, convert
from sim.device.driver import SimDriverParameters

Meta = msgspec.Meta


class Leaf(msgspec.Struct, forbid_unknown_fields=True):
    """A struct with bounds and a check of its own."""

    gain: Annotated[float, Meta(gt=0.0)]
    count: Annotated[int, Meta(ge=0, le=5)] = 0
    mode: Literal["auto", "off"] = "auto"

    def __post_init__(self) -> None:
        """Reject what the bounds allow."""
        if self.count > self.gain:
            raise ValueError("count is above gain")


class Tree(msgspec.Struct):
    """A struct of every kind of type that parameters use; unknown names are allowed."""

    leaf: Leaf | None = None
    leaves: list[Leaf] = []
    by_name: dict[Annotated[str, Meta(pattern="^[a-z]+$")], Leaf] = {}
    point: tuple[float, float] = (0.0, 0.0)
    taps: Annotated[list[float], Meta(min_length=1, max_length=2)] = msgspec.field(
        default_factory=lambda: [0.0]
    )
    cpu: int | Literal["auto", "any"] = "auto"
    awake: bool | Literal["auto"] = "auto"
    ratio: int | float = 0
    text: Annotated[str, Meta(max_length=3)] = ""
    anything: Any = None


scalars = st.sampled_from(
    [None, True, 0, 1, 6, -1, 0.5, 2.0, "auto", "any", "off", "a", "Abcd"]
)
names = st.sampled_from([*Tree.__struct_fields__, *Leaf.__struct_fields__, "a", "B"])
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=4)
    ),
    max_leaves=12,
)


def place(refusal: str) -> str:
    """Return the path in a sentence of msgspec's, with `[...]` for the key of a mapping."""
    found = re.search(
        r" - at (?:`key(?:\[\.\.\.\])?` in )?`\$(.*)`$", refusal, re.DOTALL
    )
    return found[1] if found else ""


def hidden_keys(path: str) -> str:
    """Return a path as msgspec writes it: without the key of the only mapping."""
    return re.sub(r"^(\.by_name)\.(\w+)", r"\1[...]", path)


def refusal(data: Any, target: Any) -> str | None:
    try:
        msgspec.convert(data, target)
    except msgspec.ValidationError as error:
        return str(error)
    return None


@given(
    st.fixed_dictionaries({}, optional=dict.fromkeys(Tree.__struct_fields__, trees))
    | trees
)
@example({"leaf": {"gain": 1.0, "count": 2}})
@example({"leaves": [{"gain": 1.0}, {"gain": 1.0, "mode": "of"}]})
@example({"by_name": {"a": {"gain": 1.0}, "B": {"gain": 1.0}}})
@example({"by_name": {"a": {"gain": 0.0}}})
@example({"point": [0.0]})
@example({"leaf": {}})
def test_a_misfit_is_found_where_msgspec_finds_it(data: Any) -> None:
    told = refusal(data, Tree)
    misfit = find_misfit(data, Tree)
    assert (misfit is None) == (told is None)
    if misfit is None or told is None:
        return
    if "missing required field" in told or "unknown field" in told:
        path, _, name = misfit.path.rpartition(".")
        assert hidden_keys(path) == place(told)
        assert f"`{name}`" in told
    else:
        assert hidden_keys(misfit.path) == place(told)


@pytest.mark.parametrize(
    "target", [CouplingParameters, SimDriverParameters, NodeSpec, RunSpec]
)
@given(data=st.data())
def test_nodes_accept_what_has_no_misfit(
    target: type[msgspec.Struct], data: st.DataObject
) -> None:
    values = data.draw(
        st.dictionaries(st.sampled_from(target.__struct_fields__), trees, max_size=3)
    )
    assert (find_misfit(values, target) is None) == (refusal(values, target) is None)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (
            {"cpu": "fast"},
            "node.cpu: expected a whole number or any or auto, got 'fast'",
        ),
        (
            {"awake": "aut"},
            "node.awake: expected true or false or auto, got 'aut'; did you mean",
        ),
        (
            {"leaf": {"gain": 1.0, "mode": "of"}},
            "expected one of auto, off, got 'of'; did you",
        ),
        (
            {"by_name": {"a": {"gain": 0.0}}},
            "node.by_name.a.gain: expected a number above 0, got",
        ),
        ({"leaf": {"gain": 1.0, "count": 2}}, "node.leaf: count is above gain"),
        (
            {"leaf": {"gain": 10**400}},
            "node.leaf.gain: expected a number of at most 1.797",
        ),
        ({"leaf": {}}, "node.leaf.gain: is missing, and has no default"),
        (
            {"point": [0.0]},
            "node.point: expected a list of length 2, got a list of length 1",
        ),
        (
            {"taps": []},
            "node.taps: expected a list of length at least 1, got a list of length 0",
        ),
    ],
)
def test_a_misfit_names_path_value_and_limit(data: Any, told: str) -> None:
    with pytest.raises(ParameterError) as raised:
        convert(data, Tree, "node")
    assert str(raised.value).startswith(told) or told in str(raised.value)


def test_the_command_line_suggests_a_choice(capsys: pytest.CaptureFixture[str]) -> None:
    """It relies on a private method of argparse's."""
    parser = Parser(prog="haptic")
    parser.add_argument("--law", choices=["pd", "pd_alpha"])
    parser.add_subparsers().add_parser("launch")
    with pytest.raises(SystemExit):
        parser.parse_args(["--law", "pd_alfa"])
    told = "argument --law: invalid choice: 'pd_alfa' (choose from 'pd', 'pd_alpha'); did you mean"
    assert f"{told} pd_alpha?" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        parser.parse_args(["lanch"])
    assert "did you mean launch?" in capsys.readouterr().err
