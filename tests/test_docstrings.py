"""Every public function has a docstring that names each argument, and every module tells its reason (python-control's rule)."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any

import messages
import nodes
import sim

INTERNAL = ("nodes.tick.kernels.", "sim.device.tick.device.", "sim.device.tick.kernel.")
"""What is called by its own room only gets a sentence: nobody else can call a compiled kernel."""


def modules() -> Iterator[ModuleType]:
    for package in (messages, nodes, sim):
        yield package
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if found.name not in ("nodes.__main__",):  # starts a node when imported as a program; has no functions
                yield importlib.import_module(found.name)


def own(module: ModuleType) -> Iterator[tuple[str, Any]]:
    for name, thing in vars(module).items():
        if not name.startswith("_") and getattr(thing, "__module__", None) == module.__name__:
            yield f"{module.__name__}.{name}", thing


def functions(module: ModuleType) -> Iterator[tuple[str, FunctionType]]:
    for name, thing in own(module):
        thing = inspect.unwrap(getattr(thing, "py_func", thing))
        if isinstance(thing, FunctionType):
            # A compiled form of a private function is as private as that.
            if not thing.__name__.startswith("_"):
                yield name, thing
        elif inspect.isclass(thing):
            for member, value in vars(thing).items():
                value = getattr(value, "__func__", value)
                if isinstance(value, property):
                    assert value.fget is not None
                    value = value.fget
                # A function that is a field's default is documented where it is defined.
                defined_here = getattr(value, "__qualname__", "") == f"{thing.__qualname__}.{member}"
                if not member.startswith("_") and isinstance(value, FunctionType) and defined_here:
                    yield f"{name}.{member}", value


def test_every_module_tells_its_reason() -> None:
    silent = [module.__name__ for module in modules() if len((module.__doc__ or "").strip()) < 20]
    assert silent == []


def test_every_public_function_documents_each_argument() -> None:
    faults = []
    seen = 0
    for module in modules():
        for name, function in functions(module):
            seen += 1
            text = inspect.getdoc(function) or ""
            if not text:
                faults.append(f"{name}: no docstring")
                continue
            if name.startswith(INTERNAL):
                continue
            for parameter in inspect.signature(function).parameters.values():
                if parameter.name in ("self", "cls"):
                    continue
                if parameter.name not in text:
                    faults.append(f"{name}: {parameter.name} is not documented")
            returns = inspect.signature(function).return_annotation
            is_property = any(
                isinstance(v, property) and v.fget is function for v in vars(_owner(module, name)).values()
            )
            silent = not is_property and "Returns" not in text and "Yields" not in text
            if silent and returns not in (None, "None", "NoReturn", inspect.Signature.empty):
                faults.append(f"{name}: what it returns is not documented")
    assert faults == []
    assert seen > 300  # the walk itself works


def _owner(module: ModuleType, name: str) -> Any:
    parts = name.removeprefix(module.__name__ + ".").split(".")
    return vars(module)[parts[0]] if len(parts) > 1 else module


def test_every_public_class_has_a_docstring() -> None:
    silent = [
        name
        for module in modules()
        for name, thing in own(module)
        if inspect.isclass(thing) and not inspect.getdoc(thing)
    ]
    assert silent == []
