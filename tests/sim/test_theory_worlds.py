"""THEORY.md §18: its formulas computed from the page, and its table."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.k_max import with_spring, without_spring
from nodes.stability.loop_region import known_answer
from nodes.stability.plant import Plant
from nodes.stability.worlds import (
    AnyWorld,
    EulerTool,
    OtherDevice,
    SteppedTool,
    WorldKind,
    world_k_max,
)
from tests.support.formulas import PAGE, formulas

T = 0.002
SECTION = re.search(
    r"^## \d+\. Any hand, any world\n.*?(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL
)


def section() -> str:
    assert SECTION is not None
    return SECTION[0]


def holds(text: str, values: dict[str, Any], **definitions: str) -> bool:
    """Whether an inequality of the page holds at all frequencies."""
    known = {"real": np.real, "cos": np.cos, "abs": np.abs, **values}
    for name, formula in definitions.items():
        known[name] = eval(formula, {}, known)  # noqa: S307
    return bool(np.all(eval(text, {}, known)))  # noqa: S307


def values(law: CompiledLaw, plant: Plant, **more: Any) -> dict[str, Any]:
    theta = np.linspace(1e-3, np.pi, 20001)
    w = np.exp(-1j * theta)
    i, phi = int(plant.delay), plant.delay - int(plant.delay)
    (lag,) = formulas()["18.2"]
    psi = eval(lag.partition("=")[2], {"w": w, "i": i, "varphi": phi})  # noqa: S307
    return {
        "theta": theta,
        "w": w,
        "z": 1.0 / w,
        "V": (1.0 - w) / T,
        "H": law.response(1.0 / w),
        "P_d": known_answer(plant, theta) / (1.0 - w),
        "psi": psi,
        "b": plant.damping,
        "d": plant.delay,
        "T": T,
        **more,
    }


PD = without_spring(parse_law({"kind": "pd", "stiffness": 1.0, "damping": 0.2}), T)


@pytest.mark.parametrize(
    ("number", "world", "any_hand", "delay"),
    [
        (3, AnyWorld(), False, 0.0),
        (3, AnyWorld(), False, 0.5),
        (4, AnyWorld(), True, 0.5),
        (4, AnyWorld(), True, 1.0),
        (5, SteppedTool(2.0), True, 1.0),
        (6, SteppedTool(2.0), False, 0.0),
        (6, SteppedTool(2.0), False, 1.0),
        (7, EulerTool(0.1), False, 1.0),
        (8, OtherDevice(1.5, 2.0), True, 1.0),
    ],
)
def test_the_formulas_of_the_page_end_where_the_engine_does(
    number: int, world: WorldKind, any_hand: bool, delay: float
) -> None:
    plant = Plant(T, 0.1, 1.0, delay)
    edge = world_k_max(PD, plant, world, any_hand).k_max_n_per_m
    assert edge is not None
    more = {"b_t": 2.0, "m_t": 0.1, "b_1": 1.0, "b_2": 1.5, "d_1": delay, "d_2": 2.0}
    parts = formulas()[f"18.{number}"]
    conditions = [part for part in parts if re.search(r"[<>]", part)]
    definitions = dict(part.split("=", 1) for part in parts if "=" in part)
    if number == 8:
        definitions = {
            f"s_{k}": definitions["s_i"].replace("d_i", f"d_{k}") for k in (1, 2)
        }
    for factor, expected in ((1.0 - 1e-3, True), (1.0 + 1e-3, False)):
        known = values(with_spring(PD, factor * edge), plant, **more)
        assert (
            all(holds(condition, known, **definitions) for condition in conditions)
            is expected
        )


def test_every_figure_of_the_table() -> None:
    rows = re.findall(r"^\| PD B ([\d.]+) \|(.*)\|$", section(), re.MULTILINE)
    assert len(rows) == 4
    for gain, cells in rows:
        law = without_spring(
            parse_law({"kind": "pd", "stiffness": 1.0, "damping": float(gain)}), T
        )
        for delay, cell in zip((0.0, 0.5, 1.0, 2.0), cells.split("|"), strict=True):
            for text, any_hand in zip(cell.split("/"), (False, True), strict=True):
                found = world_k_max(
                    law, Plant(T, 0.1, 1.0, delay), AnyWorld(), any_hand
                ).k_max_n_per_m
                # Half a unit of the last digit.
                assert found == (
                    None
                    if text.strip() == "none"
                    else pytest.approx(float(text), abs=5.1e-4)
                )
