"""Formulas of THEORY.md §2, §3, §9, §13, §17, computed from the page against the loop."""

from __future__ import annotations

import re

import numpy as np
import pytest

from nodes.laws.parse import parse_law
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from tests.support.formulas import DISPLAYED, PAGE, formulas

T = 0.002


def right_side(number: str, **values: object) -> complex:
    """Return the right side of a formula of the page."""
    known = {
        "cos": np.cos,
        "sin": np.sin,
        "tan": np.tan,
        "real": np.real,
        "abs": abs,
        "pi": np.pi,
        **values,
    }
    statement = formulas()[number][0]
    return complex(eval(re.split("<=|>=|[<>=]", statement, maxsplit=1)[1], {}, known))  # noqa: S307


def test_formulas_are_numbered_in_order_within_their_section() -> None:
    numbers: dict[str, list[int]] = {}
    for part in re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]:
        for _, number in DISPLAYED.findall(part):
            section, _, place = number.partition(".")
            assert part.startswith(f"{section}. "), number
            numbers.setdefault(section, []).append(int(place))
    assert all(
        places == list(range(1, len(places) + 1)) for places in numbers.values()
    ), numbers
    assert PAGE.count(r"\tag{") == sum(map(len, numbers.values())), (
        "a formula that DISPLAYED does not read"
    )


def test_formulas_that_are_cited_stand_in_the_page() -> None:
    there = {number for _, number in DISPLAYED.findall(PAGE)}
    assert set(re.findall(r"\((\d{1,2}\.\d)\)", PAGE)) <= there


@pytest.mark.parametrize("beta", [0.1, 0.8284271, 1.5])
def test_k_max_of_pd_on_a_mass_without_damping(beta: float) -> None:
    mass = 0.1
    law = without_spring(
        parse_law({"kind": "pd", "stiffness": 1.0, "damping": beta * mass / T}), T
    )
    found = k_max(law, Plant(T, mass, 1e-9, 0.0)).k_max_n_per_m
    assert found is not None
    # (3.3) is the limit b → 0; b/m·T = 2e-11 moves it by that order.
    assert found * T * T / mass == pytest.approx(
        right_side("3.3", beta=beta).real, rel=1e-6
    )


@pytest.mark.parametrize(
    ("law", "delay"), [("pd", 0.0), ("pd", 1.0), ("pd_alpha", 1.0)]
)
def test_the_boundary_curve_ends_where_the_pole_radius_does(
    law: str, delay: float
) -> None:
    """Curve (3.4) with the held device of (3.2) crosses the real axis at K_max."""
    form = {"kind": law, "stiffness": 1.0, "damping": 3.0} | (
        {"order": 0.5, "taps": 4, "gains": "paper"} if law == "pd_alpha" else {}
    )
    mu = T * 1.0 / 0.1
    free, plant = without_spring(parse_law(form), T), Plant(T, 0.1, 1.0, delay)
    edge = k_max(free, plant).k_max_n_per_m
    assert edge is not None

    def curve(theta: float) -> complex:
        z = np.exp(1j * theta)
        held = right_side(
            "3.2", z=z, q=(1.0 - np.exp(-mu)) / mu * T, T=T, b=1.0, mu=mu, e=np.e
        )
        return right_side(
            "3.4", z=z, d=delay, P=held, D=complex(free.response(np.array([z]))[0])
        )

    grid = np.linspace(1e-3, np.pi - 1e-3, 4000)
    values = np.array([curve(theta) for theta in grid])
    before = np.flatnonzero(np.diff(np.sign(values.imag)))
    share = values.imag[before] / (values.imag[before] - values.imag[before + 1])
    crossed = values.real[before] + share * np.diff(values.real)[before]
    # The error of a straight line over a step of π/4000 of a smooth curve.
    assert min(abs(crossed / edge - 1.0)) < 1e-5
    theta = float(grid[before][np.argmin(abs(crossed / edge - 1.0))])
    z = np.exp(1j * theta)
    held = right_side(
        "3.2", z=z, q=(1.0 - np.exp(-mu)) / mu * T, T=T, b=1.0, mu=mu, e=np.e
    )
    ratio = right_side("9.2", T=T, b=1.0, z=z, P=held).real
    late = with_spring(free, edge)
    f = T * np.real((z**-delay * late.response(np.array([z]))[0] - edge) / (1.0 - z))
    # One step of the grid moves the frequency by at most π/4000, f and R by that order.
    assert right_side("9.1", T=T, b=1.0, R=ratio, f_omega=f).real == pytest.approx(
        edge, rel=1e-2
    )


def test_two_devices_with_a_spring_between_them() -> None:
    for delays, stiffness in (
        ((0, 0), 500.0),
        ((0, 1), 236.07),
        ((1, 1), 166.67),
        ((0, 2), 151.39),
    ):
        statement = formulas()["17.4"][0]
        for factor, expected in ((1.0 - 1e-4, True), (1.0 + 1e-4, False)):
            known = {
                "K": factor * stiffness,
                "T": T,
                "b": 1.0,
                "d_1": delays[0],
                "d_2": delays[1],
            }
            assert eval(statement, {}, known) is expected  # noqa: S307


@pytest.mark.parametrize("gain", [0.0, 0.5, 3.0])
def test_damping_that_a_derivative_costs(gain: float) -> None:
    law = with_spring(
        without_spring(parse_law({"kind": "pd", "stiffness": 1.0, "damping": gain}), T),
        0.0,
    )
    omega = np.linspace(1.0, np.pi / T, 50)
    z = np.exp(1j * omega * T)
    f = eval(  # noqa: S307
        formulas()["2.2"][0].partition("=")[2],
        {},
        {"T": T, "real": np.real, "D": law.response(z), "z": z},
    )
    assert f == pytest.approx(-gain * np.cos(omega * T), abs=1e-9)
