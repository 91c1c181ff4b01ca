"""THEORY.md §18: its formulas are read from the page and computed, and its table too."""

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
from nodes.stability.worlds import AnyWorld, EulerTool, OtherDevice, SteppedTool, WorldKind, world_k_max
from tests.support import ROOT

T = 0.002
PAGE = (ROOT / "sim" / "THEORY.md").read_text(encoding="utf-8")
SECTION = re.search(r"^## \d+\. Any hand, any world\n.*?(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)


def section() -> str:
    assert SECTION is not None
    return SECTION[0]


def formulas() -> dict[int, str]:
    """Formulas of the section by their number, without their names."""
    found = {}
    for number, text in re.findall(r"^    \(\d+\.(\d)\) (.*(?:\n {12}.*)*)", section(), re.MULTILINE):
        found[int(number)] = " ".join(re.split(r":\s{2,}", text)[-1].split())
    return found


def as_python(text: str) -> str:
    """Turn a formula of the page into Python."""
    for mark, written in {"−": "-", "^": "**", "θ": "theta", "ψ": "psi"}.items():
        text = text.replace(mark, written)
    while (bare := re.sub(r"Re\{([^{}]*)\}", r"real(\1)", text)) != text:
        text = bare
    text = re.sub(r"\|([A-Z])\|", r"abs(\1)", text)
    # A space or a closing bracket before a name, a number or an opening bracket multiplies; a function's bracket does not.
    return re.sub(r"(?<=[\w)]) (?=[\w(])", "*", text)


def holds(text: str, values: dict[str, Any], **definitions: str) -> bool:
    """Whether an inequality of the page holds at all frequencies."""
    known = {"real": np.real, "cos": np.cos, "abs": np.abs, **values}
    for name, formula in definitions.items():
        known[name] = eval(as_python(formula), {}, known)  # noqa: S307
    return bool(np.all(eval(as_python(text), {}, known)))  # noqa: S307


def values(law: CompiledLaw, plant: Plant, **more: Any) -> dict[str, Any]:
    theta = np.linspace(1e-3, np.pi, 20001)
    w = np.exp(-1j * theta)
    i, phi = int(plant.delay), plant.delay - int(plant.delay)
    psi = (1.0 - phi) * w ** (1 + i) + phi * w ** (2 + i)
    step = (1.0 - w) / T
    return {
        "theta": theta,
        "w": w,
        "z": 1.0 / w,
        "D": step,
        "H": law.response(1.0 / w),
        "P": known_answer(plant, theta) / (1.0 - w),
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
        (2, AnyWorld(), False, 0.0),
        (2, AnyWorld(), False, 0.5),
        (3, AnyWorld(), True, 0.5),
        (3, AnyWorld(), True, 1.0),
        (4, SteppedTool(2.0), True, 1.0),
        (5, SteppedTool(2.0), False, 0.0),
        (5, SteppedTool(2.0), False, 1.0),
        (6, EulerTool(0.1), False, 1.0),
        (7, OtherDevice(1.5, 2.0), True, 1.0),
    ],
)
def test_the_formulas_of_the_page_end_where_the_engine_does(
    number: int, world: WorldKind, any_hand: bool, delay: float
) -> None:
    plant = Plant(T, 0.1, 1.0, delay)
    edge = world_k_max(PD, plant, world, any_hand).k_max_n_per_m
    assert edge is not None
    more = {"b_t": 2.0, "m_t": 0.1, "b_1": 1.0, "b_2": 1.5, "d_1": delay, "d_2": 2.0}
    parts = [part.strip() for part in re.split(r",\s+(?=[A-Zs])", formulas()[number])]
    conditions = [part for part in parts if re.search(r"[<>]", part)]
    definitions = dict(part.split(" = ", 1) for part in parts if " = " in part)
    if number == 7:
        definitions = {f"s_{k}": definitions["s_i"].replace("d_i", f"d_{k}") for k in (1, 2)}
    for factor, expected in ((1.0 - 1e-3, True), (1.0 + 1e-3, False)):
        known = values(with_spring(PD, factor * edge), plant, **more)
        assert all(holds(condition, known, **definitions) for condition in conditions) is expected


def test_every_figure_of_the_table() -> None:
    rows = re.findall(r"^\| PD B ([\d.]+) \|(.*)\|$", section(), re.MULTILINE)
    assert len(rows) == 4
    for gain, cells in rows:
        law = without_spring(parse_law({"kind": "pd", "stiffness": 1.0, "damping": float(gain)}), T)
        for delay, cell in zip((0.0, 0.5, 1.0, 2.0), cells.split("|"), strict=True):
            for text, any_hand in zip(cell.split("/"), (False, True), strict=True):
                found = world_k_max(law, Plant(T, 0.1, 1.0, delay), AnyWorld(), any_hand).k_max_n_per_m
                # Half a unit of the last digit.
                assert found == (None if text.strip() == "none" else pytest.approx(float(text), abs=5.1e-4))
