"""Numbers of a law's description: read by path, changed and scaled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nodes.laws import CompiledLaw


def numbers_of(tree: Any) -> dict[str, float]:
    """Return all floats of a law's description by path."""
    found: dict[str, float] = {}

    def note(path: str, value: float) -> float:
        return found.setdefault(path, value)

    with_numbers(tree, note)
    return found


def with_numbers(
    tree: Any, change: Callable[[str, float], float], path: str = ""
) -> Any:
    """Return a description with its floats changed."""
    if isinstance(tree, float):
        return change(path, tree)
    if isinstance(tree, dict):
        return {
            key: with_numbers(inner, change, f"{path}.{key}" if path else key)
            for key, inner in tree.items()
        }
    if isinstance(tree, list):
        return [
            with_numbers(inner, change, f"{path}[{i}]") for i, inner in enumerate(tree)
        ]
    return tree


def scaled_law(law: CompiledLaw, factor: float) -> CompiledLaw:
    """Return a law with taps and sections multiplied by a factor."""
    sections = tuple(
        (factor * b0, factor * b1, a1, a2) for b0, b1, a1, a2 in law.sections
    )
    return replace(law, taps=tuple(factor * tap for tap in law.taps), sections=sections)
