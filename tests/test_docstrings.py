"""The public surface is listed and documented in full; everything else has a sentence.

A module belongs to the surface when it has ``__all__``; nodes/EXTENDING.md lists those modules.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any

import haptic

import messages
import nodes
import sim
from tests.support import ROOT


def modules() -> Iterator[ModuleType]:
    for package in (messages, nodes, sim):
        yield package
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            # starts a node when imported as a program; has no functions
            if found.name not in ("nodes.__main__",):
                yield importlib.import_module(found.name)


def surface() -> list[ModuleType]:
    # An __init__ that passes names on has nothing of its own.
    return [
        haptic,
        *(
            module
            for module in modules()
            if hasattr(module, "__all__") and any(own(module))
        ),
    ]


def own(module: ModuleType) -> Iterator[tuple[str, Any]]:
    if module is haptic:
        # It loads what it offers from where that stands.
        yield from (
            (f"haptic.{name}", getattr(haptic, name)) for name in haptic.__all__
        )
        return
    for name, thing in vars(module).items():
        if (
            not name.startswith("_")
            and getattr(thing, "__module__", None) == module.__name__
        ):
            yield f"{module.__name__}.{name}", thing


def functions(module: ModuleType) -> Iterator[tuple[str, FunctionType, bool]]:
    """Yield public functions and methods, and whether each overrides a documented one."""
    for name, thing in own(module):
        thing = inspect.unwrap(getattr(thing, "py_func", thing))
        if isinstance(thing, FunctionType):
            # A compiled form of a private function is as private as that.
            if not thing.__name__.startswith("_"):
                yield name, thing, False
        elif inspect.isclass(thing):
            for member, value in vars(thing).items():
                value = getattr(value, "__func__", value)
                # A function that is a field's default is documented where it is defined.
                defined_here = (
                    getattr(value, "__qualname__", "")
                    == f"{thing.__qualname__}.{member}"
                )
                if (
                    not member.startswith("_")
                    and isinstance(value, FunctionType)
                    and defined_here
                ):
                    yield (
                        f"{name}.{member}",
                        value,
                        any(hasattr(base, member) for base in thing.__mro__[1:]),
                    )


def test_every_module_tells_its_reason() -> None:
    silent = [
        module.__name__
        for module in modules()
        if len((module.__doc__ or "").strip()) < 20
    ]
    assert silent == []


def test_everything_public_has_at_least_a_sentence() -> None:
    silent = [
        name
        for module in modules()
        for name, function, _ in functions(module)
        if not inspect.getdoc(function)
    ]
    silent += [
        name
        for module in modules()
        for name, thing in own(module)
        if inspect.isclass(thing) and not inspect.getdoc(thing)
    ]
    assert silent == []


def test_the_surface_documents_arguments_and_results() -> None:
    faults = []
    seen = 0
    for module in surface():
        for name, function, inherited in functions(module):
            seen += 1
            text = inspect.getdoc(function) or ""
            signature = inspect.signature(function)
            if inherited:
                continue
            faults += [
                f"{name}: {parameter} is not documented"
                for parameter in signature.parameters
                if parameter not in ("self", "cls")
                and not re.search(rf"\b{parameter}\b", text)
            ]
            silent = not re.search(r"^(Returns|Yields)\n-", text, re.MULTILINE)
            if silent and signature.return_annotation not in (
                None,
                "None",
                "NoReturn",
                inspect.Signature.empty,
            ):
                faults.append(f"{name}: what it returns is not documented")
    assert faults == []
    assert seen > 80  # the walk itself works


def test_the_surface_names_what_is_there_and_stands_on_the_page() -> None:
    page = (ROOT / "nodes" / "EXTENDING.md").read_text(encoding="utf-8")
    listed = set(
        re.findall(
            r"^\| `([\w.]+)` \|",
            page.partition("## The public surface")[2],
            re.MULTILINE,
        )
    )
    assert listed == {module.__name__ for module in surface()}
    for module in surface():
        assert [name for name in module.__all__ if not hasattr(module, name)] == []
